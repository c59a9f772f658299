"""Sub-pixel registration of multimodal rasters.

`open_pair`, `match` and `fit` are the steps of a registration, and `FittedCorrection.warp` applies what they
find; they take files, open datasets, arrays and xarray.DataArrays. `register` and `match_files` do a whole
job, files in, folder out, and `batch` does many; `stack` brings many images of one ground into one frame;
`warp` applies what `register` has found to other bands; `qa` measures how well the bands of a scene lie on
each other; `match_arrays` takes two arrays and gives their tie points. The heavy libraries load when a name
is first used, so that ``pcwlad-geo --help`` answers at once.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from pcwlad_geo.errors import (
    CancelledError,
    ExecutionError,
    InputError,
    OutputError,
    PcwladGeoError,
    RegistrationRejectedError,
    RequirementError,
    SettingsError,
)

if TYPE_CHECKING:
    from pcwlad_geo.api import FittedCorrection, fit, match, open_pair
    from pcwlad_geo.band_warping import WarpOptions, warp
    from pcwlad_geo.bandqa.bands import PairResult
    from pcwlad_geo.bandqa.run import qa
    from pcwlad_geo.bandqa.summary import QaResult
    from pcwlad_geo.batches import BatchResult, batch
    from pcwlad_geo.correction.error_statistics import Accuracy
    from pcwlad_geo.correction.models import Correction
    from pcwlad_geo.events import Event, EventCallback, Progress, Warned
    from pcwlad_geo.execution.runner import Runner
    from pcwlad_geo.job import Options, PairOptions, match_files, register
    from pcwlad_geo.matching.matcher import match_arrays
    from pcwlad_geo.matching.types import MatchSettings, TiePoints
    from pcwlad_geo.options import Settings
    from pcwlad_geo.raster.arrays import DataArrayLike, Raster, RasterLike
    from pcwlad_geo.raster.grid import Grid
    from pcwlad_geo.raster.source import RasterInfo
    from pcwlad_geo.raster.trust import Trust
    from pcwlad_geo.registration.fitting import Quality
    from pcwlad_geo.registration.judge import Verdict
    from pcwlad_geo.registration.prealign import Pose, Prealignment
    from pcwlad_geo.registration.result import Matches, Pair, Registration
    from pcwlad_geo.requirements import RequirementResult
    from pcwlad_geo.rigs.applying import CaptureOutcome
    from pcwlad_geo.rigs.rig import Rig, RigLens
    from pcwlad_geo.rigs.run import RigApplied, rig_apply, rig_learn
    from pcwlad_geo.stacks.cycles import StackQuality
    from pcwlad_geo.stacks.pairs import StackPair
    from pcwlad_geo.stacks.result import Stack, StackImage
    from pcwlad_geo.stacks.run import stack, stack_add
    from pcwlad_geo.tiepoints.table import TiePointTable

__version__ = "0.1.0"

__all__ = [
    "Accuracy",
    "BatchResult",
    "CancelledError",
    "CaptureOutcome",
    "Correction",
    "DataArrayLike",
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
    "Verdict",
    "Warned",
    "WarpOptions",
    "__version__",
    "batch",
    "fit",
    "match",
    "match_arrays",
    "match_files",
    "open_pair",
    "qa",
    "register",
    "rig_apply",
    "rig_learn",
    "stack",
    "stack_add",
    "warp",
]

_NAMES = {
    "api": ("FittedCorrection", "fit", "match", "open_pair"),
    "band_warping": ("WarpOptions", "warp"),
    "bandqa.bands": ("PairResult",),
    "bandqa.run": ("qa",),
    "bandqa.summary": ("QaResult",),
    "batches": ("BatchResult", "batch"),
    "correction.error_statistics": ("Accuracy",),
    "correction.models": ("Correction",),
    "events": ("Event", "EventCallback", "Progress", "Warned"),
    "execution.runner": ("Runner",),
    "job": ("Options", "PairOptions", "match_files", "register"),
    "matching.matcher": ("match_arrays",),
    "matching.types": ("MatchSettings", "TiePoints"),
    "options": ("Settings",),
    "raster.arrays": ("DataArrayLike", "Raster", "RasterLike"),
    "raster.grid": ("Grid",),
    "raster.source": ("RasterInfo",),
    "raster.trust": ("Trust",),
    "registration.fitting": ("Quality",),
    "registration.judge": ("Verdict",),
    "registration.prealign": ("Pose", "Prealignment"),
    "registration.result": ("Matches", "Pair", "Registration"),
    "requirements": ("RequirementResult",),
    "rigs.applying": ("CaptureOutcome",),
    "rigs.rig": ("Rig", "RigLens"),
    "rigs.run": ("RigApplied", "rig_apply", "rig_learn"),
    "stacks.cycles": ("StackQuality",),
    "stacks.pairs": ("StackPair",),
    "stacks.result": ("Stack", "StackImage"),
    "stacks.run": ("stack", "stack_add"),
    "tiepoints.table": ("TiePointTable",),
}
_HOMES = {name: f"pcwlad_geo.{module}" for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
