"""Adaptive local consistency: a match is kept where its neighbours have similar displacements.

After an idea of Huang, Pan and Zhou (2024), doi:10.5194/isprs-annals-X-1-2024-99-2024, a wide test against
the median of the neighbours removes gross errors, and a narrow one, whose width follows the scatter of the
survivors and the sigma of the match, removes the rest. Neighbours that err alike vouch for each other, so
that cells of matches are compared with those around them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.estimation.robust import axis_sigma
from pcwlad_geo.matching.types import MatchSettings, TiePoints
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class OutlierParameters:
    """When a match agrees with its neighbours; px are of displacements."""

    neighbours: int = 12
    """Number of nearest neighbours that a match is compared with."""
    wide_px: float = 6.0
    """Limit of the wide test, about the median of the neighbours."""
    narrow_px: float = 2.0
    """Largest limit of the narrow test."""
    least_narrow_px: float = 0.25
    """Least limit of the narrow test."""
    scatters: float = 7.856
    """The narrow limit in scatters per axis of the survivors: a rough field scatters correct ones, too."""
    sigmas: float = 3.0
    """Least narrow limit, in radial sigmas of the match."""
    least_support: float = 1 / 3
    """Least share of the neighbours that must agree with a match, within the limit of the test."""
    confirming: int = 3
    """Number of neighbours that confirm an inconsistent match."""
    confirming_share: float = 0.2
    """They differ from it by less than this share of its distance from the prediction."""
    equal_share: float = 0.05
    """The same of neighbours at any distance, which may share pixels with the match."""
    cells: int = 8
    """Number of nearest cells that a match is compared with."""


OUTLIERS: Final = OutlierParameters()
"""Those in use."""


def consistent_points(points: TiePoints, settings: MatchSettings) -> Bool:
    """Return the (n,) mask of the `points` that agree with their neighbours in windows of `settings`."""
    sigma = np.sqrt(np.trace(points.covariance_px2, axis1=1, axis2=2))
    return consistent(points.reference_xy_px, points.displacement_px, sigma, settings.window.side_px)


def consistent(xy_px: Float64, displacement_px: Float64, sigma_px: Float64, window_px: int) -> Bool:
    """Return the (n,) mask of the matches that agree with their neighbours.

    They are at the (n, 2) positions `xy_px`, with the (n, 2) displacements `displacement_px` (col, row) and
    the (n,) radial standard deviations `sigma_px`. Windows that share pixels can share errors.
    """
    mask = np.ones(len(xy_px), bool)
    for narrow in (False, True):
        for _ in range(6):
            before = mask
            mask = _one_round(xy_px, displacement_px, sigma_px, mask, narrow)
            if (mask == before).all():
                break
    return _with_their_surroundings(xy_px, displacement_px, sigma_px, mask, window_px / 2)


def confirmed(
    xy_px: Float64, displacement_px: Float64, index: Index, predicted_px: Float64, window_px: int
) -> Bool:
    """Return the (m,) mask of inconsistent matches that others next to them confirm, against the field.

    Such ground has moved by itself: a slide, a cloud, another depth. Matches nearer than a quarter of the
    window err alike, if not by the same. All matches are at the (n, 2) `xy_px` with the (n, 2)
    `displacement_px` (col, row); the inconsistent ones are those of the (m,) `index`, with the (m, 2)
    `predicted_px`.
    """
    if len(xy_px) <= OUTLIERS.confirming or len(index) == 0:
        return np.zeros(len(index), bool)
    distance, nearest = cKDTree(xy_px).query(xy_px[index], k=min(OUTLIERS.neighbours + 1, len(xy_px)))
    displacement = displacement_px[index]
    difference = np.linalg.norm(displacement_px[nearest[:, 1:]] - displacement[:, None], axis=2)
    off = np.linalg.norm(displacement - predicted_px, axis=1)
    nearer = difference < OUTLIERS.confirming_share * off[:, None]
    confirms = (nearer & (distance[:, 1:] >= window_px / 4)).sum(axis=1) >= OUTLIERS.confirming
    return np.asarray(
        confirms | ((difference < OUTLIERS.equal_share * off[:, None]).sum(axis=1) >= OUTLIERS.confirming)
    )


def _one_round(xy: Float64, displacement: Float64, sigma: Float64, mask: Bool, narrow: bool) -> Bool:
    index = np.flatnonzero(mask)
    if len(index) < 4:
        return np.zeros_like(mask)
    k = min(OUTLIERS.neighbours, len(index) - 1)
    _, neighbours = cKDTree(xy[index]).query(xy[index], k=k + 1)
    around = displacement[index][neighbours[:, 1:]]
    displaced = displacement[index]
    residual = np.linalg.norm(displaced - np.median(around, axis=1), axis=1)
    limit = np.full(len(index), OUTLIERS.wide_px)
    if narrow:
        width = np.maximum(OUTLIERS.scatters * axis_sigma(residual), OUTLIERS.sigmas * sigma[index])
        limit = np.clip(width, OUTLIERS.least_narrow_px, OUTLIERS.narrow_px)
    agreeing = (
        np.linalg.norm(around - displaced[:, None, :], axis=2) < np.maximum(limit, 1.0)[:, None]
    ).mean(axis=1)
    result = np.zeros_like(mask)
    result[index] = (residual < limit) & (agreeing >= OUTLIERS.least_support)
    return result


def _with_their_surroundings(
    xy: Float64, displacement: Float64, sigma: Float64, mask: Bool, cell_px: float
) -> Bool:
    """Remove clusters that agree only among themselves: moved clouds, a wrong peak common to many windows.

    Every point is compared with the medians of the nearest cells other than its own.
    """
    index = np.flatnonzero(mask)
    if len(index) < 4:
        return np.zeros_like(mask)
    place, displaced = xy[index], displacement[index]
    cells, cell_of = np.unique(np.floor(place / cell_px).astype(np.intp), axis=0, return_inverse=True)
    cell_of = cell_of.ravel()
    if len(cells) < OUTLIERS.cells:
        return mask
    order = np.argsort(cell_of, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(cell_of[order])) + 1)
    centres = np.array([place[group].mean(axis=0) for group in groups])
    medians = np.array([np.median(displaced[group], axis=0) for group in groups])
    _, nearest = cKDTree(centres).query(centres, k=min(OUTLIERS.cells + 1, len(cells)))
    around = np.median(medians[nearest[:, 1:]], axis=1)
    residual = np.linalg.norm(displaced - around[cell_of], axis=1)
    width = np.maximum(OUTLIERS.scatters * axis_sigma(residual), OUTLIERS.sigmas * sigma[index])
    result = np.zeros_like(mask)
    result[index] = residual < np.clip(width, OUTLIERS.least_narrow_px, OUTLIERS.wide_px)
    return result
