"""The precision of parameters that are fitted to points whose matching windows share errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from pcwlad_geo.estimation.solving import inverse, solve
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class SharedErrorParameters:
    """How errors that overlapping windows share are represented and estimated."""

    cells_per_window: int = 6
    """Number of ground cells along the side of a window; windows that cover a cell share its errors."""
    probe_numbers: int = 32_000
    """Wanted total of random signs, points times vectors, that estimate a trace."""
    min_probes: int = 8
    """Least number of vectors of random signs."""
    max_probes: int = 64
    """Largest number of vectors of random signs."""
    vectors_at_once: int = 16
    """Number of vectors multiplied at once, which limits the memory: each needs a number per ground cell."""
    prior_patches: float = 2.0
    """Weight, in independent windows, of the prior assumption that errors are shared in full."""
    scale_patches: float = 10.0
    """Weight, in independent windows, of the prior assumption that the points' covariances are true."""


SHARED_ERRORS: Final = SharedErrorParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Overlaps:
    """The (n, n) correlation R of errors that windows share, which is the shared part of two windows.

    A window is represented by the ground cells that it covers, its border cells in part. Then
    R = cover · coverᵀ holds to a few hundredths, in memory that does not grow with the density of the points.
    """

    cover: scipy.sparse.csr_array | None
    """(n, cells) rows of length 1; None for windows of size 0, where R is the identity."""
    n: int
    transposed: scipy.sparse.csc_array | None = None
    """(cells, n) of `cover`."""

    @classmethod
    def of(
        cls, xy_px: Float64, side_px: float, parameters: SharedErrorParameters = SHARED_ERRORS
    ) -> Overlaps:
        """Return the overlaps of windows of side `side_px` at the (n, 2) positions `xy_px` (col, row)."""
        n, cells_along = len(xy_px), parameters.cells_per_window
        if side_px <= 0:
            return cls(None, n)
        # Border cells in part make the correlation reach a little too far, which smaller cells compensate.
        corner = (xy_px - xy_px.min(axis=0)) / side_px * cells_along**2 / (cells_along - 1 / 3)
        first = np.floor(corner).astype(np.int64)
        part = (corner - first)[:, :, None]
        covered = np.concatenate([1 - part, np.ones((n, 2, cells_along - 1)), part], axis=2)
        covered /= np.linalg.norm(covered, axis=2, keepdims=True)
        index = first[:, :, None] + np.arange(cells_along + 1)
        columns = index[:, 1, :, None] * (index[:, 0].max(initial=0) + 1) + index[:, 0, None, :]
        cells, column = np.unique(columns, return_inverse=True)
        values = covered[:, 1, :, None] * covered[:, 0, None, :]
        pointer = np.arange(0, values.size + 1, (cells_along + 1) ** 2)
        shape = (n, len(cells))
        cover = scipy.sparse.csr_array((values.ravel(), column.ravel(), pointer), shape=shape)
        return cls(cover, n, cover.T)

    def times(self, vectors: Float64) -> Float64:
        """Return the (n, ...) product of R with the (n, ...) `vectors`."""
        if self.cover is None or self.transposed is None:
            return vectors
        flat, step = vectors.reshape(self.n, -1), SHARED_ERRORS.vectors_at_once
        products = np.empty_like(flat)
        for start in range(0, flat.shape[1], step):
            part = slice(start, start + step)
            products[:, part] = self.cover @ (self.transposed @ flat[:, part])
        return products.reshape(vectors.shape)

    def patches(self) -> float:
        """Return the number of independent windows that the points amount to if errors are shared in full."""
        return self.n**2 / float(self.times(np.ones(self.n)).sum())


def probes_of(xy_px: Float64, parameters: SharedErrorParameters = SHARED_ERRORS) -> Float64:
    """Return (n, m) random signs for the (n, 2) points `xy_px`, which estimate traces.

    Few points need more vectors. The estimator is Hutchinson's (1990, doi:10.1080/03610919008812866).
    """
    count = parameters.probe_numbers // max(len(xy_px), 1)
    return random_signs(xy_px, int(np.clip(count, parameters.min_probes, parameters.max_probes)))


def random_signs(xy_px: Float64, count: int, step_px: float = 1e-3) -> Float64:
    """Return (n, `count`) random signs, each row by its own of the (n, 2) positions `xy_px`.

    A point more or less changes no other's signs, but for one at the edge, so that a fit does not jump. They
    are bits of a hash (splitmix64) of the position from the corner of all, in steps of `step_px`: the origin
    of the image does not matter.
    """
    steps = np.rint((xy_px - xy_px.min(axis=0, initial=np.inf)) / step_px).astype(np.int64).view(np.uint64)
    state = _mixed(_mixed(steps[:, 0]) ^ steps[:, 1])
    words = [_mixed(state + np.uint64(word)) for word in range(-(-count // 64))]
    bits = np.column_stack(words)[:, :, None] >> np.arange(64, dtype=np.uint64) & np.uint64(1)
    return np.where(bits.reshape(len(xy_px), -1)[:, :count] > 0, 1.0, -1.0)


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return 64 bits for each value, in which each bit of it has a part."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        values = (values ^ values >> np.uint64(shift)) * np.uint64(factor)
    return values ^ values >> np.uint64(31)


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
    redundancy = 2 * n - 2 * p + float(np.trace(independent @ gram))
    if footprint_px <= 0:
        errors = SharedErrors(0.0, _scale(float((e**2).sum()), redundancy, n), float(n))
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
            [redundancy, 2 * n - loss + np.trace(shared @ gram)],
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
        prior = SHARED_ERRORS.prior_patches
        alpha = (alpha * patches + prior) / (patches + prior)
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
    prior = SHARED_ERRORS.scale_patches
    return (ratio * patches + prior) / (patches + prior)


def _inner(one: Float64, other: Float64) -> Float64:
    return np.asarray(np.einsum("iap,iaq->pq", one, other))
