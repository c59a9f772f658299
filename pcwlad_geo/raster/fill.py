"""Fill that nothing declares: one value over much of a band, far from all others or in both of a pair."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import cv2
import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.band_pixels import BandPixels, Sample
from pcwlad_geo.raster.grid import Grid, map_px
from pcwlad_geo.raster.rpc.grid import RpcGrid
from pcwlad_geo.raster.source import Fill, RasterInfo
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class FillParameters:
    """When a value counts as fill."""

    min_share: float = 0.01
    """Least share of the band that has exactly this value."""
    min_gap: float = 0.25
    """Least distance from the other values, in ranges between their 1st and 99th percentile: of 479 bands
    those with a frequent extreme had at most 0.11, and fill of -9999 from 1.8 on."""
    max_between: float = 0.2
    """Largest number of values that are neither the fill nor near the data, as a share of the fill's pixels:
    where resampling has mixed both."""
    min_values: int = 16
    """Least number of other values: masks, classes and plans of few colours have no fill."""
    max_among_data: float = 0.02
    """Largest share of the other pixels with the value of a fill that only the same place in both shows."""
    core_px: int = 9
    """Side of the squares of which such a fill consists, px of the overview."""
    max_apart: float = 0.01
    """Largest share of such a fill that only one of the two has, farther than a pixel from its outline."""


FILL: Final = FillParameters()
"""Those in use."""


def fill_note(info: RasterInfo, fill: Fill, why: str) -> str:
    """Return the note that a value of a band is taken for its fill."""
    return (
        f"{100 * fill.share:.2g} % of {info.uri} has the value {fill.value:g}, {why}: taken for nodata; "
        "if it is data, declare another nodata value, or give a mask"
    )


def find_fills(sample: Sample, info: RasterInfo) -> tuple[Fill, ...]:
    """Return the fills of a band in a sample of it; at the upper end of its range not of 8 bits."""
    values = sample.values[sample.unmarked(info)].astype(np.float64)
    fills: list[Fill] = []
    total = max(1, len(values))
    for sign in (1.0,) if info.dtype == "uint8" else (1.0, -1.0):
        while (fill := _lowest_fill(sign * values, total)) is not None:
            ends = sorted((sign * fill.low, sign * fill.high))
            fill = Fill(sign * fill.value, ends[0], ends[1], fill.share)
            values = values[fill.is_data(values)]
            fills.append(fill)
    return tuple(fills)


def _lowest_fill(values: Float64, total: int) -> Fill | None:
    """Return the lowest of (n,) values, of `total` that the band has, as a fill if it is one."""
    if len(values) == 0:
        return None
    value = float(values.min())
    data = values[values != value]
    share = (len(values) - len(data)) / total
    if share < FILL.min_share or len(np.unique(data)) < FILL.min_values:
        return None
    low, high = np.percentile(data, (1, 99)).tolist()
    end = max(value / 2 + low / 2, low - (high - low))
    between = np.count_nonzero(data < end) / (share * total)
    if low - value < FILL.min_gap * (high - low) or between > FILL.max_between:
        return None
    return Fill(value, -np.inf, end, share)


def without_shared_fill(
    reference: RasterInfo,
    target: RasterInfo,
    reference_pixels: BandPixels | None = None,
    target_pixels: BandPixels | None = None,
) -> tuple[RasterInfo, RasterInfo, tuple[str, ...]]:
    """Return both bands of a pair without the fill that only the other one gives away, and notes of it.

    An extreme value without a gap to the others, such as 0 in 8 bits, is fill where both bands have it in the
    same large areas of the map, outline by outline, and hardly elsewhere. Ground that looks so in both, such
    as a lake without light, tells nothing but its shore. The pixels are those of the two bands, where they
    have been read already.
    """
    unchanged = reference, target, ()
    if isinstance(reference.grid, RpcGrid) or isinstance(target.grid, RpcGrid):
        return unchanged
    pixels = [
        read if read is not None and read.info.band == info.band else BandPixels(info)
        for info, read in ((reference, reference_pixels), (target, target_pixels))
    ]
    try:
        ends = [
            _frequent_ends(info, of_band) for info, of_band in zip((reference, target), pixels, strict=True)
        ]
        if not all(ends):
            return unchanged
        overview, other = (of_band.overview for of_band in pixels)
    except InputError:
        return unchanged
    row, col, inside = _places_in(reference.grid, overview.shape, target.grid, other.shape)
    common = overview.unmarked(reference) & inside & other.unmarked(target)[row, col]
    shares = {
        (one, two): _shared_share(
            (overview.values == one) & common, (other.values[row, col] == two) & common, common
        )
        for one, two in product(*ends)
    }
    reference_end, target_end = max(shares, key=lambda pair: shares[pair])
    if not (share := shares[reference_end, target_end]):
        return unchanged
    ref, tgt = (
        replace(info, fills=(*info.fills, Fill(end, end, end, share)))
        for info, end in ((reference, reference_end), (target, target_end))
    )
    why = f"in the same part of the map as {tgt.uri} the value {target_end:g}"
    return ref, tgt, (fill_note(ref, ref.fills[-1], why),)


def _frequent_ends(info: RasterInfo, pixels: BandPixels) -> list[float]:
    """Return the ends of a band's range that so much of it has exactly that they may be fill."""
    if info.mask_uri is not None or info.brightness is not None:
        return []
    values = pixels.sample.values[pixels.sample.unmarked(info)]
    if len(np.unique(values)) <= FILL.min_values:
        return []
    ends = [values.min(), values.max()]
    return [float(end) for end in ends if np.mean(values == end) >= FILL.min_share]


def _places_in(
    grid: Grid, shape: tuple[int, int], other: Grid, other_shape: tuple[int, int]
) -> tuple[Index, Index, Bool]:
    """Return the row and column in another overview of the pixels of one, and whether they lie in it."""
    size = np.array(other_shape[::-1], dtype=np.float64)
    px = np.array(grid.shape[::-1]) / np.array(shape[::-1])
    px_there = np.array(other.shape[::-1]) / size
    centres = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in shape[::-1])), axis=-1).reshape(-1, 2)
    at = map_px(centres * px, grid, other) / px_there
    with np.errstate(invalid="ignore"):
        inside = np.asarray(((at >= 0) & (at < size)).all(axis=1))
    col, row = np.where(inside[:, None], at, 0).astype(np.intp).T
    return row.reshape(shape), col.reshape(shape), inside.reshape(shape)


def _shared_share(one: Bool, other: Bool, common: Bool) -> float:
    """Return the share of the `common` pixels that an area has of two equal ones; 0 if they are not equal."""
    if one.sum() < FILL.min_share * common.sum():
        return 0.0
    neighbours, square = np.ones((3, 3), np.uint8), np.ones((FILL.core_px,) * 2, np.uint8)
    areas = [area.astype(np.uint8) for area in (one, other)]
    solid = [cv2.morphologyEx(area, cv2.MORPH_OPEN, square) for area in areas]
    strays = [
        float(np.sum(area > core) / max(1, int(np.sum(common > core))))
        for area, core in zip(areas, solid, strict=True)
    ]
    unshared = (solid[0] > cv2.dilate(areas[1], neighbours)) | (solid[1] > cv2.dilate(areas[0], neighbours))
    if unshared.sum() > FILL.max_apart * one.sum() or max(strays) > FILL.max_among_data:
        return 0.0
    return float(one.sum() / common.sum())
