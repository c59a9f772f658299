"""What the steps of `registration.run` hand on, from two files to the verdict.

A `Pair` are two rasters ready to be matched, `Matches` are its tie points before any fit, and a
`Registration` is the result. The `MatchRecord` tells where the matching looked and what it lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.dense import positions
from pcwlad_geo.correction.error_statistics import Accuracy, Proof
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.epipolar import EpipolarGeometry, plane_residual_px
from pcwlad_geo.matching.gaps import narrow_gaps
from pcwlad_geo.matching.keypoints import Candidates
from pcwlad_geo.matching.types import MatchSettings
from pcwlad_geo.matching.windows import Scales
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.file_tree import file_name
from pcwlad_geo.raster.grid import Grid, Window
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.rpc.ortho import RpcPlacement
from pcwlad_geo.raster.source import RasterInfo, bands_of, has_quick_overview
from pcwlad_geo.registration.inputs import InputFile
from pcwlad_geo.registration.judge import Verdict
from pcwlad_geo.registration.motions import Motion
from pcwlad_geo.registration.planning import MIN_TEXTURE, texture_of
from pcwlad_geo.registration.point_file import Origin
from pcwlad_geo.registration.prealign import Overviews, Prealignment, direct_start, searches_first
from pcwlad_geo.registration.quality import Doubt, Quality
from pcwlad_geo.registration.rpc import RpcRegistration
from pcwlad_geo.registration.tiles import TileJob, TileResult
from pcwlad_geo.requirements import RequirementResult
from pcwlad_geo.text import Shown, html_table, one_line
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64

GROUND: Final = ("usable", "no_texture", "edge", "reference_without_data", "target_without_data")
"""Whether a place can be matched: `no_texture` has faint contrast at most in one of the two, `edge` too many
pixels without data within a window around it."""
BARE_TEXTURE: Final = 0.2
"""Contrast weight of a band below which a place shows no structure: 0.09 of water with noise, 0.9 of land."""
LATTICE_SIDE: Final = 120
"""Along the longer side of the reference, where that is asked."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchRecord:
    """What the matching did where, in px (col, row) of the reference file."""

    ground: NDArray[np.uint8]
    """(rows, cols) index into `GROUND` of places spread evenly over the reference."""
    windows_px: Float64
    """(k, 4) col, row, col_stop, row_stop of the parts whose corners were candidates."""
    unread: Bool
    """(k,) whether such a part could not be read."""
    without_structure_px: Float64
    """(b, 4) likewise, the parts left out for want of structure."""
    lost: Candidates
    """The candidates that gave no match; positions in reference px."""
    thinned_px: Float64 = field(default_factory=lambda: np.empty((0, 2)))
    """(t, 2) tie points left out because fewer were wanted."""
    bare: Bool | None = None
    """(rows, cols) whether neither band shows structure at these places; None where that is not known."""

    def common_px(self, shape: tuple[int, int], *, bare: bool) -> Float64:
        """Return (n, 2) places (col, row) spread over a reference of this shape that both bands show.

        They are the `bare` ones, such as water, or all others.
        """
        places, _ = _places(shape)
        common = self.ground.ravel() < GROUND.index("reference_without_data")
        is_bare = np.zeros(len(places), bool) if self.bare is None else self.bare.ravel()
        chosen: Float64 = places[common & (is_bare == bare)]
        return chosen

    @property
    def searched(self) -> bool:
        """Whether anything was matched; the points are another's otherwise."""
        return len(self.windows_px) > 0


def record_matching(
    pair: ViewPair,
    overviews: Overviews,
    target_offset_px: tuple[int, int],
    settings: MatchSettings,
    without_structure: Sequence[Window],
    jobs: Sequence[TileJob],
    results: Sequence[TileResult],
) -> MatchRecord:
    """Record the first pass of a scene.

    The `target_offset_px` (col, row) leads from reference view to target view, pre-alignment included;
    `without_structure` are parts of the reference view without a tile. The results are in the order of the
    jobs.
    """
    side = max(settings.template, settings.window)  # of the first pass
    patches = overviews.reference, overviews.target
    textures = [texture_of(patch, of.epsilon) for patch, of in zip(patches, overviews.scenes, strict=True)]
    contents = [
        _Content(patch.valid, texture >= MIN_TEXTURE, texture >= BARE_TEXTURE)
        for patch, texture in zip(patches, textures, strict=True)
    ]
    ground = _ground(pair, contents, overviews.factor, target_offset_px, side, settings.least_valid)
    lost = Candidates.concatenate([result.lost for result in results])
    return MatchRecord(
        ground,
        _boxes(pair, [job.core for job in jobs]),
        np.array([result.status == "failed" for result in results], dtype=bool),
        _boxes(pair, without_structure),
        Candidates(pair.reference.to_file_px(lost.reference_xy_px), lost.outcome),
        bare=_bare(pair, contents, overviews.factor, target_offset_px),
    )


