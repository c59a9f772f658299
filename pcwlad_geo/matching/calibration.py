"""Calibrated sigmas: the formal covariance of a fit times what the scene itself shows.

Neighbouring residuals are correlated and the structure weights follow the position, so the formal
sigma is too small, by a factor that depends on the pair. The scene gives that factor: each point
against what neighbours that share no pixel with it predict.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

DEFAULT_SCALE: Final = 3.0
"""Where a scene has too few points to tell."""
SCALE_RANGE: Final = (1.5, 12.0)
LEAST_POINTS: Final = 30
MEDIAN_CHI_SQUARE_2: Final = 1.3863
LEAST_SIGMA_PX: Final = 0.01


def sigma_scale(residual_px: Float64, covariance_px2: Float64) -> float:
    """Return the factor from formal to real sigmas.

    Parameters
    ----------
    residual_px : (n, 2) array
        Displacement minus the prediction of independent neighbours; NaN where not known.
    covariance_px2 : (n, 2, 2) array
        Formal covariances.
    """
    known = np.isfinite(residual_px).all(axis=1)
    if known.sum() < LEAST_POINTS:
        return DEFAULT_SCALE
    residual, covariance = residual_px[known], covariance_px2[known] + 1e-8 * np.eye(2)
    squared = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(covariance), residual)
    scale = float(np.sqrt(np.median(squared) / MEDIAN_CHI_SQUARE_2))
    return float(np.clip(scale, *SCALE_RANGE))


def shared_variance(xy_px: Float64, residual_px: Float64, window_px: int, neighbours: int) -> float:
    """Return the variance per axis of the mean of the independent windows among so many neighbours.

    Points that take their mutual structure where their neighbours agree share the neighbours' error.

    Parameters
    ----------
    xy_px : (n, 2) array
        Positions of all points.
    residual_px : (n, 2) array
        Displacement minus the prediction of independent neighbours; NaN where not known.
    window_px : int
        Side of the matching window.
    neighbours : int
        Points that guide a point.
    """
    radial = np.hypot(residual_px[:, 0], residual_px[:, 1])
    known = radial[np.isfinite(radial)]
    if len(known) < LEAST_POINTS:
        return 0.0
    windows = len(np.unique(np.floor(xy_px / window_px).astype(np.intp), axis=0))
    independent = max(1.0, windows * min(1.0, neighbours / len(xy_px)))
    return float(np.median(known) ** 2 / MEDIAN_CHI_SQUARE_2 / independent)


def calibrated(covariance_px2: Float64, scale: float, shared_variance_px2: float | Float64 = 0.0) -> Float64:
    """Return the (n, 2, 2) covariances scaled, with what points share and a floor added."""
    common = np.asarray(shared_variance_px2 + LEAST_SIGMA_PX**2)
    result: Float64 = covariance_px2 * scale**2 + common[..., None, None] * np.eye(2)
    return result
