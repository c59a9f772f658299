"""Displacements over time: steps, drifts, seasons and outliers of images, and the velocity of the ground.

What is told is told with a known rate of false alarms. A series is modelled as a level, steps, a straight
drift and a yearly wave, all in both axes at once. A term is taken into the model, the strongest first, if its
score test exceeds that of all candidates in permutations of the residuals (the largest of all candidates, so
that their number is allowed for). Residuals are clipped as Huber does, so that outliers make no step.

References
----------
.. [1] Huber, P. J. (1964), doi:10.1214/aoms/1177703732.
.. [2] Westfall, P. H. and Young, S. S. (1993), Resampling-Based Multiple Testing (largest statistic).
.. [3] Page, E. S. (1954), doi:10.1093/biomet/41.1-2.100 (cumulative sums).
.. [4] Aronow, P. M., Samii, C. and Assenova, V. A. (2015), doi:10.1093/pan/mpv018 (errors of pairs).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.special import fdtri

from pcwlad_geo.estimation.robust import axis_sigma, biweight, huber, irls, weighted
from pcwlad_geo.estimation.solving import components, inverse, solve, triangular
from pcwlad_geo.types import Bool, Float64, Index

FALSE_ALARM: Final = 0.004
"""Probability that a series without terms is given one; with outliers, below 1 % in all."""
FALSE_OUTLIER: Final = 0.002
"""Probability that any date of a series of normal errors is called an outlier."""
PERMUTATIONS: Final = 3000
"""Of the residuals, for each test."""
MIN_IMAGES: Final = 8
"""Shortest series in which anything is sought."""
MIN_PERMUTED: Final = 13
"""Shortest series that has enough orders of its images for the permutations to tell."""
MIN_SIDE: Final = 4
"""Least number of images on either side of a step: fewer are as well outliers."""
MIN_SEASON_YEARS: Final = 1.5
"""Shortest series in which a yearly wave can be told from a drift."""
MIN_SEASON_IMAGES: Final = 12
"""Least number of images in which one is sought."""
CLIPPED_SIGMA: Final = 2.0
"""Residuals beyond are clipped in the tests, in standard deviations."""
MIN_SIGMA_PX: Final = 1e-3
"""Least standard deviation of a displacement: that of an image that is its own datum is none."""

Kind = Literal["step", "drift", "season"]
SMOOTH_TERMS: Final[tuple[Kind, ...]] = ("drift", "season")
"""Terms that change slowly."""
STEP_TERMS: Final[tuple[Kind, ...]] = ("step",)
"""Terms that change at once."""
Clip = Literal["huber", "biweight"]


@dataclass(frozen=True, slots=True)
class Term:
    """A part of the model of a series."""

    kind: Kind
    at: int = 0
    """Of a step: number of the first image after it."""

    def columns(self, years: Float64) -> Float64:
        """Return the (n, k) columns of the design at the (n,) times `years`."""
        if self.kind == "step":
            return np.asarray(np.arange(len(years)) >= self.at, np.float64)[:, None]
        if self.kind == "drift":
            return np.asarray(years - years.mean())[:, None]
        angle = 2 * np.pi * years
        return np.column_stack([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A term that a series has."""

    term: Term
    size_px: Float64
    """(k, 2) coefficients (col, row): size of a step, px a year of a drift, cosine and sine of a season."""
    sigma_px: float
    """Their standard deviation along an axis."""


@dataclass(frozen=True, slots=True, eq=False)
class SeriesModel:
    """The model of a series of n images, in the order of their times."""

    found: tuple[Found, ...]
    fitted_px: Float64
    """(n, 2) what the model says."""
    level_px: Float64
    """(2,) level after the last step, at the last image, without the season."""
    level_sigma_px: float
    """Its standard deviation along an axis."""
    noise_px: float
    """Robust standard deviation of the residuals along an axis."""
    outliers: Bool
    """(n,) images whose displacement is none of the series."""


