"""Robust estimation: scales, weights of outliers, reliability, and fits that are weighted again and again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from pcwlad_geo.estimation.solving import (
    check_rank,
    inverse,
    least_squares,
    pseudo_inverse,
    solve,
    triangular,
)
from pcwlad_geo.types import Float64

SIGMA_OF_MEDIAN: Final = 1.4826
"""Standard deviation of normal errors over the median of their absolute values."""
SIGMA_OF_MEDIAN_LENGTH: Final = 0.8493
"""Standard deviation per axis of circular normal errors over the median of their lengths."""
MEDIAN_LENGTH: Final = 1.1774
"""Median length of two normal components of unit variance: √(2 ln 2), of Rayleigh's distribution."""
MEDIAN_CHI2: Final = 2 * np.log(2)
"""Median of χ² with two degrees of freedom."""
MEASURED: Final = "a pair of images needs tie points of ordinary size, with a sigma above 0"
"""What the equations of a pair ask for."""


@dataclass(frozen=True, slots=True)
class RobustParameters:
    """How robust fits weight observations."""

    rejection_sigma: float = 5.12
    """Mahalanobis distance from which on Tukey's biweight is 0: 95 % efficient in two dimensions."""
    min_variance_px2: float = 1e-8
    """Variance added to every covariance: no position is known to better than 1e-4 px, also where it is
    zero."""
    collinear: float = 1e-6
    """Least ratio of the smallest to the largest singular value of a basis that the points determine."""
    max_steps: int = 50
    """Largest number of steps of a fit."""
    full_steps: int = 10
    """Number of steps after which weights change by half only, so that all of them converge."""
    coarse_steps: int = 10
    """Number of steps, after a start from a simpler model, in which τ² comes from the median of the
    residuals."""
    point_limit: float = 3.0
    """Points that lie off their pair's by more sigmas lose weight."""
    block_correlation: float = 1.4
    """Neighbouring blocks err alike, so that a jackknife tells too little by this factor: measured on scenes
    of known truth (two sensors, 320 and 1,024 px)."""


ROBUST: Final = RobustParameters()
"""Those in use."""


def sigma_of(errors: Float64) -> float:
    """Return the robust standard deviation of normal errors about zero: (...,) `errors`, one at least.

    It is that of the median absolute deviation (Hampel 1974, doi:10.1080/01621459.1974.10482962).
    """
    return SIGMA_OF_MEDIAN * float(np.median(np.abs(errors)))


def axis_sigma(lengths: Float64) -> float:
    """Return the robust standard deviation per axis of circular normal errors of (n,) `lengths`."""
    return SIGMA_OF_MEDIAN_LENGTH * float(np.median(lengths))


def unit_sigma(lengths: Float64) -> float:
    """Return the robust standard deviation of errors of (n,) `lengths` in their own sigmas, at least 1."""
    return max(1.0, float(np.median(lengths)) / MEDIAN_LENGTH)


def huber(lengths: Float64, limit: float) -> Float64:
    """Return (...,) weights, 1 up to a limit and falling with the length of an error beyond.

    The (...,) `lengths` are in the unit of `limit` (Huber 1964, doi:10.1214/aoms/1177703732).
    """
    return np.minimum(1.0, limit / np.maximum(lengths, 1e-12))


def biweight(squared: Float64, limit: float = ROBUST.rejection_sigma) -> Float64:
    """Return (...,) weights, 1 for no error and 0 from a limit on, of (...,) `squared` lengths of errors.

    The limit is a length (Beaton & Tukey 1974, doi:10.1080/00401706.1974.10489171).
    """
    return np.maximum(1 - squared / limit**2, 0.0) ** 2


def outlier_factors(
    errors: Float64, weight: Float64, power: int = 1, parameters: RobustParameters = ROBUST
) -> Float64:
    """Return (n,) factors of weights: Huber's to a power, over the squared scale of all (n, 2) `errors`.

    The (n, 2, 2) `weight` are their inverse covariances.
    """
    lengths = np.sqrt(np.maximum(np.einsum("na,nab,nb->n", errors, weight, errors), 1e-12))
    unit = unit_sigma(lengths) if len(lengths) else 1.0
    return huber(lengths, parameters.point_limit * unit) ** power / unit**2


