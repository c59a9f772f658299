"""What counts: kinds of masks, areas of vector files, and constant borders that nothing marks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal, get_args

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.polygon import orient

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.file_tree import name_of_uri
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.types import Bool, Float64

MaskKind = Literal["zeros", "QA_PIXEL", "BQA", "SCL", "MSK_CLASSI"]
"""zeros: 0 = excluded; the other kinds have the names that the products give them."""

QA_PIXEL_BITS: Final = (0, 1, 2, 3, 4)
"""Bits of Landsat Collection 2 whose pixels are excluded: fill, dilated cloud, cirrus, cloud, shadow."""
BQA_BITS: Final = (0, 1, 4, 6, 8, 12)
"""Of Collection 1: fill, dropped or hidden, cloud, a confidence above a third of cloud, shadow and cirrus."""
OLD_BQA_BITS: Final = (0, 1, 2, 13, 15)
"""Of before the Collections: fill, dropped, hidden, a confidence above a third of cirrus and cloud."""
OLD_BQA: Final = 1 << 13
"""Least value of before the Collections, which always sets one of the bits that Collection 1 leaves empty."""
SCL_CLASSES: Final = (0, 1, 3, 8, 9, 10)
"""Excluded classes of Sentinel-2 L2A: no data, defective, cloud shadow, medium or high cloud, cirrus."""
CLASSI_BANDS: Final = (1, 2)
"""Bands of the Sentinel-2 mask whose nonzero pixels are excluded: opaque clouds, cirrus (3 is snow)."""

_ENDINGS: Final = r"(_\d+m)?(\.\w+)?$"
_NAMES: Final[dict[MaskKind, str]] = {
    "QA_PIXEL": rf"(^|_)QA_PIXEL{_ENDINGS}",
    "BQA": rf"(^|_)BQA{_ENDINGS}",
    "SCL": rf"(^|_)SCL{_ENDINGS}",
    "MSK_CLASSI": rf"(^|_)MSK_CLASSI(_B00)?{_ENDINGS}",
}
_OTHERS: Final = re.compile(
    rf"(^|_)(QA_RADSAT|QA_AEROSOL|CLOUD_QA|ST_QA|MSK_(?!CLASSI)[A-Z]+(_B\w\w)?|CLD|SNW){_ENDINGS}",
    re.IGNORECASE,
)
"""Quality rasters with values of another meaning; as masks of zeros they would exclude the wrong pixels."""


def kind_of(uri: str, descriptions: Sequence[str | None], dtypes: Sequence[str]) -> MaskKind:
    """Return the kind of a mask by the ending of its file name, else by the description of its first band.

    Raises `InputError` if the name is that of an unsupported quality raster, or the bands do not fit the
    name. The `uri` is a path or a GDAL URI; descriptions and data types are those of its bands.
    """
    names = [name_of_uri(uri.replace("\\", "/")), (descriptions[0] or "") if descriptions else ""]
    for name in names:
        for kind in get_args(MaskKind)[1:]:
            if re.search(_NAMES[kind], name, re.IGNORECASE):
                _check(kind, uri, dtypes)
                return kind  # type: ignore[no-any-return]  # get_args has no types
    if _OTHERS.search(names[0]):
        raise InputError(
            f"the mask {uri} is a quality raster whose values are not read: give QA_PIXEL, BQA, SCL, "
            "MSK_CLASSI, or a mask of your own (0 = excluded) under another name"
        )
    return "zeros"


def is_quality_raster(name: str) -> bool:
    """Whether a file has the name of a quality raster of a product, which is no image."""
    is_mask = any(re.search(pattern, name, re.IGNORECASE) for pattern in _NAMES.values())
    return is_mask or _OTHERS.search(name) is not None


def bands_of(kind: MaskKind) -> tuple[int, ...]:
    """Return the numbers of the bands, from 1, that a kind of mask consists of."""
    return CLASSI_BANDS if kind == "MSK_CLASSI" else (1,)


def accepted(kind: MaskKind, values: NDArray[np.generic]) -> Bool:
    """Return the pixels that a mask does not exclude.

    The (bands, rows, cols) `values` are those of the bands of `bands_of`, with the dtype of the file; NaN
    excludes. The result is a (rows, cols) array of bool.
    """
    if kind == "QA_PIXEL":
        return _without(QA_PIXEL_BITS, values[0])
    if kind == "BQA":
        old, later = (_without(bits, values[0]) for bits in (OLD_BQA_BITS, BQA_BITS))
        return np.where(values[0] >= OLD_BQA, old, later)
    if kind == "SCL":
        return ~np.isin(values[0], SCL_CLASSES)
    if kind == "MSK_CLASSI":
        return np.asarray((values == 0).all(axis=0))
    return np.asarray((values[0] != 0) & np.isfinite(values[0]))


def _without(bits: Sequence[int], values: NDArray[np.generic]) -> Bool:
    return np.asarray((values.astype(np.int64) & sum(1 << bit for bit in bits)) == 0)


def _check(kind: MaskKind, uri: str, dtypes: Sequence[str]) -> None:
    count = max(bands_of(kind))
    if len(dtypes) < count or any(np.dtype(dtype).kind not in "iu" for dtype in dtypes[:count]):
        plural = "s" if len(dtypes) != 1 else ""
        content = f"{len(dtypes)} band{plural} of type {', '.join(sorted(set(dtypes)))}"
        raise InputError(
            f"the mask {uri} is named like a {kind} raster, which has {count} whole-number "
            f"band{'s' if count > 1 else ''}, and holds {content}: give the product's own file, or rename a "
            "mask of your own (0 = excluded)"
        )


Read = Callable[[Window, tuple[int, int]], NDArray[np.generic]]
"""A function that reads a window of a band, by nearest neighbour, into (rows, columns)."""

COLLAR_OVERVIEW_PX: Final = 1024
"""Largest side of the overview on which the outline of the data is sought."""
JPEG_NOISE: Final = 8
"""Largest difference from its value of a collar of 8 bits in blocks that it shares with data; other types are
hardly ever compressed with loss, and their collars are exactly constant."""
ROUNDING: Final = 1
"""Largest difference from its value of a collar of 8 bits elsewhere."""
JPEG_REACH_PX: Final = 16
"""Beyond this distance from the data JPEG leaves a collar constant: its blocks are that large."""
MAX_STRAYS: Final = 0.01
"""Largest share of other values beyond that distance."""
OUTLINE_PX: Final = 1.5
"""Accuracy with which the outline of the data is simplified to sides, px of the overview."""
MIN_SIDE: Final = 0.04
"""Least length of a side that is looked at, as a share of the larger side of the raster."""
REACH_PX: Final = 8
"""Distance from the side of the overview within which the data must end, in px beside two of the overview."""
MIN_SUPPORT: Final = 0.6
"""Least share of the places at which the data end on a straight line. Shores touch one here and there."""
PROTRUSION_PX: Final = 6.0
"""Largest distance by which noise beside an edge may lie beyond a side, px beside one of the overview."""
BLENDED_PX: Final = 1.5
"""Width of the edge in which resampling has mixed data and collar, which counts as collar."""
RARE: Final = 0.02
"""Share of the pixels among the data up to which a value is hardly ever data: one straight side will do."""
MAX_COMMON: Final = 1 / 3
"""Largest share of the pixels among the data with the value of the collar: maps are full of theirs."""
MIN_LENGTH_RARE: Final = 0.15
"""Least total length of straight sides, in smaller sides of the raster, where the value is rare."""
MIN_LENGTH_COMMON: Final = 1.0
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


@np.errstate(over="ignore", invalid="ignore")  # differences of the largest numbers, and of infinite ones
def find_collar(read: Read, shape: tuple[int, int]) -> Collar | None:
    """Find the collar of a band without nodata and masks: a constant border with straight sides.

    A corner of the raster must be constant, at zero or an extreme of the type or the band. Around all that
    differs a convex outline is drawn on an overview, and each of its sides is located at full resolution,
    where the data must end on a straight line along most of it. So nothing but the constant value lies in a
    collar, and dark water or white roads with a shore or a kerb of their own are none. The band has `shape`
    rows and columns and is read by `read`.
    """
    in_corners = _corner_value(read, shape)
    if in_corners is None:
        return None
    size = max(shape)
    small_rows, small_cols = (max(1, round(n * min(1.0, COLLAR_OVERVIEW_PX / size))) for n in shape)
    small = small_rows, small_cols
    overview = read(Window.whole(shape), small)
    value = _extreme_near(in_corners, overview)
    if value is None:
        return None
    if overview.shape == shape:

        def read(window: Window, _: tuple[int, int]) -> NDArray[np.generic]:
            return overview[window.row : window.row_stop, window.col : window.col_stop]

    data = _solid(_differs(overview, value))
    px = np.array([shape[1] / small[1], shape[0] / small[0]])
    outline = _outline(data) * px
    sides, length = [], 0.0
    for begin, end in _inner_sides(outline, shape):
        side = _straight_side(read, shape, value, begin, end, float(px.max()))
        if side is None or (outline @ side[:2]).max() - side[2] > PROTRUSION_PX + px.max():
            continue
        if _is_clean(Collar(shape, value, (side,)), overview):
            sides.append(side)
            length += float(np.hypot(*(end - begin))) / min(shape)
    if length < _least_length(~_differs(overview, value), data):
        return None
    return _measured(Collar(shape, value, tuple(sides)), small)


def _measured(collar: Collar, small: tuple[int, int]) -> Collar:
    """Return the collar with its share, measured on an overview of the shape `small`."""
    return replace(collar, share=float((~collar.valid(Window.whole(small), small)).mean()))


def _corner_value(read: Read, shape: tuple[int, int]) -> float | None:
    """Return the commonest value of the constant corners, but for noise; None if there is none."""
    side = min(3, *shape)
    candidates = []
    for row in (0, shape[0] - side):
        for col in (0, shape[1] - side):
            corner = read(Window(row, col, side, side), (side, side))
            values = corner.astype(np.float64)
            middle = float(np.median(values))
            value = _extreme_near(middle, corner) if corner.dtype == np.uint8 else middle
            if value is not None and np.ptp(values) <= _tolerance(corner, JPEG_NOISE):
                candidates.append(value)
    return max(candidates, key=candidates.count, default=None)


def _tolerance(values: NDArray[np.generic], of_8_bits: float) -> float:
    return of_8_bits if values.dtype == np.uint8 else 0.0


def _extreme_near(value: float, values: NDArray[np.generic]) -> float | None:
    """Return zero or the extreme of a type or, except for 8 bits, of the values, if a value is that."""
    extremes = [0.0]
    if values.dtype.kind in "iu":
        limits = np.iinfo(str(values.dtype))
        extremes += [float(limits.min), float(limits.max)]
    if values.dtype != np.uint8:
        extremes += [float(np.fmin.reduce(values, axis=None)), float(np.fmax.reduce(values, axis=None))]
    nearest = min(extremes, key=lambda extreme: abs(value - extreme))
    return nearest if abs(value - nearest) <= _tolerance(values, JPEG_NOISE) else None


def _differs(values: NDArray[np.generic], value: float) -> Bool:
    """Return where values are data, not the collar's; NaN is not data."""
    return np.abs(values.astype(np.float64) - value) > _tolerance(values, JPEG_NOISE)


