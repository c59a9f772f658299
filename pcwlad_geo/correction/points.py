"""Well-spread selections of tie points: thinned points, and check points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcwlad_geo.types import Bool, Float64, Index


def thin(xy_px: Float64, sigma: Float64, count: int | None) -> Bool:
    """Keep at most `count` well-spread points, the most precise of every cell.

    The bounding box of the points is divided into the finest grid of nearly square cells of which no more
    than `count` are occupied. Every occupied cell keeps its most precise point; the rest of `count` are the
    second best points of the cells, the most precise first, then the third best, and so on.

    Parameters
    ----------
    xy_px : (n, 2) array of float
        Positions (col, row), px.
    sigma : (n,) array of float
        Standard deviation of each point, any unit; NaN comes last.
    count : int or None
        Largest number of points kept; None keeps all.

    Returns
    -------
    (n,) array of bool
        True where a point is kept; min(n, count) of them. The order of the points matters for ties only.
    """
    selected = np.ones(len(xy_px), dtype=bool)
    if count is None or len(xy_px) <= count:
        return selected
    selected[:] = False
    if count > 0:
        cell, _ = cells(xy_px, count)
        selected[best_of_cells(cell, sigma)[:count]] = True
    return selected


def cells(xy_px: Float64, most_occupied: int) -> tuple[Index, Float64]:
    """Divide the bounding box of the points into the finest grid with at most `most_occupied` occupied cells.

    For the (n, 2) positions `xy_px` (col, row), at least one, return the (n,) int index of the cell in which
    each lies, and its (n,) distance from the centre of that cell, in cell sides (the larger of the two axes).
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


def best_of_cells(cell: Index, badness: Float64) -> Index:
    """Return the (n,) indices that sort points: the best of every cell, then the second best, and so on.

    The (n,) array `cell` has the index of the cell of each point; the (n,) `badness` ranks points, the least
    first.
    """
    by_cell = np.lexsort((badness, cell))
    _, start, size = np.unique(cell[by_cell], return_index=True, return_counts=True)
    rank = np.empty(len(cell), dtype=np.intp)
    rank[by_cell] = np.arange(len(cell)) - np.repeat(start, size)
    return np.lexsort((badness, rank))


def _cell_of(xy_px: Float64, low: Float64, extent: Float64, side: float) -> tuple[Index, Float64]:
    shape = np.maximum(np.rint(extent / side), 1).astype(np.intp)
    place = (xy_px - low) / extent * shape
    index = np.minimum(place.astype(np.intp), shape - 1)
    return index[:, 1] * shape[0] + index[:, 0], np.abs(place - index - 0.5).max(axis=1)


def hold_out(xy_px: Float64, footprint_px: float, checks: int = 30) -> NDArray[np.str_]:
    """Divide tie points into fit points, check points and points that are neither.

    The check points are spread by cells over the whole area. In each cell the point nearest to the cell's
    centre is taken, whatever its precision, so that they are a fair sample of the points. Matching windows
    that overlap share pixels, and so errors: points whose windows overlap that of a check point are left
    out of the fit (`unused`), as far as the number of points allows. The compromise, in this order:

    1. one point in twenty (at least `checks`) is a check point, no fit point within `footprint_px` of one;
    2. `checks` check points with the same guard;
    3. `checks` check points with the widest guard that leaves 75 % of the points to the fit (of 100 to 119
       points what the check points leave).

    The first that leaves at least 75 % of the points to the fit is taken. (1000 points in 512 × 512 px with
    81 px windows: 30 check points and a guard of about 25 px.) Of fewer than 100 points one in five is a
    check point, of fewer than 10 none. The result is not random.

    Parameters
    ----------
    xy_px : (n, 2) array of float
        Positions (col, row), px.
    footprint_px : float
        Side of the matching window, px. The guard is measured along the larger of the two axes, as square
        windows overlap.
    checks : int
        Least number of check points where there are at least 100 points and `checks` is at most 40 % of them.

    Returns
    -------
    (n,) array of str
        ``fit``, ``check`` or ``unused``.
    """
    n = len(xy_px)
    if n < 10 or checks < 1:
        return np.full(n, "fit", dtype="<U6")
    count = checks if n >= 100 else min(checks, n // 5)
    count = min(count, int(0.4 * n))
    least_fit = min(int(np.ceil(0.75 * n)), n - count)
    for number in (max(n // 20, count), count):
        check = _spread(xy_px, number)
        nearest = cKDTree(xy_px[check]).query(xy_px, p=np.inf)[0]
        guard = min(footprint_px, float(np.sort(nearest[~check])[-least_fit]))
        if guard >= footprint_px:
            break
    fit = ~check & (nearest >= guard)
    return np.where(check, "check", np.where(fit, "fit", "unused"))


def _spread(xy_px: Float64, count: int) -> Bool:
    cell, centre_distance = cells(xy_px, count)
    selected = np.zeros(len(xy_px), dtype=bool)
    selected[best_of_cells(cell, centre_distance)[:count]] = True
    return selected
