from .band_warping import warp
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
from .events import Progress, Warned
from .multi.batch.run import batch
from .multi.qa.run import qa
from .multi.stack.adding import stack_add
from .multi.stack.result import Stack
from .multi.stack.run import stack
from .multi.watch.run import watch
from .objects.by_hand import affine, projective, shift, similarity
from .objects.correction import Correction
from .objects.registration import Registration
from .objects.steps import fit, load, match, open, register
from .objects.tie_points import TiePoints
from .proving import prove
from .raster.grid import Grid
from .raster.raster import Raster
from .rigs.applying_run import rig_apply
from .rigs.learning_run import rig_learn
from .rigs.rig import Rig
from .shifting import shift_files

__version__: str
__all__ = [
    "CancelledError",
    "Correction",
    "ExecutionError",
    "Grid",
    "InputError",
    "OutputError",
    "PcwladGeoError",
    "Progress",
    "Raster",
    "Registration",
    "RegistrationRejectedError",
    "RequirementError",
    "Rig",
    "SettingsError",
    "Stack",
    "TiePoints",
    "Warned",
    "__version__",
    "affine",
    "batch",
    "fit",
    "load",
    "match",
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
