"""Jitter: displacement that depends on the row or the column of the sensor alone, found and fitted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal

import numpy as np

from pcwlad_geo.correction.fitted import ParametricFit, Trend, checked
from pcwlad_geo.correction.models import AffineCorrection, JitterCorrection, JitterWave
from pcwlad_geo.estimation.robust import biweight, design, irls, linear, reweighted, weighted
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.types import Float64, Index

ALONG: Final = ("column", "row")
"""What a profile runs along, by the index of the coordinate."""
MIN_WAVE_POINTS: Final = 60
"""Least number of tie points in which waves are looked for."""
SHORTEST: Final = 1.5
"""Shortest period that is looked for, in windows: of shorter ones a window leaves a third at most."""
CYCLES: Final = 2.0
"""Least number of periods over the extent of the points; longer waves are what models take out."""
OVERSAMPLED: Final = 4
"""Number of frequencies that are tried for each independent one."""
DIRECTIONS: Final = np.radians([*range(20, 75, 6), *range(110, 165, 6)])
"""Directions of waves, from the rows, that say what chance does: jitter runs along rows or columns."""
CHANCE: Final = 1e-3
"""Largest probability that chance makes the highest peak of all, at which it is jitter."""


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


def smooth_rest(at_px: Float64, displacement_px: Float64) -> Float64:
    """Return the (n, 2) `displacement_px` at the (n, 2) `at_px` less their cubic trend."""
    u = (at_px - at_px.mean(axis=0)) / max(float(np.ptp(at_px, axis=0).max()), 1e-9)
    terms = np.stack([u[:, 0] ** i * u[:, 1] ** j for i in range(4) for j in range(4 - i)], axis=1)

    def weigh(rest: Float64) -> Float64:
        size = np.linalg.norm(rest, axis=1)
        return biweight((size / (4.0 * float(np.median(size)) or 1.0)) ** 2, 1.0)

    _, rest, weight = irls(weighted(terms, displacement_px), weigh, np.ones(len(u)), rounds=5)
    return np.where((weight > 0)[:, None], rest, 0.0)


def peaks(at_px: Float64, rest_px: Float64, footprint_px: float) -> tuple[Peak, ...]:
    """Return the highest peak of the periodogram along each coordinate, of each component: four or none.

    The power of errors, also of those that windows share and of smooth displacements, depends on the length
    of a wave and not on its direction: the mean power in other directions is that of chance, whose powers are
    distributed exponentially about it. The (n, 2) `rest_px` (col, row) are what a smooth model leaves of the
    displacements at the (n, 2) `at_px`, target px; the matching window is `footprint_px` wide.
    """
    every = max(1, -(-len(at_px) // 4_000))
    at_px, rest_px = at_px[::every], rest_px[::every]
    if len(at_px) < MIN_WAVE_POINTS:
        return ()
    extent = np.ptp(at_px, axis=0)
    spacing = float(np.sqrt(np.prod(extent) / len(at_px)))
    shortest = max(SHORTEST * footprint_px, spacing, 4.0)
    found = [
        _peak(at_px, rest_px, along, of, shortest, footprint_px)
        for along in (0, 1)
        for of in (0, 1)
        if extent[along] > CYCLES * shortest
    ]
    return tuple(found)


def _peak(
    at_px: Float64, rest_px: Float64, along: int, of: int, shortest_px: float, footprint_px: float
) -> Peak:
    extent = float(np.ptp(at_px[:, along]))
    most = min(int(OVERSAMPLED * extent / shortest_px), 800 * OVERSAMPLED)
    frequency = np.arange(int(CYCLES * OVERSAMPLED), most + 1) / (OVERSAMPLED * extent)
    values = rest_px[:, of] - rest_px[:, of].mean()
    power = _power(at_px[:, along], values, frequency)
    turned = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)], axis=1)
    others = np.array([_power(at_px @ direction, values, frequency) for direction in turned]).mean(axis=0)
    noise = np.maximum(_smoothed(others, 2 * OVERSAMPLED), 1e-30)
    index = int(np.argmax(power / noise))
    ratio = float(power[index] / noise[index])
    # all independent frequencies of both coordinates and both components were looked at, finer ones too
    trials = 4 * len(frequency) / OVERSAMPLED * 2
    chance = -float(np.expm1(trials * np.log1p(-min(np.exp(-ratio), 1 - 1e-12))))
    best = frequency[index] + np.linspace(-1, 1, 41) / (OVERSAMPLED * extent)
    sharp = _power(at_px[:, along], values, best)
    period = float(1.0 / best[np.argmax(sharp)])
    share = visible_share(period, footprint_px)
    count = len(values)
    amplitude = 2.0 * np.sqrt(max(float(sharp.max()) - noise[index], 0.0)) / count
    sigma = np.sqrt(2.0 * noise[index]) / count
    found = float(amplitude) / share, float(sigma) / share
    return Peak(ALONG[along], ALONG[of], period, *found, chance, chance < CHANCE)


def _power(place_px: Float64, values: Float64, frequency: Float64) -> Float64:
    """Return the (f,) squared sums of (n,) values times waves of the (f,) frequencies, 1/px."""
    waves = (np.exp(-2j * np.pi * each * place_px) @ values for each in frequency)
    return np.array([abs(each) ** 2 for each in waves])


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
    rest = smooth_rest(predicted, displacement)
    for _ in range(3):
        more = [each for each in peaks(predicted, rest, footprint_px) if each.significant]
        if not more:
            break
        strongest = min(more, key=lambda each: (each.chance, -each.amplitude_px))
        waves = (*waves, (ALONG.index(strongest.along), strongest.period_px))
        terms = _terms(predicted, centre, waves, footprint_px)[:, 3:]
        rest = rest - terms @ least_squares(terms, rest)
    values = _terms(predicted, centre, waves, footprint_px)
    trend = trend or Trend.of(predicted, observed, covariance)
    units = np.array([1.0, RADIUS_PX / trend.radius_px, RADIUS_PX / trend.radius_px])
    found = replace(trend.estimate, parameters=trend.estimate.parameters * units[:, None])
    if waves:
        # the affine takes waves for errors at most; they are smaller than what it rejects
        found = reweighted(linear(values, displacement), found.fitted_px, displacement, covariance)
    return ParametricFit.of(
        correction=_correction(found.parameters, centre, waves),
        jacobian=partial(_jacobian, centre_px=centre, waves=waves),
        predicted_px=predicted,
        observed_px=observed,
        estimate=found,
        footprint_px=footprint_px,
    )


RADIUS_PX: Final = 1000.0
"""Unit of the affine's terms, so that all terms are of one order."""


