"""Gross errors among tie points of any origin: points that their neighbours contradict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

NEIGHBOURS: Final = 8
LEAST_POINTS: Final = 6
"""Fewer cannot tell which of them is wrong."""
SCATTERS: Final = 6.11
"""Times the robust scatter, per axis, of all points about their neighbours."""
SIGMAS: Final = 4.0
"""Times a point's own sigma, where it has one."""
ROUNDS: Final = 4
LEAST_PX: Final = 1e-3
_STEPS: Final = 50
_SIGMA_OF_MEDIAN_SIZE: Final = 1.4826
"""Standard deviation of normal errors by the median of their absolute values,"""
_SIGMA_OF_MEDIAN_LENGTH: Final = 0.8493
"""and, per axis, by the median of their lengths, which are Rayleigh-distributed."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """How well tie points agree with one another."""

    kept: Bool
    """(n,) False where the neighbours contradict."""
    linear: Array
    """(2, 2) linear part of the affine trend from predicted to observed."""
    sigma_px: float
    """Standard deviation per axis of a kept point about its neighbours, px; NaN of fewer than six points."""
    unexplained: float
    """Median distance of all points from the affine trend, as a share of their spread."""


def agreement(predicted_px: Array, observed_px: Array, sigma_px: Array | None = None) -> Agreement:
    """Compare every tie point with its neighbours, once the affine trend of all is taken off.

    The trend may be anything (points of a scanned map turn and scale); what remains is smooth, so that the
    median of the nearest neighbours predicts it. The limit follows the scatter of the points themselves.

    Parameters
    ----------
    predicted_px, observed_px : (n, 2) array of float
        Target positions (col, row), px.
    sigma_px : (n,) array of float, optional
        Radial standard deviation of the observed positions, px; NaN where unknown.
    """
    n = len(predicted_px)
    if n < LEAST_POINTS:
        return Agreement(np.ones(n, bool), np.eye(2), float("nan"), 0.0)
    residual_px, linear = _about_the_trend(predicted_px, observed_px)
    spread_px = float(np.sqrt(observed_px.var(axis=0).sum()))
    unexplained = float(np.median(np.linalg.norm(residual_px, axis=1))) / max(spread_px, LEAST_PX)
    own = np.zeros(n) if sigma_px is None else np.nan_to_num(sigma_px)
    kept = np.ones(n, bool)
    for _ in range(ROUNDS):
        apart_px = _apart(predicted_px, residual_px, kept)
        size_px = np.linalg.norm(apart_px, axis=1)
        scatter_px = _SIGMA_OF_MEDIAN_LENGTH * float(np.median(size_px[kept]))
        again = size_px <= np.maximum(np.maximum(SCATTERS * scatter_px, SIGMAS * own), LEAST_PX)
        if (again == kept).all() or again.sum() < LEAST_POINTS:
            break
        kept = again
    # The median of k neighbours has a variance of its own, π/2k of a point's.
    per_axis_px = _SIGMA_OF_MEDIAN_SIZE * float(np.median(np.abs(apart_px[kept])))
    neighbours = min(NEIGHBOURS, int(kept.sum()) - 1)
    sigma = per_axis_px / np.sqrt(1 + np.pi / (2 * neighbours))
    return Agreement(kept, linear, max(float(sigma), LEAST_PX), unexplained)


def _about_the_trend(predicted_px: Array, observed_px: Array) -> tuple[Array, Array]:
    """Return (n, 2) residuals of the affine trend of least absolute deviations, and its linear part."""
    centre_px = np.median(predicted_px, axis=0)
    scale_px = max(float(np.abs(predicted_px - centre_px).mean()), LEAST_PX)
    basis = np.column_stack([np.ones(len(predicted_px)), (predicted_px - centre_px) / scale_px])
    weight = np.ones(len(basis))
    for _ in range(_STEPS):
        root = np.sqrt(weight)[:, None]
        found = np.linalg.lstsq(basis * root, observed_px * root, rcond=None)[0]
        distance_px = np.linalg.norm(observed_px - basis @ found, axis=1)
        weight = 1 / np.maximum(distance_px, LEAST_PX)
    return observed_px - basis @ found, found[1:].T / scale_px


def _apart(xy_px: Array, residual_px: Array, kept: Bool) -> Array:
    """Return (n, 2) residuals less the median of those of the nearest kept neighbours."""
    index = np.flatnonzero(kept)
    k = min(NEIGHBOURS, len(index) - 1)
    _, near = cKDTree(xy_px[index]).query(xy_px, k=k + 1)
    neighbours = index[near]
    # A kept point is its own nearest; one at the same place as another may come second.
    itself = neighbours == np.arange(len(xy_px))[:, None]
    itself[~itself.any(axis=1), -1] = True
    others = neighbours[~itself].reshape(len(xy_px), k)
    return np.asarray(residual_px - np.median(residual_px[others], axis=1))
