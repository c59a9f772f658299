"""Statistics of displacements or residuals as registration quality reports give them, per axis and radial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pair = tuple[float, float]

THREE_SIGMA_PERCENT = 99.73
"""What a requirement "at 3 sigma" covers."""


@dataclass(frozen=True, slots=True)
class AxisStatistics:
    """Statistics of one component of the errors, in their unit."""

    mean: float
    median: float
    std: float
    """Of the population (divided by n)."""
    rmse: float
    min: float
    max: float
    le90: float
    """Empirical 90th percentile of the absolute error."""


@dataclass(frozen=True, slots=True)
class RadialStatistics:
    """Statistics of the lengths of the errors, in their unit."""

    rmse: float
    """Root of RMSEx² + RMSEy²."""
    ce90: float
    ce95: float
    ce99_7: float
    """Empirical 90th, 95th and 99.73th percentile of the length."""


@dataclass(frozen=True, slots=True)
class NetStatistics:
    """The same with the matching noise taken out of the scatter, in the unit of the errors."""

    noise_xy: Pair
    """Root mean square of the points' sigma per axis: what has been taken out."""
    std_xy: Pair
    """0 where the scatter is no larger than the noise."""
    le90_xy: Pair
    rmse: float
    ce90: float
    ce95: float
    ce99_7: float


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Statistics of n errors in one unit."""

    n: int
    col: AxisStatistics
    row: AxisStatistics
    radial: RadialStatistics
    net: NetStatistics

    @staticmethod
    def of(errors_xy: Array, sigma_xy: Array) -> ErrorStatistics | None:
        """Return the statistics; None where no error is finite.

        Parameters
        ----------
        errors_xy : (n, 2) array
            Along columns and rows, any unit. Rows that are not finite are left out.
        sigma_xy : (n, 2) array
            Standard deviation of the matching noise in them, same unit.
        """
        finite = np.isfinite(errors_xy).all(axis=1)
        errors, sigma = errors_xy[finite], sigma_xy[finite]
        if len(errors) == 0:
            return None
        return ErrorStatistics(
            n=len(errors),
            col=axis_statistics(errors[:, 0]),
            row=axis_statistics(errors[:, 1]),
            radial=radial_statistics(errors),
            net=_net(errors, sigma),
        )


def in_units(
    errors_xy: Array, sigma_xy: Array, factors: Mapping[str, Array | None]
) -> dict[str, ErrorStatistics | None]:
    """Return the statistics by unit: errors and sigmas times the unit's (col, row); None: it is not known."""
    return {
        unit: None if factor is None else ErrorStatistics.of(errors_xy * factor, sigma_xy * factor)
        for unit, factor in factors.items()
    }


def without_noise(errors_xy: Array, sigma_xy: Array) -> Array:
    """Draw errors towards their mean until the matching noise is out of their scatter.

    The variance of the truth is that of the errors less the mean of the sigmas squared. Each error is
    drawn in until, noise included, it is expected to scatter as the truth does (Louis 1984,
    doi:10.1080/01621459.1984.10478062, for sigmas that differ), so percentiles of the result estimate
    those of the truth.

    Parameters
    ----------
    errors_xy : (n, 2) array
        Any unit.
    sigma_xy : (n, 2) array
        Standard deviation of the noise in each, same unit.

    Returns
    -------
    (n, 2) array
        With the mean of the errors; all equal to it along an axis where noise explains the whole scatter.
    """
    mean = errors_xy.mean(axis=0)
    noise = sigma_xy**2
    true = np.maximum(errors_xy.var(axis=0) - noise.mean(axis=0), 0.0)
    share = np.divide(true, true + noise, out=np.zeros_like(noise), where=true > 0)
    left = (errors_xy - mean) * np.sqrt(share)
    return np.asarray(mean + left - left.mean(axis=0))


def axis_statistics(errors: Array) -> AxisStatistics:
    """Return the statistics of (n,) errors, one or more."""
    return AxisStatistics(
        mean=float(errors.mean()),
        median=float(np.median(errors)),
        std=float(errors.std()),
        rmse=float(np.sqrt((errors**2).mean())),
        min=float(errors.min()),
        max=float(errors.max()),
        le90=float(np.percentile(np.abs(errors), 90)),
    )


def radial_statistics(errors_xy: Array) -> RadialStatistics:
    """Return the statistics of the lengths of (n, 2) errors, one or more."""
    length = np.hypot(errors_xy[:, 0], errors_xy[:, 1])
    ce90, ce95, ce99_7 = np.percentile(length, [90, 95, THREE_SIGMA_PERCENT]).tolist()
    return RadialStatistics(float(np.sqrt((length**2).mean())), ce90, ce95, ce99_7)


def _net(errors_xy: Array, sigma_xy: Array) -> NetStatistics:
    left = without_noise(errors_xy, sigma_xy)
    radial = radial_statistics(left)
    return NetStatistics(
        noise_xy=_pair(np.sqrt((sigma_xy**2).mean(axis=0))),
        std_xy=_pair(left.std(axis=0)),
        le90_xy=_pair(np.percentile(np.abs(left), 90, axis=0)),
        rmse=radial.rmse,
        ce90=radial.ce90,
        ce95=radial.ce95,
        ce99_7=radial.ce99_7,
    )


def _pair(values: Array) -> Pair:
    return float(values[0]), float(values[1])