def record_ground(pair: ViewPair) -> MatchRecord | None:
    """Record where a pair can be compared at all, without any matching.

    None where that would take long or cannot be read.
    """
    views = pair.reference, pair.target
    factor = max(1.0, max(side for view in views for side in view.grid.shape) / 512)
    try:
        if not all(has_quick_overview(view.info) for view in views):
            return None
        masks = [view.reduced(factor).valid for view in views]
    except InputError:
        return None
    col, row = pair.offset_px
    contents = [_Content(valid, np.ones_like(valid), np.ones_like(valid)) for valid in masks]
    ground = _ground(pair, contents, factor, (round(col), round(row)), 1, 0.5)
    nothing = np.empty((0, 4))
    return MatchRecord(ground, nothing, np.empty(0, bool), nothing, Candidates.empty())


@dataclass(frozen=True, slots=True, eq=False)
class _Content:
    """A band made small."""

    valid: Bool
    textured: Bool
    structured: Bool
    """Whether there is more than what is left of noise, waves and haze."""


def _ground(
    pair: ViewPair,
    contents: Sequence[_Content],
    factor: float,
    target_offset_px: tuple[int, int],
    window_px: int,
    least_valid: float,
) -> NDArray[np.uint8]:
    """Tell, for places spread over the reference, whether both bands show something there and around.

    `contents` are of the reference and the target, `factor` view px a pixel of theirs.
    """
    places, shape = _places(pair.reference.info.grid.shape)
    with np.errstate(invalid="ignore"):
        at = pair.reference.from_file_px(places) / factor
    at_target = at + np.asarray(target_offset_px) / factor
    reference, target = contents
    here, there = _value_at(reference.valid, at), _value_at(target.valid, at_target)
    # a resampled view of the reference ends a little beyond what the target covers
    inside = _value_at(np.ones_like(reference.valid), at)
    textured = _value_at(reference.textured, at) & _value_at(target.textured, at_target)
    seen = [each.valid | narrow_gaps(each.valid, factor) for each in contents]
    around = cv2.blur(
        (_value_at(seen[0], at) & _value_at(seen[1], at_target)).reshape(shape).astype(np.float32),
        _odd_sides(pair, window_px, shape),
        borderType=cv2.BORDER_CONSTANT,
    )
    reasons = [inside & ~here, ~(inside & there), around.ravel() < least_valid, ~textured]
    names = ("reference_without_data", "target_without_data", "edge", "no_texture")
    ground = np.select(reasons, [GROUND.index(name) for name in names], default=0)
    return ground.reshape(shape).astype(np.uint8)


def _bare(
    pair: ViewPair, contents: Sequence[_Content], factor: float, target_offset_px: tuple[int, int]
) -> Bool:
    """Tell, for the places of `_ground`, whether neither band shows structure there."""
    places, shape = _places(pair.reference.info.grid.shape)
    with np.errstate(invalid="ignore"):
        at = pair.reference.from_file_px(places) / factor
    at_target = at + np.asarray(target_offset_px) / factor
    reference, target = contents
    bare = ~_value_at(reference.structured, at) & ~_value_at(target.structured, at_target)
    return np.asarray(bare.reshape(shape))


def _places(frame: tuple[int, int]) -> tuple[Float64, tuple[int, int]]:
    """Return the middles of about square places of a frame (rows, cols), and how many there are."""
    step = max(1.0, max(frame) / LATTICE_SIDE)
    rows, cols = (max(1, round(side / step)) for side in frame)
    down = (np.arange(rows) + 0.5) * frame[0] / rows
    across = (np.arange(cols) + 0.5) * frame[1] / cols
    return positions(across, down), (rows, cols)


def _odd_sides(pair: ViewPair, window_px: int, shape: tuple[int, int]) -> tuple[int, int]:
    """Return the sides (across, down) of a window of the view, in places, odd."""
    rows, cols = pair.reference.info.grid.shape
    reach = pair.reference.to_file_px(np.array([[0.0, 0.0], [window_px, window_px]]))
    sides_px = np.abs(np.diff(reach, axis=0)[0])
    half = np.floor(sides_px * [shape[1] / cols, shape[0] / rows] / 2)
    across, down = (2 * np.nan_to_num(half) + 1).astype(int).tolist()
    return across, down