def analyse(
    years: Float64, moved_px: Float64, sigma_px: Float64, covariance_px2: Float64 | None = None
) -> SeriesModel:
    """Find the terms of a series.

    Parameters
    ----------
    years : (n,) array
        Times of the images, in years, ascending.
    moved_px : (n, 2) array
        Displacements (col, row), px.
    sigma_px : (n,) array
        Their standard deviations along an axis, px.
    covariance_px2 : (n, n) array, optional
        Covariance of their errors along an axis; independent errors by default.

    Returns
    -------
    SeriesModel
        Without terms if the series has fewer than `MIN_IMAGES` images.
    """
    series = _Series.of(years, moved_px, sigma_px, covariance_px2)
    if len(moved_px) < MIN_IMAGES:
        return _model(series, [])
    # steps can stand for a drift, and a season for steps: grown in either order, the simpler is taken
    grown = [_grown(series, kinds) for kinds in (((*SMOOTH_TERMS, *STEP_TERMS),), (SMOOTH_TERMS, STEP_TERMS))]
    return _model(series, min(grown, key=lambda terms: _criterion(series, terms)))


def _grown(series: _Series, orders: Sequence[Collection[Kind]]) -> list[Term]:
    """Add terms, of the first kinds before others, as long as they are more than chance."""
    terms: list[Term] = []
    before: set[tuple[Term, ...]] = set()
    while len(terms) < 12 and tuple(terms) not in before:
        before.add(tuple(terms))
        found = (_strongest(series, terms, kinds) for kinds in orders)
        term = next((each for each in found if each is not None), None)
        if term is None:
            break
        terms = _needed(series, _placed(series, [*terms, term]))
    return terms


def _criterion(series: _Series, terms: Sequence[Term]) -> float:
    """Return Schwarz's criterion (doi:10.1214/aos/1176344136) of a model, with Huber's loss.

    A step has a place and a size in both axes, a drift a velocity, a season two waves.
    """
    parameters = sum({"step": 3, "drift": 2, "season": 4}[term.kind] for term in terms)
    return 2 * _cost(series, terms) + parameters * float(np.log(2 * len(series.years)))


@dataclass(frozen=True, slots=True, eq=False)
class _Series:
    """A series, and what makes its errors independent and of unit variance."""

    years: Float64
    moved_px: Float64
    white: Float64
    """(n, n) matrix from px to standard deviations: the inverse of a root of the covariance."""
    sigma_px: Float64
    """(n,) standard deviations along an axis."""

    @staticmethod
    def of(years: Float64, moved_px: Float64, sigma_px: Float64, covariance_px2: Float64 | None) -> _Series:
        """Add what neighbours in time differ by beyond their covariance: few of them have a step."""
        least = MIN_SIGMA_PX**2 * np.eye(len(years))
        covariance = (np.diag(sigma_px**2) if covariance_px2 is None else covariance_px2) + least
        more = 0.0
        if len(years) > 2:
            lengths = np.hypot(*np.diff(moved_px, axis=0).T)
            own = np.diag(covariance)[1:] + np.diag(covariance)[:-1] - 2 * np.diag(covariance, 1)
            more = max(0.0, axis_sigma(lengths) ** 2 - float(np.median(own)))
        covariance = covariance + more / 2 * np.eye(len(years))
        white = inverse(triangular(covariance, NEEDED))
        return _Series(years, moved_px, white, np.sqrt(np.diag(covariance)))

    def design(self, terms: Sequence[Term]) -> Float64:
        """Return the (n, p) design of a level and terms."""
        return np.column_stack([np.ones(len(self.years)), *(term.columns(self.years) for term in terms)])


NEEDED: Final = "errors of images that are neither negative nor infinite"
"""What the equations of a series ask for."""


