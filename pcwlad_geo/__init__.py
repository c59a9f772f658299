"""Sub-pixel registration of multimodal rasters.

`register` and `match` do a whole job, files in, folder out, and `batch` does many; `warp` applies what
`register` has found to other bands; `qa` measures how well the bands of a stack lie on each other;
`match_arrays` takes two arrays and gives their tie points. The heavy
libraries load when a name is first used, so that ``pcwlad-geo --help`` answers at once.
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
    from pcwlad_geo.bands import warp
    from pcwlad_geo.batches.run import batch
    from pcwlad_geo.matching.matcher import match_arrays
    from pcwlad_geo.matching.tie_points import TiePoints
    from pcwlad_geo.registration.result import Registration
    from pcwlad_geo.registration.settings import Settings
    from pcwlad_geo.stacks.run import qa
    from pcwlad_geo.workflow import match, register

__version__ = "0.1.0"

__all__ = [
    "CancelledError",
    "ExecutionError",
    "InputError",
    "OutputError",
    "PcwladGeoError",
    "Registration",
    "RegistrationRejectedError",
    "RequirementError",
    "Settings",
    "SettingsError",
    "TiePoints",
    "__version__",
    "batch",
    "match",
    "match_arrays",
    "qa",
    "register",
    "warp",
]

_HOMES = {
    "Registration": "pcwlad_geo.registration.result",
    "Settings": "pcwlad_geo.registration.settings",
    "TiePoints": "pcwlad_geo.matching.tie_points",
    "batch": "pcwlad_geo.batches.run",
    "match": "pcwlad_geo.workflow",
    "match_arrays": "pcwlad_geo.matching.matcher",
    "qa": "pcwlad_geo.stacks.run",
    "register": "pcwlad_geo.workflow",
    "warp": "pcwlad_geo.bands",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
