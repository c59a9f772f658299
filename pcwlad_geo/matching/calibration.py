"""Calibration: formal covariances of tie points are scaled to the errors that a scene shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.matching import field
from pcwlad_geo.matching.types import MatchSettings, TiePoints
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class CalibrationParameters:
    """How formal covariances are scaled."""

    default_scale: float = 3.0
    """Factor on sigmas where too few points tell it."""
    scale_range: tuple[float, float] = (1.5, 12.0)
    """Least and largest factor."""
    least_residuals: int = 30
    """Least number of points with a residual that tell it."""
    coarse_sigma_px: float = 0.35
    """Sigma per axis of a match at a whole pixel, as method `coarse` ends with."""
    least_sigma_px: float = 0.01
    """Sigma per axis that every tie point gets, in quadrature."""


CALIBRATION: Final = CalibrationParameters()
"""Those in use."""
MEDIAN_CHI_SQUARE_2: Final = 1.3863
"""Median of the χ² distribution with two degrees of freedom, 2 ln 2."""


def sigma_scale(residual_px: Float64, covariance_px2: Float64) -> float:
    """Return the factor from formal to calibrated sigmas.

    The (n, 2) `residual_px` are displacements minus the prediction of independent neighbours (col, row), NaN
    where not known. The (n, 2, 2) `covariance_px2` are formal covariances, px².
    """
    finite = np.isfinite(residual_px).all(axis=1)
    if finite.sum() < CALIBRATION.least_residuals:
        return CALIBRATION.default_scale
    residual, weight = residual_px[finite], inverse(covariance_px2[finite] + 1e-8 * np.eye(2))
    squared = np.einsum("ni,nij,nj->n", residual, weight, residual)
    scale = float(np.sqrt(np.median(squared) / MEDIAN_CHI_SQUARE_2))
    return float(np.clip(scale, *CALIBRATION.scale_range))


def shared_variance(xy_px: Float64, residual_px: Float64, window_px: int, neighbours: int) -> float:
    """Return the variance per axis, px², of the error that the guides of a point have in common.

    It is the variance of the mean over the independent windows among them, as points whose structure is taken
    where their neighbours predict share the error of that prediction. The (n, 2) `xy_px` are the positions of
    all points, and (n, 2) `residual_px` is as for `sigma_scale`. So many `neighbours` guide a point.
    """
    radial = np.hypot(residual_px[:, 0], residual_px[:, 1])
    finite_px = radial[np.isfinite(radial)]
    if len(finite_px) < CALIBRATION.least_residuals:
        return 0.0
    windows = len(np.unique(np.floor(xy_px / window_px).astype(np.intp), axis=0))
    independent = max(1.0, windows * min(1.0, neighbours / len(xy_px)))
    return float(np.median(finite_px) ** 2 / MEDIAN_CHI_SQUARE_2 / independent)


def calibrated(covariance_px2: Float64, scale: float, shared_variance_px2: float | Float64 = 0.0) -> Float64:
    """Return calibrated covariances: scaled formal ones, plus shared variance, plus the least variance.

    The formal (n, 2, 2) `covariance_px2` get the factor `scale` of the sigmas, see `sigma_scale`, and
    `shared_variance_px2`, the variance per axis of errors shared with neighbours, one or (n,), px². The
    result is of shape (n, 2, 2), px².
    """
    common = np.asarray(shared_variance_px2 + CALIBRATION.least_sigma_px**2)
    result: Float64 = covariance_px2 * scale**2 + common[..., None, None] * np.eye(2)
    return result


def calibrate(
    points: TiePoints,
    surface: field.Surface | None,
    shared_variance_px2: float | Float64,
    settings: MatchSettings,
    window_variance_px2: float | None = None,
) -> TiePoints:
    """Return consistent points of the whole scene with calibrated covariances.

    The surface and `shared_variance_px2`, a float or (n,) array, are those of the guide, None without a
    field. The prediction of independent neighbours counts by the share of the point's own error in its
    residual, and `window_variance_px2`, the variance per axis from the differences of windows, for the rest.
    """
    residual, share = np.full((len(points), 2), np.nan), 0.0
    if surface is not None:
        residual, share = field.independent_residual(
            points.reference_xy_px, points.displacement_px, settings.window.side_px, surface
        )
    scale = sigma_scale(residual, points.covariance_px2)
    if window_variance_px2 is not None and len(points):
        formal_px2 = float(np.median(np.trace(points.covariance_px2, axis1=1, axis2=2))) / 2
        by_windows = window_variance_px2 / max(formal_px2, 1e-8)
        own_share = share if np.isfinite(residual).all(axis=1).sum() >= CALIBRATION.least_residuals else 0.0
        scale = float(
            np.clip(np.sqrt(own_share * scale**2 + (1 - own_share) * by_windows), *CALIBRATION.scale_range)
        )
    covariance = calibrated(points.covariance_px2, scale, shared_variance_px2)
    return replace(points, covariance_px2=covariance)
