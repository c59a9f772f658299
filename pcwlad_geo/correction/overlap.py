"""What errors that windows share do to the precision of a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.windows import Overlaps, probes_of

Array = NDArray[np.float64]

PRIOR_PATCHES = 2.0
"""Weight, in independent patches of ground, of the belief that errors are shared in full."""
SCALE_PATCHES = 10.0
"""The same of the belief that the points' covariances are true."""


def parameter_covariance(
    design: Array, weight: Array, residual: Array, xy_px: Array, footprint_px: float
) -> tuple[Array, float, SharedErrors]:
    """Return the covariance of the parameters, and the number of independent points it amounts to.

    The errors of two points are taken to correlate as α · (shared part of their windows). α, between 0 and
    1, comes from the residuals: their sum of squares and the sum of their overlap-weighted products are set
    equal to what is expected of them (method of moments, which allows for what the fit has taken out of
    the residuals). Few windows' worth of ground say little about α, so it is drawn towards 1 there. Where
    the residuals are smaller than the points' covariances say, so is the covariance returned.

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
    errors : SharedErrors
    """
    inlier = weight > 0
    u, e, w, xy_px = design[inlier], residual[inlier], weight[inlier], xy_px[inlier]
    n, _, p = u.shape
    normal = np.einsum("i,iap,iaq->pq", w, u, u)
    g = w[:, None, None] * u @ np.linalg.inv(normal)  # parameters = Σ gᵀ · whitened observations
    independent = _inner(g, g)
    gram = _inner(u, u)
    kept = 2 * n - 2 * p + float(np.trace(independent @ gram))
    if footprint_px <= 0:
        errors = SharedErrors(0.0, _scale(float((e**2).sum()), kept, n), float(n))
        return errors.scale * independent, float(n), errors
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
    effective = n * np.trace(independent @ gram) / np.trace(covariance @ gram)
    return errors.scale * covariance, float(min(effective, n)), errors


@dataclass(frozen=True, slots=True)
class SharedErrors:
    """The errors of whitened observations: scale · ((1 − α) I + α R), R the overlaps of the windows."""

    alpha: float
    """0: independent; 1: shared as the windows are."""
    scale: float
    """At most 1: residuals larger than the covariances are in these already, as the variance floor."""
    patches: float
    """Number of windows that would lie side by side, as independent looks at the ground."""

    @classmethod
    def of(cls, moments: Array, squares: float, products: float, patches: float) -> SharedErrors:
        """Estimate the errors from the moments of the residuals.

        Parameters
        ----------
        moments : (2, 2) array of float
            What Σ e² and Σ e R e are expected to be for errors of covariance I (first column) and R.
        squares, products : float
            What they are.
        patches : float
            Independent looks at the ground.
        """
        alpha = _shared_part(moments, np.array([squares, products]))
        alpha = (alpha * patches + PRIOR_PATCHES) / (patches + PRIOR_PATCHES)
        expected = (1 - alpha) * moments[0, 0] + alpha * moments[0, 1]
        return cls(float(alpha), _scale(squares, float(expected), patches), patches)


def _shared_part(moments: Array, observed: Array) -> float:
    """Return b / (a + b), 0 to 1, of moments · (a, b) = observed; 1 where the moments cannot tell."""
    if np.linalg.cond(moments) > 1e8:
        return 1.0
    a, b = np.linalg.solve(moments, observed)
    if b <= 0:
        return 0.0
    return float(min(b / (a + b), 1.0)) if a > 0 else 1.0


def _scale(squares: float, expected: float, patches: float) -> float:
    ratio = min(squares / expected, 1.0) if expected > 0 else 1.0
    return (ratio * patches + SCALE_PATCHES) / (patches + SCALE_PATCHES)


def _inner(left: Array, right: Array) -> Array:
    return np.asarray(np.einsum("iap,iaq->pq", left, right))
