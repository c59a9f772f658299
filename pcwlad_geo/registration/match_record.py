"""Where the matching looked, and what it lost where: why there are no tie points at a place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.candidates import Candidates
from pcwlad_geo.matching.settings import MatchSettings
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.source import is_quick_to_glance_at
from pcwlad_geo.raster.windows import Window
from pcwlad_geo.registration.prealign import Look
from pcwlad_geo.registration.sites import LEAST_TEXTURE, texture_of
from pcwlad_geo.registration.tiles import TileJob, TileResult

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

GROUND: Final = ("usable", "no_texture", "edge", "reference_without_data", "target_without_data")
"""Whether a place can be matched: `no_texture` has faint contrast at most in one of the two, `edge` too many
pixels without data within a window around it."""
PLACES: Final = 120
"""Along the longer side of the reference, where that is asked."""
NODES: Final = 5
"""Along a side of a window, where its place in the file is asked."""
GLANCE_PX: Final = 512
"""Side of the overviews that are read where there was no matching."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchRecord:
    """What the matching did where, in px (col, row) of the reference file."""

    ground: NDArray[np.uint8]
    """(rows, cols) index into `GROUND` of places spread evenly over the reference."""
    windows_px: Array
    """(k, 4) col, row, col_stop, row_stop of the parts whose corners were candidates."""
    unread: Bool
    """(k,) whether such a part could not be read."""
    barren_px: Array
    """(b, 4) likewise, the parts left out for want of structure."""
    lost: Candidates
    """The candidates that gave no match; positions in reference px."""
    thinned_px: Array = field(default_factory=lambda: np.empty((0, 2)))
    """(t, 2) tie points left out because fewer were wanted."""

    def common_px(self, shape: tuple[int, int]) -> Array:
        """Return (n, 2) places (col, row) spread over a reference of this shape that both bands show."""
        places, _ = _places(shape)
        return places[self.ground.ravel() < GROUND.index("reference_without_data")]

    @property
    def searched(self) -> bool:
        """Whether anything was matched; the points are another's otherwise."""
        return len(self.windows_px) > 0


def record_matching(
    pair: ViewPair,
    look: Look,
    target_offset_px: tuple[int, int],
    settings: MatchSettings,
    barren: Sequence[Window],
    jobs: Sequence[TileJob],
    results: Sequence[TileResult],
) -> MatchRecord:
    """Record the first pass of a scene.

    Parameters
    ----------
    pair : ViewPair
    look : Look
        Both bands at a glance.
    target_offset_px : (int, int)
        (col, row) from reference view to target view, pre-alignment included.
    settings : MatchSettings
    barren : sequence of Window
        Parts of the reference view without a tile, for want of structure.
    jobs, results : sequences of TileJob, TileResult
        Of the same order.
    """
    side = max(settings.template, settings.window)
    glances = [
        _Glance(patch.valid, texture_of(patch, scene.epsilon) >= LEAST_TEXTURE)
        for patch, scene in zip((look.reference, look.target), look.scenes, strict=True)
    ]
    ground = _ground(pair, glances, look.factor, target_offset_px, side, settings.least_valid)
    lost = Candidates.concatenate([result.lost for result in results])
    return MatchRecord(
        ground,
        _boxes(pair, [job.core for job in jobs]),
        np.array([result.status == "failed" for result in results], dtype=bool),
        _boxes(pair, barren),
        Candidates(pair.reference.to_file_px(lost.reference_xy_px), lost.fate),
    )


def record_ground(pair: ViewPair) -> MatchRecord | None:
    """Record where a pair can be compared at all, without any matching.

    None where that would take long or cannot be read.
    """
    sides = max(pair.reference.grid.shape), max(pair.target.grid.shape)
    factor = max(1.0, max(sides) / GLANCE_PX)
    try:
        if not all(is_quick_to_glance_at(view.info) for view in (pair.reference, pair.target)):
            return None
        seen = [
            view.read_decimated(max(1, round(side / factor)))[0].valid
            for view, side in zip((pair.reference, pair.target), sides, strict=True)
        ]
    except InputError:
        return None
    col, row = pair.offset_px
    glances = [_Glance(valid, np.ones_like(valid)) for valid in seen]
    ground = _ground(pair, glances, factor, (round(col), round(row)), 1, 0.5)
    nothing = np.empty((0, 4))
    return MatchRecord(ground, nothing, np.empty(0, bool), nothing, Candidates.empty())