def _value_at(mask: Bool, xy: Float64) -> Bool:
    """Return (n,) the value of a mask at positions (col, row); False outside."""
    known: Bool = np.asarray(np.isfinite(xy).all(axis=1))
    col, row = np.floor(np.where(known[:, None], xy, -1.0)).astype(np.intp).T
    rows, cols = mask.shape
    inside = known & (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    found = np.zeros(len(xy), dtype=bool)
    found[inside] = mask[row[inside], col[inside]]
    return found


def _boxes(pair: ViewPair, windows: Sequence[Window]) -> Float64:
    """Return (k, 4) the boxes around windows of the reference view, px of its file."""
    if not windows:
        return np.empty((0, 4))
    edges = np.array([(each.col, each.row, each.col_stop, each.row_stop) for each in windows], np.float64)
    parts = np.linspace(0.0, 1.0, 5)
    places = edges[:, None, :2] + positions(parts, parts) * (edges[:, None, 2:] - edges[:, None, :2])
    mapped = pair.reference.to_file_px(places.reshape(-1, 2)).reshape(places.shape)
    # corners of a view of the ground may have no place in the file: fmin and fmax leave those out
    return np.concatenate([np.fmin.reduce(mapped, axis=1), np.fmax.reduce(mapped, axis=1)], axis=1)


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
    verdict: Verdict
    """Whether the pair is matched reliably, and by what evidence."""
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
    frame_doubt: str | None = None
    """Why they may belong to the frames, not to the ground (`frame_evidence`); None where nothing says so."""
    job: TileJob | None = None
    """One of the tiles, as all were matched; None for points of a file."""
    scales: Scales | None = None
    """The windows of the last pass; None where there was none."""
    origin: Origin | None = None
    """Of points of a file; None of those that were matched here."""
    roles: NDArray[np.str_] | None = None
    """(n,) what an earlier fit used the points of a file for; None where that is to be chosen."""
    doubts: tuple[Doubt, ...] = ()
    """What speaks against the displacement taken."""
    warnings: tuple[str, ...] = ()
    """Of all steps up to this one."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Likewise, by stage."""

    def __len__(self) -> int:
        return int(np.count_nonzero(self.tie_points.status != "rejected"))

    @property
    def accepted(self) -> bool:
        """Whether the tie points can be trusted, so that a correction may be fitted."""
        return self.verdict.accepted

    @property
    def reason(self) -> str | None:
        """Why not, and what to do; None where they can."""
        if self.verdict.reason is None or self.pair.rpc is None:
            return self.verdict.reason
        return (
            f"{self.verdict.reason}; check also that the RPC in {self.pair.rpc.source.origin} belongs to the "
            "target as it is, not to an image that it was cropped or decimated from"
        )

    def _more(self) -> dict[str, str]:
        return {"warnings": "; ".join(self.warnings) or "none"}

    def _facts(self) -> dict[str, str]:
        used = self.tie_points.select("matched")
        facts = {"status": "accepted" if self.accepted else f"rejected: {self.reason}"}
        asked = self.counts.get("candidates", len(self.every))
        facts["tie points"] = f"{len(used)} tie points of {asked} candidates"
        if len(used):
            facts["sigma"] = f"sigma {np.sqrt((used.sigma_px**2).mean()):.2f} px"
            d_col, d_row = np.median(used.displacement_px, axis=0)
            facts["displacement"] = f"displacement ({d_col:+.2f}, {d_row:+.2f}) px (col, row)"
        return facts


def _band_text(info: RasterInfo) -> str:
    rows, cols = info.grid.shape
    return f"{file_name(info.uri)} {bands_of(info).text} ({cols} x {rows} px)"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Registration(Shown):
    """What a job found, written or not."""

    status: RegistrationStatus
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
    geometry: PairGeometry = PairGeometry("planar")
    """By what the tie points were told from wrong matches."""
    motions: tuple[Motion, ...] = ()
    """What parts of the matches agree on, if more than one displacement; the one taken comes first."""
    jitter_px: float = 0.0
    """By how much rows and columns move within a window, RMS, target px; 0 where that is not seen."""
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
    window_px: int | None = None
    """Side of the window that the tie points were refined with, matching-grid px; None: not known."""
    origin: Origin | None = None
    """Of tie points of a file; None of those that were matched."""
    proof: Proof | None = None
    """The tool's own error on the pair, where that was asked for."""
    outputs: Mapping[str, Path] = field(default_factory=dict)
    """The files written, by kind: raster, report, tiepoints, and so on; none where nothing was."""

    def _more(self) -> dict[str, str]:
        outputs = ", ".join(map(str, self.outputs.values())) or "none"
        return {"warnings": "; ".join(self.warnings) or "none", "outputs": outputs}

    def _facts(self) -> dict[str, str]:
        facts = {"status": self.status if self.reason is None else f"{self.status}: {self.reason}"}
        pair = f"{_band_text(self.reference)} <- {_band_text(self.target)}"
        facts |= {"pair": pair, "tie points": self.tie_points.summary()}
        if self.correction is not None:
            facts["model"] = self.correction.name
        checked = self.accuracy.get("check_px")
        if checked is not None and checked.n:
            facts["accuracy"] = f"RMSE {checked.rmse:.2f} px at {checked.n} check points"
        if self.quality is not None:
            facts["quality"] = f"quality {self.quality.grade}"
        return facts

    @property
    def passed(self) -> bool | None:
        """Whether all requirements are met; None where nothing was required."""
        return all(each.met for each in self.requirements) if self.requirements else None
