"""What the tie points of a block say of its DEM: its height, its position and its scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import betainc

from pcwlad_geo.estimation.robust import sigma_of
from pcwlad_geo.multi.block.adjustment import BlockAdjustment
from pcwlad_geo.multi.block.block import BlockPair, RpcBlock, pixel_in_frame
from pcwlad_geo.multi.block.linearisation import implied_heights
from pcwlad_geo.multi.block.parameters import DEM_CHECK, DemCheckParameters
from pcwlad_geo.raster import WGS84, Dem, pixel_sizes_m, transform_xy
from pcwlad_geo.raster.rpc.dem import relief
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class DemCheck:
    """The errors of the DEM that the tie points indicate."""

    uri: str
    too_high_m: float | None
    """Height error of the DEM that would explain the biases of the RPCs; null without parallax."""
    by_chance: float | None
    """Probability that biases of random directions would be explained as well."""
    separation_px: float | None
    """Largest displacement between two images that this height error causes."""
    offset_m: tuple[float, float] | None
    """Horizontal offset (x, y) of the relief of the DEM from that of the tie points; null if unknown."""
    offset_sigma_m: tuple[float, float] | None
    scale: float | None
    """Relative scale error of the heights of the DEM, positive if its relief is too high; null if unknown."""
    scale_sigma: float | None
    scatter_m: float
    """Robust standard deviation of the DEM's heights at the tie points."""
    off_m: float
    """Error of 90 % of the heights, less their mean, if the horizontal offset is significant; 0 otherwise."""
    faults: tuple[str, ...]
    """Its significant errors, each a sentence; empty if there are none."""


def check_dem(
    block: RpcBlock,
    pairs: Sequence[BlockPair],
    adjustment: BlockAdjustment,
    absolute: bool,
    parameters: DemCheckParameters = DEM_CHECK,
) -> DemCheck | None:
    """Return what the tie points of a block say of its DEM; None without one.

    One that is wrong by a constant looks like RPCs that err along the lines of parallax alone, each as its
    view asks for, which chance hardly brings about. One that lies beside its place, or has another scale of
    heights, leaves residuals along these lines that follow its slopes, or its heights. The block is
    `absolute` if a reference or control points fix it.
    """
    dem = block.dem
    if dem is None:
        return None
    least_m = _least_m(block, dem, absolute, parameters)
    height_m, chance, separation_px = _too_high(block, adjustment)
    offset_m, sigma_m = _horizontal_offset(block, dem, adjustment, least_m)
    scale, scale_sigma = _scale(block, pairs, adjustment, parameters)
    reasons: list[str] = []
    if (
        chance is not None
        and chance < parameters.significance
        and separation_px is not None
        and separation_px >= parameters.min_separation_px
    ):
        reasons.append(_height_message(dem, height_m or 0.0, separation_px))
    if offset_m is not None and adjustment.dem_moved and np.hypot(*offset_m) > least_m:
        reasons.append(
            f"the relief of the DEM {dem.uri} lies ({offset_m[0]:+.1f}, {offset_m[1]:+.1f}) m (x, y) beside "
            "the relief that the tie points show: check its position"
            + ("" if absolute else ", unless the RPCs of all images err by that")
        )
    least_scale = max(parameters.min_scale, parameters.scale_sigmas * (scale_sigma or 0.0))
    if scale is not None and abs(scale) > least_scale:
        reasons.append(
            f"the relief of the DEM {dem.uri} is {100 * abs(scale):.0f} % too "
            f"{'high' if scale > 0 else 'low'}: check the unit of its heights, and whether it is smoothed"
        )
    rough_px = adjustment.sigma_height_m * _parallax_px(adjustment)
    if rough_px > parameters.rough_px:
        reasons.append(
            f"the heights of the DEM {dem.uri} scatter by {adjustment.sigma_height_m:.1f} m about those of "
            f"the tie points, which sets orthoimages {rough_px:.1f} px apart from place to place"
        )
    return DemCheck(
        uri=dem.uri,
        too_high_m=height_m,
        by_chance=chance,
        separation_px=separation_px,
        offset_m=offset_m,
        offset_sigma_m=sigma_m,
        scale=scale,
        scale_sigma=scale_sigma,
        scatter_m=adjustment.sigma_height_m,
        off_m=_off_m(block, adjustment),
        faults=tuple(reasons),
    )


def _off_m(block: RpcBlock, adjustment: BlockAdjustment) -> float:
    """Return `DemCheck.off_m`: what a DEM that stays beside its place does to the heights of points."""
    if not adjustment.dem_moved:
        return 0.0
    ground_px = np.concatenate([fit.linear.ground_px for fit in adjustment.edges])
    higher_m, _ = relief(block.dem, block.frame, ground_px, 0.0, adjustment.dem_shift_px)
    return float(np.percentile(np.abs(higher_m - np.mean(higher_m)), 90))


def _height_message(dem: Dem, height_m: float, separation_px: float) -> str:
    side = "high" if height_m > 0 else "low"
    return (
        f"the DEM {dem.uri} lies about {abs(height_m):.1f} m too {side} by the parallax of the tie points, "
        f"or the RPCs err along the parallax alone, by up to {separation_px:.1f} px: check --dem-vertical "
        "(what its heights are above) and its position"
    )


