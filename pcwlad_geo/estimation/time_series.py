"""Displacements of images over time: steps, drifts, seasons and outliers, with a known rate of false alarms.

A series is modelled as a level, steps, a straight
drift and a yearly wave, all in both axes at once. A term is taken into the model, the strongest first, if its
score test exceeds that of all candidates in permutations of the residuals (the largest of all candidates, so
that their number is allowed for). Residuals are clipped as Huber does, so that outliers make no step.

References
----------
.. [1] Huber, P. J. (1964), doi:10.1214/aoms/1177703732.
.. [2] Westfall, P. H. and Young, S. S. (1993), Resampling-Based Multiple Testing (largest statistic).
.. [3] Page, E. S. (1954), doi:10.1093/biomet/41.1-2.100 (cumulative sums).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from pcwlad_geo.estimation.robust import axis_sigma, biweight, huber, irls, weighted
from pcwlad_geo.estimation.solving import inverse, triangular
from pcwlad_geo.types import Bool, Float64

Kind = Literal["step", "drift", "season"]
SMOOTH_TERMS: Final[tuple[Kind, ...]] = ("drift", "season")
"""Terms that change slowly."""
STEP_TERMS: Final[tuple[Kind, ...]] = ("step",)
"""Terms that change at once."""
Clip = Literal["huber", "biweight"]
NEEDED: Final = "errors of images that are neither negative nor infinite"
"""What the equations of a series ask for."""


@dataclass(frozen=True, slots=True)
class SeriesParameters:
    """When a series is given a term, and when an image is an outlier."""

    false_alarm: float = 0.004
    """Probability that a series without terms is given one; with outliers, below 1 % in all."""
    false_outlier: float = 0.002
    """Probability that any date of a series of normal errors is called an outlier."""
    permutations: int = 3000
    """Of the residuals, for each test."""
    min_images: int = 8
    """Shortest series in which anything is sought."""
    min_permuted: int = 13
    """Shortest series that has enough orders of its images for the permutations to tell."""
    min_side: int = 4
    """Least number of images on either side of a step: fewer are as well outliers."""
    min_season_years: float = 1.5
    """Shortest series in which a yearly wave can be told from a drift."""
    min_season_images: int = 12
    """Least number of images in which one is sought."""
    max_terms: int = 12
    """Largest number of terms."""
    clipped_sigma: float = 2.0
    """Residuals beyond are clipped in the tests, in standard deviations."""
    min_sigma_px: float = 1e-3
    """Least standard deviation of a displacement: that of an image that is its own datum is none."""


SERIES: Final = SeriesParameters()
"""Those in use."""


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
class FittedTerm:
    """A term that a series has."""

    term: Term
    size_px: Float64
    """(k, 2) coefficients (col, row): size of a step, px a year of a drift, cosine and sine of a season."""
    sigma_px: float
    """Their standard deviation along an axis."""


@dataclass(frozen=True, slots=True, eq=False)
class SeriesModel:
    """The model of a series of n images, in the order of their times."""

    terms: tuple[FittedTerm, ...]
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
    years: Float64,
    moved_px: Float64,
    sigma_px: Float64,
    covariance_px2: Float64 | None = None,
    parameters: SeriesParameters = SERIES,
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
    parameters : SeriesParameters
        When terms are added.

    Returns
    -------
    SeriesModel
        Without terms if the series has fewer images than `SeriesParameters.min_images`.
    """
    series = _Series.of(years, moved_px, sigma_px, covariance_px2, parameters)
    if len(moved_px) < parameters.min_images:
        return _model(series, [])
    # steps can stand for a drift, and a season for steps: grown in either order, the simpler is taken
    grown = [_grown(series, kinds) for kinds in (((*SMOOTH_TERMS, *STEP_TERMS),), (SMOOTH_TERMS, STEP_TERMS))]
    return _model(series, min(grown, key=lambda terms: _criterion(series, terms)))


def _grown(series: _Series, orders: Sequence[Collection[Kind]]) -> list[Term]:
    """Add terms, of the first kinds before others, as long as they are more than chance."""
    terms: list[Term] = []
    before: set[tuple[Term, ...]] = set()
    while len(terms) < series.parameters.max_terms and tuple(terms) not in before:
        before.add(tuple(terms))
        candidates = (_strongest(series, terms, kinds) for kinds in orders)
        term = next((candidate for candidate in candidates if candidate is not None), None)
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
    parameters: SeriesParameters

    @staticmethod
    def of(
        years: Float64,
        moved_px: Float64,
        sigma_px: Float64,
        covariance_px2: Float64 | None,
        parameters: SeriesParameters,
    ) -> _Series:
        """Add what neighbours in time differ by beyond their covariance: few of them have a step."""
        least = parameters.min_sigma_px**2 * np.eye(len(years))
        covariance = (np.diag(sigma_px**2) if covariance_px2 is None else covariance_px2) + least
        more = 0.0
        if len(years) > 2:
            lengths = np.hypot(*np.diff(moved_px, axis=0).T)
            expected = np.diag(covariance)[1:] + np.diag(covariance)[:-1] - 2 * np.diag(covariance, 1)
            more = max(0.0, axis_sigma(lengths) ** 2 - float(np.median(expected)))
        covariance = covariance + more / 2 * np.eye(len(years))
        white = inverse(triangular(covariance, NEEDED))
        return _Series(years, moved_px, white, np.sqrt(np.diag(covariance)), parameters)

    def design(self, terms: Sequence[Term]) -> Float64:
        """Return the (n, p) design of a level and terms."""
        return np.column_stack([np.ones(len(self.years)), *(term.columns(self.years) for term in terms)])

    def huber_weight(self, residual: Float64) -> Float64:
        """Return (n,) weights of (n, 2) residuals by Huber."""
        length = np.hypot(*residual.T)
        return huber(length, self.parameters.clipped_sigma * max(axis_sigma(length), 1e-6))


