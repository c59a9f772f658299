"""The error to expect of a correction: its own sigma, what the matches show beside it, extrapolation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.selection import Selection

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

CELLS_PER_WINDOW: Final = 3.0
"""Points in one cell of a third of a window see the same pixels: they count as one witness."""
NEIGHBOURS: Final = 5
"""Witnesses whose median says what the correction leaves at a place."""
SHARED: Final = 0.5
"""Witnesses whose distance from their median exceeds this share of it contradict one another."""
CLOSELY_PX: Final = 0.5
"""Beyond the tie points, where rejected matches are alone, they have to agree within this: matches of ground
without structure are wrong in any direction, and some of them alike by chance."""
LAGS: Final = 8
"""Distances at which the roughness of the displacements is measured."""
SAMPLE: Final = 400
"""Points from which it is measured."""
DRAWS: Final = 64
"""Errors of a unit normal distribution that stand for all of them, spread as it spreads them."""
GOLDEN_ANGLE: Final = np.pi * (3 - np.sqrt(5))
"""Turned by this from one to the next, directions are even at any length."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """What a correction leaves at all matches of a pair."""

    predicted_px: Array
    """(n, 2) target position (col, row) that the original georeferencing predicts, px."""
    residual_px: Array
    """(n, 2) observed minus corrected position, px."""
    kept: Bool
    """(n,) False for matches that their neighbours contradict."""


def expected_ce90(selection: Selection, residuals: Residuals, places_px: Array, footprint_px: float) -> float:
    """Return the radial error within which 90 % of the places are expected to lie, px.

    The error at a place is taken to be normally distributed. Its mean is what the matches around show beside
    the correction: the median of the nearest five witnesses. Matches that were rejected count where they
    agree among themselves, as the points of a second layer of the ground do, and isolated wrong ones do not.
    Its covariance is that of the correction; beyond the tie points it grows by what the displacements change
    over such a distance.

    Parameters
    ----------
    selection : Selection
        The correction, and its precision.
    residuals : Residuals
        Of at least one match.
    places_px : (m, 2) array of float
        Predicted px (col, row) spread evenly over the ground in question; m ≥ 1.
    footprint_px : float
        Side of the matching window, px.
    """
    left = left_by_correction(residuals, places_px, footprint_px)
    reach_px = selection.fit.support.reach_px
    told = left.by_all & (left.distance_px <= reach_px) & (left.spread_px <= CLOSELY_PX)
    unseen = selection.extrapolated(places_px) & ~told
    mean_px = np.where(unseen[:, None], 0.0, left.median_px)
    # What the model misses is in the mean, so not in the covariance.
    covariance = selection.fit.covariance(places_px) + np.diag(selection.common_px2)
    growth = _variance_beyond(selection, residuals, places_px[unseen])
    covariance[unseen] += growth[:, None, None] * np.eye(2)
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    errors = mean_px[:, None, :] + np.einsum("nij,kj->nki", root, _normal_draws())
    return float(np.percentile(np.linalg.norm(errors, axis=2), 90))


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """What the matches around places show beside the correction."""

    median_px: Array
    """(m, 2) median of the nearest witnesses (col, row), px."""
    by_all: Bool
    """(m,) whether all matches around agree on it; where they do not, it is that of those kept."""
    spread_px: Array
    """(m,) median distance of the nearest of all witnesses from their median, px."""
    distance_px: Array
    """(m,) distance of the nearest of all witnesses, px."""


def left_by_correction(residuals: Residuals, places_px: Array, footprint_px: float) -> Left:
    """Return what the matches around (m, 2) places show beside the correction."""
    median, spread, distance = _around(residuals.predicted_px, residuals.residual_px, places_px, footprint_px)
    if not residuals.kept.any():
        return Left(median, np.ones(len(places_px), bool), spread, distance)
    among_kept, _, _ = _around(
        residuals.predicted_px[residuals.kept], residuals.residual_px[residuals.kept], places_px, footprint_px
    )
    agree = spread <= SHARED * np.linalg.norm(median, axis=1)
    return Left(np.where(agree[:, None], median, among_kept), agree, spread, distance)


def _around(
    xy_px: Array, value_px: Array, places_px: Array, footprint_px: float
) -> tuple[Array, Array, Array]:
    """Return the median of the nearest witnesses, their median distance from it, how far the nearest is."""
    place, value = _witnesses(xy_px, value_px, footprint_px / CELLS_PER_WINDOW)
    count = min(NEIGHBOURS, len(place))
    distance, near = cKDTree(place).query(places_px, k=[*range(1, count + 1)])
    around = value[near]
    median = np.median(around, axis=1)
    spread = np.median(np.linalg.norm(around - median[:, None], axis=2), axis=1)
    return median, spread, distance[:, 0]


def _witnesses(xy_px: Array, value_px: Array, side_px: float) -> tuple[Array, Array]:
    """Return the mean position and the median value of the points of each cell of this side."""
    if side_px <= 0:
        return xy_px, value_px
    cell = np.unique(np.floor(xy_px / side_px).astype(np.intp), axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(cell)
    begin = np.cumsum(count) - count
    place = np.column_stack([np.bincount(cell, axis) / count for axis in xy_px.T])
    ordered = np.column_stack([axis[np.lexsort((axis, cell))] for axis in value_px.T])
    return place, (ordered[begin + (count - 1) // 2] + ordered[begin + count // 2]) / 2


def _variance_beyond(selection: Selection, residuals: Residuals, places_px: Array) -> Array:
    """Return (k,) variance per axis to add at places beyond the tie points, px².

    It is half the mean squared difference of displacements as far apart as the place is from the nearest
    point (the semivariogram of kriging), less that of neighbours, which is noise. A correction that is no
    more than affine continues a trend, and only what is left of the displacements counts; one that bends says
    nothing beyond its points, and all that bends counts.
    """
    xy, left = residuals.predicted_px[residuals.kept], residuals.residual_px[residuals.kept]
    if len(places_px) == 0 or len(xy) < 3:
        return np.zeros(len(places_px))
    if not isinstance(selection.fit.correction, AffineCorrection):
        left = _beside_affine(xy, left + selection.fit.correction.forward(xy) - xy)
    sample = np.linspace(0, len(xy) - 1, min(len(xy), SAMPLE)).astype(np.intp)
    apart = np.linalg.norm(xy[sample, None] - xy[None, sample], axis=2)
    halved = ((left[sample, None] - left[None, sample]) ** 2).sum(axis=2) / 4  # of two points, of two axes
    most = max(float(np.ptp(xy, axis=0).max()) / 2, 1e-9)
    bins = np.minimum(np.ceil(apart / most * LAGS), LAGS + 1).astype(np.intp).ravel()
    counts = np.bincount(bins, minlength=LAGS + 2)[1 : LAGS + 1]
    sums = np.bincount(bins, halved.ravel(), minlength=LAGS + 2)[1 : LAGS + 1]
    rough = np.divide(sums, counts, out=np.zeros(LAGS), where=counts > 0)
    rough = np.maximum.accumulate(np.maximum(rough - rough[0], 0.0))
    distance, _ = cKDTree(xy).query(places_px)
    lags = np.arange(LAGS + 1) * most / LAGS
    grown = np.interp(distance, lags, np.concatenate([[0.0], rough]))
    return np.asarray(grown * np.maximum(distance / most, 1.0) ** 2)


def _beside_affine(xy_px: Array, moved_px: Array) -> Array:
    design = np.column_stack([np.ones(len(xy_px)), xy_px - xy_px.mean(axis=0)])
    return np.asarray(moved_px - design @ np.linalg.lstsq(design, moved_px, rcond=None)[0])


def _normal_draws() -> Array:
    """Return (DRAWS, 2) errors spread as a unit normal distribution spreads them."""
    length = np.sqrt(-2 * np.log1p(-(np.arange(DRAWS) + 0.5) / DRAWS))
    angle = GOLDEN_ANGLE * np.arange(DRAWS)
    return np.column_stack([length * np.cos(angle), length * np.sin(angle)])