def _solid(differs: Bool) -> Bool:
    """Return the data without the specks that JPEG leaves beside an edge."""
    from scipy.ndimage import uniform_filter

    return np.asarray(differs & (uniform_filter(differs.astype(np.float32), 3, mode="nearest") > 0.5))


def _outline(solid: Bool) -> Float64:
    """Return the (n, 2) corners (col, row) of the convex outline of the data, the first again as the last."""
    rows = np.flatnonzero(solid.any(axis=1))
    if len(rows) == 0:
        return np.empty((0, 2))
    first, last = solid[rows].argmax(axis=1), solid.shape[1] - solid[rows, ::-1].argmax(axis=1)
    ends = [np.column_stack([col, row]) for col in (first, last) for row in (rows, rows + 1)]
    hull = shapely.MultiPoint(np.concatenate(ends)).convex_hull.simplify(OUTLINE_PX)
    return np.asarray(shapely.get_coordinates(orient(hull)))


def _inner_sides(outline_px: Float64, shape: tuple[int, int]) -> Iterator[tuple[Float64, Float64]]:
    """Yield the ends of the longer sides of an outline that are not sides of the raster."""
    size = np.array(shape[::-1])
    edge_px = max(1.0, max(shape) / COLLAR_OVERVIEW_PX)
    for begin, end in pairwise(outline_px):
        at_edge = (np.maximum(begin, end) <= edge_px) | (np.minimum(begin, end) >= size - edge_px)
        if not at_edge.any() and np.hypot(*(end - begin)) >= MIN_SIDE * size.max():
            yield begin, end