def _fit(series: _Series, terms: Sequence[Term], clip: Clip) -> tuple[Float64, Float64, Float64]:
    """Return the (k, 2) coefficients of a robust fit, the (n, 2) residuals in sigmas, and (n,) weights."""
    design, displacement = series.white @ series.design(terms), series.white @ series.moved_px
    weigh = series.huber_weight if clip == "huber" else _biweight
    start = np.ones(len(displacement))
    return irls(weighted(design, displacement), weigh, start, rounds=30, has_converged=_has_converged)


def _has_converged(coefficients: Float64, before: Float64) -> bool:
    return bool(np.abs(coefficients - before).max() < 1e-5)


def _biweight(residual: Float64) -> Float64:
    """Return (n,) weights of (n, 2) residuals by Tukey; 1 if most of them are 0."""
    length = np.hypot(*residual.T)
    factor = biweight((length / max(axis_sigma(length), 1e-6)) ** 2)
    return factor if np.count_nonzero(factor) > len(factor) / 2 else np.ones(len(factor))


@dataclass(frozen=True, slots=True, eq=False)
class _ScoreTest:
    """What a model leaves of a series, clipped, and what maps residuals to those of a fit."""

    series: _Series
    residual: Float64
    """(n, 2) in standard deviations."""
    basis: Float64
    """(n, p) orthonormal columns of the whitened design."""

    @staticmethod
    def of(series: _Series, terms: Sequence[Term]) -> _ScoreTest:
        _, residual, _ = _fit(series, terms, "huber")
        basis = np.linalg.qr(series.white @ series.design(terms))[0]
        return _ScoreTest(series, residual * series.huber_weight(residual)[:, None], basis)

    def candidate(self, term: Term) -> Float64:
        """Return (n, k) orthonormal columns of a term, less what the model has of them."""
        whole = self.series.white @ term.columns(self.series.years)
        new = whole - self.basis @ (self.basis.T @ whole)
        lengths = np.linalg.norm(new, axis=0) / np.maximum(np.linalg.norm(whole, axis=0), 1e-12)
        return np.linalg.qr(new)[0] if lengths.min() > 1e-6 else np.zeros_like(new)

    def chances(self, candidates: Sequence[Float64], residual: Float64) -> Float64:
        """Return (m, q) log-probabilities of m candidates for (n, q, 2) residuals."""
        projected = residual - np.tensordot(self.basis, np.tensordot(self.basis.T, residual, 1), 1)
        freedom = 2 * max(1, len(residual) - self.basis.shape[1])
        variance = np.maximum((projected**2).sum(axis=(0, 2)) / freedom, 1e-30)
        chances = []
        for columns in candidates:
            score = (np.tensordot(columns.T, projected, 1) ** 2).sum(axis=(0, 2)) / variance
            # of χ² with 2 and 4 degrees of freedom the logarithm of what exceeds it
            chances.append(-score / 2 + (0.0 if columns.shape[1] == 1 else np.log1p(score / 2)))
        return np.array(chances)

    def chance_by_noise(self, columns: Float64) -> float:
        """Return the probability of the score of (n, 1) columns if errors are normal, as neighbours tell.

        That is the tail of an F distribution; half of the differences count, as their median tells them.
        """
        freedom = (len(self.residual) - 1) / 2
        projected = self.residual - self.basis @ (self.basis.T @ self.residual)
        score = float(((columns.T @ projected) ** 2).sum())
        return float((1 + score / freedom) ** (-freedom / 2)) if columns.shape[1] == 1 else 1.0


