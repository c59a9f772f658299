"""Accuracy figures of residuals, empirical: RMSE, LE90, CE90, CE95."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.error_statistics import axis_statistics, radial_statistics

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Statistics of (n, 2) residuals in one unit; NaN where there are none."""

    n: int
    mean_xy: tuple[float, float]
    rmse_xy: tuple[float, float]
    le90_xy: tuple[float, float]
    """Empirical 90th percentile of the absolute residual per axis."""
    rmse: float
    """Radial: root of RMSEx² + RMSEy²."""
    ce90: float
    """Empirical 90th percentile of the radial residual."""
    ce95: float
    """Empirical 95th percentile of the radial residual."""

    @staticmethod
    def of(residuals: Array) -> Accuracy:
        """Return the statistics of (n, 2) residuals (any unit; rows with NaN are left out)."""
        residuals = residuals[np.isfinite(residuals).all(axis=1)]
        if len(residuals) == 0:
            nan2 = (float("nan"), float("nan"))
            return Accuracy(0, nan2, nan2, nan2, *(float("nan"),) * 3)
        x, y = axis_statistics(residuals[:, 0]), axis_statistics(residuals[:, 1])
        radial = radial_statistics(residuals)
        return Accuracy(
            n=len(residuals),
            mean_xy=(x.mean, y.mean),
            rmse_xy=(x.rmse, y.rmse),
            le90_xy=(x.le90, y.le90),
            rmse=radial.rmse,
            ce90=radial.ce90,
            ce95=radial.ce95,
        )