def _straight_side(
    read: Read, shape: tuple[int, int], value: float, begin: Float64, end: Float64, overview_px: float
) -> tuple[float, float, float] | None:
    """Locate a side of the data at full resolution; None where they do not end on a straight line.

    The (2,) arrays `begin` and `end` are the ends (col, row) of the side on the overview, px of the band, of
    which a px of the overview has `overview_px`; the data lie on its left (row down).
    """
    length = float(np.hypot(*(end - begin)))
    along = (end - begin) / length
    outward = np.array([along[1], -along[0]])
    at = np.linspace(0.04, 0.96, 32) * length
    reach = round(2 * overview_px) + REACH_PX
    depth = np.array([_data_depth(read, shape, value, begin + s * along, outward, reach) for s in at])
    one, other = np.nonzero(at[None, :] - at[:, None] > length / 4)
    slope = (depth[other] - depth[one]) / (at[other] - at[one])
    off = np.abs(depth - (depth[one, None] + slope[:, None] * (at - at[one, None])))
    on_line = off <= 1.0
    best = on_line[on_line.sum(axis=1).argmax()]
    if best.mean() < MIN_SUPPORT:
        return None
    slope_px, depth_px = np.polyfit(at[best], depth[best], 1)
    normal = outward + slope_px * along
    normal /= np.hypot(*normal)
    a, b = normal.tolist()
    return a, b, float(normal @ (begin - (depth_px + BLENDED_PX) * outward))


