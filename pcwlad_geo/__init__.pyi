from .band_warping import WarpOptions, warp
from .correction.error_statistics import Accuracy
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
from .job import match_files
from .matching.matcher import match_arrays
from .matching.types import MatchSettings
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
from .objects.by_hand import affine, projective, shift, similarity
from .objects.correction import Correction
from .objects.registration import Registration
from .objects.steps import fit, load, match, open, register
from .objects.tie_points import TiePoints
from .options import Options, PairOptions, Settings
from .proving import prove
from .raster.arrays import DataArrayLike, RasterLike
from .raster.grid import Grid
from .raster.raster import Raster
from .raster.source import RasterInfo
from .raster.trust.permissions import Trust
from .registration.decision import Decision
from .registration.quality import Quality
from .registration.result import Matches, Pair
from .registration.starts.alignment import Prealignment
from .registration.starts.pose import Pose
from .requirements import RequirementResult
from .rigs.applying import CaptureOutcome
from .rigs.applying_run import RigApplied, rig_apply
from .rigs.learning_run import rig_learn
from .rigs.rig import Rig, RigLens
from .shifting import shift_files
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
    "affine",
    "batch",
    "fit",
    "load",
    "match",
    "match_arrays",
    "match_files",
    "open",
    "projective",
    "prove",
    "qa",
    "register",
    "rig_apply",
    "rig_learn",
    "shift",
    "shift_files",
    "similarity",
    "stack",
    "stack_add",
    "warp",
    "watch",
]
