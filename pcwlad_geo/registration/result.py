"""What the steps of a registration hand on.

A `Pair` are two rasters ready to be matched, `Matches` are its tie points before any fit, and a
`Registration` is the result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.error_statistics import FitAccuracy
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.matching import Scales
from pcwlad_geo.matching.epipolar import EpipolarGeometry, plane_residual_px
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid, RasterInfo, RpcPlacement, ViewPair, file_name
from pcwlad_geo.raster.source import bands_of
from pcwlad_geo.registration.decision import Decision
from pcwlad_geo.registration.inputs import InputFile
from pcwlad_geo.registration.match_record import MatchRecord
from pcwlad_geo.registration.motions import Motion
from pcwlad_geo.registration.point_file import Origin
from pcwlad_geo.registration.quality import Quality
from pcwlad_geo.registration.rpc import RpcRegistration
from pcwlad_geo.registration.starts.alignment import Prealignment, direct_start, searches_first
from pcwlad_geo.registration.tiles import TileJob
from pcwlad_geo.requirements import RequirementResult
from pcwlad_geo.text import Shown, html_table, one_line
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class PairGeometry:
    """What right matches of a pair have in common, by which the others were rejected."""

    name: Literal["planar", "epipolar"]
    """planar: a displacement that changes smoothly; epipolar: the lines of the target on which places of the
    reference lie whatever their depth, as in two perspective frames."""
    fundamental: tuple[tuple[float, float, float], ...] | None = None
    """Rows of the fundamental matrix F: (target col, row, 1) · F · (reference col, row, 1) = 0, px of the
    files, corner-based; null if planar."""
    across_px: float | None = None
    """RMS distance of the tie points from their lines, target px; null if planar."""
    along_px: float | None = None
    """RMS displacement along the lines beside that of one plane, the parallax, target px; null if planar."""

    @staticmethod
    def of(table: TiePointTable, epipolar: bool) -> PairGeometry:
        """Return the geometry of the matched rows of a table."""
        points = table.select("matched")
        lines = EpipolarGeometry.of(points.reference_px, points.target_px) if epipolar else None
        if lines is None:
            return PairGeometry("planar")
        everyone = np.ones(len(points), bool)
        off_plane = plane_residual_px(points.reference_px, points.target_px, everyone)
        along = None if off_plane is None else (off_plane * lines.along(points.reference_px)).sum(axis=1)
        across = lines.distance_px(points.reference_px, points.target_px)
        return PairGeometry(
            "epipolar",
            tuple((row[0], row[1], row[2]) for row in lines.matrix.tolist()),
            _rms(across),
            None if along is None else _rms(along),
        )


def _rms(values: Float64) -> float:
    return float(np.sqrt((values**2).mean()))


RegistrationStatus = Literal["registered", "rejected", "matched"]


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two rasters made ready to be matched: where they lie, and on which pixels they are compared."""

    reference: RasterInfo
    target: RasterInfo
    """As the matching takes them: placed by an RPC, or in one plane, where the files alone do not tell."""
    views: ViewPair
    """Both on the pixels of the matching grid."""
    settings: Settings
    """All options; bands are numbers, masks those of the products where none is given."""
    warnings: tuple[str, ...]
    inputs: tuple[InputFile, ...]
    """The files that are read, as they were before any was opened."""
    seconds: dict[str, float]
    """Spent so far, by stage."""
    rpc: RpcPlacement | None = None
    """Of a target that its RPC places."""
    scratch: object = None
    """What keeps the files of arrays for as long as they are needed."""

    @property
    def georeferenced(self) -> bool:
        """Whether both have a place; otherwise their pixels are compared as they lie."""
        return self.views.georeferenced

    @property
    def matching_grid(self) -> Grid:
        """The grid of the pixels that are compared."""
        return self.views.reference.grid

    @property
    def prealignment(self) -> Prealignment | None:
        """What the matching starts from; None where a search over the whole image comes first."""
        return None if searches_first(self.views, self.settings) else direct_start(self.views, self.settings)

    def __repr__(self) -> str:
        pair = " <- ".join(map(_band_text, (self.reference, self.target)))
        return f"<Pair: {one_line(', '.join([pair, *self._facts()]))}>"

    def _repr_html_(self) -> str:
        rows, cols = self.matching_grid.shape
        start = self.prealignment
        return html_table(
            "Pair",
            {
                "reference": _band_text(self.reference),
                "target": _band_text(self.target),
                "georeferenced": "yes" if self.georeferenced else "no",
                "matching grid": f"{cols} x {rows} px",
                "starts from": start.method if start else "a search",
                "warnings": "; ".join(self.warnings) or "none",
            },
        )

    def _facts(self) -> list[str]:
        rows, cols = self.matching_grid.shape
        facts = [f"matching grid {cols} x {rows} px"]
        facts += [] if self.georeferenced else ["not georeferenced"]
        return facts + ([f"{len(self.warnings)} warnings"] if self.warnings else [])


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Matches(Shown):
    """The tie points of a pair, before any fit."""

    pair: Pair
    tie_points: TiePointTable
    """Status ``matched`` or ``rejected``; no more than were wanted."""
    decision: Decision
    """Whether the pair is matched reliably, by what evidence, and with what doubts."""
    counts: dict[str, int]
    """Candidates and what became of them, stage by stage, in order."""
    prealignment: Prealignment
    """What the matching started from."""
    record: MatchRecord | None
    """What the matching did where; None where that is not known."""
    views: ViewPair
    """On which they were found: a target with RPC is matched again as the first result places it."""
    every: TiePointTable
    """All tie points, also those that were not wanted."""
    window_px: int
    """Side of the window that they were refined with, matching-grid px; of a file's points, as asked for."""
    geometry: PairGeometry = PairGeometry("planar")
    """By what the tie points were told from wrong matches."""
    motions: tuple[Motion, ...] = ()
    """What parts of the matches agree on, if more than one displacement; the one taken comes first."""
    jitter_px: float = 0.0
    """By how much rows and columns move within a window, RMS, target px; 0 where that is not seen."""
    bend_px: float = 0.0
    """What windows average away of a displacement that bends within them, RMS, target px; 0 where that is
    not known."""
    job: TileJob | None = None
    """One of the tiles, as all were matched; None for points of a file."""
    scales: Scales | None = None
    """The windows of the last pass; None where there was none."""
    frames: object = None
    """What keeps the files that were matched, where they are no longer those of the pair."""
    origin: Origin | None = None
    """Of points of a file; None of those that were matched here."""
    roles: NDArray[np.str_] | None = None
    """(n,) what an earlier fit used the points of a file for; None where that is to be chosen."""
    warnings: tuple[str, ...] = ()
    """Of all steps up to this one."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Likewise, by stage."""

    def __len__(self) -> int:
        return int(np.count_nonzero(self.tie_points.status != "rejected"))

    @property
    def accepted(self) -> bool:
        """Whether the tie points can be trusted, so that a correction may be fitted."""
        return self.decision.accepted

    @property
    def reason(self) -> str | None:
        """Why not, and what to do; None where they can."""
        return self.decision.refusal

    def _more(self) -> dict[str, str]:
        return {"warnings": "; ".join(self.warnings) or "none"}

    def _facts(self) -> dict[str, str]:
        points = self.tie_points.select("matched")
        facts = {"status": "accepted" if self.accepted else f"rejected: {self.reason}"}
        candidates = self.counts.get("candidates", len(self.every))
        facts["tie points"] = f"{len(points)} tie points of {candidates} candidates"
        if len(points):
            facts["sigma"] = f"sigma {np.sqrt((points.sigma_px**2).mean()):.2f} px"
            d_col, d_row = np.median(points.displacement_px, axis=0)
            facts["displacement"] = f"displacement ({d_col:+.2f}, {d_row:+.2f}) px (col, row)"
        return facts


