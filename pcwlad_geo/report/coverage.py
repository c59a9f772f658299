"""Which squares of the reference have tie points, and why the others have none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from pcwlad_geo.matching.candidates import FATES, Candidates
from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.registration.match_record import GROUND, MatchRecord
from pcwlad_geo.report.statistics import KEPT

SQUARES: Final = 12
"""Along the longer side of the reference, at most."""
LEAST_DATA: Final = 0.1
"""Of the places in a square: a smaller share that can be matched is as good as none."""
LOST: Final = (*FATES[1:], "rejected")
"""Reasons that candidates tell: the stage that lost most of those in the square."""
REASONS: Final = (*GROUND[1:], "unread", "not_asked", *LOST, "unknown")
"""Why a square has no tie point."""
NO_DATA: Final = ("reference_without_data", "target_without_data")
"""Reasons for which no tie point is to be expected."""

SHARE_DIGITS: Final = 3
"""Of a share in the report."""
JOINED: Final = 0.5
"""Windows that cover a larger share of their extent are tiles."""
TINY: Final = 1e-9

Counts = NDArray[np.int64]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Tie points by square of the reference."""

    shape_px: tuple[int, int]
    """Rows and columns of the reference."""
    points: Counts
    """(rows, columns) tie points that agree with the others."""
    reason: NDArray[np.str_]
    """(rows, columns) one of `REASONS` where there is none; empty elsewhere."""

    @property
    def without(self) -> dict[str, int]:
        """How many squares have no tie point, by reason; those that occur."""
        return {name: int(count) for name in REASONS if (count := np.count_nonzero(self.reason == name))}

    @property
    def empty_share(self) -> float:
        """Part of the squares with data that has no tie point.

        Where none was asked for, one in a square beside it will do.
        """
        with_data = ~np.isin(self.reason, NO_DATA)
        near = binary_dilation(self.points > 0, np.ones((3, 3)))
        missing = with_data & (self.points == 0) & ~(near & np.isin(self.reason, ("not_asked", "unknown")))
        return float(missing.sum() / max(int(with_data.sum()), 1))


def coverage_of(table: TiePointTable, shape_px: tuple[int, int], record: MatchRecord | None) -> Coverage:
    """Count the tie points of each square, and find why there are none.

    The first that holds: no data in one of the two, an edge too near, no structure, a part that could not be
    read, no window laid there or fewer points wanted, the stage that lost most of its candidates.

    Parameters
    ----------
    table : TiePointTable
    shape_px : (rows, cols)
        Of the reference.
    record : MatchRecord, optional
        What the matching did where.
    """
    step = max(max(shape_px) / SQUARES, _spacing_px(record))
    frame = _Frame(shape_px, (max(1, round(shape_px[0] / step)), max(1, round(shape_px[1] / step))))
    points = frame.count(table.select(*KEPT).reference_px)
    reason = np.full(frame.squares, "unknown", dtype="<U24")
    if record is not None:
        # from the weakest reason to the strongest
        rejected = frame.count(table.select("rejected").reference_px)
        if record.searched:
            reason = _by_matching(record, rejected, frame)
        reason = np.where(frame.count(record.thinned_px) > 0, "not_asked", reason)
        ground = _by_ground(record.ground, frame)
        reason = np.where(ground == "", reason, ground)
    return Coverage(shape_px, points, np.where(points > 0, "", reason))


def _spacing_px(record: MatchRecord | None) -> float:
    """Return how far apart small windows lie: smaller squares would fall between them; 0 where tiles join."""
    if record is None or not record.searched:
        return 0.0
    first, last = record.windows_px[:, :2], record.windows_px[:, 2:]
    region = float(np.prod(np.nanmax(last, axis=0) - np.nanmin(first, axis=0)))
    covered = float(np.nansum((last - first).prod(axis=1)))
    return (region / len(first)) ** 0.5 if covered < JOINED * region else 0.0


@dataclass(frozen=True, slots=True)
class _Frame:
    """The squares of an image."""

    shape_px: tuple[int, int]
    squares: tuple[int, int]

    def count(self, at_px: Array) -> Counts:
        """Return how many positions (col, row) lie in each square."""
        rows, cols = self.squares
        at_px = at_px[np.isfinite(at_px).all(axis=1)]
        scale = np.array([cols / self.shape_px[1], rows / self.shape_px[0]])
        col, row = np.clip((at_px * scale).astype(int), 0, [cols - 1, rows - 1]).T
        return np.bincount(row * cols + col, minlength=rows * cols).reshape(rows, cols)

    def touched(self, boxes_px: Array) -> NDArray[np.bool_]:
        """Tell which squares share half a side, of themselves or of the box, with one of the boxes."""
        found = np.zeros(self.squares, bool)
        scale = np.array([self.squares[1] / self.shape_px[1], self.squares[0] / self.shape_px[0]])
        for box in boxes_px[np.isfinite(boxes_px).all(axis=1)]:
            first, last = box[:2] * scale, box[2:] * scale
            half = np.minimum(last - first, 1.0) / 2
            begin = np.maximum(np.ceil(first + half - 1.0 - TINY), 0).astype(int)
            end = np.maximum(np.floor(last - half + TINY) + 1, 0).astype(int)
            found[begin[1] : end[1], begin[0] : end[0]] = True
        return found


def _by_ground(ground: NDArray[np.uint8], frame: _Frame) -> NDArray[np.str_]:
    """Return why a square cannot be matched at all; empty where it can."""
    usable, flat, edge, *without = (_share(ground == index, frame.squares) for index in range(len(GROUND)))
    reason = np.where(usable < LEAST_DATA, "no_texture", "")
    reason = np.where(usable + flat < LEAST_DATA, "edge", reason)
    worst = np.array(GROUND[3:])[np.argmax(without, axis=0)]
    return np.where(usable + flat + edge < LEAST_DATA, worst, reason)


def _by_matching(record: MatchRecord, rejected: Counts, frame: _Frame) -> NDArray[np.str_]:
    """Return what the matching says of squares without tie points."""
    lost = [_lost_to(record.lost, index, frame) for index in range(1, len(FATES))]
    losses = np.array([*lost, rejected])
    reason = np.array(LOST, dtype="<U24")[losses.argmax(axis=0)]
    no_candidate = losses.sum(axis=0) == 0
    asked, barren = frame.touched(record.windows_px), frame.touched(record.barren_px)
    reason = np.where(no_candidate, np.where(asked | barren, "no_texture", "not_asked"), reason)
    unread = frame.touched(record.windows_px[record.unread])
    return np.where(no_candidate & unread, "unread", reason)


def _lost_to(lost: Candidates, fate: int, frame: _Frame) -> Counts:
    return frame.count(lost.reference_xy_px[lost.fate == fate])


def _share(mask: NDArray[np.bool_], squares: tuple[int, int]) -> Array:
    """Return the share of True in each square of a mask."""
    parts = [np.array_split(half, squares[1], axis=1) for half in np.array_split(mask, squares[0], axis=0)]
    return np.array([[part.mean() if part.size else 1.0 for part in row] for row in parts])
