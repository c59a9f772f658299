"""Collars: constant borders of a raster that nothing marks as nodata."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.polygon import orient

from pcwlad_geo.raster.grid import Window
from pcwlad_geo.types import Bool, Float64

Read = Callable[[Window, tuple[int, int]], NDArray[np.generic]]
"""A function that reads a window of a band, by nearest neighbour, into (rows, columns)."""


@dataclass(frozen=True, slots=True)
class CollarParameters:
    """What counts as the collar of a band."""

    overview_px: int = 1024
    """Largest side of the overview on which the outline of the data is sought."""
    jpeg_noise: int = 8
    """Largest difference from its value of a collar of 8 bits in blocks that it shares with data.

    Other types are hardly ever compressed with loss, and their collars are exactly constant.
    """
    rounding: int = 1
    """Largest difference from its value of a collar of 8 bits elsewhere."""
    jpeg_reach_px: int = 16
    """Beyond this distance from the data JPEG leaves a collar constant: its blocks are that large."""
    max_strays: float = 0.01
    """Largest share of other values beyond that distance."""
    outline_px: float = 1.5
    """Accuracy with which the outline of the data is simplified to sides, px of the overview."""
    min_side: float = 0.04
    """Least length of a side that is looked at, as a share of the larger side of the raster."""
    reach_px: int = 8
    """Distance from the side on the overview within which the data end, px beside two of the overview."""
    min_support: float = 0.6
    """Least share of the places at which the data end on a straight line; shores touch one rarely."""
    protrusion_px: float = 6.0
    """Largest distance by which noise beside an edge may lie beyond a side, px beside one of the overview."""
    blended_px: float = 1.5
    """Width of the edge in which resampling has mixed data and collar, which counts as collar."""
    rare: float = 0.02
    """Share of the pixels among the data up to which a value is hardly ever data: one side will do."""
    max_common: float = 1 / 3
    """Largest share of the pixels among the data with the value of the collar: maps are full of theirs."""
    min_length_rare: float = 0.15
    """Least total length of straight sides, in smaller sides of the raster, where the value is rare."""
    min_length_common: float = 1.0
    """The same where the value is common: about what a frame has that is turned within its own size."""


@dataclass(frozen=True, slots=True)
class Collar:
    """A constant border that nothing marks as nodata, such as the corners around a rotated frame.

    It is all that lies beyond straight sides, so that every window of the raster excludes the same pixels.
    """

    shape: tuple[int, int]
    """Rows and columns of the raster."""
    value: float
    sides: tuple[tuple[float, float, float], ...]
    """(a, b, c), a² + b² = 1: the collar is where a · col + b · row > c for any of them, px of the raster."""
    share: float = 0.0
    """Of the raster's area."""

    def valid(self, window: Window, shape: tuple[int, int]) -> Bool:
        """Return (rows, cols), False on the collar, of a window of the raster or an overview of `shape`."""
        col = (window.col + np.arange(window.cols) + 0.5) * (self.shape[1] / shape[1])
        row = (window.row + np.arange(window.rows) + 0.5) * (self.shape[0] / shape[0])
        valid = np.ones(window.shape, bool)
        for a, b, c in self.sides:
            if max(a * col[0], a * col[-1]) + max(b * row[0], b * row[-1]) > c:
                valid &= a * col + (b * row)[:, None] <= c
        return valid

    def measured(self, shape: tuple[int, int]) -> Collar:
        """Return the collar with its share, measured on an overview of `shape`."""
        return replace(self, share=float((~self.valid(Window.whole(shape), shape)).mean()))


