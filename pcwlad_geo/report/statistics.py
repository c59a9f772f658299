"""Statistics of a registration: errors, predicted sigma and coverage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.error_statistics import ErrorStatistics, in_units
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.keypoints import OUTCOMES
from pcwlad_geo.products.finding import native_per_px, native_px_m
from pcwlad_geo.raster import Dem, RasterInfo, at_mean_height, file_name, pixel_sizes_m
from pcwlad_geo.registration import Registration
from pcwlad_geo.registration.match_record import PLACE_STATES, MatchRecord
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64

KEPT: Final = ("fit", "check", "unused", "matched")
"""Statuses of the tie points that are included in displacement statistics."""
PointGroup = Literal["all", "fit", "check"]
STATUSES: Final[Mapping[PointGroup, tuple[str, ...]]] = {"all": KEPT, "fit": ("fit",), "check": ("check",)}
"""Statuses of the tie points of a group, by its name."""
LOST: Final = (*OUTCOMES[1:], "rejected")
"""Reasons from rejected candidates: the stage that rejected most of those in the square."""
REASONS: Final = (*PLACE_STATES[1:], "unread", "not_asked", *LOST, "unknown")
"""Reasons for which a square has no tie point."""
NO_DATA: Final = ("reference_without_data", "target_without_data")
"""Reasons for which no tie point can be expected."""
When = Literal["before", "after"]
"""State of the registration for which statistics are given: before or after the correction."""


def statistics_of(
    registration: Registration, when: When, group: PointGroup, sizes_m: Float64 | None
) -> dict[str, ErrorStatistics | None]:
    """Return the statistics by unit of a `group` of `STATUSES` of a `registration`; `when`: before or after.

    The (n, 2) `sizes_m` are those of `target_px_m`.
    """
    of_group = np.isin(registration.tie_points.status, STATUSES[group])
    points = registration.tie_points[of_group]
    native_m, px_m = native_size_m(registration.reference, registration.target), registration.px_m
    native = None if px_m is None or native_m is None else native_per_px(px_m, native_m)
    metres = None if sizes_m is None else sizes_m[of_group]
    errors_px = points.displacement_px if when == "before" else points.residual_px
    return in_units(errors_px, points.sigma_px, {"px": np.ones(2), "native_px": native, "m": metres})


def target_px_m(registration: Registration) -> Float64 | None:
    """Return the (n, 2) sizes of the target's pixels at its tie points, metres; None without a CRS."""
    return pixel_sizes_m(at_mean_height(registration.target.grid), registration.tie_points.predicted_px)


def native_size_m(*rasters: RasterInfo) -> float | None:
    """Return the coarsest native pixel size of rasters in metres, if file names determine it, else None."""
    sizes = [native_px_m(Path(file_name(info.uri)).stem, None) for info in rasters]
    return max((size for size in sizes if size is not None), default=None)


@dataclass(frozen=True, slots=True, eq=False)
class PrecisionMap:
    """Sigma on a lattice over the target."""

    target_shape: tuple[int, int]
    """Rows and columns of the target."""
    sigma_px: Float64
    """(rows, columns, 2) standard deviation (col, row), target px."""
    extrapolated: Bool
    """(rows, columns) array, True where the correction extrapolates beyond the tie points."""

    @classmethod
    def of(cls, selection: Selection, target_shape: tuple[int, int], nodes: int = 80) -> PrecisionMap:
        """Evaluate the sigma of a `selection` over a target of `target_shape` (rows, cols).

        There are so many `nodes` along its longer side.
        """
        step = max(target_shape) / nodes
        rows, cols = ((np.arange(count) + 0.5) * side / count for side, count in _counts(target_shape, step))
        places = np.stack(np.meshgrid(cols, rows), axis=-1)
        flat = places.reshape(-1, 2)
        return cls(
            target_shape,
            selection.sigma(flat).reshape(places.shape),
            selection.extrapolated(flat).reshape(places.shape[:2]),
        )


def precision_of(registration: Registration) -> PrecisionMap | None:
    """Return the predicted sigma of a registration's correction; None if there is no correction."""
    selection = registration.selection
    if selection is None or registration.model is None:
        return None
    return PrecisionMap.of(selection, registration.target.grid.shape)


def _counts(shape: tuple[int, int], step: float) -> list[tuple[int, int]]:
    return [(side, max(round(side / step), 1)) for side in shape]


Counts = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class CoverageParameters:
    """How the squares are laid in which tie points are counted."""

    most_squares: int = 12
    """Largest number of squares along the longer side of the reference."""
    least_data: float = 0.1
    """Least share of a square that can be matched; with less the square counts as without data."""
    contiguous_share: float = 0.5
    """Share of their extent that windows must exceed to count as contiguous tiles."""
    tolerance: float = 1e-9
    """Of rounding errors, in units of squares."""


