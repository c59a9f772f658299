"""What its neighbours say about a point: outliers told from detail, before any model is fitted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

NEIGHBOURS = 40
ROUNDS = 8
LEAST_SCALE_PX = 1e-6


def local_surface(xy_px: Array, values_px: Array) -> Array:
    """Return, at every point, a robust quadratic surface through its nearest neighbours.

    Parameters
    ----------
    xy_px : (n, 2) array of float
        Positions (col, row), px.
    values_px : (n, 2) array of float
        Such as displacements, px.

    Returns
    -------
    (n, 2) array of float
        The surface's value; a plane's where the points are fewer than 40.
    """
    n = len(xy_px)
    _, near = cKDTree(xy_px).query(xy_px, k=np.arange(1, min(NEIGHBOURS, n) + 1))
    offset = xy_px[near] - xy_px[:, None]
    offset /= np.maximum(np.abs(offset).max(axis=(1, 2)), 1e-9)[:, None, None]
    x, y = np.moveaxis(offset, 2, 0)
    terms = [np.ones_like(x), x, y]
    design = np.stack(terms if n < NEIGHBOURS else [*terms, x * x, x * y, y * y], axis=2)
    around = values_px[near]
    scatter = around - np.median(around, axis=1, keepdims=True)
    value = np.empty_like(values_px)
    for _ in range(ROUNDS):
        size = np.hypot(scatter[..., 0], scatter[..., 1])
        scale = np.maximum(np.median(size, axis=1, keepdims=True), LEAST_SCALE_PX)
        weighted = design / (1 + (size / (2 * scale)) ** 2)[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, design)
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(design.shape[2])
        found = np.linalg.solve(normal, np.einsum("nki,nkj->nij", weighted, around))
        scatter = around - design @ found
        value = found[:, 0]
    return value