def _data_depth(
    read: Read, shape: tuple[int, int], value: float, at: Float64, outward: Float64, reach: int
) -> float:
    """Return how far inward of a place the data begin, px; NaN where they do not within `reach`."""
    depth = np.arange(-reach, reach + 1)
    col, row = np.floor(at[:, None] - outward[:, None] * depth).astype(int)
    window = Window.from_bounds(row.min(), col.min(), row.max() + 1, col.max() + 1).clipped(shape)
    if window.empty:
        return float("nan")
    inside = (col >= window.col) & (col < window.col_stop) & (row >= window.row) & (row < window.row_stop)
    differs = _differs(read(window, window.shape), value)
    data = np.zeros(len(depth) + 2, bool)
    data[:-2][inside] = differs[row[inside] - window.row, col[inside] - window.col]
    begins = data[:-2] & (data[1:-1] | data[2:])  # not a single speck
    return float(depth[begins.argmax()]) if begins.any() else float("nan")


def _is_clean(collar: Collar, overview: NDArray[np.generic]) -> bool:
    """Whether a collar is constant where JPEG has no cause for noise."""
    farther = tuple((a, b, c + JPEG_REACH_PX) for a, b, c in collar.sides)
    deep = ~replace(collar, sides=farther).valid(Window.whole(overview.shape), overview.shape)
    strays = np.abs(overview[deep].astype(np.float64) - collar.value) > _tolerance(overview, ROUNDING)
    return not deep.any() or bool(strays.mean() <= MAX_STRAYS)


def _least_length(constant: Bool, data: Bool) -> float:
    """Return the length of sides that shows a collar, in smaller sides of the raster, from how rare it is."""
    among = _between(data, 0) | _between(data, 1)
    share = float(constant[among].mean()) if among.any() else 1.0
    return MIN_LENGTH_RARE if share <= RARE else MIN_LENGTH_COMMON if share <= MAX_COMMON else np.inf


def _between(data: Bool, axis: int) -> Bool:
    """Return the pixels that have data, or are data, on both sides along an axis."""
    before = np.logical_or.accumulate(data, axis)
    after = np.flip(np.logical_or.accumulate(np.flip(data, axis), axis), axis)
    return before & after


FRAME_STRIP_PX: Final = 3
"""Rows at the top, in the middle and at the bottom that show whether a raster may be a framed scan."""
FRAME_EVEN: Final = 0.25
"""Largest spread of the outer ones of these strips, as a share of the spread of the middle one."""
FRAME_TOLERANCE: Final = 0.08
"""Difference from its tone, as a share of that spread, that the border of a scan may have at least."""
FRAME_DEPTH: Final = 0.2
"""Largest depth of a border, as a share of the image."""
FRAME_EDGE_PX: Final = 8
"""Depth of the strips on both sides of the border's end, px of the overview."""
FRAME_OUTSIDE: Final = 0.7
"""Least share of the border that has its tone: fiducial marks, clocks and text have the rest."""
FRAME_INSIDE: Final = 0.4
"""Largest share of the image just inside that has the tone of the border."""


