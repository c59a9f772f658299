"""Matching windows that overlap share pixels, and so errors: the overlaps as a product of sparse matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

Array = NDArray[np.float64]

CELLS = 6
"""Cells along the side of a window, whose contents its points share."""
PROBE_NUMBERS = 32_000
FEWEST_PROBES, MOST_PROBES = 8, 64
BATCH = 16
"""Vectors multiplied at once: in between there is a number for every cell of ground."""


@dataclass(frozen=True, slots=True, eq=False)
class Overlaps:
    """The correlation R of errors that windows share: the shared part of two windows.

    A window is written as the cells of ground that it covers, its border cells in part. R = cover · coverᵀ
    holds to a few hundredths then, in memory that does not grow with the density of the points.
    """

    cover: scipy.sparse.csr_array | None
    """(n, cells) rows of length 1; None for windows of no size: R is the identity."""
    n: int

    @classmethod
    def of(cls, xy_px: Array, side_px: float) -> Overlaps:
        """Return the overlaps of windows about (n, 2) positions (col, row); side 0: none overlap."""
        n = len(xy_px)
        if side_px <= 0:
            return cls(None, n)
        # Border cells in part make the correlation reach a little too far: smaller cells make up for it.
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

    def times(self, vectors: Array) -> Array:
        """Return R times (n, …) vectors."""
        if self.cover is None:
            return vectors
        flat = vectors.reshape(self.n, -1)
        products = np.empty_like(flat)
        for start in range(0, flat.shape[1], BATCH):
            part = slice(start, start + BATCH)
            products[:, part] = self.cover @ (self.cover.T @ flat[:, part])
        return products.reshape(vectors.shape)

    def patches(self) -> float:
        """Return how many independent looks at the ground the points are, if windows share errors in full."""
        return self.n**2 / float(self.times(np.ones(self.n)).sum())


def probes_of(xy_px: Array) -> Array:
    """Return (n, m) random signs that estimate traces (Hutchinson 1990, doi:10.1080/03610919008812866).

    Few points need many of them, and can afford them.
    """
    return random_signs(xy_px, int(np.clip(PROBE_NUMBERS // max(len(xy_px), 1), FEWEST_PROBES, MOST_PROBES)))


def random_signs(xy_px: Array, count: int) -> Array:
    """Return (n, count) random signs that depend on where the points lie, not on their order."""
    signs = np.empty((len(xy_px), count))
    signs[np.lexsort(xy_px.T)] = np.random.default_rng(0).choice([-1.0, 1.0], size=signs.shape)
    return signs