def _terms(
    at_px: Float64, centre_px: Float64, waves: tuple[tuple[int, float], ...], footprint_px: float
) -> Float64:
    """Return the (n, k) values of 1, col, row, and of cosine and sine of each wave, means over windows."""
    place = at_px - centre_px
    columns = [np.ones(len(at_px)), *(place / RADIUS_PX).T]
    for along, period in waves:
        phase, share = 2 * np.pi * place[:, along] / period, visible_share(period, footprint_px)
        columns += [share * np.cos(phase), share * np.sin(phase)]
    return np.stack(columns, axis=1)


def _jacobian(at_px: Float64, *, centre_px: Float64, waves: tuple[tuple[int, float], ...]) -> Float64:
    values = _terms(at_px, centre_px, waves, 0.0)
    return design(values, np.broadcast_to(np.eye(2), (len(at_px), 2, 2)))


def _correction(
    parameters_px: Float64, centre_px: Float64, waves: tuple[tuple[int, float], ...]
) -> JitterCorrection:
    slopes = parameters_px[1:3].T / RADIUS_PX
    matrix = np.column_stack([np.eye(2) + slopes, parameters_px[0] - slopes @ centre_px])
    fitted = tuple(
        JitterWave(ALONG[along], period, float(centre_px[along]), parameters_px[3 + 2 * k : 5 + 2 * k])
        for k, (along, period) in enumerate(waves)
    )
    return JitterCorrection("jitter", AffineCorrection("affine", matrix), fitted)


PARTS: Final = 8
"""Number of parts across the profile whose scatter gives its confidence band."""


@dataclass(frozen=True, slots=True)
class Profile:
    """Means of what a smooth model leaves of the displacement, by intervals of one quantity."""

    place: tuple[float, ...]
    """Middles of the intervals, px or m."""
    mean_px: tuple[tuple[float, float], ...]
    """Displacement (col, row)."""
    band_px: tuple[tuple[float, float], ...]
    """Half width of the 95 % confidence band (col, row): from the scatter of eight parts across."""


def profile(along: Float64, across: Float64, rest_px: Float64, least_step: float) -> Profile:
    """Return the profile of the (n, 2) `rest_px` (col, row), which a smooth model leaves, along one quantity.

    The (n,) `along` is that quantity, in intervals of `least_step` of its unit or more; the (n,) `across`
    divides the points into parts whose errors are independent.
    """
    known = np.isfinite(along)
    along, across, rest_px = along[known], across[known], rest_px[known]
    if len(along) < MIN_WAVE_POINTS or np.ptp(along) <= 0:
        return Profile((), (), ())
    count = int(np.clip(np.ptp(along) / max(least_step, 1e-9), 1, 48))
    edges = np.linspace(along.min(), along.max(), count + 1)
    interval = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, count - 1)
    part = np.argsort(np.argsort(across, kind="stable"), kind="stable") * PARTS // len(across)
    rows = list(_intervals(edges, interval, part, rest_px))
    places, means, bands = zip(*rows, strict=True) if rows else ((), (), ())
    return Profile(tuple(places), tuple(means), tuple(bands))


def _intervals(
    edges: Float64, interval: Index, part: Index, rest_px: Float64
) -> Iterator[tuple[float, tuple[float, float], tuple[float, float]]]:
    from scipy.special import stdtrit  # slow to load

    for index in range(len(edges) - 1):
        inside = interval == index
        parts = [rest_px[inside & (part == each)] for each in range(PARTS)]
        means = np.array([each.mean(axis=0) for each in parts if len(each)])
        if np.count_nonzero(inside) < 5 or len(means) < 3:
            continue
        weight = np.array([len(each) for each in parts if len(each)], dtype=float)
        weight /= weight.sum()
        mean = weight @ means
        freedom = len(means) - 1
        error = np.sqrt((weight**2) @ (means - mean) ** 2 * (1 + 1 / freedom))
        (col, row), (d_col, d_row) = mean.tolist(), (float(stdtrit(freedom, 0.975)) * error).tolist()
        yield float(edges[index : index + 2].mean()), (col, row), (d_col, d_row)
