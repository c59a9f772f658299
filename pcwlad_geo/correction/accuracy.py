"""Accuracy figures of residuals, empirical: RMSE, LE90, CE90, CE95."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        radial = np.hypot(residuals[:, 0], residuals[:, 1])
        return Accuracy(
            n=len(residuals),
            mean_xy=_pair(residuals.mean(axis=0)),
            rmse_xy=_pair(np.sqrt((residuals**2).mean(axis=0))),
            le90_xy=_pair(np.percentile(np.abs(residuals), 90, axis=0)),
            rmse=float(np.sqrt((radial**2).mean())),
            ce90=float(np.percentile(radial, 90)),
            ce95=float(np.percentile(radial, 95)),
        )


def _pair(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])