COVERAGE: Final = CoverageParameters()
"""As reports count."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Number of tie points by square of the reference."""

    shape_px: tuple[int, int]
    """Rows and columns of the reference."""
    points: Counts
    """(rows, columns) number of tie points that are not rejected."""
    reason: NDArray[np.str_]
    """(rows, columns) one of `REASONS` where there is no tie point; empty elsewhere."""

    @property
    def without(self) -> dict[str, int]:
        """Number of squares without tie point by reason, for reasons that occur."""
        return {name: int(count) for name in REASONS if (count := np.count_nonzero(self.reason == name))}

    @property
    def empty_share(self) -> float:
        """Share of the squares with data that have no tie point.

        A square in which none was requested counts as covered if a neighbouring square has one.
        """
        with_data = ~np.isin(self.reason, NO_DATA)
        has_neighbour = cv2.dilate((self.points > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        missing = (
            with_data & (self.points == 0) & ~(has_neighbour & np.isin(self.reason, ("not_asked", "unknown")))
        )
        return float(missing.sum() / max(int(with_data.sum()), 1))


def coverage_of(
    table: TiePointTable,
    shape_px: tuple[int, int],
    record: MatchRecord | None,
    parameters: CoverageParameters = COVERAGE,
) -> Coverage:
    """Count the tie points of each square of a reference of (rows, cols) `shape_px`; tell why there are none.

    The reason is the first that applies: no data in one of the images, too near to an edge, no structure, an
    unreadable part, no window or fewer points requested, the stage that rejected most candidates.
    """
    step = max(max(shape_px) / parameters.most_squares, _spacing_px(record, parameters.contiguous_share))
    counts = max(1, round(shape_px[0] / step)), max(1, round(shape_px[1] / step))
    frame = _Squares(shape_px, counts, parameters)
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


def _spacing_px(record: MatchRecord | None, contiguous_share: float) -> float:
    """Return the spacing of separate windows, the least side of a square, px; 0 for contiguous tiles."""
    if record is None or not record.searched:
        return 0.0
    first, last = record.windows_px[:, :2], record.windows_px[:, 2:]
    region = float(np.prod(np.nanmax(last, axis=0) - np.nanmin(first, axis=0)))
    covered = float(np.nansum((last - first).prod(axis=1)))
    return (region / len(first)) ** 0.5 if covered < contiguous_share * region else 0.0


@dataclass(frozen=True, slots=True)
class _Squares:
    """The squares of an image."""

    shape_px: tuple[int, int]
    squares: tuple[int, int]
    parameters: CoverageParameters

    def count(self, at_px: Float64) -> Counts:
        """Return the (rows, columns) number of (n, 2) positions `at_px` (col, row), px, in each square."""
        rows, cols = self.squares
        at_px = at_px[np.isfinite(at_px).all(axis=1)]
        scale = np.array([cols / self.shape_px[1], rows / self.shape_px[0]])
        col, row = np.clip((at_px * scale).astype(int), 0, [cols - 1, rows - 1]).T
        return np.bincount(row * cols + col, minlength=rows * cols).reshape(rows, cols)

    def touched(self, boxes_px: Float64) -> Bool:
        """Return the squares that a box of (n, 4) `boxes_px` overlaps by half a side of either."""
        mask, tiny = np.zeros(self.squares, bool), self.parameters.tolerance
        scale = np.array([self.squares[1] / self.shape_px[1], self.squares[0] / self.shape_px[0]])
        for box in boxes_px[np.isfinite(boxes_px).all(axis=1)]:
            first, last = box[:2] * scale, box[2:] * scale
            half = np.minimum(last - first, 1.0) / 2
            begin = np.maximum(np.ceil(first + half - 1.0 - tiny), 0).astype(int)
            end = np.maximum(np.floor(last - half + tiny) + 1, 0).astype(int)
            mask[begin[1] : end[1], begin[0] : end[0]] = True
        return mask


def _by_ground(ground: NDArray[np.uint8], frame: _Squares) -> NDArray[np.str_]:
    """Return the reason why a square cannot be matched at all; empty where it can."""
    usable, flat, edge, *without = (
        _share(ground == index, frame.squares) for index in range(len(PLACE_STATES))
    )
    least = frame.parameters.least_data
    reason = np.where(usable < least, "no_texture", "")
    reason = np.where(usable + flat < least, "edge", reason)
    worst = np.array(PLACE_STATES[3:])[np.argmax(without, axis=0)]
    return np.where(usable + flat + edge < least, worst, reason)


def _by_matching(record: MatchRecord, rejected: Counts, frame: _Squares) -> NDArray[np.str_]:
    """Return the reasons from the matching for squares without tie points."""
    places, outcome = record.lost.reference_xy_px, record.lost.outcome
    stage_losses = [frame.count(places[outcome == index]) for index in range(1, len(OUTCOMES))]
    losses = np.array([*stage_losses, rejected])
    reason = np.array(LOST, dtype="<U24")[losses.argmax(axis=0)]
    no_candidate = losses.sum(axis=0) == 0
    searched, without_structure = frame.touched(record.windows_px), frame.touched(record.without_structure_px)
    reason = np.where(no_candidate, np.where(searched | without_structure, "no_texture", "not_asked"), reason)
    unread = frame.touched(record.windows_px[record.unread])
    return np.where(no_candidate & unread, "unread", reason)


def _share(mask: Bool, squares: tuple[int, int]) -> Float64:
    """Return the share of True in each square of a mask."""
    parts = [np.array_split(half, squares[1], axis=1) for half in np.array_split(mask, squares[0], axis=0)]
    return np.array([[part.mean() if part.size else 1.0 for part in row] for row in parts])


def heights_m(registration: Registration, predicted_px: Float64) -> Float64 | None:
    """Return (n,) heights of the ground, m, at the (n, 2) `predicted_px`; None without an elevation model."""
    rpc = registration.rpc
    if rpc is None or not isinstance(rpc.original.heights, Dem):
        return None
    try:
        return rpc.original.heights.at(rpc.original.to_xy(predicted_px))
    except InputError:  # the page can do without heights
        return None
