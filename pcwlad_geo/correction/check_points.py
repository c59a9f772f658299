"""Check points: tie points kept out of the fit, for the accuracy figure that is reported."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcwlad_geo.correction.thinning import best_of_cells, cells

Array = NDArray[np.float64]

FEWEST_POINTS = 10
"""Below this number of points none is held out."""
ENOUGH_POINTS = 100
"""From this number of points on, all wanted check points are held out; below, a fifth of the points."""
CHECK_SHARE = 0.4
"""Most of the points that are check points."""
FIT_SHARE = 0.75
"""Least share of the points that stays in the fit: the guard distance shrinks to hold it."""


def hold_out(xy_px: Array, footprint_px: float, wanted: int = 30) -> NDArray[np.str_]:
    """Divide tie points into fit points, check points and points that are neither.

    The check points are spread by cells over the whole area. In each cell the point nearest to the cell's
    centre is taken, whatever its precision, so that they are a fair sample of the points. Matching windows
    that overlap share pixels, and so errors: points whose windows overlap that of a check point are left
    out of the fit (`unused`), as far as the number of points allows. The compromise, in this order:

    1. one point in twenty (at least `wanted`) is a check point, no fit point within `footprint_px` of one;
    2. `wanted` check points with the same guard;
    3. `wanted` check points with the widest guard that leaves 75 % of the points to the fit (of 100 to 119
       points what the check points leave).

    The first that leaves at least 75 % of the points to the fit counts. (1000 points in 512 × 512 px with
    81 px windows: 30 check points and a guard of about 25 px.) Of fewer than 100 points one in five is a
    check point, of fewer than 10 none. There is no randomness in it.

    Parameters
    ----------
    xy_px : (n, 2) array of float
        Positions (col, row), px.
    footprint_px : float
        Side of the matching window, px. The guard counts along the larger of the two axes, as square
        windows overlap.
    wanted : int
        Least number of check points where there are at least 100 points and `wanted` is at most 40 % of them.

    Returns
    -------
    (n,) array of str
        ``fit``, ``check`` or ``unused``.
    """
    n = len(xy_px)
    if n < FEWEST_POINTS or wanted < 1:
        return np.full(n, "fit", dtype="<U6")
    count = wanted if n >= ENOUGH_POINTS else min(wanted, n // 5)
    count = min(count, int(CHECK_SHARE * n))
    least_fit = min(int(np.ceil(FIT_SHARE * n)), n - count)
    for number in (max(n // 20, count), count):
        check = _spread(xy_px, number)
        nearest = _distance(xy_px, xy_px[check])
        guard = min(footprint_px, float(np.sort(nearest[~check])[-least_fit]))
        if guard >= footprint_px:
            break
    fit = ~check & (nearest >= guard)
    return np.where(check, "check", np.where(fit, "fit", "unused"))


def _spread(xy_px: Array, count: int) -> NDArray[np.bool_]:
    cell, centre_distance = cells(xy_px, count)
    chosen = np.zeros(len(xy_px), dtype=bool)
    chosen[best_of_cells(cell, centre_distance)[:count]] = True
    return chosen


def _distance(xy_px: Array, centres_px: Array) -> Array:
    """Return the (n,) distance (Chebyshev) of the points from the nearest of the centres."""
    return np.asarray(cKDTree(centres_px).query(xy_px, p=np.inf)[0])
