"""Robust weighted least squares, and its precision where windows share errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse

from pcwlad_geo.solving import check_rank, inverse, pseudo_inverse, solve
from pcwlad_geo.types import Float64

CELLS = 6
"""Number of ground cells along the side of a window; windows that cover a cell share its errors."""
PROBE_NUMBERS = 32_000
"""Wanted total of random signs, points times vectors, that estimate a trace."""
MIN_PROBES, MAX_PROBES = 8, 64
"""Least and largest number of vectors of random signs."""
BATCH = 16
"""Number of vectors multiplied at once, which limits the memory: each needs a number per ground cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Overlaps:
    """The (n, n) correlation R of errors that windows share, which is the shared part of two windows.

    A window is represented by the ground cells that it covers, its border cells in part. Then
    R = cover · coverᵀ holds to a few hundredths, in memory that does not grow with the density of the points.
    """

    cover: scipy.sparse.csr_array | None
    """(n, cells) rows of length 1; None for windows of size 0, where R is the identity."""
    n: int

    @classmethod
    def of(cls, xy_px: Float64, side_px: float) -> Overlaps:
        """Return the overlaps of windows of side `side_px` at the (n, 2) positions `xy_px` (col, row)."""
        n = len(xy_px)
        if side_px <= 0:
            return cls(None, n)
        # Border cells in part make the correlation reach a little too far, which smaller cells compensate.
        corner = (xy_px - xy_px.min(axis=0)) / side_px * CELLS**2 / (CELLS - 1 / 3)
        first = np.floor(corner).astype(np.int64)
        part = (corner - first)[:, :, None]
        covered = np.concatenate([1 - part, np.ones((n, 2, CELLS - 1)), part], axis=2)
        covered /= np.linalg.norm(covered, axis=2, keepdims=True)
        index = first[:, :, None] + np.arange(CELLS + 1)
        columns = index[:, 1, :, None] * (index[:, 0].max(initial=0) + 1) + index[:, 0, None, :]
        cells, column = np.unique(columns, return_inverse=True)
        values = covered[:, 1, :, None] * covered[:, 0, None, :]
        pointer = np.arange(0, values.size + 1, (CELLS + 1) ** 2)
        shape = (n, len(cells))
        return cls(scipy.sparse.csr_array((values.ravel(), column.ravel(), pointer), shape=shape), n)

    def times(self, vectors: Float64) -> Float64:
        """Return the (n, ...) product of R with the (n, ...) `vectors`."""
        if self.cover is None:
            return vectors
        flat = vectors.reshape(self.n, -1)
        products = np.empty_like(flat)
        for start in range(0, flat.shape[1], BATCH):
            part = slice(start, start + BATCH)
            products[:, part] = self.cover @ (self.cover.T @ flat[:, part])
        return products.reshape(vectors.shape)

    def patches(self) -> float:
        """Return the number of independent windows that the points amount to if errors are shared in full."""
        return self.n**2 / float(self.times(np.ones(self.n)).sum())


