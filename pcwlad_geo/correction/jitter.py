"""Jitter: displacement that depends on the row or the column of the sensor alone, found and fitted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal

import numpy as np

from pcwlad_geo.correction.fitted import ParametricFit, Trend, checked
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.waves import JitterCorrection, JitterWave
from pcwlad_geo.estimation.robust import biweight, design, irls, linear, reweighted, weighted
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.types import Float64, Index

ALONG: Final = ("column", "row")
"""What a profile runs along, by the index of the coordinate."""


@dataclass(frozen=True, slots=True)
class JitterParameters:
    """How waves are looked for, and when they are taken for jitter."""

    min_points: int = 60
    """Least number of tie points in which waves are looked for."""
    max_periodogram_points: int = 4_000
    """Of more points, every k-th is taken for the periodogram."""
    shortest_windows: float = 1.5
    """Shortest period that is looked for, in windows: of shorter ones a window leaves a third at most."""
    least_cycles: float = 2.0
    """Least number of periods over the extent of the points; longer waves are what models take out."""
    oversampling: int = 4
    """Number of frequencies that are tried for each independent one."""
    max_frequencies: int = 800
    """Largest number of independent frequencies."""
    directions_deg: tuple[int, ...] = (*range(20, 75, 6), *range(110, 165, 6))
    """Directions of waves, from the rows, that say what chance does: jitter runs along rows or columns."""
    chance: float = 1e-3
    """Largest probability that chance makes the highest peak of all, at which it is jitter."""
    max_waves: int = 3
    """Largest number of periods that are fitted."""
    unit_px: float = 1000.0
    """Unit of the affine's terms, so that all terms are of one order."""
    profile_parts: int = 8
    """Number of parts across the profile whose scatter gives its confidence band."""


JITTER: Final = JitterParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True)
class Peak:
    """The strongest wave along an axis, in one component of the displacement."""

    along: Literal["column", "row"]
    """The displacement depends on this coordinate of the target."""
    of: Literal["column", "row"]
    """The component of the displacement."""
    period_px: float
    amplitude_px: float
    """Of the ground, as far as the windows let it be known: what they average is restored."""
    sigma_px: float
    """Standard deviation of the amplitude."""
    chance: float
    """Probability that errors alone, as they are in other directions, make so high a peak anywhere."""
    significant: bool
    """Whether it is jitter: chance is below one in a thousand."""


def visible_share(period_px: float, footprint_px: float) -> float:
    """Return the share of the amplitude of a wave that is left of it in means over windows."""
    return float(np.sinc(footprint_px / period_px))


def without_trend(at_px: Float64, displacement_px: Float64) -> Float64:
    """Return the (n, 2) `displacement_px` at the (n, 2) `at_px` less their cubic trend."""
    u = (at_px - at_px.mean(axis=0)) / max(float(np.ptp(at_px, axis=0).max()), 1e-9)
    terms = np.stack([u[:, 0] ** i * u[:, 1] ** j for i in range(4) for j in range(4 - i)], axis=1)

    def weigh(remainder: Float64) -> Float64:
        size = np.linalg.norm(remainder, axis=1)
        return biweight((size / (4.0 * float(np.median(size)) or 1.0)) ** 2, 1.0)

    _, remainder, weight = irls(weighted(terms, displacement_px), weigh, np.ones(len(u)), rounds=5)
    return np.where((weight > 0)[:, None], remainder, 0.0)


