from .api import fit, match, open_pair
from .band_warping import WarpOptions, warp
from .correction.error_statistics import Accuracy
from .correction.models import Correction
from .correction.proof_result import Proof
from .errors import (
    CancelledError,
    ExecutionError,
    InputError,
    OutputError,
    PcwladGeoError,
    RegistrationRejectedError,
    RequirementError,
    SettingsError,
)
from .events import Event, EventCallback, Progress, Warned
from .execution.runner import Runner
from .fitted_correction import FittedCorrection
from .job import match_files, register
from .matching.matcher import match_arrays
from .matching.types import MatchSettings, TiePoints
from .multi.batch.run import BatchResult, batch
from .multi.qa.band_pairs import PairResult
from .multi.qa.numbers import QaResult
from .multi.qa.run import qa
from .multi.stack.adding import stack_add
from .multi.stack.pair import StackPair
from .multi.stack.quality import StackQuality
from .multi.stack.result import Stack, StackImage
from .multi.stack.run import stack
from .multi.watch.numbers import WatchNumbers
from .multi.watch.run import watch
from .options import Options, PairOptions, Settings
from .proving import prove
from .raster.arrays import DataArrayLike, Raster, RasterLike
from .raster.grid import Grid
from .raster.source import RasterInfo
from .raster.trust.permissions import Trust
from .registration.decision import Decision
from .registration.quality import Quality
from .registration.result import Matches, Pair, Registration
from .registration.starts.alignment import Prealignment
from .registration.starts.pose import Pose
from .requirements import RequirementResult
from .rigs.applying import CaptureOutcome
from .rigs.applying_run import RigApplied, rig_apply
from .rigs.learning_run import rig_learn
from .rigs.rig import Rig, RigLens
from .shifting import shift
from .tiepoints.table import TiePointTable

__version__: str
__all__ = [
    "Accuracy",
    "BatchResult",
    "CancelledError",
    "CaptureOutcome",
    "Correction",
    "DataArrayLike",
    "Decision",
    "Event",
    "EventCallback",
    "ExecutionError",
    "FittedCorrection",
    "Grid",
    "InputError",
    "MatchSettings",
    "Matches",
    "Options",
    "OutputError",
    "Pair",
    "PairOptions",
    "PairResult",
    "PcwladGeoError",
    "Pose",
    "Prealignment",
    "Progress",
    "Proof",
    "QaResult",
    "Quality",
    "Raster",
    "RasterInfo",
    "RasterLike",
    "Registration",
    "RegistrationRejectedError",
    "RequirementError",
    "RequirementResult",
    "Rig",
    "RigApplied",
    "RigLens",
    "Runner",
    "Settings",
    "SettingsError",
    "Stack",
    "StackImage",
    "StackPair",
    "StackQuality",
    "TiePointTable",
    "TiePoints",
    "Trust",
    "Warned",
    "WarpOptions",
    "WatchNumbers",
    "__version__",
    "batch",
    "fit",
    "match",
    "match_arrays",
    "match_files",
    "open_pair",
    "prove",
    "qa",
    "register",
    "rig_apply",
    "rig_learn",
    "shift",
    "stack",
    "stack_add",
    "warp",
    "watch",
]