@np.errstate(over="ignore", invalid="ignore")
def find_frame(read: Read, shape: tuple[int, int]) -> Collar | None:
    """Find the border of a scanned frame: film of one tone, with fiducial marks, clocks and text in it.

    All frames of a camera have the same one, on which they would agree whatever they show. Its tone is that
    of the outermost pixels, and at least three sides of it must end on a straight line beyond which hardly
    a pixel has that tone. Scans are of unsigned numbers. The band has `shape` rows and columns and is read
    by `read`.
    """
    rows, cols = shape
    if min(shape) < 8 * FRAME_EDGE_PX:
        return None
    across = FRAME_STRIP_PX, min(cols, COLLAR_OVERVIEW_PX)
    begins = (0, (rows - FRAME_STRIP_PX) // 2, rows - FRAME_STRIP_PX)
    read_strips = [read(Window(row, 0, FRAME_STRIP_PX, cols), across) for row in begins]
    strips = [strip.astype(np.float64) for strip in read_strips]
    top, middle, bottom = (float(np.ptp(np.percentile(strip, (10, 90)))) for strip in strips)
    if read_strips[0].dtype.kind != "u" or max(top, bottom) > FRAME_EVEN * middle or middle == 0:
        return None
    factor = max(1.0, max(shape) / COLLAR_OVERVIEW_PX)
    small = round(rows / factor), round(cols / factor)
    overview = read(Window.whole(shape), small).astype(np.float64)
    views = {(0, -1): overview, (0, 1): overview[::-1], (-1, 0): overview.T, (1, 0): overview.T[::-1]}
    sides = []
    for outward, view in views.items():
        ends = _border_end(view, FRAME_TOLERANCE * middle)
        if ends is not None:
            sides.append(_side_of(outward, np.add(ends, BLENDED_PX) * factor, shape))
    if len(sides) < 3:  # of the four of a scan
        return None
    value = float(np.median([np.median(strips[0]), np.median(strips[2])]))
    return _measured(Collar(shape, value, tuple(sides)), small)


def _border_end(overview: Float64, tolerance: float) -> tuple[float, float] | None:
    """Return how deep the border at the top of an image reaches at its left and at its right side, px.

    None where there is none. `tolerance` is the least difference from its tone that it may have.
    """
    outermost = overview[:FRAME_STRIP_PX]
    tone = float(np.median(outermost))
    spread = float(np.median(np.abs(outermost - tone)))
    same = np.abs(overview[:, ::2] - tone) <= max(6 * spread, tolerance)
    depth = np.arange(int(FRAME_DEPTH * len(overview)))
    col = np.arange(same.shape[1])
    edge = np.ones(FRAME_EDGE_PX) / FRAME_EDGE_PX
    best, best_ends = 0.0, None
    for slope in np.linspace(-0.03, 0.03, 25):  # a scan is laid down within two degrees
        tilt = slope * (2 * col - overview.shape[1] / 2)
        at = np.clip(np.rint(depth[:, None] + tilt).astype(int), 0, len(overview) - 1)
        share = same[at, col].mean(axis=1)
        mean = np.convolve(share, edge, "valid")
        outer, inner = mean[: -FRAME_EDGE_PX - 2], mean[FRAME_EDGE_PX + 2 :]
        ends = depth[: len(outer)] + FRAME_EDGE_PX
        all_of_it = np.cumsum(share)[ends - 1] / ends
        step = np.where(
            (np.minimum(outer, all_of_it) >= FRAME_OUTSIDE) & (inner <= FRAME_INSIDE), outer - inner, 0
        )
        if step.max() > best:
            best, end = float(step.max()), float(ends[step.argmax()])
            best_ends = end + 2 - slope * overview.shape[1] / 2, end + 2 + slope * overview.shape[1] / 2
    return best_ends


def _side_of(
    outward: tuple[int, int], ends_px: Float64, shape: tuple[int, int]
) -> tuple[float, float, float]:
    """Return the side of a collar (see `Collar.sides`) whose (2,) depths at both ends of a border are given.

    `outward` is the direction (col, row) of the border.
    """
    rows, cols = shape
    along = np.array([0.0, cols if outward[1] else rows])
    opposite = cols if outward == (1, 0) else rows if outward == (0, 1) else 0
    depth = opposite - ends_px if opposite else ends_px
    places = np.column_stack([along, depth] if outward[1] else [depth, along])
    edge = places[1] - places[0]
    normal = np.array([edge[1], -edge[0]]) / np.hypot(*edge)
    normal *= np.sign(normal @ outward)
    a, b = normal.tolist()
    return a, b, float(normal @ places[0])