def _fit(series: _Series, terms: Sequence[Term], clip: Clip) -> tuple[Float64, Float64, Float64]:
    """Return the (k, 2) coefficients of a robust fit, the (n, 2) residuals in sigmas, and (n,) weights."""
    design, moved = series.white @ series.design(terms), series.white @ series.moved_px
    weigh = _clipped if clip == "huber" else _kept
    return irls(weighted(design, moved), weigh, np.ones(len(moved)), rounds=30, still=_still)


def _still(found: Float64, before: Float64) -> bool:
    return bool(np.abs(found - before).max() < 1e-5)


def _clipped(left: Float64) -> Float64:
    """Return (n,) weights of (n, 2) residuals by Huber."""
    off = np.hypot(*left.T)
    return huber(off, CLIPPED_SIGMA * max(axis_sigma(off), 1e-6))


def _kept(left: Float64) -> Float64:
    """Return (n,) weights of (n, 2) residuals by Tukey; 1 if most of them are 0."""
    off = np.hypot(*left.T)
    factor = biweight((off / max(axis_sigma(off), 1e-6)) ** 2)
    return factor if np.count_nonzero(factor) > len(factor) / 2 else np.ones(len(factor))


@dataclass(frozen=True, slots=True, eq=False)
class _ScoreTest:
    """What a model leaves of a series, clipped, and what maps residuals to those of a fit."""

    series: _Series
    left: Float64
    """(n, 2) in standard deviations."""
    basis: Float64
    """(n, p) orthonormal columns of the whitened design."""

    @staticmethod
    def of(series: _Series, terms: Sequence[Term]) -> _ScoreTest:
        _, left, _ = _fit(series, terms, "huber")
        basis = np.linalg.qr(series.white @ series.design(terms))[0]
        return _ScoreTest(series, left * _clipped(left)[:, None], basis)

    def candidate(self, term: Term) -> Float64:
        """Return (n, k) orthonormal columns of a term, less what the model has of them."""
        whole = self.series.white @ term.columns(self.series.years)
        own = whole - self.basis @ (self.basis.T @ whole)
        lengths = np.linalg.norm(own, axis=0) / np.maximum(np.linalg.norm(whole, axis=0), 1e-12)
        return np.linalg.qr(own)[0] if lengths.min() > 1e-6 else np.zeros_like(own)

    def chances(self, candidates: Sequence[Float64], left: Float64) -> Float64:
        """Return (m, q) log-probabilities of m candidates for (n, q, 2) residuals."""
        projected = left - np.tensordot(self.basis, np.tensordot(self.basis.T, left, 1), 1)
        freedom = 2 * max(1, len(left) - self.basis.shape[1])
        variance = np.maximum((projected**2).sum(axis=(0, 2)) / freedom, 1e-30)
        found = []
        for columns in candidates:
            score = (np.tensordot(columns.T, projected, 1) ** 2).sum(axis=(0, 2)) / variance
            # of χ² with 2 and 4 degrees of freedom the logarithm of what exceeds it
            found.append(-score / 2 + (0.0 if columns.shape[1] == 1 else np.log1p(score / 2)))
        return np.array(found)

    def chance_by_noise(self, columns: Float64) -> float:
        """Return the probability of the score of (n, 1) columns if errors are normal, as neighbours tell.

        That is the tail of an F distribution; half of the differences count, as their median tells them.
        """
        freedom = (len(self.left) - 1) / 2
        projected = self.left - self.basis @ (self.basis.T @ self.left)
        score = float(((columns.T @ projected) ** 2).sum())
        return float((1 + score / freedom) ** (-freedom / 2)) if columns.shape[1] == 1 else 1.0


