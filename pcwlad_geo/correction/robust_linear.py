"""Robust weighted least squares of two-dimensional displacements with their covariances.

The displacement of point i is d_i = Σ_j B_ij θ_j + e_i, where θ_j is a (col, row) pair and e_i has the
covariance C_i + τ² I: C_i as the matcher gives it, τ² the scatter of real displacements that no formal
covariance knows of (a random-effects model; Paule & Mandel 1982, doi:10.6028/jres.087.022).
"""

from __future__ import annotations

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
STARTS = 200
START_POINTS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class LinearEstimate:
    """Parameters, and what their covariance is made from."""

    parameters: Array
    """(k, 2) θ, a (col, row) pair per basis function, px."""
    weight: Array
    """(n,) robust weight, 0 to 1; 0 for outliers."""
    variance_floor_px2: float
    """τ²."""
    whitener: Array
    """(n, 2, 2) matrix that makes the covariance of a point's residual the identity."""


def estimate(basis: Array, displacement_px: Array, covariance_px2: Array) -> LinearEstimate:
    """Fit the parameters: least median of squares, then Tukey's biweight on Mahalanobis distances.

    Parameters
    ----------
    basis : (n, k) array of float
        B, of order one.
    displacement_px : (n, 2) array of float
        d (col, row), px.
    covariance_px2 : (n, 2, 2) array of float
        C, px², symmetric and not negative.

    Raises
    ------
    InputError
        If the points (without the outliers) do not determine the parameters, as when all lie on a line.
    """
    eigenvalue, eigenvector = np.linalg.eigh(covariance_px2)
    variance = np.maximum(eigenvalue, 0.0) + LEAST_VARIANCE_PX2
    axes = eigenvector.transpose(0, 2, 1)  # axes @ residual: along the axes of the error ellipse
    parameters = _least_median(basis, displacement_px)
    principal = _rotate(axes, displacement_px - basis @ parameters)
    floor = _variance_floor(principal, variance, MEDIAN_CHI2, median=True)
    weight = _biweight(principal, variance + floor)
    for _ in range(ITERATIONS):
        before = parameters
        whitener = axes / np.sqrt(variance + floor)[:, :, None]
        parameters = _weighted_least_squares(basis, displacement_px, whitener, weight)
        principal = _rotate(axes, displacement_px - basis @ parameters)
        inlier = weight > 0
        n_inlier = np.count_nonzero(inlier)
        # Each parameter pair takes one point's worth of freedom from the residuals.
        expected = 2 * (1 - basis.shape[1] / n_inlier)
        floor = _variance_floor(principal[inlier], variance[inlier], expected, median=False)
        weight = _biweight(principal, variance + floor)
        if np.abs(parameters - before).max() < TOLERANCE_PX:
            break
    return LinearEstimate(parameters, weight, floor, axes / np.sqrt(variance + floor)[:, :, None])


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


def _weighted_least_squares(basis: Array, displacement_px: Array, whitener: Array, weight: Array) -> Array:
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