@np.errstate(over="ignore", invalid="ignore")  # differences of the largest numbers, and of infinite ones
def find_collar(
    read: Read, shape: tuple[int, int], parameters: CollarParameters = CollarParameters()
) -> Collar | None:
    """Find the collar of a band without nodata and masks: a constant border with straight sides.

    A corner of the raster must be constant, at zero or an extreme of the type or the band. Around all that
    differs a convex outline is drawn on an overview, and each of its sides is located at full resolution,
    where the data must end on a straight line along most of it. So nothing but the constant value lies in a
    collar, and dark water or white roads with a shore or a kerb of their own are none. The band has `shape`
    rows and columns and is read by `read`.
    """
    in_corners = _corner_value(read, shape, parameters.jpeg_noise)
    if in_corners is None:
        return None
    size = max(shape)
    small_rows, small_cols = (max(1, round(n * min(1.0, parameters.overview_px / size))) for n in shape)
    small = small_rows, small_cols
    overview = read(Window.whole(shape), small)
    value = _extreme_near(in_corners, overview, parameters.jpeg_noise)
    if value is None:
        return None
    if overview.shape == shape:

        def read(window: Window, _: tuple[int, int]) -> NDArray[np.generic]:
            return overview[window.row : window.row_stop, window.col : window.col_stop]

    data = _solid(_differs(overview, value, parameters.jpeg_noise))
    px = np.array([shape[1] / small[1], shape[0] / small[0]])
    outline = _outline(data, parameters.outline_px) * px
    sides, length = [], 0.0
    for begin, end in _inner_sides(outline, shape, parameters):
        side = _straight_side(read, shape, value, begin, end, float(px.max()), parameters)
        if side is None or (outline @ side[:2]).max() - side[2] > parameters.protrusion_px + px.max():
            continue
        if _is_clean(Collar(shape, value, (side,)), overview, parameters):
            sides.append(side)
            length += float(np.hypot(*(end - begin))) / min(shape)
    if length < _least_length(~_differs(overview, value, parameters.jpeg_noise), data, parameters):
        return None
    return Collar(shape, value, tuple(sides)).measured(small)


def _corner_value(read: Read, shape: tuple[int, int], noise: float) -> float | None:
    """Return the commonest value of the constant corners, but for noise; None if there is none."""
    side = min(3, *shape)
    candidates = []
    for row in (0, shape[0] - side):
        for col in (0, shape[1] - side):
            corner = read(Window(row, col, side, side), (side, side))
            values = corner.astype(np.float64)
            middle = float(np.median(values))
            value = _extreme_near(middle, corner, noise) if corner.dtype == np.uint8 else middle
            if value is not None and np.ptp(values) <= _tolerance(corner, noise):
                candidates.append(value)
    return max(candidates, key=candidates.count, default=None)


def _tolerance(values: NDArray[np.generic], of_8_bits: float) -> float:
    return of_8_bits if values.dtype == np.uint8 else 0.0


def _extreme_near(value: float, values: NDArray[np.generic], noise: float) -> float | None:
    """Return zero or the extreme of a type or, except for 8 bits, of the values, if a value is that."""
    extremes = [0.0]
    if values.dtype.kind in "iu":
        limits = np.iinfo(str(values.dtype))
        extremes += [float(limits.min), float(limits.max)]
    if values.dtype != np.uint8:
        extremes += [float(np.fmin.reduce(values, axis=None)), float(np.fmax.reduce(values, axis=None))]
    nearest = min(extremes, key=lambda extreme: abs(value - extreme))
    return nearest if abs(value - nearest) <= _tolerance(values, noise) else None


def _differs(values: NDArray[np.generic], value: float, noise: float) -> Bool:
    """Return where values are data, not the collar's; NaN is not data."""
    return np.abs(values.astype(np.float64) - value) > _tolerance(values, noise)


def _solid(differs: Bool) -> Bool:
    """Return the data without the specks that JPEG leaves beside an edge."""
    from scipy.ndimage import uniform_filter

    return np.asarray(differs & (uniform_filter(differs.astype(np.float32), 3, mode="nearest") > 0.5))


def _outline(solid: Bool, accuracy_px: float) -> Float64:
    """Return the (n, 2) corners (col, row) of the convex outline of the data, the first again as the last."""
    rows = np.flatnonzero(solid.any(axis=1))
    if len(rows) == 0:
        return np.empty((0, 2))
    first, last = solid[rows].argmax(axis=1), solid.shape[1] - solid[rows, ::-1].argmax(axis=1)
    ends = [np.column_stack([col, row]) for col in (first, last) for row in (rows, rows + 1)]
    hull = shapely.MultiPoint(np.concatenate(ends)).convex_hull.simplify(accuracy_px)
    return np.asarray(shapely.get_coordinates(orient(hull)))


