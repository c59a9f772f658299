"""Matching windows that overlap share pixels and so errors: what that does to the precision of a fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PRIOR_PATCHES = 2.0
"""Weight, in independent patches of ground, of the belief that errors are shared in full."""
CHUNK = 512


def parameter_covariance(
    design: Array, weight: Array, residual: Array, xy_px: Array, footprint_px: float
) -> tuple[Array, float]:
    """Return the covariance of the parameters, and the number of independent points it amounts to.

    The errors of two points are taken to correlate as α · (shared part of their windows). α, between 0 and
    1, comes from the residuals: their sum of squares and the sum of their overlap-weighted products are set
    equal to what is expected of them (method of moments, which allows for what the fit has taken out of
    the residuals). Few windows' worth of ground say little about α, so it is drawn towards 1 there.

    Parameters
    ----------
    design : (n, 2, p) array of float
        Derivative of the whitened residuals by the parameters.
    weight : (n,) array of float
        Robust weights; points with weight 0 are left out.
    residual : (n, 2) array of float
        Whitened residuals.
    xy_px : (n, 2) array of float
        Positions (col, row), px.
    footprint_px : float
        Side of the matching window, px; 0 for independent errors.

    Returns
    -------
    covariance : (p, p) array of float
    effective_points : float
        Number of independent points that would give the same mean variance of prediction.
    """
    inlier = weight > 0
    u, e, w, xy_px = design[inlier], residual[inlier], weight[inlier], xy_px[inlier]
    n, _, p = u.shape
    normal = np.einsum("i,iap,iaq->pq", w, u, u)
    g = w[:, None, None] * u @ np.linalg.inv(normal)  # parameters = Σ gᵀ · whitened observations
    independent = _inner(g, g)
    if footprint_px <= 0:
        return independent, float(n)
    order = np.argsort(xy_px[:, 0], kind="stable")
    u, e, g = u[order], e[order], g[order]
    ones = np.ones((n, 2, 1))
    stacked = np.concatenate([g, u, e[:, :, None], ones], axis=2)
    products, squares = _correlate(xy_px[order], footprint_px, stacked)
    rg, ru, re, r1 = products[:, :, :p], products[:, :, p : 2 * p], products[:, :, 2 * p], products[:, 0, -1]
    shared = _inner(g, rg)
    gram = _inner(u, u)
    # Moments of the residuals M ε, M = I − U Gᵀ, for ε of covariance a I + b R (R: overlaps).
    loss = 2 * np.trace(_inner(g, ru))
    moments = np.array(
        [
            [2 * n - 2 * p + np.trace(independent @ gram), 2 * n - loss + np.trace(shared @ gram)],
            [
                2 * n - loss + np.trace(independent @ _inner(u, ru)),
                2 * squares - 2 * np.trace(_inner(rg, ru)) + np.trace(shared @ _inner(u, ru)),
            ],
        ]
    )
    alpha = _shared_part(moments, np.array([(e**2).sum(), (e * re).sum()]))
    patches = n**2 / float(r1.sum())
    alpha = (alpha * patches + PRIOR_PATCHES) / (patches + PRIOR_PATCHES)
    covariance = (1 - alpha) * independent + alpha * shared
    effective = n * np.trace(independent @ gram) / np.trace(covariance @ gram)
    return covariance, float(min(effective, n))


def _shared_part(moments: Array, observed: Array) -> float:
    """Return b / (a + b), 0 to 1, of moments · (a, b) = observed; 1 where the moments cannot tell."""
    if np.linalg.cond(moments) > 1e8:
        return 1.0
    a, b = np.linalg.solve(moments, observed)
    if b <= 0:
        return 0.0
    return float(min(b / (a + b), 1.0)) if a > 0 else 1.0


def _inner(left: Array, right: Array) -> Array:
    return np.asarray(np.einsum("iap,iaq->pq", left, right))


def _correlate(xy_px: Array, side_px: float, vectors: Array) -> tuple[Array, float]:
    """Multiply (n, 2, m) vectors by the overlaps R; points sorted by col. Also return Σ R²."""
    products = np.empty_like(vectors)
    squares = 0.0
    col = xy_px[:, 0]
    flat = vectors.reshape(len(vectors), -1)
    for start in range(0, len(xy_px), CHUNK):
        part = slice(start, min(start + CHUNK, len(xy_px)))
        first = np.searchsorted(col, col[part][0] - side_px)
        last = np.searchsorted(col, col[part][-1] + side_px)
        lag = np.abs(xy_px[part, None] - xy_px[None, first:last]) / side_px
        overlap = np.maximum(1 - lag, 0.0).prod(axis=2)
        products[part] = (overlap @ flat[first:last]).reshape(-1, *vectors.shape[1:])
        squares += float((overlap**2).sum())
    return products, squares
