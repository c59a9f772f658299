"""Where the matching looked, what it lost, and which ground can be compared at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.dense import positions
from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import Candidates, MatchSettings
from pcwlad_geo.matching.gaps import narrow_gaps
from pcwlad_geo.raster import ViewPair, Window
from pcwlad_geo.raster.source import has_quick_overview
from pcwlad_geo.registration.planning import PlanParameters, texture_of
from pcwlad_geo.registration.starts.overviews import Overviews
from pcwlad_geo.registration.tiles import TileJob, TileResult
from pcwlad_geo.types import Bool, Float64

PLACE_STATES: Final = ("usable", "no_texture", "edge", "reference_without_data", "target_without_data")
"""Whether a place can be matched: `no_texture` has faint contrast at most in one of the two, `edge` too many
pixels without data within a window around it."""


@dataclass(frozen=True, slots=True)
class RecordParameters:
    """Numbers of the record of a matching."""

    plan: PlanParameters = field(default_factory=PlanParameters)
    """Those of the plan."""
    bare_texture: float = 0.2
    """Contrast weight of a band below which a place shows no structure: 0.09 of water with noise, 0.9 of
    land."""
    lattice_side: int = 120
    """Number of places along the longer side of the reference."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchRecord:
    """What the matching did where, in px (col, row) of the reference file."""

    ground: NDArray[np.uint8]
    """(rows, cols) index into `PLACE_STATES` of places spread evenly over the reference."""
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
        places = _middles(shape, self.ground.shape)
        common = self.ground.ravel() < PLACE_STATES.index("reference_without_data")
        is_bare = np.zeros(len(places), bool) if self.bare is None else self.bare.ravel()
        places_px: Float64 = places[common & (is_bare == bare)]
        return places_px

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
    parameters: RecordParameters = RecordParameters(),
) -> MatchRecord:
    """Record the first pass of a scene.

    The `target_offset_px` (col, row) leads from reference view to target view, pre-alignment included;
    `without_structure` are parts of the reference view without a tile. The results are in the order of the
    jobs.
    """
    side = max(settings.template, settings.window.side_px)  # of the first pass
    patches = overviews.reference, overviews.target
    textures = [
        texture_of(patch, scene.epsilon) for patch, scene in zip(patches, overviews.scenes, strict=True)
    ]
    contents = [
        _Content(patch.valid, texture >= parameters.plan.least_texture, texture >= parameters.bare_texture)
        for patch, texture in zip(patches, textures, strict=True)
    ]
    ground, bare = _ground(
        pair, contents, overviews.factor, target_offset_px, side, settings.least_valid, parameters
    )
    failures = Candidates.concatenate([result.lost for result in results])
    return MatchRecord(
        ground,
        _boxes(pair, [job.core for job in jobs]),
        np.array([result.status == "failed" for result in results], dtype=bool),
        _boxes(pair, without_structure),
        Candidates(pair.reference.to_file_px(failures.reference_xy_px), failures.outcome),
        bare=bare,
    )


def record_ground(pair: ViewPair, parameters: RecordParameters = RecordParameters()) -> MatchRecord | None:
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
    ground, _ = _ground(pair, contents, factor, (round(col), round(row)), 1, 0.5, parameters)
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
    parameters: RecordParameters,
) -> tuple[NDArray[np.uint8], Bool]:
    """Tell, for places spread over the reference, whether both bands show something there and around.

    The second array tells whether neither shows structure there. `contents` are of the reference and the
    target, `factor` view px a pixel of theirs.
    """
    places, shape = _places(pair.reference.info.grid.shape, parameters)
    with np.errstate(invalid="ignore"):
        at = pair.reference.from_file_px(places) / factor
    at_target = at + np.asarray(target_offset_px) / factor
    reference, target = contents
    in_reference, in_target = _value_at(reference.valid, at), _value_at(target.valid, at_target)
    # a resampled view of the reference ends a little beyond what the target covers
    inside = _value_at(np.ones_like(reference.valid), at)
    textured = _value_at(reference.textured, at) & _value_at(target.textured, at_target)
    usable = [content.valid | narrow_gaps(content.valid, factor) for content in contents]
    around = cv2.blur(
        (_value_at(usable[0], at) & _value_at(usable[1], at_target)).reshape(shape).astype(np.float32),
        _odd_sides(pair, window_px, shape),
        borderType=cv2.BORDER_CONSTANT,
    )
    reasons = [inside & ~in_reference, ~(inside & in_target), around.ravel() < least_valid, ~textured]
    names = ("reference_without_data", "target_without_data", "edge", "no_texture")
    ground = np.select(reasons, [PLACE_STATES.index(name) for name in names], default=0)
    bare = ~_value_at(reference.structured, at) & ~_value_at(target.structured, at_target)
    return ground.reshape(shape).astype(np.uint8), np.asarray(bare.reshape(shape))


def _places(frame: tuple[int, int], parameters: RecordParameters) -> tuple[Float64, tuple[int, int]]:
    """Return the middles of about square places of a frame (rows, cols), and how many there are."""
    step = max(1.0, max(frame) / parameters.lattice_side)
    shape = max(1, round(frame[0] / step)), max(1, round(frame[1] / step))
    return _middles(frame, shape), shape


def _middles(frame: tuple[int, int], shape: tuple[int, ...]) -> Float64:
    """Return the (n, 2) middles (col, row) of places of a frame (rows, cols), of which there are `shape`."""
    down, across = ((np.arange(count) + 0.5) * side / count for side, count in zip(frame, shape, strict=True))
    return positions(across, down)


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
    finite: Bool = np.asarray(np.isfinite(xy).all(axis=1))
    col, row = np.floor(np.where(finite[:, None], xy, -1.0)).astype(np.intp).T
    rows, cols = mask.shape
    inside = finite & (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    values = np.zeros(len(xy), dtype=bool)
    values[inside] = mask[row[inside], col[inside]]
    return values


def _boxes(pair: ViewPair, windows: Sequence[Window]) -> Float64:
    """Return (k, 4) the boxes around windows of the reference view, px of its file."""
    if not windows:
        return np.empty((0, 4))
    edges = np.array(
        [(window.col, window.row, window.col_stop, window.row_stop) for window in windows], np.float64
    )
    parts = np.linspace(0.0, 1.0, 5)
    places = edges[:, None, :2] + positions(parts, parts) * (edges[:, None, 2:] - edges[:, None, :2])
    mapped = pair.reference.to_file_px(places.reshape(-1, 2)).reshape(places.shape)
    # corners of a view of the ground may have no place in the file: fmin and fmax leave those out
    return np.concatenate([np.fmin.reduce(mapped, axis=1), np.fmax.reduce(mapped, axis=1)], axis=1)