def reliability(observed: float, adjusted: float, is_used: bool, least: float) -> tuple[float, float]:
    """Return the standard deviation of what an observation lies off an adjustment, and its redundancy.

    The variance of the observation is `observed`, that of its adjusted value `adjusted`. The redundancy is
    the share of its error that the others check, of which `least` counts at least; 1 of one that `is_used`
    not (Baarda 1968, Publications on Geodesy 2(5), Delft).
    """
    redundancy = max(0.0, 1.0 - adjusted / observed) if is_used else 1.0
    variance = observed * redundancy if is_used else observed + adjusted
    return float(np.sqrt(max(variance, least * observed))), redundancy


def jackknife(estimates: Float64, parameters: RobustParameters = ROBUST) -> Float64:
    """Return (k, ...) changes of estimates without each of k blocks; their products add up to the covariance.

    The (k, ...) `estimates` are those without a block (Tukey 1958, doi:10.1214/aoms/1177706647).
    """
    count, changes = len(estimates), estimates - estimates.mean(axis=0)
    return np.asarray(changes * parameters.block_correlation * np.sqrt((count - 1) / count))


def propagated(design: Float64, covariance: Float64, changes: Float64) -> Float64:
    """Return the (n, 2, 2) covariance of values by that of parameters, at least what a jackknife tells.

    The (n, 2, p) `design` holds their derivatives; the (p, p) `covariance` and the (k, p) `changes` without a
    block (see `jackknife`) are of the parameters. In each direction the larger is taken.
    """
    one = design @ covariance @ design.transpose(0, 2, 1)
    changed = np.einsum("nap,kp->nak", design, changes)
    other = changed @ changed.transpose(0, 2, 1)
    size = np.trace(one, axis1=1, axis2=2) + np.trace(other, axis1=1, axis2=2)
    least = (1e-9 * size + 1e-30)[:, None, None] * np.eye(2)
    root = triangular(one + least, MEASURED)
    inverse_root = inverse(root, MEASURED)
    ratio, axes = np.linalg.eigh(inverse_root @ (other + least) @ inverse_root.transpose(0, 2, 1))
    turned = root @ axes
    larger = turned @ (np.maximum(ratio, 1.0)[:, :, None] * turned.transpose(0, 2, 1))
    return np.where(size[:, None, None] > 0, larger, 0.0)


Result = TypeVar("Result")


def irls(
    solve: Callable[[Float64], tuple[Result, Float64]],
    weigh: Callable[[Float64], Float64],
    weight: Float64,
    rounds: int,
    has_converged: Callable[[Result, Result], bool] | None = None,
) -> tuple[Result, Float64, Float64]:
    """Solve and weight in turn: iteratively reweighted least squares, in so many rounds at most.

    Of (n, ...) weights, first `weight`, `solve` makes a solution and its residuals, and `weigh` makes weights
    of these. It ends with a solution that `has_converged`, by it and the one before. Returned are the last
    solution, its residuals, and the weights of these, or its own if it has converged.
    """
    before: Result | None = None
    for _ in range(rounds):
        solution, residual = solve(weight)
        if has_converged and before is not None and has_converged(solution, before):
            break
        before, weight = solution, weigh(residual)
    return solution, residual, weight


