"""Robust weighted least squares of two-dimensional displacements with their covariances.

The displacement of point i is d_i = f_i(θ) + e_i, where f is a model and e_i has the covariance C_i + τ² I:
C_i as the matcher gives it, τ² the scatter of real displacements that no formal covariance knows of
(a random-effects model; Paule & Mandel 1982, doi:10.6028/jres.087.022).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError

Array = NDArray[np.float64]

REJECTION_SIGMA = 5.12
"""Tukey's biweight gives no weight beyond this Mahalanobis distance: 95 % efficient in two dimensions."""
MEDIAN_CHI2 = 2 * np.log(2)
"""Median of χ² with two degrees of freedom."""
LEAST_VARIANCE_PX2 = 1e-8
"""Added to every covariance: no position is known to better than 1e-4 px, also where C_i is zero."""
COLLINEAR = 1e-6
"""Smallest over largest singular value of the basis from which on the points determine the model."""
TOLERANCE_PX = 1e-7
ITERATIONS = 50
LIVELY_STEPS = 10
"""Steps after which new weights are averaged with the old ones: points at the limit would swing for ever."""
CALM_SHARE = 0.5
COARSE_STEPS = 10
"""Steps from the fit of a simpler model to one's own, before the mean of the residuals is trusted."""
STARTS = 200
START_POINTS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Weighted least squares with given weights."""

    parameters: Array
    """θ, in whatever shape the model has them."""
    fitted_px: Array
    """(n, 2) f."""
    freedom: float
    """Number of parameters of one axis; with a penalty, their effective number."""


Solve = Callable[[Array, Array], Solution]
"""Receives the (n, 2, 2) whiteners and the (n,) weights."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Parameters, and what their covariance is made from."""

    parameters: Array
    """θ; of a linear model (k, 2), a (col, row) pair per basis function, px."""
    fitted_px: Array
    """(n, 2) f."""
    freedom: float
    """Effective number of parameters of one axis."""
    weight: Array
    """(n,) robust weight, 0 to 1; 0 for outliers."""
    variance_floor_px2: float
    """τ²."""
    whitener: Array
    """(n, 2, 2) matrix that makes the covariance of a point's residual the identity."""


def estimate(basis: Array, displacement_px: Array, covariance_px2: Array) -> Estimate:
    """Fit a linear model: least median of squares, then Tukey's biweight on Mahalanobis distances.

    Parameters
    ----------
    basis : (n, k) array of float
        B, of order one: f_i = Σ_j B_ij θ_j, θ_j a (col, row) pair.
    displacement_px : (n, 2) array of float
        d (col, row), px.
    covariance_px2 : (n, 2, 2) array of float
        C, px², symmetric and not negative.

    Raises
    ------
    InputError
        If the points (without the outliers) do not determine the parameters, as when all lie on a line.
    """

    def solve(whitener: Array, weight: Array) -> Solution:
        parameters = weighted_least_squares(basis, displacement_px, whitener, weight)
        return Solution(parameters, basis @ parameters, basis.shape[1])

    start = basis @ _least_median(basis, displacement_px)
    return reweighted(solve, start, displacement_px, covariance_px2)


