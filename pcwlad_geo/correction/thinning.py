"""Thinning: at most so many points, spread evenly over the area, the best of every cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def thin(xy_px: Array, sigma: Array, count: int | None) -> NDArray[np.bool_]:
    """Keep at most `count` well-spread points, the most precise of every cell.

    The bounding box of the points is divided into the finest grid of nearly square cells of which no more
    than `count` are occupied. Every occupied cell keeps its most precise point; what is left of `count`
    goes to the second best points of the cells, the most precise first, then the third best, and so on.

    Parameters
    ----------
    xy_px : (n, 2) array of float
        Positions (col, row), px.
    sigma : (n,) array of float
        Standard deviation of each point, any unit; NaN comes last.
    count : int or None
        Most points kept; None keeps all.

    Returns
    -------
    (n,) array of bool
        True where a point is kept; min(n, count) of them. The order of the points matters for ties only.
    """
    keep = np.ones(len(xy_px), dtype=bool)
    if count is None or len(xy_px) <= count:
        return keep
    keep[:] = False
    if count > 0:
        cell, _ = cells(xy_px, count)
        keep[best_of_cells(cell, sigma)[:count]] = True
    return keep


def cells(xy_px: Array, most_occupied: int) -> tuple[NDArray[np.intp], Array]:
    """Divide the bounding box of the points into the finest grid with at most so many occupied cells.

    Parameters
    ----------
    xy_px : (n, 2) array of float
        Positions (col, row), px; n ≥ 1.
    most_occupied : int
        Most occupied cells, ≥ 1.

    Returns
    -------
    cell : (n,) array of int
        Number of the cell each point lies in.
    centre_distance : (n,) array of float
        Distance of each point from the centre of its cell, in cell sides (the larger of the two axes).
    """
    low = xy_px.min(axis=0)
    extent = np.maximum(xy_px.max(axis=0) - low, 1e-9)
    # The side is searched by bisection of its logarithm. Occupancy does not fall strictly with the side,
    # so this finds a grid close to the finest; that is all that spreading needs.
    coarse, fine = float(extent.max()), float(extent.max()) / (most_occupied + 1)
    for _ in range(30):
        side = float(np.sqrt(coarse * fine))
        if len(np.unique(_cell_of(xy_px, low, extent, side)[0])) <= most_occupied:
            coarse = side
        else:
            fine = side
    return _cell_of(xy_px, low, extent, coarse)


def best_of_cells(cell: NDArray[np.intp], badness: Array) -> NDArray[np.intp]:
    """Return the order in which points are taken: the best of every cell, then the second best, and so on."""
    by_cell = np.lexsort((badness, cell))
    _, start, size = np.unique(cell[by_cell], return_index=True, return_counts=True)
    rank = np.empty(len(cell), dtype=np.intp)
    rank[by_cell] = np.arange(len(cell)) - np.repeat(start, size)
    return np.asarray(np.lexsort((badness, rank)))


def _cell_of(xy_px: Array, low: Array, extent: Array, side: float) -> tuple[NDArray[np.intp], Array]:
    shape = np.maximum(np.rint(extent / side), 1).astype(np.intp)
    place = (xy_px - low) / extent * shape
    index = np.minimum(place.astype(np.intp), shape - 1)
    return index[:, 1] * shape[0] + index[:, 0], np.abs(place - index - 0.5).max(axis=1)
