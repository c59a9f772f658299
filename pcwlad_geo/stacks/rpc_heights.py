"""Whether the DEM of a block of RPC images can be right: what the tie points say of its place and heights.

A DEM that is wrong by a constant looks like RPCs that err along the lines of parallax alone, each as its view
asks for, which chance hardly brings about. One that lies beside its place, or has another scale of heights,
leaves residuals along these lines that follow its slopes, or its heights.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import betainc

from pcwlad_geo.estimation.robust import sigma_of
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.geodesy import pixel_sizes_m
from pcwlad_geo.raster.rpc.dem import WGS84, Dem
from pcwlad_geo.stacks.rpc_block import (
    PLACE_SIGMAS,
    Block,
    BlockAdjustment,
    BlockPair,
    implied_heights,
    pixel_in_frame,
    relief,
)
from pcwlad_geo.types import Float64

BY_CHANCE: Final = 0.1
"""Probability below which biases that all lie along the parallax are not taken for those of RPCs."""
LEAST_PX: Final = 4.0
"""Least disagreement of two images, px, by which a DEM is called too high or too low."""
OFFSET_PX: Final = 3.0
"""A DEM is called displaced by at least so many of its pixels, or of the images', if that is significant."""
LEAST_OFFSET_M: Final = 3.0
"""And by at least so many metres."""
OFFSET_M: Final = 10.0
"""Without a reference, which RPCs may all miss alike, by at least so many metres."""
SCALE: Final = 0.03
"""Least error of the scale of heights that is told."""
SCALE_SIGMAS: Final = 5.0
"""It is told beyond so many sigmas."""
MIN_RELIEF: Final = 10.0
"""Least relief, in standard deviations of a point's height, that tells of the scale."""
ROUGH_PX: Final = 2.0
"""Least distance of two orthoimages that the scatter of a DEM's heights makes for them to be told of."""


@dataclass(frozen=True, slots=True)
class DemCheck:
    """What the tie points say of the DEM."""

    uri: str
    too_high_m: float | None
    """How much too high the DEM would be if the biases of the RPCs came from it; null without parallax."""
    by_chance: float | None
    """Probability that biases of random directions look so much like it."""
    disagreement_px: float | None
    """By how much that would set two images apart, at most."""
    beside_m: tuple[float, float] | None
    """How far (x, y) the relief of the DEM lies beside that of the tie points; null where it cannot tell."""
    beside_sigma_m: tuple[float, float] | None
    scale: float | None
    """By how much a metre of the DEM's relief is too high; null where it cannot tell."""
    scale_sigma: float | None
    scatter_m: float
    """Robust standard deviation of the DEM's heights at the tie points."""
    off_m: float
    """Error of 90 % of the heights, less their mean, where the relief clearly lies elsewhere; 0 otherwise."""
    wrong: tuple[str, ...]
    """Why it is taken for wrong; empty if nothing speaks against it."""


def check_dem(
    block: Block, pairs: Sequence[BlockPair], found: BlockAdjustment, absolute: bool
) -> DemCheck | None:
    """Return what the tie points of a block say of its DEM; None without one.

    The block is `absolute` if a reference or control points fix it.
    """
    dem = block.dem
    if dem is None:
        return None
    height_m, chance, separation_px = _too_high(block, pairs, found)
    beside_m, sigma_m = _horizontal_offset(block, dem, found, absolute)
    scale, scale_sigma = _scale(block, pairs, found)
    reasons: list[str] = []
    if chance is not None and chance < BY_CHANCE and separation_px is not None and separation_px >= LEAST_PX:
        reasons.append(_height_message(dem, height_m or 0.0, separation_px))
    if beside_m is not None and found.dem_moved and np.hypot(*beside_m) > _least_m(block, dem, absolute):
        reasons.append(
            f"the relief of the DEM {dem.uri} lies ({beside_m[0]:+.1f}, {beside_m[1]:+.1f}) m (x, y) beside "
            "the relief that the tie points show: check its position"
            + ("" if absolute else ", unless the RPCs of all images err by that")
        )
    if scale is not None and abs(scale) > max(SCALE, SCALE_SIGMAS * (scale_sigma or 0.0)):
        reasons.append(
            f"the relief of the DEM {dem.uri} is {100 * abs(scale):.0f} % too "
            f"{'high' if scale > 0 else 'low'}: check the unit of its heights, and whether it is smoothed"
        )
    rough_px = found.sigma_height_m * _parallax_px(found)
    if rough_px > ROUGH_PX:
        reasons.append(
            f"the heights of the DEM {dem.uri} scatter by {found.sigma_height_m:.1f} m about those of the "
            f"tie points, which sets orthoimages {rough_px:.1f} px apart from place to place"
        )
    return DemCheck(
        dem.uri, height_m, chance, separation_px, beside_m, sigma_m, scale, scale_sigma,
        found.sigma_height_m, _off_m(block, found), tuple(reasons),
    )  # fmt: skip


def _off_m(block: Block, found: BlockAdjustment) -> float:
    """Return `DemCheck.off_m`: what a DEM that stays beside its place does to the heights of points."""
    if not found.dem_moved:
        return 0.0
    ground_px = np.concatenate([fit.linear.ground_px for fit in found.edges])
    higher_m, _ = relief(block, ground_px, 0.0, found.dem_shift_px)
    return float(np.percentile(np.abs(higher_m - np.mean(higher_m)), 90))


