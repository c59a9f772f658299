"""Means of displacements, or of positions, in the cells of a square net."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_POINTS: Final = 3
"""A cell counts where it has so many points."""


@dataclass(frozen=True, slots=True)
class CellMean:
    """The points of a cell."""

    n: int
    mean_px: tuple[float, float]
    """(col, row)."""


def cell_means(at_px: Array, values_px: Array, side_px: float) -> dict[tuple[int, int], CellMean]:
    """Return the mean of the points' values in each cell (col, row) that has enough points.

    Parameters
    ----------
    at_px, values_px : (n, 2) arrays
        Where, and what, (col, row).
    side_px : float
        Of a cell.
    """
    if len(at_px) == 0:
        return {}
    cells, of, count = np.unique(
        np.floor(at_px / side_px).astype(np.intp), axis=0, return_inverse=True, return_counts=True
    )
    of = of.ravel()
    col_mean, row_mean = (np.bincount(of, weights=values_px[:, axis]) / count for axis in (0, 1))
    return {
        (int(col), int(row)): CellMean(int(count[index]), (float(col_mean[index]), float(row_mean[index])))
        for index, (col, row) in enumerate(cells)
        if count[index] >= LEAST_POINTS
    }
