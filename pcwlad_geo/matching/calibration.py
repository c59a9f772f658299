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

DEFAULT_SCALE: Final = 3.5
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


def calibrated(covariance_px2: Float64, scale: float) -> Float64:
    """Return the (n, 2, 2) covariances scaled, with a floor."""
    result: Float64 = covariance_px2 * scale**2 + LEAST_SIGMA_PX**2 * np.eye(2)
    return result