def _height_message(dem: Dem, height_m: float, separation_px: float) -> str:
    side = "high" if height_m > 0 else "low"
    return (
        f"the DEM {dem.uri} lies about {abs(height_m):.1f} m too {side} by the parallax of the tie points, "
        f"or the RPCs err along the parallax alone, by up to {separation_px:.1f} px: check --dem-vertical "
        "(what its heights are above) and its position"
    )


def _too_high(
    block: Block, pairs: Sequence[BlockPair], found: BlockAdjustment
) -> tuple[float | None, float | None, float | None]:
    """Return how much too high the DEM seems, the chance of that, and what it sets images apart by, px."""
    size = {image: pixel_in_frame(block, image) for image in found.free}
    by_height, by_image = [], []
    for image in found.free:
        middle = block.grids[image].middle_px
        by_height.append(found.by_height_px[image] * size[image])
        by_image.append((found.corrections[image].forward(middle) - middle)[0] * size[image])
    response, biases = np.concatenate(by_height), np.concatenate(by_image)
    freedom = 2 * len(found.free) - min(found.datum_rank, 2)
    power = float(response @ response)
    rate = _parallax_px(found)
    if freedom < 2 or not rate > 1e-3 or not power > 0 or not np.any(biases):
        return None, None, None
    height_m = float(response @ biases) / power
    alike = height_m**2 * power / float(biases @ biases)
    chance = 1.0 - float(betainc(0.5, (freedom - 1) / 2, min(alike, 1.0)))
    return height_m, chance, abs(height_m) * rate


def _parallax_px(found: BlockAdjustment) -> float:
    """Return by how much a metre of height sets two images apart, at most."""
    rates = [np.nanmedian(fit.linear.height_rate, axis=0) for fit in found.edges]
    return max((float(np.hypot(*each)) for each in rates), default=0.0)


def _horizontal_offset(
    block: Block, dem: Dem, found: BlockAdjustment, absolute: bool
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return where the relief of the DEM lies, and its standard deviation; None where it cannot tell."""
    sizes = pixel_sizes_m(dem.grid, dem.grid.middle_px)
    if sizes is None:
        return None, None
    off, sigma = -found.dem_shift_px * sizes[0], found.dem_sigma_px * sizes[0]
    if not found.dem_moved and PLACE_SIGMAS * np.hypot(*sigma) > _least_m(block, dem, absolute):
        return None, None
    down = -1.0 if dem.grid.transform.e < 0 else 1.0
    return (float(off[0]), float(down * off[1])), (float(sigma[0]), float(sigma[1]))


def _least_m(block: Block, dem: Dem, absolute: bool) -> float:
    """Return the least displacement of a DEM that is told, metres."""
    sizes = [pixel_sizes_m(grid, grid.middle_px) for grid in (dem.grid, block.frame)]
    least = OFFSET_PX * max(float(each.max()) for each in sizes if each is not None)
    return max(least, LEAST_OFFSET_M if absolute else OFFSET_M)


def _scale(
    block: Block, pairs: Sequence[BlockPair], found: BlockAdjustment
) -> tuple[float | None, float | None]:
    """Return the share by which the relief of the DEM is too high, and its standard deviation."""
    above, at_m, cell = (np.concatenate(each) for each in zip(*_points(block, pairs, found), strict=True))
    known = np.isfinite(above) & np.isfinite(at_m)
    above, at_m, cell = above[known], at_m[known], cell[known]
    noise = sigma_of(above) if len(above) else 0.0
    numbers = np.unique(cell)
    if len(numbers) < 6 or np.ptp(at_m) < MIN_RELIEF * max(noise, 1e-3):
        return None, None
    near = np.abs(above - np.median(above)) <= 4 * max(noise, 1e-3)

    def slope(chosen: Float64) -> float:
        return float(np.polyfit(at_m[chosen] - at_m.mean(), above[chosen], 1)[0])

    left = np.array([slope(near & (cell != number)) for number in numbers])
    sigma = 1.4 * float(np.sqrt((len(left) - 1) * left.var()))
    scale = -slope(near)
    significant = max(SCALE, abs(scale)) > SCALE_SIGMAS * sigma
    return (scale, sigma) if significant else (None, None)


def _points(
    block: Block, pairs: Sequence[BlockPair], found: BlockAdjustment
) -> Iterator[tuple[Float64, Float64, Float64]]:
    """Yield for each pair by how much its points lie above the DEM, where that is, and their cells."""
    dem = block.dem
    for pair, fit in zip(pairs, found.edges, strict=True):
        ground_px = fit.linear.ground_px
        above, _ = implied_heights(pair, fit.linear, fit.left_px)
        lon_lat = transform_xy(block.frame.to_xy(ground_px), block.frame.crs, WGS84)
        cell = np.floor(6 * ground_px / max(block.frame.shape)) @ np.array([1.0, 100.0])
        used = fit.weight.any(axis=(1, 2)) & (pair.height_m is None)
        at_m = dem.at(lon_lat) if dem is not None else np.full(len(pair), np.nan)
        yield np.where(used, above, np.nan), at_m, cell