def _too_high(
    block: RpcBlock, adjustment: BlockAdjustment
) -> tuple[float | None, float | None, float | None]:
    """Return how much too high the DEM seems, the chance of that, and what it sets images apart by, px."""
    size = {image: pixel_in_frame(block, image) for image in adjustment.free}
    by_height, by_image = [], []
    for image in adjustment.free:
        middle = block.grids[image].middle_px
        by_height.append(adjustment.by_height_px[image] * size[image])
        by_image.append((adjustment.corrections[image].forward(middle) - middle)[0] * size[image])
    response, biases = np.concatenate(by_height), np.concatenate(by_image)
    freedom = 2 * len(adjustment.free) - min(adjustment.datum_rank, 2)
    power = float(response @ response)
    rate = _parallax_px(adjustment)
    if freedom < 2 or not rate > 1e-3 or not power > 0 or not np.any(biases):
        return None, None, None
    height_m = float(response @ biases) / power
    agreement = height_m**2 * power / float(biases @ biases)
    chance = 1.0 - float(betainc(0.5, (freedom - 1) / 2, min(agreement, 1.0)))
    return height_m, chance, abs(height_m) * rate


def _parallax_px(adjustment: BlockAdjustment) -> float:
    """Return by how much a metre of height sets two images apart, at most."""
    derivatives = [np.nanmedian(fit.linear.height_derivative, axis=0) for fit in adjustment.edges]
    return max((float(np.hypot(*derivative)) for derivative in derivatives), default=0.0)


def _horizontal_offset(
    block: RpcBlock, dem: Dem, adjustment: BlockAdjustment, least_m: float
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return where the relief of the DEM lies, and its standard deviation; None where it cannot tell."""
    sizes = pixel_sizes_m(dem.grid, dem.grid.middle_px)
    if sizes is None:
        return None, None
    off, sigma = -adjustment.dem_shift_px * sizes[0], adjustment.dem_sigma_px * sizes[0]
    if not adjustment.dem_moved and block.parameters.dem_shift_sigmas * np.hypot(*sigma) > least_m:
        return None, None
    down = -1.0 if dem.grid.transform.e < 0 else 1.0
    return (float(off[0]), float(down * off[1])), (float(sigma[0]), float(sigma[1]))


def _least_m(block: RpcBlock, dem: Dem, absolute: bool, parameters: DemCheckParameters) -> float:
    """Return the least displacement of a DEM that is reported, metres."""
    sizes = [pixel_sizes_m(grid, grid.middle_px) for grid in (dem.grid, block.frame)]
    least = parameters.min_offset_px * max(float(size_m.max()) for size_m in sizes if size_m is not None)
    return max(least, parameters.min_offset_m[not absolute])


def _scale(
    block: RpcBlock, pairs: Sequence[BlockPair], adjustment: BlockAdjustment, parameters: DemCheckParameters
) -> tuple[float | None, float | None]:
    """Return the share by which the relief of the DEM is too high, and its standard deviation."""
    cells = parameters.scale_cells
    above, at_m, cell = (
        np.concatenate(parts) for parts in zip(*_points(block, pairs, adjustment, cells), strict=True)
    )
    valid = np.isfinite(above) & np.isfinite(at_m)
    above, at_m, cell = above[valid], at_m[valid], cell[valid]
    noise = sigma_of(above) if len(above) else 0.0
    numbers = np.unique(cell)
    if len(numbers) < cells or np.ptp(at_m) < parameters.min_relief * max(noise, 1e-3):
        return None, None
    inliers = np.abs(above - np.median(above)) <= 4 * max(noise, 1e-3)

    def slope(selection: Float64) -> float:
        return float(np.polyfit(at_m[selection] - at_m.mean(), above[selection], 1)[0])

    slopes = np.array([slope(inliers & (cell != number)) for number in numbers])
    sigma = 1.4 * float(np.sqrt((len(slopes) - 1) * slopes.var()))
    scale = -slope(inliers)
    significant = max(parameters.min_scale, abs(scale)) > parameters.scale_sigmas * sigma
    return (scale, sigma) if significant else (None, None)


def _points(
    block: RpcBlock, pairs: Sequence[BlockPair], adjustment: BlockAdjustment, cells: int
) -> Iterator[tuple[Float64, Float64, Float64]]:
    """Yield for each pair by how much its points lie above the DEM, where that is, and their cells.

    The longer side of the ground is divided into `cells`.
    """
    dem = block.dem
    for pair, fit in zip(pairs, adjustment.edges, strict=True):
        ground_px = fit.linear.ground_px
        above, _ = implied_heights(pair, fit.linear, fit.residual_px)
        lon_lat = transform_xy(block.frame.to_xy(ground_px), block.frame.crs, WGS84)
        cell = np.floor(cells * ground_px / max(block.frame.shape)) @ np.array([1.0, 100.0])
        in_use = fit.weight.any(axis=(1, 2)) & (pair.height_m is None)
        at_m = dem.at(lon_lat) if dem is not None else np.full(len(pair), np.nan)
        yield np.where(in_use, above, np.nan), at_m, cell