@dataclass(frozen=True, slots=True, eq=False)
class _Glance:
    """A band made small."""

    valid: Bool
    textured: Bool


def _ground(
    pair: ViewPair,
    glances: Sequence[_Glance],
    factor: float,
    target_offset_px: tuple[int, int],
    window_px: int,
    least_valid: float,
) -> NDArray[np.uint8]:
    """Tell, for places spread over the reference, whether both bands show something there and around.

    `glances` are of the reference and the target, `factor` view px a pixel of theirs.
    """
    places, shape = _places(pair.reference.info.grid.shape)
    with np.errstate(invalid="ignore"):
        at = pair.reference.from_file_px(places) / factor
    at_target = at + np.asarray(target_offset_px) / factor
    reference, target = glances
    here, there = _value_at(reference.valid, at), _value_at(target.valid, at_target)
    # a resampled view of the reference ends a little beyond what the target covers
    seen = _value_at(np.ones_like(reference.valid), at)
    textured = _value_at(reference.textured, at) & _value_at(target.textured, at_target)
    around = cv2.blur(
        (here & there).reshape(shape).astype(np.float32),
        _odd_sides(pair, window_px, shape),
        borderType=cv2.BORDER_CONSTANT,
    )
    reasons = [seen & ~here, ~(seen & there), around.ravel() < least_valid, ~textured]
    names = ("reference_without_data", "target_without_data", "edge", "no_texture")
    ground = np.select(reasons, [GROUND.index(name) for name in names], default=0)
    return ground.reshape(shape).astype(np.uint8)


def _places(frame: tuple[int, int]) -> tuple[Array, tuple[int, int]]:
    """Return the middles of about square places of a frame (rows, cols), and how many there are."""
    step = max(1.0, max(frame) / PLACES)
    rows, cols = (max(1, round(side / step)) for side in frame)
    down = (np.arange(rows) + 0.5) * frame[0] / rows
    across = (np.arange(cols) + 0.5) * frame[1] / cols
    return np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2), (rows, cols)


def _odd_sides(pair: ViewPair, window_px: int, shape: tuple[int, int]) -> tuple[int, int]:
    """Return the sides (across, down) of a window of the view, in places, odd."""
    rows, cols = pair.reference.info.grid.shape
    reach = pair.reference.to_file_px(np.array([[0.0, 0.0], [window_px, window_px]]))
    sides_px = np.abs(np.diff(reach, axis=0)[0])
    half = np.floor(sides_px * [shape[1] / cols, shape[0] / rows] / 2)
    across, down = (2 * np.nan_to_num(half) + 1).astype(int).tolist()
    return across, down


def _value_at(mask: Bool, xy: Array) -> Bool:
    """Return (n,) the value of a mask at positions (col, row); False outside."""
    known: Bool = np.asarray(np.isfinite(xy).all(axis=1))
    col, row = np.floor(np.where(known[:, None], xy, -1.0)).astype(np.intp).T
    rows, cols = mask.shape
    inside = known & (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    found = np.zeros(len(xy), dtype=bool)
    found[inside] = mask[row[inside], col[inside]]
    return found


def _boxes(pair: ViewPair, windows: Sequence[Window]) -> Array:
    """Return (k, 4) the boxes around windows of the reference view, px of its file."""
    if not windows:
        return np.empty((0, 4))
    edges = np.array([(each.col, each.row, each.col_stop, each.row_stop) for each in windows], np.float64)
    parts = np.linspace(0.0, 1.0, NODES)
    share = np.stack(np.meshgrid(parts, parts), axis=-1).reshape(-1, 2)
    places = edges[:, None, :2] + share * (edges[:, None, 2:] - edges[:, None, :2])
    mapped = pair.reference.to_file_px(places.reshape(-1, 2)).reshape(places.shape)
    # corners of a view of the ground may have no place in the file: fmin and fmax leave those out
    return np.concatenate([np.fmin.reduce(mapped, axis=1), np.fmax.reduce(mapped, axis=1)], axis=1)
