"""Statistics of errors, per axis and radial, with and without the matching noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from pcwlad_geo.types import Float64

FloatPair = tuple[float, float]
Amount = Annotated[float, ("minimum", 0)]
Count = Annotated[int, ("minimum", 0)]
Share = Annotated[float, ("minimum", 0), ("maximum", 1)]
SIGMA_90: Final = 2.146
"""Radius that holds 90 % of a circular normal distribution, in sigmas of an axis."""


@dataclass(frozen=True, slots=True)
class AxisStatistics:
    """Statistics of one component of the errors, in their unit."""

    mean: float
    median: float
    std: Amount
    """Standard deviation of the population (divided by n)."""
    rmse: Amount
    min: float
    max: float
    le90: Amount
    """Empirical 90th percentile of the absolute error."""


@dataclass(frozen=True, slots=True)
class RadialStatistics:
    """Statistics of the lengths of the errors, in their unit."""

    rmse: Amount
    """Root of RMSEx² + RMSEy²."""
    ce90: Amount
    """Empirical 90th percentile of the length."""
    ce95: Amount
    """Empirical 95th percentile of the length."""
    ce99_7: Amount
    """Empirical 99.73th percentile of the length."""


@dataclass(frozen=True, slots=True)
class NetStatistics:
    """Statistics with the matching noise removed from the scatter, in the unit of the errors."""

    noise_xy: FloatPair
    """Root mean square of the points' sigma per axis, the noise that was removed."""
    std_xy: FloatPair
    """Standard deviation per axis; 0 where the scatter is no larger than the noise."""
    le90_xy: FloatPair
    rmse: Amount
    ce90: Amount
    ce95: Amount
    ce99_7: Amount


@dataclass(frozen=True, slots=True)
class UnitStatistics:
    """Statistics of errors in one unit."""

    col: AxisStatistics
    row: AxisStatistics
    radial: RadialStatistics
    net: NetStatistics