def weighted(basis: Float64, values: Float64) -> Callable[[Float64], tuple[Float64, Float64]]:
    """Return what solves for the (k, 2) parameters of an (n, k) `basis` of (n, 2) `values`, for `irls`."""

    def solve(weight: Float64) -> tuple[Float64, Float64]:
        root = np.sqrt(weight)[:, None]
        parameters = least_squares(root * basis, root * values)
        return parameters, values - basis @ parameters

    return solve


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Weighted least squares with given weights."""

    parameters: Float64
    """θ, in the shape that the model gives them."""
    fitted_px: Float64
    """(n, 2) fitted displacement f (col, row)."""
    freedom: float
    """Number of parameters of one axis; with a penalty, their effective number."""


Solve = Callable[[Float64, Float64], Solution]
"""A function that fits a model with given (n, 2, 2) whiteners and (n,) weights."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Parameters of a robust fit, and what their covariance is computed from."""

    parameters: Float64
    """θ; of a linear model (k, 2), a (col, row) pair per basis function, px."""
    fitted_px: Float64
    """(n, 2) fitted displacement f (col, row)."""
    freedom: float
    """Effective number of parameters of one axis."""
    weight: Float64
    """(n,) robust weight, 0 to 1; 0 for outliers."""
    variance_floor_px2: float
    """τ², the variance per axis added to all covariances (Paule & Mandel 1982, doi:10.6028/jres.087.022)."""
    whitener: Float64
    """(n, 2, 2) matrices, 1/px, that make the covariance of a point's residual the identity."""


def estimate(basis: Float64, displacement_px: Float64, covariance_px2: Float64) -> Estimate:
    """Fit a linear model: least median of squares, then Tukey's biweight on Mahalanobis distances.

    Raises `InputError` if the points (without the outliers) do not determine the parameters, as when all lie
    on a line.

    Parameters
    ----------
    basis : (n, k) array of float
        B, of order one: f_i = Σ_j B_ij θ_j, θ_j a (col, row) pair.
    displacement_px : (n, 2) array of float
        Observed displacements d (col, row), px.
    covariance_px2 : (n, 2, 2) array of float
        Their covariances C, px², symmetric and not negative.
    """
    start = basis @ _least_median(basis, displacement_px)
    return reweighted(linear(basis, displacement_px), start, displacement_px, covariance_px2)


def linear(basis: Float64, displacement_px: Float64) -> Solve:
    """Return what fits an (n, k) `basis` to the (n, 2) displacements `displacement_px` (col, row)."""

    def solve(whitener: Float64, weight: Float64) -> Solution:
        parameters = weighted_least_squares(basis, displacement_px, whitener, weight)
        return Solution(parameters, basis @ parameters, basis.shape[1])

    return solve


def reweighted(
    solve: Solve,
    start_px: Float64,
    displacement_px: Float64,
    covariance_px2: Float64,
    *,
    coarse_steps: int = 0,
    tolerance_px: float = 1e-7,
    parameters: RobustParameters = ROBUST,
) -> Estimate:
    """Iterate a weighted fit and its robust weights until the fit converges.

    Unlike those of `irls`, its rounds also change the variance that is added to all points, and from some
    step on they change the weights by half only.

    Parameters
    ----------
    solve : callable
        Fits the model with given weights.
    start_px : (n, 2) array of float
        A first fit (col, row) that few outliers influence.
    displacement_px, covariance_px2 : (n, 2) and (n, 2, 2) arrays of float
        See `estimate`.
    coarse_steps : int
        Number of steps in which τ² comes from the median of the residuals: needed after a start from a
        simpler model, whose errors must not count as outliers, and whose outliers must not set τ².
    tolerance_px : float
        The iteration ends where the fit changes by less than this at every point.
    parameters : RobustParameters
        How the points are weighted.
    """
    eigenvalue, eigenvector = np.linalg.eigh(covariance_px2)
    variance = np.maximum(eigenvalue, 0.0) + parameters.min_variance_px2
    axes = eigenvector.transpose(0, 2, 1)  # axes @ residual: along the axes of the error ellipse
    fitted = start_px
    principal = _rotate(axes, displacement_px - fitted)
    floor = _variance_floor(principal, variance, MEDIAN_CHI2, median=True)
    limit = parameters.rejection_sigma
    weight = biweight(_squared(principal, variance + floor), limit)
    for step in range(parameters.max_steps):
        before = fitted
        solution = solve(axes / np.sqrt(variance + floor)[:, :, None], weight)
        fitted = solution.fitted_px
        principal = _rotate(axes, displacement_px - fitted)
        inlier = weight > 0
        # Each parameter pair takes the degrees of freedom of one point from the residuals.
        redundancy = 1 - solution.freedom / np.count_nonzero(inlier)
        if step < coarse_steps:
            floor = _variance_floor(principal, variance, MEDIAN_CHI2 * redundancy, median=True)
        else:
            floor = _variance_floor(principal[inlier], variance[inlier], 2 * redundancy, median=False)
        share = 1.0 if step < parameters.full_steps else 0.5
        weight = (1 - share) * weight + share * biweight(_squared(principal, variance + floor), limit)
        if step >= coarse_steps and np.abs(fitted - before).max() < tolerance_px:
            break
    whitener = axes / np.sqrt(variance + floor)[:, :, None]
    return Estimate(solution.parameters, fitted, solution.freedom, weight, floor, whitener)