def probes_of(xy_px: Float64) -> Float64:
    """Return (n, m) random signs for the (n, 2) points `xy_px`, which estimate traces.

    Few points need more vectors. The estimator is Hutchinson's (1990, doi:10.1080/03610919008812866).
    """
    return random_signs(xy_px, int(np.clip(PROBE_NUMBERS // max(len(xy_px), 1), MIN_PROBES, MAX_PROBES)))


def random_signs(xy_px: Float64, count: int) -> Float64:
    """Return (n, `count`) random signs that depend on the (n, 2) positions `xy_px`, not on their order."""
    signs = np.empty((len(xy_px), count))
    signs[np.lexsort(xy_px.T)] = np.random.default_rng(0).choice([-1.0, 1.0], size=signs.shape)
    return signs


PRIOR_PATCHES = 2.0
"""Weight, in independent windows, of the prior assumption that errors are shared in full."""
SCALE_PATCHES = 10.0
"""Weight, in independent windows, of the prior assumption that the points' covariances are true."""


def parameter_covariance(
    design: Float64, weight: Float64, residual: Float64, xy_px: Float64, footprint_px: float
) -> tuple[Float64, SharedErrors]:
    """Return the covariance of the parameters, and how far the errors of the points are shared.

    The errors of two points are taken to correlate as α · (shared part of their windows). α, between 0 and
    1, comes from the residuals: their sum of squares and the sum of their overlap-weighted products are set
    equal to their expectations (method of moments, which allows for what the fit has removed from the
    residuals). Few independent windows say little about α, so it is shrunk towards 1 there. Where the
    residuals are smaller than the points' covariances say, so is the covariance returned.

    Parameters
    ----------
    design : (n, 2, p) array of float
        Derivative of the whitened residuals by the parameters, per px.
    weight : (n,) array of float
        Robust weights; points with weight 0 are left out.
    residual : (n, 2) array of float
        Whitened residuals, without unit.
    xy_px : (n, 2) array of float
        Positions (col, row), px.
    footprint_px : float
        Side of the matching window, px; 0 for independent errors.

    Returns
    -------
    covariance : (p, p) array of float
        px².
    errors : SharedErrors
    """
    inlier = weight > 0
    u, e, w, xy_px = design[inlier], residual[inlier], weight[inlier], xy_px[inlier]
    n, _, p = u.shape
    normal = np.einsum("i,iap,iaq->pq", w, u, u)
    # parameters = Σ gᵀ · whitened observations
    g = w[:, None, None] * u @ inverse(normal, "the precision of a model needs tie points apart")
    independent = _inner(g, g)
    gram = _inner(u, u)
    kept = 2 * n - 2 * p + float(np.trace(independent @ gram))
    if footprint_px <= 0:
        errors = SharedErrors(0.0, _scale(float((e**2).sum()), kept, n), float(n))
        return errors.scale * independent, errors
    overlaps = Overlaps.of(xy_px, footprint_px)
    rg, ru, re = overlaps.times(g), overlaps.times(u), overlaps.times(e)
    probes = probes_of(xy_px)
    squares = float((overlaps.times(probes) ** 2).sum()) / probes.shape[1]  # Σ R²
    shared = _inner(g, rg)
    # Moments of the residuals M ε, M = I − U Gᵀ, for ε of covariance a I + b R (R: overlaps).
    loss = 2 * np.trace(_inner(g, ru))
    moments = np.array(
        [
            [kept, 2 * n - loss + np.trace(shared @ gram)],
            [
                2 * n - loss + np.trace(independent @ _inner(u, ru)),
                2 * squares - 2 * np.trace(_inner(rg, ru)) + np.trace(shared @ _inner(u, ru)),
            ],
        ]
    )
    errors = SharedErrors.of(moments, float((e**2).sum()), float((e * re).sum()), overlaps.patches())
    covariance = (1 - errors.alpha) * independent + errors.alpha * shared
    return errors.scale * covariance, errors


@dataclass(frozen=True, slots=True)
class SharedErrors:
    """The errors of whitened observations: scale · ((1 − α) I + α R), R the overlaps of the windows."""

    alpha: float
    """0 for independent errors, 1 for errors shared as the windows are."""
    scale: float
    """At most 1, as the variance floor already accounts for residuals larger than the covariances."""
    patches: float
    """Number of independent windows that the points amount to."""

    @classmethod
    def of(cls, moments: Float64, squares: float, products: float, patches: float) -> SharedErrors:
        """Estimate the errors from the moments of the residuals.

        The (2, 2) `moments` are the expectations of Σ e² and Σ e R e for errors of covariance I (first
        column) and R (second); `squares` and `products` are the two sums as observed. The points amount to
        `patches` independent windows.
        """
        alpha = _shared_part(moments, np.array([squares, products]))
        alpha = (alpha * patches + PRIOR_PATCHES) / (patches + PRIOR_PATCHES)
        expected = (1 - alpha) * moments[0, 0] + alpha * moments[0, 1]
        return cls(float(alpha), _scale(squares, float(expected), patches), patches)


def _shared_part(moments: Float64, observed: Float64) -> float:
    """Return b / (a + b), 0 to 1, of moments · (a, b) = observed; 1 where the moments do not determine it."""
    if np.linalg.cond(moments) > 1e8:
        return 1.0
    a, b = solve(moments, observed)
    if b <= 0:
        return 0.0
    return float(min(b / (a + b), 1.0)) if a > 0 else 1.0


def _scale(squares: float, expected: float, patches: float) -> float:
    ratio = min(squares / expected, 1.0) if expected > 0 else 1.0
    return (ratio * patches + SCALE_PATCHES) / (patches + SCALE_PATCHES)


def _inner(left: Float64, right: Float64) -> Float64:
    return np.asarray(np.einsum("iap,iaq->pq", left, right))


REJECTION_SIGMA = 5.12
"""Mahalanobis distance from which on Tukey's biweight is 0: 95 % efficient in two dimensions."""
MEDIAN_CHI2 = 2 * np.log(2)
"""Median of χ² with two degrees of freedom."""
MIN_VARIANCE_PX2 = 1e-8
"""Variance added to every covariance: no position is known to better than 1e-4 px, also where C_i is zero."""
COLLINEAR = 1e-6
"""Least ratio of the smallest to the largest singular value of a basis that the points determine."""
TOLERANCE_PX = 1e-7
"""The reweighting ends where the fit changes by less than this at every point."""
ITERATIONS = 50
"""Largest number of reweighted fits."""
LIVELY_STEPS = 10
"""Number of steps after which weights are averaged with the old ones, so that all of them converge."""
CALM_SHARE = 0.5
"""Share of the new weights in that average."""
COARSE_STEPS = 10
"""Number of steps, after a start from a simpler model, in which τ² comes from the median of the residuals."""
STARTS = 200
"""Number of random samples tried by the least median of squares."""
START_POINTS = 1000
"""Largest number of points whose residuals judge these samples."""


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

    def solve(whitener: Float64, weight: Float64) -> Solution:
        parameters = weighted_least_squares(basis, displacement_px, whitener, weight)
        return Solution(parameters, basis @ parameters, basis.shape[1])

    start = basis @ _least_median(basis, displacement_px)
    return reweighted(solve, start, displacement_px, covariance_px2)


def reweighted(
    solve: Solve,
    start_px: Float64,
    displacement_px: Float64,
    covariance_px2: Float64,
    *,
    coarse_steps: int = 0,
    tolerance_px: float = TOLERANCE_PX,
) -> Estimate:
    """Iterate a weighted fit and its robust weights until the fit converges.

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
    """
    eigenvalue, eigenvector = np.linalg.eigh(covariance_px2)
    variance = np.maximum(eigenvalue, 0.0) + MIN_VARIANCE_PX2
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
        # Each parameter pair takes the degrees of freedom of one point from the residuals.
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
    samples = np.random.default_rng(0).integers(0, n, size=(STARTS, k))
    candidates = pseudo_inverse(basis[samples]) @ displacement_px[samples]
    judges = np.linspace(0, n - 1, min(n, START_POINTS)).astype(np.intp)
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
    check_rank(basis[weight > 0], COLLINEAR, needs)
    root = np.sqrt(weight)[:, None]
    rows = (root[:, :, None] * design(basis, whitener)).reshape(-1, 2 * basis.shape[1])
    values = (root * _rotate(whitener, displacement_px)).ravel()
    # Normal equations: two to some tens of parameters on a centred, scaled basis.
    return solve(rows.T @ rows, rows.T @ values, needs).reshape(-1, 2)


def _variance_floor(principal_px: Float64, variance_px2: Float64, expected: float, *, median: bool) -> float:
    """Return the τ² for which the squared Mahalanobis distances have the expected median, or mean."""
    typical = np.median if median else np.mean

    def excess(floor: float) -> float:
        return float(typical((principal_px**2 / (variance_px2 + floor)).sum(axis=1))) - expected

    if expected <= 0 or excess(0.0) <= 0:
        return 0.0
    from scipy.optimize import brentq  # slow to load, and needed only where points scatter too much

    most = float(typical((principal_px**2).sum(axis=1))) / expected
    if excess(most) >= 0:  # by rounding: the variances are nothing beside it
        return most
    return float(brentq(excess, 0.0, most, xtol=1e-10, rtol=1e-6))


def _biweight(principal_px: Float64, variance_px2: Float64) -> Float64:
    squared = (principal_px**2 / variance_px2).sum(axis=1)
    return np.asarray(np.maximum(1 - squared / REJECTION_SIGMA**2, 0.0) ** 2)


def _rotate(matrices: Float64, vectors: Float64) -> Float64:
    return np.asarray(np.einsum("iab,ib->ia", matrices, vectors))