def _inner_sides(
    outline_px: Float64, shape: tuple[int, int], parameters: CollarParameters
) -> Iterator[tuple[Float64, Float64]]:
    """Yield the ends of the longer sides of an outline that are not sides of the raster."""
    size = np.array(shape[::-1])
    edge_px = max(1.0, max(shape) / parameters.overview_px)
    for begin, end in pairwise(outline_px):
        at_edge = (np.maximum(begin, end) <= edge_px) | (np.minimum(begin, end) >= size - edge_px)
        if not at_edge.any() and np.hypot(*(end - begin)) >= parameters.min_side * size.max():
            yield begin, end


def _straight_side(
    read: Read,
    shape: tuple[int, int],
    value: float,
    begin: Float64,
    end: Float64,
    overview_px: float,
    parameters: CollarParameters,
) -> tuple[float, float, float] | None:
    """Locate a side of the data at full resolution; None where they do not end on a straight line.

    The (2,) arrays `begin` and `end` are the ends (col, row) of the side on the overview, px of the band, of
    which a px of the overview has `overview_px`; the data lie on its left (row down).
    """
    length = float(np.hypot(*(end - begin)))
    along = (end - begin) / length
    outward = np.array([along[1], -along[0]])
    at = np.linspace(0.04, 0.96, 32) * length
    reach = round(2 * overview_px) + parameters.reach_px

    def data(window: Window) -> Bool:
        return _differs(read(window, window.shape), value, parameters.jpeg_noise)

    depth = np.array([_data_depth(data, shape, begin + s * along, outward, reach) for s in at])
    one, other = np.nonzero(at[None, :] - at[:, None] > length / 4)
    slope = (depth[other] - depth[one]) / (at[other] - at[one])
    off = np.abs(depth - (depth[one, None] + slope[:, None] * (at - at[one, None])))
    on_line = off <= 1.0
    best = on_line[on_line.sum(axis=1).argmax()]
    if best.mean() < parameters.min_support:
        return None
    slope_px, depth_px = np.polyfit(at[best], depth[best], 1)
    normal = outward + slope_px * along
    normal /= np.hypot(*normal)
    a, b = normal.tolist()
    return a, b, float(normal @ (begin - (depth_px + parameters.blended_px) * outward))


def _data_depth(
    data_in: Callable[[Window], Bool], shape: tuple[int, int], at: Float64, outward: Float64, reach: int
) -> float:
    """Return how far inward of a place the data begin, px; NaN where they do not within `reach`."""
    depth = np.arange(-reach, reach + 1)
    col, row = np.floor(at[:, None] - outward[:, None] * depth).astype(int)
    window = Window.from_bounds(row.min(), col.min(), row.max() + 1, col.max() + 1).clipped(shape)
    if window.empty:
        return float("nan")
    inside = (col >= window.col) & (col < window.col_stop) & (row >= window.row) & (row < window.row_stop)
    differs = data_in(window)
    data = np.zeros(len(depth) + 2, bool)
    data[:-2][inside] = differs[row[inside] - window.row, col[inside] - window.col]
    begins = data[:-2] & (data[1:-1] | data[2:])  # not a single speck
    return float(depth[begins.argmax()]) if begins.any() else float("nan")


def _is_clean(collar: Collar, overview: NDArray[np.generic], parameters: CollarParameters) -> bool:
    """Whether a collar is constant where JPEG has no cause for noise."""
    farther = tuple((a, b, c + parameters.jpeg_reach_px) for a, b, c in collar.sides)
    deep = ~replace(collar, sides=farther).valid(Window.whole(overview.shape), overview.shape)
    strays = _differs(overview[deep], collar.value, parameters.rounding)
    return not deep.any() or bool(strays.mean() <= parameters.max_strays)


def _least_length(constant: Bool, data: Bool, parameters: CollarParameters) -> float:
    """Return the length of sides that shows a collar, in smaller sides of the raster, from how rare it is."""
    among = _between(data, 0) | _between(data, 1)
    share = float(constant[among].mean()) if among.any() else 1.0
    if share <= parameters.rare:
        return parameters.min_length_rare
    return parameters.min_length_common if share <= parameters.max_common else np.inf


def _between(data: Bool, axis: int) -> Bool:
    """Return the pixels that have data, or are data, on both sides along an axis."""
    before = np.logical_or.accumulate(data, axis)
    after = np.flip(np.logical_or.accumulate(np.flip(data, axis), axis), axis)
    return before & after