def _strongest(series: _Series, terms: Sequence[Term], kinds: Collection[Kind]) -> Term | None:
    """Return the candidate of some kinds that most speaks for, if chance explains none that does so much."""
    found = [term for term in _candidates(series.years, terms) if term.kind in kinds]
    if not found:
        return None
    test = _ScoreTest.of(series, terms)
    columns = [test.candidate(term) for term in found]
    chances = test.chances(columns, test.left[:, None])[:, 0]
    random = np.random.default_rng(len(terms))
    orders = random.permuted(np.tile(np.arange(len(series.years)), (PERMUTATIONS, 1)), axis=1)
    by_chance = test.chances(columns, test.left[orders.T]).min(axis=0)
    best = int(chances.argmin())
    as_strong = float(1 + np.count_nonzero(by_chance <= chances[best])) / (PERMUTATIONS + 1)
    if len(series.years) < MIN_PERMUTED:  # too few orders to tell: by what neighbours in time differ
        as_strong = min(as_strong, len(found) * test.chance_by_noise(columns[best]))
    return found[best] if as_strong <= FALSE_ALARM / 2 else None


def _candidates(years: Float64, terms: Sequence[Term]) -> Iterator[Term]:
    """Yield the terms that may be added to those of a series."""
    kinds = {term.kind for term in terms}
    span = float(years[-1] - years[0])
    if "drift" not in kinds and span > 0:
        yield Term("drift")
    if "season" not in kinds and span >= MIN_SEASON_YEARS and len(years) >= MIN_SEASON_IMAGES:
        yield Term("season")
    ends = [0, *(term.at for term in terms if term.kind == "step"), len(years)]
    for at in range(MIN_SIDE, len(years) - MIN_SIDE + 1):
        if years[at] > years[at - 1] and min(abs(at - end) for end in ends) >= MIN_SIDE:
            yield Term("step", at)


def _placed(series: _Series, terms: list[Term]) -> list[Term]:
    """Return the terms with each step moved to where it fits best beside all others."""
    for number, term in enumerate(terms):
        if term.kind == "step":
            others = terms[:number] + terms[number + 1 :]
            places = [each for each in _candidates(series.years, others) if each.kind == "step"]
            costs = [_cost(series, [*others, each]) for each in places]
            terms = [*terms[:number], places[int(np.argmin(costs))], *terms[number + 1 :]]
    return terms


def _needed(series: _Series, terms: list[Term]) -> list[Term]:
    """Return the terms without those that the others leave nothing to explain."""
    while terms:
        chances = []
        for number, term in enumerate(terms):
            others = terms[:number] + terms[number + 1 :]
            test = _ScoreTest.of(series, others)
            columns = test.candidate(term)
            chance = float(test.chances([columns], test.left[:, None])[0, 0])
            if len(series.years) < MIN_PERMUTED:
                chance = min(chance, float(np.log(max(test.chance_by_noise(columns), 1e-300))))
            places = len(series.years) if term.kind == "step" else 2
            chances.append(chance + float(np.log(places)))
        weakest = int(np.argmax(chances))
        if chances[weakest] <= np.log(FALSE_ALARM / 2):
            break
        terms = terms[:weakest] + terms[weakest + 1 :]
    return terms


def _cost(series: _Series, terms: Sequence[Term]) -> float:
    """Return Huber's loss of a model."""
    off = np.hypot(*_fit(series, terms, "huber")[1].T)
    inside = np.minimum(off, CLIPPED_SIGMA)
    return float((inside * (off - inside / 2)).sum())


def _model(series: _Series, terms: list[Term]) -> SeriesModel:
    """Fit the terms, and tell which images are outliers."""
    design = series.design(terms)
    coefficients, left, factor = _fit(
        series, terms, "biweight" if len(series.years) >= MIN_IMAGES else "huber"
    )
    unit = max(1.0, axis_sigma(np.hypot(*left.T)))
    white = series.white @ design
    normal = white.T @ (factor[:, None] * white) + 1e-12 * np.eye(design.shape[1])
    covariance = inverse(normal) * unit**2
    found, column = [], 1
    last = np.zeros(design.shape[1])
    last[0] = 1.0
    for term in terms:
        own = slice(column, column + term.columns(series.years).shape[1])
        sigma = float(np.sqrt(np.diagonal(covariance)[own].mean()))
        found.append(Found(term, coefficients[own], sigma))
        if term.kind != "season":
            last[own] = design[-1, own]
        column = own.stop
    off_px = np.hypot(*(series.moved_px - design @ coefficients).T)
    return SeriesModel(
        found=tuple(sorted(found, key=lambda each: (each.term.kind != "step", each.term.at))),
        fitted_px=design @ coefficients,
        level_px=last @ coefficients,
        level_sigma_px=float(np.sqrt(last @ covariance @ last)),
        noise_px=axis_sigma(off_px),
        outliers=_outliers(off_px / (series.sigma_px * unit)),
    )