def design(basis: Float64, whitener: Float64) -> Float64:
    """Return the (n, 2, 2 * k) whitened design: residual per parameter (col, row of each basis function).

    The (n, k) `basis` holds the basis functions at the points; the (n, 2, 2) `whitener` is that of
    `Estimate`.
    """
    return np.asarray(np.einsum("iac,ij->iajc", whitener, basis).reshape(len(basis), 2, -1))


def _least_median(basis: Float64, displacement_px: Float64) -> Float64:
    """Return the parameters, determined by few points, with the smallest median squared residual."""
    n, k = basis.shape
    # A fixed seed: the same points give the same fit. Of 200 samples of 3 points one is clean, also with half
    # of the points outliers, in all but 1 of 10¹¹ cases.
    samples = np.random.default_rng(0).integers(0, n, size=(200, k))
    candidates = pseudo_inverse(basis[samples]) @ displacement_px[samples]
    judges = np.linspace(0, n - 1, min(n, 1000)).astype(np.intp)
    residual = displacement_px[judges] - basis[judges] @ candidates
    return np.asarray(candidates[np.argmin(np.median((residual**2).sum(axis=2), axis=1))])


def weighted_least_squares(
    basis: Float64, displacement_px: Float64, whitener: Float64, weight: Float64
) -> Float64:
    """Return the (k, 2) parameters (col, row), px, of a linear model for given weights.

    Raises `InputError` if the points with weight do not determine the parameters. The (n, k) `basis` and (n,
    2) `displacement_px` are as for `estimate`, the (n, 2, 2) `whitener` and (n,) `weight` as in `Estimate`.
    """
    needs = (
        f"the {np.count_nonzero(weight > 0)} consistent tie points lie on a line or in one place and do not "
        "determine the model; use a simpler model, or more tie points"
    )
    determining = basis[weight > 0]
    check_rank(determining.T @ determining, ROBUST.collinear**2, needs)  # far smaller than the basis itself
    root = np.sqrt(weight)[:, None]
    rows = (root[:, :, None] * design(basis, whitener)).reshape(-1, 2 * basis.shape[1])
    values = (root * _rotate(whitener, displacement_px)).ravel()
    # Normal equations: two to some tens of parameters on a centred, scaled basis.
    return solve(rows.T @ rows, rows.T @ values, needs).reshape(-1, 2)


def _variance_floor(principal_px: Float64, variance_px2: Float64, expected: float, *, median: bool) -> float:
    """Return the τ² for which the squared Mahalanobis distances have the expected median, or mean."""
    typical = np.median if median else np.mean

    def excess(floor: float) -> float:
        return float(typical(_squared(principal_px, variance_px2 + floor))) - expected

    if expected <= 0 or excess(0.0) <= 0:
        return 0.0
    from scipy.optimize import brentq  # slow to load, and needed only where points scatter too much

    most = float(typical((principal_px**2).sum(axis=1))) / expected
    if excess(most) >= 0:  # by rounding: the variances are nothing beside it
        return most
    return float(brentq(excess, 0.0, most, xtol=1e-10, rtol=1e-6))


def _squared(principal_px: Float64, variance_px2: Float64) -> Float64:
    """Return the (n,) squared Mahalanobis distances."""
    return np.asarray((principal_px**2 / variance_px2).sum(axis=1))


def _rotate(matrices: Float64, vectors: Float64) -> Float64:
    return np.asarray(np.einsum("iab,ib->ia", matrices, vectors))