def peaks(
    at_px: Float64, remainder_px: Float64, footprint_px: float, parameters: JitterParameters = JITTER
) -> tuple[Peak, ...]:
    """Return the highest peak of the periodogram along each coordinate, of each component: four or none.

    The power of errors, also of those that windows share and of smooth displacements, depends on the length
    of a wave and not on its direction: the mean power in other directions is that of chance, whose powers are
    distributed exponentially about it. The (n, 2) `remainder_px` (col, row) are what a smooth model
    leaves of the displacements at the (n, 2) `at_px`, target px; the matching window is `footprint_px` wide.
    """
    step = max(1, -(-len(at_px) // parameters.max_periodogram_points))
    at_px, remainder_px = at_px[::step], remainder_px[::step]
    if len(at_px) < parameters.min_points:
        return ()
    extent = np.ptp(at_px, axis=0)
    spacing = float(np.sqrt(np.prod(extent) / len(at_px)))
    shortest = max(parameters.shortest_windows * footprint_px, spacing, 4.0)
    return tuple(
        _peak(at_px, remainder_px, (along, component), shortest, footprint_px, parameters)
        for along in (0, 1)
        for component in (0, 1)
        if extent[along] > parameters.least_cycles * shortest
    )


def _peak(
    at_px: Float64,
    remainder_px: Float64,
    axes: tuple[int, int],
    shortest_px: float,
    footprint_px: float,
    parameters: JitterParameters,
) -> Peak:
    """Return the highest peak along the first of the `axes`, of the component that is the second."""
    (along, component), oversampling = axes, parameters.oversampling
    extent = float(np.ptp(at_px[:, along]))
    most = min(int(oversampling * extent / shortest_px), parameters.max_frequencies * oversampling)
    frequency = np.arange(int(parameters.least_cycles * oversampling), most + 1) / (oversampling * extent)
    values = remainder_px[:, component] - remainder_px[:, component].mean()
    power = _power(at_px[:, along], values, frequency)
    angles = np.radians(parameters.directions_deg)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    by_chance = np.array([_power(at_px @ direction, values, frequency) for direction in directions])
    noise = np.maximum(_smoothed(by_chance.mean(axis=0), 2 * oversampling), 1e-30)
    index = int(np.argmax(power / noise))
    ratio = float(power[index] / noise[index])
    # all independent frequencies of both coordinates and both components were looked at, finer ones too
    trials = 4 * len(frequency) / oversampling * 2
    chance = -float(np.expm1(trials * np.log1p(-min(np.exp(-ratio), 1 - 1e-12))))
    best = frequency[index] + np.linspace(-1, 1, 41) / (oversampling * extent)
    sharp = _power(at_px[:, along], values, best)
    period = float(1.0 / best[np.argmax(sharp)])
    share = visible_share(period, footprint_px)
    count = len(values)
    amplitude = 2.0 * np.sqrt(max(float(sharp.max()) - noise[index], 0.0)) / count
    sigma = np.sqrt(2.0 * noise[index]) / count
    return Peak(
        along=ALONG[along],
        of=ALONG[component],
        period_px=period,
        amplitude_px=float(amplitude) / share,
        sigma_px=float(sigma) / share,
        chance=chance,
        significant=chance < parameters.chance,
    )


def _power(place_px: Float64, values: Float64, frequency: Float64) -> Float64:
    """Return the (f,) squared sums of (n,) values times waves of the (f,) frequencies, 1/px."""
    sums = (np.exp(-2j * np.pi * cycles * place_px) @ values for cycles in frequency)
    return np.array([abs(total) ** 2 for total in sums])


def _smoothed(values: Float64, reach: int) -> Float64:
    """Return running means over 2 · `reach` + 1 values, fewer at the ends."""
    kernel = np.ones(2 * reach + 1)
    total = np.convolve(values, kernel)[reach : reach + len(values)]
    return total / np.convolve(np.ones_like(values), kernel)[reach : reach + len(values)]


def fit_jitter(
    predicted_px: Float64,
    observed_px: Float64,
    covariance_px2: Float64,
    *,
    footprint_px: float = 0.0,
    trend: Trend | None = None,
    parameters: JitterParameters = JITTER,
) -> ParametricFit:
    """Fit an affine and the waves along rows and columns that are more than chance, of up to three periods.

    Without such a wave it is the affine. A displacement is taken for the mean over its window. Raises
    `InputError` if the points are too few or do not determine the model, or an array has a wrong shape or
    values that are not finite. The (n, 2) `predicted_px` and `observed_px` and the (n, 2, 2) `covariance_px2`
    are those of `fit.fit_polynomial`, as are `footprint_px` and `trend`.
    """
    predicted, observed, covariance = checked("jitter", 5, predicted_px, observed_px, covariance_px2)
    displacement, centre = observed - predicted, predicted.mean(axis=0)
    waves: tuple[tuple[int, float], ...] = ()
    remainder, unit_px = without_trend(predicted, displacement), parameters.unit_px
    for _ in range(parameters.max_waves):
        highest = peaks(predicted, remainder, footprint_px, parameters)
        significant = [peak for peak in highest if peak.significant]
        if not significant:
            break
        strongest = min(significant, key=lambda peak: (peak.chance, -peak.amplitude_px))
        waves = (*waves, (ALONG.index(strongest.along), strongest.period_px))
        terms = _terms(predicted, centre, waves, footprint_px, unit_px)[:, 3:]
        remainder = remainder - terms @ least_squares(terms, remainder)
    values = _terms(predicted, centre, waves, footprint_px, unit_px)
    trend = trend or Trend.of(predicted, observed, covariance)
    units = np.array([1.0, unit_px / trend.radius_px, unit_px / trend.radius_px])
    estimated = replace(trend.estimate, parameters=trend.estimate.parameters * units[:, None])
    if waves:
        # the affine takes waves for errors at most; they are smaller than what it rejects
        estimated = reweighted(linear(values, displacement), estimated.fitted_px, displacement, covariance)
    return ParametricFit.of(
        correction=_correction(estimated.parameters, centre, waves, unit_px),
        jacobian=partial(_jacobian, centre_px=centre, waves=waves, unit_px=unit_px),
        predicted_px=predicted,
        observed_px=observed,
        estimate=estimated,
        footprint_px=footprint_px,
    )


def _terms(
    at_px: Float64,
    centre_px: Float64,
    waves: tuple[tuple[int, float], ...],
    footprint_px: float,
    unit_px: float,
) -> Float64:
    """Return the (n, k) values of 1, col, row, and of cosine and sine of each wave, means over windows."""
    place = at_px - centre_px
    columns = [np.ones(len(at_px)), *(place / unit_px).T]
    for along, period in waves:
        phase, share = 2 * np.pi * place[:, along] / period, visible_share(period, footprint_px)
        columns += [share * np.cos(phase), share * np.sin(phase)]
    return np.stack(columns, axis=1)


def _jacobian(
    at_px: Float64, *, centre_px: Float64, waves: tuple[tuple[int, float], ...], unit_px: float
) -> Float64:
    values = _terms(at_px, centre_px, waves, 0.0, unit_px)
    return design(values, np.broadcast_to(np.eye(2), (len(at_px), 2, 2)))


def _correction(
    parameters_px: Float64, centre_px: Float64, waves: tuple[tuple[int, float], ...], unit_px: float
) -> JitterCorrection:
    slopes = parameters_px[1:3].T / unit_px
    matrix = np.column_stack([np.eye(2) + slopes, parameters_px[0] - slopes @ centre_px])
    fitted = tuple(
        JitterWave(ALONG[along], period, float(centre_px[along]), parameters_px[3 + 2 * k : 5 + 2 * k])
        for k, (along, period) in enumerate(waves)
    )
    return JitterCorrection("jitter", AffineCorrection("affine", matrix), fitted)


@dataclass(frozen=True, slots=True)
class Profile:
    """Means of what a smooth model leaves of the displacement, by intervals of one quantity."""

    place: tuple[float, ...]
    """Middles of the intervals, px or m."""
    mean_px: tuple[tuple[float, float], ...]
    """Displacement (col, row)."""
    band_px: tuple[tuple[float, float], ...]
    """Half width of the 95 % confidence band (col, row): from the scatter of eight parts across."""


def profile(
    along: Float64,
    across: Float64,
    remainder_px: Float64,
    least_step: float,
    parameters: JitterParameters = JITTER,
) -> Profile:
    """Return the profile along one quantity of what a smooth model leaves, the (n, 2) `remainder_px`.

    The (n,) `along` is that quantity, in intervals of `least_step` of its unit or more; the (n,) `across`
    divides the points into parts whose errors are independent.
    """
    finite = np.isfinite(along)
    along, across, remainder_px = along[finite], across[finite], remainder_px[finite]
    if len(along) < parameters.min_points or np.ptp(along) <= 0:
        return Profile((), (), ())
    count = int(np.clip(np.ptp(along) / max(least_step, 1e-9), 1, 48))
    edges = np.linspace(along.min(), along.max(), count + 1)
    interval = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, count - 1)
    rank = np.argsort(np.argsort(across, kind="stable"), kind="stable")
    part = rank * parameters.profile_parts // len(across)
    rows = list(_intervals(edges, interval, part, remainder_px, parameters.profile_parts))
    places, means, bands = zip(*rows, strict=True) if rows else ((), (), ())
    return Profile(tuple(places), tuple(means), tuple(bands))


def _intervals(
    edges: Float64, interval: Index, part: Index, remainder_px: Float64, count: int
) -> Iterator[tuple[float, tuple[float, float], tuple[float, float]]]:
    from scipy.special import stdtrit  # slow to load

    for index in range(len(edges) - 1):
        inside = interval == index
        parts = [remainder_px[inside & (part == number)] for number in range(count)]
        parts = [values for values in parts if len(values)]
        means = np.array([values.mean(axis=0) for values in parts])
        if np.count_nonzero(inside) < 5 or len(means) < 3:
            continue
        weight = np.array([len(values) for values in parts], dtype=float)
        weight /= weight.sum()
        mean = weight @ means
        freedom = len(means) - 1
        error = np.sqrt((weight**2) @ (means - mean) ** 2 * (1 + 1 / freedom))
        (col, row), (d_col, d_row) = mean.tolist(), (float(stdtrit(freedom, 0.975)) * error).tolist()
        yield float(edges[index : index + 2].mean()), (col, row), (d_col, d_row)
