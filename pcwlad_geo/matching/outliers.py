"""Adaptive local consistency: a match stays where its neighbours moved alike.

Two stages after the idea of Huang, Pan and Zhou (2024), ISPRS Annals X-1-2024, 99-106
(doi:10.5194/isprs-annals-X-1-2024-99-2024): a wide test against the neighbours' median displacement
removes the gross errors, a narrow one, whose width follows the scatter of the survivors and each
point's own sigma, removes the rest.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcwlad_geo.matching.field import SIGMA_OF_MEDIAN_DISTANCE

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

NEIGHBOURS: Final = 12
WIDE_PX: Final = 6.0
NARROW_PX: Final = 2.0
LEAST_NARROW_PX: Final = 0.25
SCATTERS: Final = 7.856
"""Times the scatter of the survivors, per axis, about their neighbours. Tuned, not derived: wide, as a field
that is not smooth scatters its points too."""
SIGMAS: Final = 3.0
"""Times a point's own radial sigma."""
LEAST_SUPPORT: Final = 1 / 3
"""Share of the neighbours that must agree with a point within the wide, then the narrow limit."""
ROUNDS: Final = 6
CELLS_AROUND: Final = 8


def consistent(xy_px: Float64, displacement_px: Float64, sigma_px: Float64, window_px: int) -> Bool:
    """Tell which matches agree with their neighbours.

    Parameters
    ----------
    xy_px : (n, 2) array
        Positions.
    displacement_px : (n, 2) array
        Displacements.
    sigma_px : (n,) array
        Radial standard deviation of each displacement.
    window_px : int
        Side of the matching window: points nearer than that see the same pixels and can err alike.

    Returns
    -------
    (n,) bool array
    """
    kept = np.ones(len(xy_px), bool)
    for narrow in (False, True):
        for _ in range(ROUNDS):
            before = kept
            kept = _one_round(xy_px, displacement_px, sigma_px, kept, narrow)
            if (kept == before).all():
                break
    return _with_their_surroundings(xy_px, displacement_px, sigma_px, kept, window_px / 2)


def axis_sigma_px(distance_px: Float64) -> float:
    """Return the robust standard deviation per axis of round normal errors from their (n,) lengths.

    Lengths are Rayleigh-distributed: their median is √(2 ln 2) = 1.1774 standard deviations of an axis. (The
    familiar 1.4826 times the median absolute deviation is for a single axis.)
    """
    return SIGMA_OF_MEDIAN_DISTANCE * float(np.median(distance_px))


def _one_round(xy: Float64, displacement: Float64, sigma: Float64, kept: Bool, narrow: bool) -> Bool:
    index = np.flatnonzero(kept)
    if len(index) < 4:
        return np.zeros_like(kept)
    k = min(NEIGHBOURS, len(index) - 1)
    _, neighbours = cKDTree(xy[index]).query(xy[index], k=k + 1)
    around = displacement[index][neighbours[:, 1:]]
    own = displacement[index]
    residual = np.linalg.norm(own - np.median(around, axis=1), axis=1)
    limit = np.full(len(index), WIDE_PX)
    if narrow:
        width = np.maximum(SCATTERS * axis_sigma_px(residual), SIGMAS * sigma[index])
        limit = np.clip(width, LEAST_NARROW_PX, NARROW_PX)
    agreeing = (np.linalg.norm(around - own[:, None, :], axis=2) < np.maximum(limit, 1.0)[:, None]).mean(
        axis=1
    )
    result = np.zeros_like(kept)
    result[index] = (residual < limit) & (agreeing >= LEAST_SUPPORT)
    return result


def _with_their_surroundings(
    xy: Float64, displacement: Float64, sigma: Float64, kept: Bool, cell_px: float
) -> Bool:
    """Drop clusters that agree among themselves only: moved clouds, one wrong peak seen by many windows.

    Every point is compared with the medians of the nearest cells other than its own.
    """
    index = np.flatnonzero(kept)
    if len(index) < 4:
        return np.zeros_like(kept)
    place, moved = xy[index], displacement[index]
    cells, cell_of = np.unique(np.floor(place / cell_px).astype(np.intp), axis=0, return_inverse=True)
    cell_of = cell_of.ravel()
    if len(cells) < CELLS_AROUND:
        return kept
    order = np.argsort(cell_of, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(cell_of[order])) + 1)
    centres = np.array([place[group].mean(axis=0) for group in groups])
    medians = np.array([np.median(moved[group], axis=0) for group in groups])
    _, nearest = cKDTree(centres).query(centres, k=min(CELLS_AROUND + 1, len(cells)))
    around = np.median(medians[nearest[:, 1:]], axis=1)
    residual = np.linalg.norm(moved - around[cell_of], axis=1)
    width = np.maximum(SCATTERS * axis_sigma_px(residual), SIGMAS * sigma[index])
    result = np.zeros_like(kept)
    result[index] = residual < np.clip(width, LEAST_NARROW_PX, WIDE_PX)
    return result