@dataclass(frozen=True, slots=True)
class ErrorStatistics(UnitStatistics):
    """Statistics of n errors in one unit."""

    n: int

    @property
    def of_unit(self) -> UnitStatistics:
        """The statistics without their number, which is the same in all units."""
        return UnitStatistics(self.col, self.row, self.radial, self.net)

    @staticmethod
    def of(errors_xy: Float64, sigma_xy: Float64) -> ErrorStatistics | None:
        """Return the statistics; None if no error is finite.

        The (n, 2) errors `errors_xy` (col, row) are in any unit, and rows that are not finite are left out.
        The (n, 2) array `sigma_xy` has the standard deviation of the matching noise in them.
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
    errors_xy: Float64, sigma_xy: Float64, factors: Mapping[str, Float64 | None]
) -> dict[str, ErrorStatistics | None]:
    """Return the statistics in several units.

    The (n, 2) arrays `errors_xy` and `sigma_xy` are those of `ErrorStatistics.of`. The `factors` convert them
    to each unit (col, row), (2,) or (n, 2); None if the factor is not known.
    """
    return {
        unit: None if factor is None else ErrorStatistics.of(errors_xy * factor, sigma_xy * factor)
        for unit, factor in factors.items()
    }


def without_noise(errors_xy: Float64, sigma_xy: Float64) -> Float64:
    """Shrink errors towards their mean so that their scatter is that without the matching noise.

    The variance of the truth is that of the errors less the mean of the sigmas squared. Each error is
    shrunk until, noise included, it is expected to scatter as the truth does (Louis 1984,
    doi:10.1080/01621459.1984.10478062, for sigmas that differ), so percentiles of the result estimate
    those of the truth.

    Parameters
    ----------
    errors_xy : (n, 2) array
        Errors (col, row), any unit.
    sigma_xy : (n, 2) array
        Standard deviation of the noise in each, same unit.

    Returns
    -------
    (n, 2) array
        Errors of the same mean; all equal to it along an axis where noise explains the whole scatter.
    """
    mean = errors_xy.mean(axis=0)
    noise = sigma_xy**2
    true = np.maximum(errors_xy.var(axis=0) - noise.mean(axis=0), 0.0)
    share = np.divide(true, true + noise, out=np.zeros_like(noise), where=true > 0)
    shrunk = (errors_xy - mean) * np.sqrt(share)
    return np.asarray(mean + shrunk - shrunk.mean(axis=0))


def axis_statistics(errors: Float64) -> AxisStatistics:
    """Return the statistics of the (n,) `errors` of one axis, in any unit; n ≥ 1."""
    return AxisStatistics(
        mean=float(errors.mean()),
        median=float(np.median(errors)),
        std=float(errors.std()),
        rmse=float(np.sqrt((errors**2).mean())),
        min=float(errors.min()),
        max=float(errors.max()),
        le90=float(np.percentile(np.abs(errors), 90)),
    )


def radial_statistics(errors_xy: Float64) -> RadialStatistics:
    """Return the statistics of the lengths of the (n, 2) errors `errors_xy`, in any unit; n ≥ 1."""
    length = np.hypot(errors_xy[:, 0], errors_xy[:, 1])
    ce90, ce95, ce99_7 = np.percentile(length, [90, 95, 99.73]).tolist()
    return RadialStatistics(float(np.sqrt((length**2).mean())), ce90, ce95, ce99_7)


def _net(errors_xy: Float64, sigma_xy: Float64) -> NetStatistics:
    errors = without_noise(errors_xy, sigma_xy)
    radial = radial_statistics(errors)
    return NetStatistics(
        noise_xy=float_pair(np.sqrt((sigma_xy**2).mean(axis=0))),
        std_xy=float_pair(errors.std(axis=0)),
        le90_xy=float_pair(np.percentile(np.abs(errors), 90, axis=0)),
        rmse=radial.rmse,
        ce90=radial.ce90,
        ce95=radial.ce95,
        ce99_7=radial.ce99_7,
    )


def float_pair(values: Float64) -> FloatPair:
    """Return the (2,) `values` as numbers of Python."""
    return float(values[0]), float(values[1])


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Statistics of (n, 2) residuals in one unit; NaN where there are none."""

    n: Count
    mean_xy: FloatPair
    rmse_xy: FloatPair
    le90_xy: FloatPair
    """Empirical 90th percentile of the absolute residual per axis."""
    rmse: float
    """Radial: root of RMSEx² + RMSEy²."""
    ce90: float
    """Empirical 90th percentile of the radial residual."""
    ce95: float
    """Empirical 95th percentile of the radial residual."""

    @staticmethod
    def of(residuals: Float64) -> Accuracy:
        """Return the statistics of the (n, 2) `residuals` in any unit; rows with NaN are left out."""
        residuals = residuals[np.isfinite(residuals).all(axis=1)]
        if len(residuals) == 0:
            nan = float("nan")
            return Accuracy(0, (nan, nan), (nan, nan), (nan, nan), nan, nan, nan)
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


@dataclass(frozen=True, slots=True)
class GroupAccuracy:
    """Statistics of the residuals of some points, in target px and in metres; NaN where not known."""

    px: Accuracy
    m: Accuracy

    @property
    def n(self) -> int:
        """Number of points."""
        return self.px.n

    @property
    def rmse_px(self) -> float:
        """Radial root mean square error, target px."""
        return self.px.rmse

    @property
    def ce90_px(self) -> float:
        """Radius that holds 90 % of the errors, target px."""
        return self.px.ce90

    @property
    def rmse_m(self) -> float:
        """Radial root mean square error, metres; NaN without a CRS."""
        return self.m.rmse

    @property
    def ce90_m(self) -> float:
        """Radius that holds 90 % of the errors, metres; NaN without a CRS."""
        return self.m.ce90


class FitAccuracy(dict[str, Accuracy]):
    """Accuracy of a correction; as a mapping it has the keys fit_px, check_px, fit_m and check_m."""

    @property
    def fit(self) -> GroupAccuracy:
        """At the points of the fit."""
        return self._group("fit")

    @property
    def check(self) -> GroupAccuracy:
        """At the check points, which took no part in the fit."""
        return self._group("check")

    def _group(self, name: str) -> GroupAccuracy:
        none = Accuracy.of(np.empty((0, 2)))
        return GroupAccuracy(self.get(f"{name}_px", none), self.get(f"{name}_m", none))
