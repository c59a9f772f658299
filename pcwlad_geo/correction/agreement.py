"""Agreement of tie points with their neighbours, which shows gross errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.estimation.robust import axis_sigma, irls, sigma_of, weighted
from pcwlad_geo.estimation.solving import check_observations
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class AgreementParameters:
    """How tie points, the user's or read from a file, are compared with their neighbours."""

    neighbours: int = 8
    """Number of nearest neighbours that a tie point is compared with."""
    min_points: int = 6
    """Least number of points among which outliers can be found."""
    scatters: float = 6.11
    """The limit is this many times the robust scatter, per axis, of all points about their neighbours."""
    sigmas: float = 4.0
    """The limit is at least this many times the sigma of the point, where it has one."""
    least_px: float = 1e-3
    """Least limit, and least sigma."""
    rounds: int = 4
    """Largest number of times that points are compared with consistent neighbours alone."""


AGREEMENT: Final = AgreementParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """How well tie points agree with one another."""

    consistent: Bool
    """(n,) False for points that disagree with their neighbours."""
    linear: Float64
    """(2, 2) linear part of the affine trend from predicted to observed."""
    sigma_px: float
    """Standard deviation per axis of a consistent point about its neighbours, px; NaN of few points."""
    unexplained: float
    """Median distance of all points from the affine trend, as a share of their spread."""


def agreement(
    predicted_px: Float64,
    observed_px: Float64,
    sigma_px: Float64 | None = None,
    parameters: AgreementParameters = AGREEMENT,
) -> Agreement:
    """Compare every tie point with its neighbours, after the affine trend of all is subtracted.

    The trend may be large (points of a scanned map rotate and scale); what remains is smooth, so that the
    median of the nearest neighbours predicts it. The limit follows the scatter of the points themselves. The
    (n, 2) arrays `predicted_px` and `observed_px` are target positions (col, row), px, by the original
    georeferencing and as found. The (n,) `sigma_px` is the radial standard deviation of the latter, NaN where
    unknown.
    """
    check_observations("tie points", predicted_px, observed_px)
    n, least_px = len(predicted_px), parameters.least_px
    consistent = np.ones(n, bool)
    if n < parameters.min_points:
        return Agreement(consistent, np.eye(2), float("nan"), 0.0)
    residual_px, linear = _about_the_trend(predicted_px, observed_px, least_px)
    spread_px = float(np.sqrt(observed_px.var(axis=0).sum()))
    unexplained = float(np.median(np.linalg.norm(residual_px, axis=1))) / max(spread_px, least_px)
    limit_px = np.zeros(n) if sigma_px is None else parameters.sigmas * np.nan_to_num(sigma_px)
    for _ in range(parameters.rounds):
        difference_px = _from_neighbours(predicted_px, residual_px, consistent, parameters.neighbours)
        size_px = np.linalg.norm(difference_px, axis=1)
        scatter_px = axis_sigma(size_px[consistent])
        within = size_px <= np.maximum(np.maximum(parameters.scatters * scatter_px, limit_px), least_px)
        if (within == consistent).all() or within.sum() < parameters.min_points:
            break
        consistent = within
    # The median of k neighbours has a variance of its own, π/2k of a point's.
    per_axis_px = sigma_of(difference_px[consistent])
    neighbours = min(parameters.neighbours, int(consistent.sum()) - 1)
    sigma = per_axis_px / np.sqrt(1 + np.pi / (2 * neighbours))
    return Agreement(consistent, linear, max(float(sigma), least_px), unexplained)


def _about_the_trend(predicted_px: Float64, observed_px: Float64, least_px: float) -> tuple[Float64, Float64]:
    """Return (n, 2) residuals of the affine trend of least absolute deviations, and its linear part."""
    centre_px = np.median(predicted_px, axis=0)
    scale_px = max(float(np.abs(predicted_px - centre_px).mean()), least_px)
    basis = np.column_stack([np.ones(len(predicted_px)), (predicted_px - centre_px) / scale_px])
    coefficients, residual_px, _ = irls(
        weighted(basis, observed_px),
        lambda residual_px: 1 / np.maximum(np.linalg.norm(residual_px, axis=1), least_px),
        np.ones(len(basis)),
        rounds=50,
    )
    return residual_px, coefficients[1:].T / scale_px


def _from_neighbours(xy_px: Float64, residual_px: Float64, consistent: Bool, count: int) -> Float64:
    """Return (n, 2) residuals less the median of those of the nearest `count` consistent neighbours."""
    index = np.flatnonzero(consistent)
    k = min(count, len(index) - 1)
    _, nearest = cKDTree(xy_px[index]).query(xy_px, k=k + 1)
    neighbours = index[nearest]
    # A consistent point is its own nearest; one at the same place as another may come second.
    itself = neighbours == np.arange(len(xy_px))[:, None]
    itself[~itself.any(axis=1), -1] = True
    neighbours = neighbours[~itself].reshape(len(xy_px), k)
    return np.asarray(residual_px - np.median(residual_px[neighbours], axis=1))
