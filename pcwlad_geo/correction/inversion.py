"""Invert a correction that has no formula for it: quasi-Newton steps to far below a pixel's thousandth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOLERANCE_PX = 1e-9
STEPS = 60
CHUNK = 1 << 16
"""Positions evaluated at once: bounds the memory, whatever the raster."""


def in_chunks(function: Callable[[Array], Array], at_px: Array) -> Array:
    """Apply a function of (n, 2) positions to part after part of them."""
    at_px = np.asarray(at_px, dtype=np.float64)
    if len(at_px) <= CHUNK:
        return function(at_px)
    return np.concatenate([function(at_px[start : start + CHUNK]) for start in range(0, len(at_px), CHUNK)])


def invert(forward: Callable[[Array], Array], slopes: Callable[[Array], Array], observed_px: Array) -> Array:
    """Return the predicted pixels that `forward` maps to the observed ones.

    Parameters
    ----------
    forward : callable
        Maps (n, 2) predicted to observed px.
    slopes : callable
        Maps (n, 2) predicted px to (n, 2, 2) derivatives of the observed px (last axis: by col, row).
    observed_px : (n, 2) array of float

    Returns
    -------
    (n, 2) array of float
        Good to 1e-8 px; NaN where the steps do not settle, as where the correction folds.
    """
    observed = np.asarray(observed_px, dtype=np.float64)
    predicted = observed.copy()
    # Coordinates of a million px have no more digits than this.
    tolerance = TOLERANCE_PX + 4 * np.finfo(np.float64).eps * np.abs(observed).max(axis=1)
    moving = np.isfinite(observed).all(axis=1)
    predicted[~moving] = np.nan
    index = np.flatnonzero(moving)
    for _ in range(STEPS):
        miss = observed[index] - forward(predicted[index])
        far = ~(np.abs(miss).max(axis=1) <= tolerance[index])
        index, miss = index[far], miss[far]
        if len(index) == 0:
            return predicted
        predicted[index] += _solved(slopes(predicted[index]), miss)
    predicted[index] = np.nan
    return predicted


def _solved(matrices: Array, vectors: Array) -> Array:
    """Return the solutions of (n, 2, 2) systems; a singular one gives what is not finite, no error."""
    (a, b), (c, d) = matrices.transpose(1, 2, 0)
    x, y = vectors.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, None])
