"""The result of a job: everything the report and the output files are made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pcwlad_geo.correction.accuracy import Accuracy
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.requirements import RequirementResult

if TYPE_CHECKING:
    from pcwlad_geo.registration.inputs import InputFile
    from pcwlad_geo.registration.match_record import MatchRecord
    from pcwlad_geo.registration.quality import Quality
    from pcwlad_geo.registration.rpc_target import RpcRegistration

Status = Literal["registered", "rejected", "matched"]


@dataclass(frozen=True, slots=True)
class Prealignment:
    """The rough alignment that the matching started from."""

    method: str
    """georeferencing, search, none, or identity (neither is georeferenced)."""
    shift_px: tuple[float, float]
    """(col, row) added to the predicted target pixel, matching-grid px."""
    search_radius_px: int
    """Radius of the coarse match around it, matching-grid px."""
    searched: bool = False
    """Whether the whole image was searched, also where that found nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """What a job found, written or not."""

    status: Status
    reason: str | None
    """Why it was rejected; None otherwise."""
    warnings: tuple[str, ...]
    reference: RasterInfo
    target: RasterInfo
    matching_grid: Grid
    px_m: tuple[float, float] | None
    """Size of a target pixel (col, row) on the ground in the middle of the overlap, metres;
    None without a CRS."""
    prealignment: Prealignment
    tie_points: TiePointTable
    correction: Correction | None
    """None where rejected, or only matched."""
    accuracy: dict[str, Accuracy]
    """Residuals: keys fit_px, check_px, fit_m, check_m (px = target px)."""
    counts: dict[str, int]
    """Candidates and what became of them, stage by stage, in order."""
    seconds: dict[str, float]
    settings: Settings
    selection: Selection | None = None
    """How the correction was chosen, and its precision anywhere; None where there is none."""
    rpc: RpcRegistration | None = None
    """The target's RPC, where that places it."""
    quality: Quality | None = None
    """How good the registration is, or why it was rejected after the fit; None where nothing was fitted."""
    record: MatchRecord | None = None
    """What the matching did where; None where that is not known."""
    requirements: tuple[RequirementResult, ...] = ()
    """What became of each requirement."""
    inputs: tuple[InputFile, ...] = ()
    """The files that the job read, as they were before it opened any of them."""

    @property
    def passed(self) -> bool | None:
        """Whether all requirements are met; None where nothing was required."""
        return all(each.met for each in self.requirements) if self.requirements else None
