"""The observations of a pair of a block: its points, followed from image to image, and derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.estimation.robust import MEASURED
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.multi.block.block import BlockPair, ImageTerms, RpcBlock
from pcwlad_geo.raster import at_mean_height, map_px
from pcwlad_geo.raster.rpc.grid import image_px, with_height_offset
from pcwlad_geo.types import Float64

NO_PARALLAX: Final = 1e-3
"""Pairs that a metre of height displaces by fewer px tell nothing of heights."""
ZERO_SIGMA: Final = 1e-6
"""Standard deviation that stands for zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """The linearised observations of a pair: its points as predicted in the second image, and derivatives."""

    residual_px: Float64
    """(n, 2) observed less predicted."""
    first_jacobian: Float64
    """(n, 2, 2) derivatives of the predicted px by those of the first image, through the terrain: the mean of
    all points, as windows average what slopes change from point to point."""
    first_terms: Float64
    """(n, 3) terms 1, column, row of the first image's correction."""
    second_terms: Float64
    height_derivative: Float64
    """(n, 2) derivative of the predicted px by the height of the DEM, px per metre."""
    dem_jacobian: Float64
    """(n, 2, 2) derivatives by a shift of the DEM (col, row), its px, orthogonal to those by the height."""
    ground_px: Float64
    """(n, 2) px of the frame."""
    points_per_dem_px: float
    """Number of points per pixel of the DEM that holds any: they share its error of height."""


def linearised_pair(block: RpcBlock, pair: BlockPair, *, level: bool = False) -> Linearisation:
    """Follow the points of a pair through the first image, the ground (`level` or not), the second image.

    The DEM stays where it is: `dem_jacobian` is 0.
    """
    grids, frame = [block.grids[image] for image in (pair.first, pair.second)], block.frame
    if level:
        grids = [at_mean_height(grid) for grid in grids]

    def predict(px: Float64, higher_m: float = 0.0) -> Float64:
        first, second = (with_height_offset(grid, higher_m) if higher_m else grid for grid in grids)
        return image_px(second, frame, map_px(px, first, frame), pair.height_m)

    at_px, ground_px = predict(pair.first_px), map_px(pair.first_px, grids[0], frame)
    sides = [predict(pair.first_px + step) - predict(pair.first_px - step) for step in np.eye(2) / 2]
    by_first = np.stack(sides, axis=2)
    height_derivative = predict(pair.first_px, 1.0) - at_px  # by a metre
    return Linearisation(
        residual_px=pair.second_px - at_px,
        first_jacobian=np.broadcast_to(np.nanmean(by_first, axis=0), by_first.shape),
        first_terms=ImageTerms.over(grids[0].shape).values(pair.first_px),
        second_terms=ImageTerms.over(grids[1].shape).values(at_px),
        height_derivative=height_derivative,
        dem_jacobian=np.zeros((len(pair), 2, 2)),
        ground_px=ground_px,
        points_per_dem_px=_points_per_dem_px(block, ground_px),
    )


def _points_per_dem_px(block: RpcBlock, ground_px: Float64) -> float:
    """Return `Linearisation.points_per_dem_px` of points at the (n, 2) `ground_px` of the frame."""
    if block.dem is None:
        return 1.0
    at_px = np.floor(map_px(ground_px, block.frame, block.dem.grid))
    return len(at_px) / max(1, len(np.unique(at_px, axis=0)))


def orthogonal_to_height(linearised: Sequence[Linearisation]) -> tuple[Linearisation, ...]:
    """Remove from the derivatives by the DEM's place what a uniform change of height explains."""
    by_height = [np.nan_to_num(linear.height_derivative) for linear in linearised]
    every, by_place = (
        np.concatenate(by_height),
        np.concatenate([derivative.dem_jacobian for derivative in linearised]),
    )
    share = np.einsum("na,nab->b", every, by_place) / max(float((every**2).sum()), NO_PARALLAX**2)
    return tuple(
        replace(linear, dem_jacobian=linear.dem_jacobian - derivative[:, :, None] * share)
        for linear, derivative in zip(linearised, by_height, strict=True)
    )


def height_variance(
    pair: BlockPair, linear: Linearisation, residual_px: Float64, sigma_m: float, limit: float
) -> Float64:
    """Return the (n,) variances of the DEM's heights, m²: all points of one of its pixels count as one.

    The (n, 2) `residual_px` are distances from an adjustment; `limit` is `BlockParameters.height_limit`.
    """
    height, _ = implied_heights(pair, linear, residual_px)
    off = np.abs(np.nan_to_num(height)) / (limit * max(sigma_m, ZERO_SIGMA))
    return sigma_m**2 * linear.points_per_dem_px * np.maximum(1.0, off)


def point_weights(pair: BlockPair, linear: Linearisation, variance_m2: Float64 | float = 0.0) -> Float64:
    """Return the (n, 2, 2) inverse covariances of points, heights eliminated; 0 where unknown.

    The variance of the heights is `variance_m2`, one or (n,) of them.
    """
    by_height = linear.height_derivative
    covariance = pair.covariance_px2 + (variance_m2 * (by_height[:, :, None] * by_height[:, None, :]).T).T
    valid = np.isfinite(linear.residual_px).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    valid &= np.isfinite(linear.first_jacobian).all(axis=(1, 2))
    weight = np.zeros_like(covariance)
    weight[valid] = inverse(covariance[valid], MEASURED)
    return weight


def implied_heights(pair: BlockPair, linear: Linearisation, residual_px: Float64) -> tuple[Float64, Float64]:
    """Return by how much (n,) points lie above the DEM, and the (n,) variance of that, metres and m².

    NaN where there is no parallax. The (n, 2) `residual_px` are distances from an adjustment.
    """
    weight = inverse(pair.covariance_px2, MEASURED)
    information = np.einsum("na,nab,nb->n", linear.height_derivative, weight, linear.height_derivative)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.einsum("na,nab,nb->n", linear.height_derivative, weight, residual_px) / information
        visible = np.hypot(*linear.height_derivative.T) >= NO_PARALLAX
        return np.where(visible, height, np.nan), np.where(visible, 1 / information, np.nan)