def _outliers(off: Float64) -> Bool:
    """Return which of (n,) lengths of residuals, in standard deviations, normal errors would hardly have."""
    if len(off) < MIN_IMAGES:
        return np.zeros(len(off), bool)
    return np.asarray(off**2 > 2 * np.log(len(off) / FALSE_OUTLIER))


FALSE_MOTION: Final = 0.01
"""Probability that any cell of a scene that stands still is said to move."""
MIN_MOVING_IMAGES: Final = 6
"""Least number of images, counted by their share, that tell the velocity of a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Velocities:
    """What cells of the ground do over time."""

    velocity_px: Float64
    """(cells, 2) px a year (col, row); NaN where too few images tell."""
    sigma_px: Float64
    """(cells,) standard deviation along an axis, px a year."""
    moving: Bool
    """(cells,) cells that move, by a test that calls none so of a still scene but in one of 100."""


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """n tie points of pairs of images, less what the corrections of both images say."""

    cell: Index
    """(n,) number of the cell that each lies in."""
    ends: Index
    """(n, 2) numbers of the two images."""
    years: Float64
    """(n,) time from the first to the second."""
    moved_px: Float64
    """(n, 2) displacement in that time (col, row)."""
    sigma_px: Float64
    """(n,) its standard deviation along an axis."""


def velocities(motions: Motions, cells: int, images: int) -> Velocities:
    """Return the velocity of each of so many cells, of tie points between so many images.

    It is a robust straight line through zero. As the points of an image share its errors, covariance and test
    count images, by their share in what tells the velocity.
    """
    weight = motions.sigma_px**-2.0

    def solved(factor: Float64) -> tuple[Float64, Float64]:
        found = _line(motions, weight * factor, cells)
        left_px = motions.moved_px - motions.years[:, None] * found[motions.cell]
        off = np.hypot(*left_px.T) / motions.sigma_px
        return found, np.where(np.isfinite(off), off, 0.0)

    found, _, factor = irls(solved, _motion_weights, np.ones(len(weight)), rounds=10)
    return _tested(motions, weight * factor, found, cells, images)


def _motion_weights(off: Float64) -> Float64:
    """Return (n,) weights of residuals of (n,) lengths, in standard deviations."""
    return huber(off, 3.0 * _unit(off))


def _unit(off: Float64) -> float:
    return max(1.0, axis_sigma(off)) if len(off) else 1.0


def displacements(motions: Motions, images: int) -> tuple[Float64, Float64]:
    """Return the displacement of one cell at each of so many images, and its sigma.

    All tie points are those of the cell. Images that pairs connect lie about their mean; those without a pair
    are unknown, and so are all but the largest such group.

    Returns
    -------
    (images, 2) array, (images,) array
        px, and standard deviations along an axis, without those of the images themselves; NaN where unknown.
    """
    group = components(motions.ends, images)
    own = np.flatnonzero(group == np.bincount(group).argmax())
    place = np.full(images, -1)
    place[own] = np.arange(len(own))
    inside = place[motions.ends[:, 0]] >= 0
    ends = place[motions.ends[inside]]
    moved_px, weight = motions.moved_px[inside], motions.sigma_px[inside] ** -2.0

    def solved(factor: Float64) -> tuple[tuple[Float64, Float64], Float64]:
        found, normal = _network(ends, moved_px, weight * factor, len(own))
        left_px = moved_px - found[ends[:, 1]] + found[ends[:, 0]]
        return (found, normal), np.hypot(*left_px.T) * np.sqrt(weight)

    (found, normal), off, _ = irls(solved, _motion_weights, np.ones(len(weight)), rounds=4)
    every, sigma_px = np.full((images, 2), np.nan), np.full(images, np.nan)
    if len(own) > 1:
        variance = np.diag(inverse(normal, NEEDED)).clip(0.0)
        every[own], sigma_px[own] = found - found.mean(axis=0), _unit(off) * np.sqrt(variance)
    return every, sigma_px


def _network(ends: Index, moved_px: Float64, weight: Float64, count: int) -> tuple[Float64, Float64]:
    """Return (count, 2) values of which differences are known, and their normal matrix.

    Their mean, which no difference tells, is zero, and known as well as a value that all others tell.
    """
    first, second = ends.T
    between = _sums(first * count + second, weight, (count, count))
    normal = np.diag(between.sum(axis=0) + between.sum(axis=1)) - between - between.T
    right = np.column_stack(
        [
            np.bincount(second, weight * axis, count) - np.bincount(first, weight * axis, count)
            for axis in moved_px.T
        ]
    )
    normal += max(float(np.trace(normal)), 1e-12) / count
    return solve(normal, right, NEEDED), normal


def _line(motions: Motions, weight: Float64, cells: int) -> Float64:
    total = np.bincount(motions.cell, weight * motions.years**2, cells)
    axes = [np.bincount(motions.cell, weight * motions.years * moved, cells) for moved in motions.moved_px.T]
    known = total > 0
    return np.where(known[:, None], np.column_stack(axes) / np.where(known, total, 1.0)[:, None], np.nan)


def _tested(motions: Motions, weight: Float64, found: Float64, cells: int, images: int) -> Velocities:
    """Return the velocities with their covariance: points of pairs that share an image share its error.

    It is that of clusters by both images of a pair (Aronow, Samii and Assenova 2015,
    doi:10.1093/pan/mpv018), and not less than that of the pairs themselves.
    """
    own = weight * motions.years**2
    total = np.bincount(motions.cell, own, cells)
    shape = cells, images
    places = np.concatenate([motions.cell * images + end for end in motions.ends.T])
    share = _sums(places, np.tile(own, 2), shape) / np.where(total > 0, 2 * total, 1.0)[:, None]
    effective = 1 / np.maximum((share**2).sum(axis=1), 1e-30)  # number of images that tell, as equals
    known = (total > 0) & (effective >= MIN_MOVING_IMAGES)
    freedom = np.where(known, effective - 2, 1.0)
    _, pair = np.unique(motions.ends, axis=0, return_inverse=True)
    pair = pair.reshape(-1)
    count = int(pair.max(initial=-1)) + 1
    variance = []
    for axis, moved in enumerate(motions.moved_px.T):
        left = weight * motions.years * (moved - motions.years * found[motions.cell, axis])
        left = np.where(known[motions.cell], left, 0.0)
        by_pair = (_sums(motions.cell * count + pair, left, (cells, count)) ** 2).sum(axis=1)
        by_image = (_sums(places, np.tile(left, 2), shape) ** 2).sum(axis=1)
        whole = np.maximum(by_image - by_pair, by_pair) / np.where(total > 0, total, 1.0) ** 2
        variance.append(whole * ((freedom + 2) / freedom) ** 2)
    velocity = np.where(known[:, None], found, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        squared = (found.T**2).sum(axis=0) / np.sum(variance, axis=0)
        chance = FALSE_MOTION / max(1, int(known.sum()))
        moving = known & (squared > fdtri(2, freedom, 1 - chance))
    return Velocities(velocity, np.where(known, np.sqrt(np.mean(variance, axis=0)), np.nan), moving)


def _sums(place: Index, values: Float64, shape: tuple[int, int]) -> Float64:
    return np.asarray(np.bincount(place, values, shape[0] * shape[1]), np.float64).reshape(shape)