def _band_text(info: RasterInfo) -> str:
    rows, cols = info.grid.shape
    return f"{file_name(info.uri)} {bands_of(info).text} ({cols} x {rows} px)"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Registration(Shown):
    """What a job found, written or not."""

    decision: Decision
    """Whether it was registered, and all that speaks for and against it."""
    warnings: tuple[str, ...]
    reference: RasterInfo
    target: RasterInfo
    matching_grid: Grid
    px_m: tuple[float, float] | None
    """Size of a target pixel (col, row) on the ground in the middle of the overlap, metres;
    None without a CRS."""
    prealignment: Prealignment
    tie_points: TiePointTable
    model: Correction | None
    """The correction; None where rejected, or only matched."""
    accuracy: FitAccuracy
    """Of the residuals, in target px and metres; empty without a correction."""
    counts: dict[str, int]
    """Candidates and what became of them, stage by stage, in order."""
    seconds: dict[str, float]
    settings: Settings
    selection: Selection | None = None
    """How the correction was chosen, and its precision anywhere, also where the fit was refused; None where
    nothing was fitted."""
    geometry: PairGeometry = PairGeometry("planar")
    """By what the tie points were told from wrong matches."""
    motions: tuple[Motion, ...] = ()
    """What parts of the matches agree on, if more than one displacement; the one taken comes first."""
    jitter_px: float = 0.0
    """By how much rows and columns move within a window, RMS, target px; 0 where that is not seen."""
    bend_px: float = 0.0
    """What windows average away of a displacement that bends within them, RMS, target px; 0 where that is
    not known."""
    rpc: RpcRegistration | None = None
    """The target's RPC, where that places it."""
    record: MatchRecord | None = None
    """What the matching did where; None where that is not known."""
    inputs: tuple[InputFile, ...] = ()
    """The files that the job read, as they were before it opened any of them."""
    window_px: int | None = None
    """Side of the window that the tie points were refined with, matching-grid px; None: not known."""
    origin: Origin | None = None
    """Of tie points of a file; None of those that were matched."""
    proof: Proof | None = None
    """The tool's own error on the pair, where that was asked for."""
    fetched: RasterInfo | None = None
    """Of a reference from a web map: where its file lies until the output folder is complete."""
    outputs: Mapping[str, Path] = field(default_factory=dict)
    """The files written, by kind: raster, report, tiepoints, and so on; none where nothing was."""

    def fetched_to(self, place: Path) -> Registration:
        """Return it with the final place of a reference that was composed, as its files name it."""
        final, staged = str(place.absolute()), str(Path(self.reference.uri).absolute())
        inputs = tuple(
            replace(file, identity=replace(file.identity, path=final))
            if file.identity.path == staged
            else file
            for file in self.inputs
        )
        return replace(
            self, reference=replace(self.reference, uri=final), fetched=self.reference, inputs=inputs
        )

    def _more(self) -> dict[str, str]:
        outputs = ", ".join(map(str, self.outputs.values())) or "none"
        return {"warnings": "; ".join(self.warnings) or "none", "outputs": outputs}

    def _facts(self) -> dict[str, str]:
        facts = {"status": self.status if self.reason is None else f"{self.status}: {self.reason}"}
        pair = f"{_band_text(self.reference)} <- {_band_text(self.target)}"
        facts |= {"pair": pair, "tie points": self.tie_points.summary()}
        if self.model is not None:
            facts["model"] = self.model.name
        checked = self.accuracy.get("check_px")
        if checked is not None and checked.n:
            facts["accuracy"] = f"RMSE {checked.rmse:.2f} px at {checked.n} check points"
        if self.quality is not None:
            facts["quality"] = f"quality {self.quality.grade}"
        return facts

    @property
    def status(self) -> RegistrationStatus:
        """Whether the pair was registered, rejected, or only matched."""
        if not self.decision.accepted:
            return "rejected"
        return "matched" if self.model is None else "registered"

    @property
    def reason(self) -> str | None:
        """Why it was rejected; None otherwise."""
        return self.decision.refusal

    @property
    def quality(self) -> Quality | None:
        """How good it is, or why it was rejected after the fit; None where nothing was fitted."""
        return self.decision.quality

    @property
    def requirements(self) -> tuple[RequirementResult, ...]:
        """What became of each requirement."""
        return self.decision.requirements

    @property
    def missed(self) -> str:
        """The requirements that are not met, as a text."""
        return "; ".join(result.text for result in self.requirements if not result.met)

    @property
    def passed(self) -> bool | None:
        """Whether all requirements are met; None where nothing was required."""
        return self.decision.passed