def reweighted(
    solve: Solve,
    start_px: Array,
    displacement_px: Array,
    covariance_px2: Array,
    *,
    coarse_steps: int = 0,
    tolerance_px: float = TOLERANCE_PX,
) -> Estimate:
    """Iterate a weighted fit and its robust weights until the fit rests.

    Parameters
    ----------
    solve : callable
        Fits the model with given weights.
    start_px : (n, 2) array of float
        A first fit that few outliers have part in.
    displacement_px, covariance_px2
        As for `estimate`.
    coarse_steps : int
        Steps in which τ² comes from the median of the residuals: needed where the start is of a simpler
        model, whose own errors must not count as outliers, and whose outliers must not set τ².
    tolerance_px : float
        Largest change of the fit at a point that counts as rest.
    """
    eigenvalue, eigenvector = np.linalg.eigh(covariance_px2)
    variance = np.maximum(eigenvalue, 0.0) + LEAST_VARIANCE_PX2
    axes = eigenvector.transpose(0, 2, 1)  # axes @ residual: along the axes of the error ellipse
    fitted = start_px
    principal = _rotate(axes, displacement_px - fitted)
    floor = _variance_floor(principal, variance, MEDIAN_CHI2, median=True)
    weight = _biweight(principal, variance + floor)
    for step in range(ITERATIONS):
        before = fitted
        solution = solve(axes / np.sqrt(variance + floor)[:, :, None], weight)
        fitted = solution.fitted_px
        principal = _rotate(axes, displacement_px - fitted)
        inlier = weight > 0
        # Each parameter pair takes one point's worth of freedom from the residuals.
        left = 1 - solution.freedom / np.count_nonzero(inlier)
        if step < coarse_steps:
            floor = _variance_floor(principal, variance, MEDIAN_CHI2 * left, median=True)
        else:
            floor = _variance_floor(principal[inlier], variance[inlier], 2 * left, median=False)
        share = 1.0 if step < LIVELY_STEPS else CALM_SHARE
        weight = (1 - share) * weight + share * _biweight(principal, variance + floor)
        if step >= coarse_steps and np.abs(fitted - before).max() < tolerance_px:
            break
    whitener = axes / np.sqrt(variance + floor)[:, :, None]
    return Estimate(solution.parameters, fitted, solution.freedom, weight, floor, whitener)


def design(basis: Array, whitener: Array) -> Array:
    """Return the (n, 2, 2k) whitened design: residual per parameter (col, row of each basis function)."""
    return np.asarray(np.einsum("iac,ij->iajc", whitener, basis).reshape(len(basis), 2, -1))


def _least_median(basis: Array, displacement_px: Array) -> Array:
    """Return the parameters through few points that leave the smallest median squared residual."""
    n, k = basis.shape
    # A fixed seed: the same points give the same fit. Of 200 samples of 3 points one is clean, also with half
    # of the points outliers, in all but 1 of 10¹¹ cases.
    samples = np.random.default_rng(0).integers(0, n, size=(STARTS, k))
    candidates = np.linalg.pinv(basis[samples]) @ displacement_px[samples]
    judges = np.linspace(0, n - 1, min(n, START_POINTS)).astype(np.intp)
    residual = displacement_px[judges] - basis[judges] @ candidates
    return np.asarray(candidates[np.argmin(np.median((residual**2).sum(axis=2), axis=1))])


def weighted_least_squares(basis: Array, displacement_px: Array, whitener: Array, weight: Array) -> Array:
    """Return the (k, 2) parameters of a linear model for given weights.

    Raises
    ------
    InputError
        If the points with weight do not determine them.
    """
    singular = np.linalg.svd(basis[weight > 0], compute_uv=False)
    if len(singular) < basis.shape[1] or singular[-1] < COLLINEAR * singular[0]:
        raise InputError(
            f"the {np.count_nonzero(weight > 0)} consistent tie points lie on a line or in one place and do "
            "not determine the model; use a simpler model, or more tie points"
        )
    root = np.sqrt(weight)[:, None]
    rows = (root[:, :, None] * design(basis, whitener)).reshape(-1, 2 * basis.shape[1])
    values = (root * _rotate(whitener, displacement_px)).ravel()
    # Normal equations: two to some tens of parameters on a centred, scaled basis.
    return np.asarray(np.linalg.solve(rows.T @ rows, rows.T @ values)).reshape(-1, 2)


def _variance_floor(principal_px: Array, variance_px2: Array, expected: float, *, median: bool) -> float:
    """Return the τ² for which the squared Mahalanobis distances have the expected median, or mean."""
    typical = np.median if median else np.mean

    def excess(floor: float) -> float:
        return float(typical((principal_px**2 / (variance_px2 + floor)).sum(axis=1))) - expected

    if expected <= 0 or excess(0.0) <= 0:
        return 0.0
    from scipy.optimize import brentq  # slow to load, and needed only where points scatter too much

    most = float(typical((principal_px**2).sum(axis=1))) / expected
    return float(brentq(excess, 0.0, most, xtol=1e-10, rtol=1e-6))


def _biweight(principal_px: Array, variance_px2: Array) -> Array:
    squared = (principal_px**2 / variance_px2).sum(axis=1)
    return np.asarray(np.maximum(1 - squared / REJECTION_SIGMA**2, 0.0) ** 2)


def _rotate(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("iab,ib->ia", matrices, vectors))
