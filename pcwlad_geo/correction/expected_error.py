"""The error to expect of a correction: the radius within which 90 % of the places lie."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.correction.error_statistics import SIGMA_90, without_noise
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class ExpectedErrorParameters:
    """How the error of a correction is estimated at a place."""

    cells_per_window: float = 3.0
    """Number of cells along the side of a window; points of one cell share pixels and count as one."""
    neighbours: int = 5
    """Number of nearest independent points whose median residual is taken for the mean error at a place."""
    max_relative_spread: float = 0.5
    """Largest spread of such points that agree, as a share of the length of their median."""
    max_rejected_spread_px: float = 0.5
    """Largest spread of rejected matches that count beyond the tie points: matches of ground without
    structure err in any direction, and some of them agree by chance."""
    unsurprising: float = 1.25
    """Largest ratio of residuals to their sigmas that is expected of correct sigmas."""
    lags: int = 8
    """Number of lags of the semivariogram of the displacements."""
    variogram_points: int = 400
    """Largest number of points of the semivariogram."""
    draws: int = 64
    """Number of quasi-random draws that represent a unit normal distribution."""
    least_common_px: float = 0.03
    """Least systematic error per axis that all points of two images share: the structure in one is offset
    from that in the other, however well the points agree (rows of an orchard: 0.09 to 0.17 px at 90 %)."""


EXPECTED_ERROR: Final = ExpectedErrorParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """The residuals of a correction at all matches of a pair."""

    predicted_px: Float64
    """(n, 2) target position (col, row) that the original georeferencing predicts, px."""
    residual_px: Float64
    """(n, 2) observed minus corrected position (col, row), px."""
    consistent: Bool
    """(n,) False for matches that disagree with their neighbours."""
    sigma_px: Float64 | None = None
    """(n, 2) standard deviation of the matching noise in each, px, where it is known."""


def expected_ce90(
    selection: Selection,
    residuals: Residuals,
    places_px: Float64,
    footprint_px: float,
    averaged_px: float = 0.0,
    parameters: ExpectedErrorParameters = EXPECTED_ERROR,
) -> float:
    """Return the radial error within which 90 % of the places are expected to lie, px.

    The error at a place is taken to be normally distributed. Its mean is estimated from the matches around,
    see `_mean_error`. Its covariance is that of the correction; beyond the tie points it grows by the
    semivariogram of the displacements. The (m, 2) `places_px` are predicted target positions (col, row), px,
    spread evenly over the ground; there is at least one of them, and one match. The matching window is
    `footprint_px` wide, and averages out `averaged_px` (RMS of the length) that the correction leaves.
    """
    local = local_residuals(residuals, places_px, footprint_px, parameters)
    covered = local.all_agree & (local.distance_px <= selection.fit.support.reach_px)
    covered &= local.spread_px <= parameters.max_rejected_spread_px
    extrapolated = selection.extrapolated(places_px) & ~covered
    inside, outside_px = ~extrapolated, places_px[extrapolated]
    mean_px = np.empty_like(places_px)
    mean_px[inside] = _mean_error(
        residuals, local.median_px[inside], places_px[inside], footprint_px, parameters
    )
    mean_px[extrapolated] = _extrapolated_mean_error(
        selection, residuals, outside_px, footprint_px, parameters
    )
    # The misfit of the model is part of the mean and must not enter the covariance.
    common_px2 = np.maximum(selection.common_px2, parameters.least_common_px**2) + averaged_px**2 / 2
    covariance = selection.fit.covariance(places_px) + np.diag(common_px2)
    growth = _extrapolation_variance(selection, residuals, outside_px, parameters)
    covariance[extrapolated] += growth[:, None, None] * np.eye(2)
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    draws = _normal_draws(parameters.draws).T
    col, row = (mean_px[:, axis, None] + root[:, axis] @ draws for axis in (0, 1))
    return float(np.percentile(np.sqrt(col**2 + row**2), 90))


def _mean_error(
    residuals: Residuals,
    median_px: Float64,
    places_px: Float64,
    footprint_px: float,
    parameters: ExpectedErrorParameters,
) -> Float64:
    """Return the (m, 2) mean error of the correction at places with matches around, px.

    Where sigmas explain the residuals, it is the (m, 2) median residual of the nearest independent points,
    with the noise removed. Otherwise displacements vary over short distances, and a match that its neighbours
    contradict may be right: it is the residual of the nearest point, rejected or not.
    """
    consistent, sigma_px = np.flatnonzero(residuals.consistent), residuals.sigma_px
    if len(places_px) == 0 or len(consistent) == 0 or sigma_px is None:
        return median_px
    sigma_of_consistent = np.maximum(sigma_px[consistent], 1e-9)
    normalised = np.linalg.norm(residuals.residual_px[consistent] / sigma_of_consistent, axis=1)
    if not np.percentile(normalised, 90) <= parameters.unsurprising * SIGMA_90:
        side_px = footprint_px / parameters.cells_per_window
        place, value = _independent_points(residuals.predicted_px, residuals.residual_px, side_px)
        return np.asarray(value[cKDTree(place).query(places_px)[1]])
    nearest = consistent[cKDTree(residuals.predicted_px[consistent]).query(places_px)[1]]
    return without_noise(median_px, sigma_px[nearest])


@dataclass(frozen=True, slots=True, eq=False)
class LocalResiduals:
    """The residuals of the matches around m places."""

    median_px: Float64
    """(m, 2) median residual of the nearest independent points (col, row), px."""
    all_agree: Bool
    """(m,) whether all matches agree on it; otherwise it is that of the consistent ones."""
    spread_px: Float64
    """(m,) median distance of the nearest independent points, of all matches, from their median, px."""
    distance_px: Float64
    """(m,) distance of the place from the nearest independent point, of all matches, px."""


def local_residuals(
    residuals: Residuals,
    places_px: Float64,
    footprint_px: float,
    parameters: ExpectedErrorParameters = EXPECTED_ERROR,
) -> LocalResiduals:
    """Return the residuals of the matches around places.

    The (m, 2) `places_px` are predicted target positions (col, row), px. There is at least one match; the
    matching window is `footprint_px` wide.
    """
    median, spread, distance = _around(
        residuals.predicted_px, residuals.residual_px, places_px, footprint_px, parameters
    )
    consistent = residuals.consistent
    if not consistent.any():
        return LocalResiduals(median, np.ones(len(places_px), bool), spread, distance)
    xy_px, residual_px = residuals.predicted_px[consistent], residuals.residual_px[consistent]
    of_consistent, _, _ = _around(xy_px, residual_px, places_px, footprint_px, parameters)
    agree = spread <= parameters.max_relative_spread * np.linalg.norm(median, axis=1)
    return LocalResiduals(np.where(agree[:, None], median, of_consistent), agree, spread, distance)


def _around(
    xy_px: Float64,
    value_px: Float64,
    places_px: Float64,
    footprint_px: float,
    parameters: ExpectedErrorParameters,
) -> tuple[Float64, Float64, Float64]:
    """Return the median of the independent points nearest to each place, their spread and least distance."""
    place, value = _independent_points(xy_px, value_px, footprint_px / parameters.cells_per_window)
    count = min(parameters.neighbours, len(place))
    distance, index = cKDTree(place).query(places_px, k=[*range(1, count + 1)])
    around = value[index]
    median = np.median(around, axis=1)
    spread = np.median(np.linalg.norm(around - median[:, None], axis=2), axis=1)
    return median, spread, distance[:, 0]


def _independent_points(xy_px: Float64, value_px: Float64, side_px: float) -> tuple[Float64, Float64]:
    """Return the mean position and the median value of the points of each cell of the given side."""
    if side_px <= 0:
        return xy_px, value_px
    cell = np.unique(np.floor(xy_px / side_px).astype(np.intp), axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(cell)
    begin = np.cumsum(count) - count
    place = np.column_stack([np.bincount(cell, axis) / count for axis in xy_px.T])
    ordered = np.column_stack([axis[np.lexsort((axis, cell))] for axis in value_px.T])
    return place, (ordered[begin + (count - 1) // 2] + ordered[begin + count // 2]) / 2


def _extrapolated_mean_error(
    selection: Selection,
    residuals: Residuals,
    places_px: Float64,
    footprint_px: float,
    parameters: ExpectedErrorParameters,
) -> Float64:
    """Return the (k, 2) mean error of the correction at places beyond the tie points, px.

    The displacement there is predicted by the affine trend of the consistent matches plus the deviation of
    the nearest of them from it. A shift ignores the trend, and a curved correction continues its curvature,
    for which there is no evidence. Rejected matches do not count: most lie on ground without structure.
    """
    consistent, correction = residuals.consistent, selection.fit.correction
    if len(places_px) == 0 or consistent.sum() < 3:
        return np.zeros_like(places_px)
    xy = residuals.predicted_px[consistent]
    observed = correction.forward(xy) + residuals.residual_px[consistent]
    trend = AffineTransform.fit(xy, observed)
    sigma_px = None if residuals.sigma_px is None else residuals.sigma_px[consistent]
    about_trend = Residuals(xy, observed - trend(xy), np.ones(len(xy), bool), sigma_px)
    nearest, _, _ = _around(xy, about_trend.residual_px, places_px, footprint_px, parameters)
    mean = _mean_error(about_trend, nearest, places_px, footprint_px, parameters)
    return mean + trend(places_px) - correction.forward(places_px)


def _extrapolation_variance(
    selection: Selection, residuals: Residuals, places_px: Float64, parameters: ExpectedErrorParameters
) -> Float64:
    """Return (k,) variance per axis to add at places beyond the tie points, px².

    It is the semivariogram of the displacements (half the mean squared difference of two of them) at the
    distance from the place to the nearest point, minus that of neighbours (the nugget, which is noise). For
    an affine correction, which continues the trend, it is that of the residuals; for a curved one, that of
    the displacements minus their affine trend.
    """
    xy = residuals.predicted_px[residuals.consistent]
    residual = residuals.residual_px[residuals.consistent]
    lags = parameters.lags
    if len(places_px) == 0 or len(xy) < 3:
        return np.zeros(len(places_px))
    if not isinstance(selection.fit.correction, AffineCorrection):
        observed = residual + selection.fit.correction.forward(xy)
        residual = observed - AffineTransform.fit(xy, observed)(xy)
    sample = np.linspace(0, len(xy) - 1, min(len(xy), parameters.variogram_points)).astype(np.intp)
    separation = np.linalg.norm(xy[sample, None] - xy[None, sample], axis=2)
    # Half the squared difference, averaged over the two axes.
    halved = ((residual[sample, None] - residual[None, sample]) ** 2).sum(axis=2) / 4
    reach = max(float(np.ptp(xy, axis=0).max()) / 2, 1e-9)
    bins = np.minimum(np.ceil(separation / reach * lags), lags + 1).astype(np.intp).ravel()
    counts = np.bincount(bins, minlength=lags + 2)[1 : lags + 1]
    sums = np.bincount(bins, halved.ravel(), minlength=lags + 2)[1 : lags + 1]
    semivariogram = np.divide(sums, counts, out=np.zeros(lags), where=counts > 0)
    semivariogram = np.maximum.accumulate(np.maximum(semivariogram - semivariogram[0], 0.0))
    distance, _ = cKDTree(xy).query(places_px)
    separations = np.arange(lags + 1) * reach / lags
    variance = np.interp(distance, separations, np.concatenate([[0.0], semivariogram]))
    return np.asarray(variance * np.maximum(distance / reach, 1.0) ** 2)


def _normal_draws(count: int) -> Float64:
    """Return (`count`, 2) quasi-random draws from the bivariate unit normal distribution."""
    length = np.sqrt(-2 * np.log1p(-(np.arange(count) + 0.5) / count))
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)  # golden angles: even at any length
    return np.column_stack([length * np.cos(angle), length * np.sin(angle)])
