"""Statistics of errors per axis and radial, expected error of a correction, results of a proof."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Final, Literal

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.correction import Effort
from pcwlad_geo.correction.models import AffineCorrection, affine_between
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.types import Bool, Float64

FloatPair = tuple[float, float]
Amount = Annotated[float, ("minimum", 0)]
Count = Annotated[int, ("minimum", 0)]
Share = Annotated[float, ("minimum", 0), ("maximum", 1)]


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


CELLS_PER_WINDOW: Final = 3.0
"""Number of cells along the side of a window; points of one cell share pixels and count as one."""
NEIGHBOURS: Final = 5
"""Number of nearest independent points whose median residual is taken for the mean error at a place."""
MAX_RELATIVE_SPREAD: Final = 0.5
"""Largest spread of such points that agree, as a share of the length of their median."""
MAX_REJECTED_SPREAD_PX: Final = 0.5
"""Largest spread of rejected matches that count beyond the tie points: matches of ground without structure
err in any direction, and some of them agree by chance."""
SIGMA_90: Final = 2.146
"""Radius that holds 90 % of a circular normal distribution, in sigmas of an axis."""
UNSURPRISING: Final = 1.25
"""Largest ratio of residuals to their sigmas that is expected of correct sigmas."""
LAGS: Final = 8
"""Number of lags of the semivariogram of the displacements."""
DRAWS: Final = 64
"""Number of quasi-random draws that represent a unit normal distribution."""
LEAST_COMMON_PX: Final = 0.03
"""Least systematic error per axis that all points of two images share: the structure in one is offset from
that in the other, however well the points agree (rows of an orchard: 0.09 to 0.17 px at 90 %)."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """The residuals of a correction at all matches of a pair."""

    predicted_px: Float64
    """(n, 2) target position (col, row) that the original georeferencing predicts, px."""
    residual_px: Float64
    """(n, 2) observed minus corrected position (col, row), px."""
    kept: Bool
    """(n,) False for matches that disagree with their neighbours."""
    sigma_px: Float64 | None = None
    """(n, 2) standard deviation of the matching noise in each, px, where it is known."""


def expected_ce90(
    selection: Selection,
    residuals: Residuals,
    places_px: Float64,
    footprint_px: float,
    jitter_px: float = 0.0,
) -> float:
    """Return the radial error within which 90 % of the places are expected to lie, px.

    The error at a place is taken to be normally distributed. Its mean is estimated from the matches around,
    see `_mean_error`. Its covariance is that of the correction; beyond the tie points it grows by the
    semivariogram of the displacements. The (m, 2) `places_px` are predicted target positions (col, row), px,
    spread evenly over the ground; there is at least one of them, and one match. The matching window is
    `footprint_px` wide, and averages out a `jitter_px` (RMS of the length) that the correction leaves.
    """
    left = left_by_correction(residuals, places_px, footprint_px)
    reach_px = selection.fit.support.reach_px
    known = left.all_agree & (left.distance_px <= reach_px) & (left.spread_px <= MAX_REJECTED_SPREAD_PX)
    extrapolated = selection.extrapolated(places_px) & ~known
    inside, outside_px = ~extrapolated, places_px[extrapolated]
    mean_px = np.empty_like(places_px)
    mean_px[inside] = _mean_error(residuals, left.median_px[inside], places_px[inside], footprint_px)
    mean_px[extrapolated] = _extrapolated_mean_error(selection, residuals, outside_px, footprint_px)
    # The misfit of the model is part of the mean and must not enter the covariance.
    common_px2 = np.maximum(selection.common_px2, LEAST_COMMON_PX**2) + jitter_px**2 / 2
    covariance = selection.fit.covariance(places_px) + np.diag(common_px2)
    growth = _extrapolation_variance(selection, residuals, outside_px)
    covariance[extrapolated] += growth[:, None, None] * np.eye(2)
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    errors = mean_px[:, None, :] + np.einsum("nij,kj->nki", root, _normal_draws())
    return float(np.percentile(np.linalg.norm(errors, axis=2), 90))


def _mean_error(residuals: Residuals, median_px: Float64, places_px: Float64, footprint_px: float) -> Float64:
    """Return the (m, 2) mean error of the correction at places with matches around, px.

    Where sigmas explain the residuals, it is the (m, 2) median residual of the nearest independent points,
    with the noise removed. Otherwise displacements vary over short distances, and a match that its neighbours
    contradict may be right: it is the residual of the nearest point, rejected or not.
    """
    kept, sigma_px = np.flatnonzero(residuals.kept), residuals.sigma_px
    if len(places_px) == 0 or len(kept) == 0 or sigma_px is None:
        return median_px
    normalised = np.linalg.norm(residuals.residual_px[kept] / np.maximum(sigma_px[kept], 1e-9), axis=1)
    if not np.percentile(normalised, 90) <= UNSURPRISING * SIGMA_90:
        side_px = footprint_px / CELLS_PER_WINDOW
        place, value = _independent_points(residuals.predicted_px, residuals.residual_px, side_px)
        return np.asarray(value[cKDTree(place).query(places_px)[1]])
    nearest = kept[cKDTree(residuals.predicted_px[kept]).query(places_px)[1]]
    return without_noise(median_px, sigma_px[nearest])


@dataclass(frozen=True, slots=True, eq=False)
class LocalResiduals:
    """The residuals of the matches around m places."""

    median_px: Float64
    """(m, 2) median residual of the nearest independent points (col, row), px."""
    all_agree: Bool
    """(m,) whether the kept and the rejected matches agree on it; otherwise it is that of the kept ones."""
    spread_px: Float64
    """(m,) median distance of the nearest independent points, of all matches, from their median, px."""
    distance_px: Float64
    """(m,) distance of the place from the nearest independent point, of all matches, px."""


def left_by_correction(residuals: Residuals, places_px: Float64, footprint_px: float) -> LocalResiduals:
    """Return the residuals of the matches around places.

    The (m, 2) `places_px` are predicted target positions (col, row), px. There is at least one match; the
    matching window is `footprint_px` wide.
    """
    median, spread, distance = _around(residuals.predicted_px, residuals.residual_px, places_px, footprint_px)
    kept = residuals.kept
    if not kept.any():
        return LocalResiduals(median, np.ones(len(places_px), bool), spread, distance)
    xy_px, residual_px = residuals.predicted_px[kept], residuals.residual_px[kept]
    of_kept, _, _ = _around(xy_px, residual_px, places_px, footprint_px)
    agree = spread <= MAX_RELATIVE_SPREAD * np.linalg.norm(median, axis=1)
    return LocalResiduals(np.where(agree[:, None], median, of_kept), agree, spread, distance)


def _around(
    xy_px: Float64, value_px: Float64, places_px: Float64, footprint_px: float
) -> tuple[Float64, Float64, Float64]:
    """Return the median of the independent points nearest to each place, their spread and least distance."""
    place, value = _independent_points(xy_px, value_px, footprint_px / CELLS_PER_WINDOW)
    count = min(NEIGHBOURS, len(place))
    distance, near = cKDTree(place).query(places_px, k=[*range(1, count + 1)])
    around = value[near]
    median = np.median(around, axis=1)
    spread = np.median(np.linalg.norm(around - median[:, None], axis=2), axis=1)
    return median, spread, distance[:, 0]


def _independent_points(xy_px: Float64, value_px: Float64, side_px: float) -> tuple[Float64, Float64]:
    """Return the mean position and the median value of the points of each cell of the given side."""
    if side_px <= 0:
        return xy_px, value_px
    cell = np.unique(np.floor(xy_px / side_px).astype(np.intp), axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(cell)
    begin = np.cumsum(count) - count
    place = np.column_stack([np.bincount(cell, axis) / count for axis in xy_px.T])
    ordered = np.column_stack([axis[np.lexsort((axis, cell))] for axis in value_px.T])
    return place, (ordered[begin + (count - 1) // 2] + ordered[begin + count // 2]) / 2


def _extrapolated_mean_error(
    selection: Selection, residuals: Residuals, places_px: Float64, footprint_px: float
) -> Float64:
    """Return the (k, 2) mean error of the correction at places beyond the tie points, px.

    The displacement there is predicted by the affine trend of the kept matches plus the deviation of the
    nearest of them from it. A shift ignores the trend, and a curved correction continues its curvature, for
    which there is no evidence. Rejected matches do not count: most lie on ground without structure.
    """
    kept, correction = residuals.kept, selection.fit.correction
    if len(places_px) == 0 or kept.sum() < 3:
        return np.zeros_like(places_px)
    xy = residuals.predicted_px[kept]
    observed = correction.forward(xy) + residuals.residual_px[kept]
    trend = AffineCorrection("affine", affine_between(xy, observed))
    sigma_px = None if residuals.sigma_px is None else residuals.sigma_px[kept]
    about_trend = Residuals(xy, observed - trend.forward(xy), np.ones(len(xy), bool), sigma_px)
    nearest, _, _ = _around(xy, about_trend.residual_px, places_px, footprint_px)
    mean = _mean_error(about_trend, nearest, places_px, footprint_px)
    return mean + trend.forward(places_px) - correction.forward(places_px)


def _extrapolation_variance(selection: Selection, residuals: Residuals, places_px: Float64) -> Float64:
    """Return (k,) variance per axis to add at places beyond the tie points, px².

    It is the semivariogram of the displacements (half the mean squared difference of two of them) at the
    distance from the place to the nearest point, minus that of neighbours (the nugget, which is noise). For
    an affine correction, which continues the trend, it is that of the residuals; for a curved one, that of
    the displacements minus their affine trend.
    """
    xy, left = residuals.predicted_px[residuals.kept], residuals.residual_px[residuals.kept]
    if len(places_px) == 0 or len(xy) < 3:
        return np.zeros(len(places_px))
    if not isinstance(selection.fit.correction, AffineCorrection):
        observed = left + selection.fit.correction.forward(xy)
        left = observed - AffineCorrection("affine", affine_between(xy, observed)).forward(xy)
    sample = np.linspace(0, len(xy) - 1, min(len(xy), 400)).astype(np.intp)
    separation = np.linalg.norm(xy[sample, None] - xy[None, sample], axis=2)
    # Half the squared difference, averaged over the two axes.
    halved = ((left[sample, None] - left[None, sample]) ** 2).sum(axis=2) / 4
    reach = max(float(np.ptp(xy, axis=0).max()) / 2, 1e-9)
    bins = np.minimum(np.ceil(separation / reach * LAGS), LAGS + 1).astype(np.intp).ravel()
    counts = np.bincount(bins, minlength=LAGS + 2)[1 : LAGS + 1]
    sums = np.bincount(bins, halved.ravel(), minlength=LAGS + 2)[1 : LAGS + 1]
    semivariogram = np.divide(sums, counts, out=np.zeros(LAGS), where=counts > 0)
    semivariogram = np.maximum.accumulate(np.maximum(semivariogram - semivariogram[0], 0.0))
    distance, _ = cKDTree(xy).query(places_px)
    lags = np.arange(LAGS + 1) * reach / LAGS
    variance = np.interp(distance, lags, np.concatenate([[0.0], semivariogram]))
    return np.asarray(variance * np.maximum(distance / reach, 1.0) ** 2)


def _normal_draws() -> Float64:
    """Return (DRAWS, 2) quasi-random draws from the bivariate unit normal distribution."""
    length = np.sqrt(-2 * np.log1p(-(np.arange(DRAWS) + 0.5) / DRAWS))
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(DRAWS)  # golden angles: even at any length
    return np.column_stack([length * np.cos(angle), length * np.sin(angle)])


Kind = Literal["shift", "turn", "field"]
EvidenceKind = Literal["channels", "windows", "directions"]


@dataclass(frozen=True, slots=True)
class Move:
    """A known move of the target, px of the matching grid."""

    kind: Kind
    shift_px: FloatPair
    """(col, row)."""
    rotation_deg: float = 0.0
    scale: float = 1.0
    amplitude_px: Amount = 0.0
    wavelength_px: Amount = 0.0

    def source(self, xy_px: Float64, centre_px: Float64) -> Float64:
        """Return the (n, 2) positions in the unmoved target of the (n, 2) `xy_px` in the moved one.

        The move is about the (2,) `centre_px`; all are px (col, row) of the same array or view.
        """
        angle = np.deg2rad(self.rotation_deg)
        cos, sin = np.cos(angle) * self.scale, np.sin(angle) * self.scale
        col, row = (xy_px - centre_px).T
        found = np.column_stack([cos * col - sin * row, sin * col + cos * row])
        if self.amplitude_px:
            turn = 2 * np.pi / self.wavelength_px
            found[:, 0] -= self.amplitude_px * np.sin(turn * 0.7 * (col + row) + 0.9)
            found[:, 1] -= self.amplitude_px * np.sin(turn * (0.9 * col - 0.45 * row) + 2.4)
        return np.asarray(found + centre_px - self.shift_px, np.float64)


@dataclass(frozen=True, slots=True)
class PhaseEntry:
    """The mean error of the points whose displacement has a fraction of a pixel."""

    phase: Share
    """Middle of the class, px of the matching grid."""
    points: tuple[Count, Count]
    """Matches in it, by the fraction of the column, and of the row."""
    mean_px: FloatPair
    """Mean error in column, and in row; null where there are none."""


@dataclass(frozen=True, slots=True)
class ClassEntry:
    """Errors of a class of points."""

    name: str
    points: Count
    bias_px: FloatPair
    """Mean, (col, row)."""
    scatter_px: FloatPair
    """Standard deviation of one match about its mean, (col, row)."""


@dataclass(frozen=True, slots=True)
class SigmaEntry:
    """Whether the sigmas of the points hold for the errors that are seen."""

    within_68: Share
    """Share of the errors, per axis, within one sigma; 0.683 is right."""
    within_95: Share
    """Within 1.96 sigmas; 0.95 is right."""
    factor: Amount
    """By which the sigmas would have to be multiplied to hold for these errors alone."""
    calibration: Amount
    """By which `calibrate_sigma` multiplies them: the factor, and where it is below 1, more by as much as the
    tie points scatter beyond these errors, as sigmas hold what no proof sees too."""


@dataclass(frozen=True, slots=True)
class CorrectionEntry:
    """The error of the correction over the common ground, from the same errors of its points."""

    model: str
    bias_px: FloatPair
    rmse_px: Amount
    ce90_px: Amount
    blind_spot_px: Amount | None
    """By how much the correction changes (RMS) in that of nine parts where this is most, if the part has no
    tie points; null where not asked for, or the others do not determine it."""


@dataclass(frozen=True, slots=True)
class EvidenceEntry:
    """Two matches of the same points by evidence of their own: how far they differ, target px."""

    name: EvidenceKind
    """channels: every second orientation of edges against the others; windows: the black squares of a
    chessboard against the white ones; directions: reference to target against target to reference."""
    points: Count
    mean_px: FloatPair
    """Mean difference."""
    error_px: FloatPair
    """Its standard error."""
    scatter_px: FloatPair
    """Standard deviation of the differences, without that of noise."""


@dataclass(frozen=True, slots=True)
class UnobservableError:
    """What is known of an error that every match shares: structure that lies elsewhere in the other band."""

    evidence: tuple[EvidenceEntry, ...]
    at_least_px: Amount
    """Half of the largest mean difference of any evidence, less two standard errors: a lower bound."""
    up_to_px: Amount
    """What has to be reckoned with where no third band closes a triangle: three times the largest difference,
    and never less than 0.1 px."""


@dataclass(frozen=True, slots=True)
class PointEntry:
    """The errors of one tie point."""

    row: Count
    """Which row of the tie points it is, from 0."""
    reference_px: FloatPair
    """Its place (col, row) in the reference file, px."""
    errors_px: tuple[FloatPair, ...]
    """The error of each match of it, bias included, target px (col, row)."""


Difficulty = Literal["displacement", "rotation", "noise", "clouds"]
LevelUnit = Literal["px", "deg", "share of the standard deviation", "share of the pixels"]


@dataclass(frozen=True, slots=True)
class TrialEntry:
    """What became of a part of the pair that was made harder."""

    level: Amount
    outcome: Literal["correct", "refused", "incorrect"]
    """incorrect: accepted, and off by more than a pixel beyond what the part as it lies differs by."""
    points: Count
    """Tie points; 0 where it was refused."""
    error_px: Amount | None
    """Median distance of the points from where they are known to lie; null where it was refused."""


@dataclass(frozen=True, slots=True)
class LimitEntry:
    """How much of a difficulty a part of the pair tolerates."""

    name: Difficulty
    unit: LevelUnit
    """Of the levels; noise is added to both images, by the standard deviation of the values of each."""
    tolerated: Amount | None
    """Largest level at which it was registered rightly; null: not even the least that was tried."""
    failed: Amount | None
    """Least level beyond at which it was refused, or wrong; null: the largest tried was tolerated."""
    trials: tuple[TrialEntry, ...]
    """By level."""


@dataclass(frozen=True, slots=True)
class Reversal:
    """Where points return to by the correction of a target and, after it, that of its reference to it."""

    model: str
    reverse_model: str
    bias_px: FloatPair
    """Mean distance (col, row) of the points from where they began."""
    rms_px: Amount
    """Radial, bias included."""


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """What a part of the pair tolerates, registered again and again as any pair is."""

    shape_px: tuple[Count, Count]
    """Size of the part (rows, columns), px of the matching grid."""
    points: Count
    """Tie points of the part as it lies."""
    limits: tuple[LimitEntry, ...]
    reversal: Reversal | None
    """Null where the reference cannot be registered to the target."""


LOCKING_PX: Final = 0.01
"""Amplitude of pixel locking up to which there is none to speak of."""


@dataclass(frozen=True, slots=True)
class Proof:
    """The tool's own error on a pair, target px; axes are those of the matching grid, (col, row)."""

    effort: Effort
    moves: tuple[Move, ...]
    points: Count
    """Tie points that were matched again."""
    matches: Count
    """Matches of these after all moves."""
    lost: Count
    """Points that found no match after a move, all moves together."""
    false_matches: Count
    """Matches that passed every test and err by more than a pixel; no other figure counts them."""
    noise: FloatPair
    """Standard deviation of the noise that was added to the reference and to the target, in their units."""
    resampling_px: Amount
    """Error of the resampling itself: RMS by which an image of the target's spectrum, whose moves are
    computed, differs from its resampled moves."""
    bias_px: FloatPair
    """Mean error of the points as the pair lies, against the mean over all fractions of a pixel."""
    bias_error_px: FloatPair
    """Standard error of the bias by the fresh noise; what the pair's own noise adds is not in it."""
    scatter_px: FloatPair
    """Standard deviation of a point's error about the mean of all."""
    shrunk: Share
    """Factor on the errors: 1, or less where noise on top of noise made them scatter more about an affine
    than the tie points do as the pair lies, which no error of theirs can exceed."""
    rmse_px: Amount
    """Of the points, radial, bias included."""
    ce90_px: Amount
    """Likewise."""
    locking_px: FloatPair
    """Amplitude of the wave that the error follows along a pixel (pixel locking)."""
    locking_error_px: FloatPair
    """Its standard error: a smaller amplitude may be chance."""
    phases: tuple[PhaseEntry, ...]
    moved: tuple[ClassEntry, ...]
    """By the kind of the move."""
    texture: tuple[ClassEntry, ...]
    """By the structure around the point, the faintest first."""
    windows: tuple[ClassEntry, ...]
    """By single windows, those that the matching may choose from; none in a quick proof."""
    sigma: SigmaEntry
    correction: CorrectionEntry | None
    """Null where nothing was fitted."""
    unobservable: UnobservableError
    """What no move of the target can show."""
    map: tuple[PointEntry, ...]
    """Point by point."""
    sensitivity: Sensitivity | None = None
    """Null in a quick proof, and where a part of the pair alone is refused."""