def _strongest(series: _Series, terms: Sequence[Term], kinds: Collection[Kind]) -> Term | None:
    """Return the candidate of some kinds that most speaks for, if chance explains none that does so much."""
    candidates = [term for term in _candidates(series, terms) if term.kind in kinds]
    if not candidates:
        return None
    test, parameters = _ScoreTest.of(series, terms), series.parameters
    columns = [test.candidate(term) for term in candidates]
    chances = test.chances(columns, test.residual[:, None])[:, 0]
    random = np.random.default_rng(len(terms))
    orders = random.permuted(np.tile(np.arange(len(series.years)), (parameters.permutations, 1)), axis=1)
    by_chance = test.chances(columns, test.residual[orders.T]).min(axis=0)
    best = int(chances.argmin())
    as_strong = float(1 + np.count_nonzero(by_chance <= chances[best])) / (parameters.permutations + 1)
    if len(series.years) < parameters.min_permuted:  # too few orders: by what neighbours in time differ
        as_strong = min(as_strong, len(candidates) * test.chance_by_noise(columns[best]))
    return candidates[best] if as_strong <= parameters.false_alarm / 2 else None


def _candidates(series: _Series, terms: Sequence[Term]) -> Iterator[Term]:
    """Yield the terms that may be added to those of a series."""
    years, parameters = series.years, series.parameters
    kinds = {term.kind for term in terms}
    span, side = float(years[-1] - years[0]), parameters.min_side
    if "drift" not in kinds and span > 0:
        yield Term("drift")
    is_long = span >= parameters.min_season_years and len(years) >= parameters.min_season_images
    if "season" not in kinds and is_long:
        yield Term("season")
    ends = [0, *(term.at for term in terms if term.kind == "step"), len(years)]
    for at in range(side, len(years) - side + 1):
        if years[at] > years[at - 1] and min(abs(at - end) for end in ends) >= side:
            yield Term("step", at)


def _placed(series: _Series, terms: list[Term]) -> list[Term]:
    """Return the terms with each step moved to where it fits best beside all others."""
    for number, term in enumerate(terms):
        if term.kind == "step":
            without = terms[:number] + terms[number + 1 :]
            places = [place for place in _candidates(series, without) if place.kind == "step"]
            costs = [_cost(series, [*without, place]) for place in places]
            terms = [*terms[:number], places[int(np.argmin(costs))], *terms[number + 1 :]]
    return terms


def _needed(series: _Series, terms: list[Term]) -> list[Term]:
    """Return the terms without those that the others leave nothing to explain."""
    while terms:
        chances = []
        for number, term in enumerate(terms):
            test = _ScoreTest.of(series, terms[:number] + terms[number + 1 :])
            columns = test.candidate(term)
            chance = float(test.chances([columns], test.residual[:, None])[0, 0])
            if len(series.years) < series.parameters.min_permuted:
                chance = min(chance, float(np.log(max(test.chance_by_noise(columns), 1e-300))))
            places = len(series.years) if term.kind == "step" else 2
            chances.append(chance + float(np.log(places)))
        weakest = int(np.argmax(chances))
        if chances[weakest] <= np.log(series.parameters.false_alarm / 2):
            break
        terms = terms[:weakest] + terms[weakest + 1 :]
    return terms


def _cost(series: _Series, terms: Sequence[Term]) -> float:
    """Return Huber's loss of a model."""
    length = np.hypot(*_fit(series, terms, "huber")[1].T)
    inside = np.minimum(length, series.parameters.clipped_sigma)
    return float((inside * (length - inside / 2)).sum())


def _model(series: _Series, terms: list[Term]) -> SeriesModel:
    """Fit the terms, and tell which images are outliers."""
    design = series.design(terms)
    is_long = len(series.years) >= series.parameters.min_images
    coefficients, residual, factor = _fit(series, terms, "biweight" if is_long else "huber")
    unit = max(1.0, axis_sigma(np.hypot(*residual.T)))
    white = series.white @ design
    normal = white.T @ (factor[:, None] * white) + 1e-12 * np.eye(design.shape[1])
    covariance = inverse(normal) * unit**2
    fitted, column = [], 1
    last = np.zeros(design.shape[1])
    last[0] = 1.0
    for term in terms:
        columns = slice(column, column + term.columns(series.years).shape[1])
        sigma = float(np.sqrt(np.diagonal(covariance)[columns].mean()))
        fitted.append(FittedTerm(term, coefficients[columns], sigma))
        if term.kind != "season":
            last[columns] = design[-1, columns]
        column = columns.stop
    off_px = np.hypot(*(series.moved_px - design @ coefficients).T)
    return SeriesModel(
        terms=tuple(sorted(fitted, key=lambda part: (part.term.kind != "step", part.term.at))),
        fitted_px=design @ coefficients,
        level_px=last @ coefficients,
        level_sigma_px=float(np.sqrt(last @ covariance @ last)),
        noise_px=axis_sigma(off_px),
        outliers=_outliers(off_px / (series.sigma_px * unit), series.parameters),
    )


def _outliers(lengths: Float64, parameters: SeriesParameters) -> Bool:
    """Return which of (n,) lengths of residuals, in standard deviations, normal errors would hardly have."""
    if len(lengths) < parameters.min_images:
        return np.zeros(len(lengths), bool)
    return np.asarray(lengths**2 > 2 * np.log(len(lengths) / parameters.false_outlier))
