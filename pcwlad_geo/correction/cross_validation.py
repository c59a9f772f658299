"""How well a model predicts points that it is not fitted to, block by block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.fitted import Fit
from pcwlad_geo.correction.folds import Folds
from pcwlad_geo.correction.windows import Overlaps, random_signs

Array = NDArray[np.float64]

PROBES = 8


@dataclass(frozen=True, slots=True, eq=False)
class SharedNoise:
    """Errors that points in a fold share, through overlapping windows, with points outside it."""

    probes: Array
    """(n, 2, m) random signs."""
    shared: tuple[Array, ...]
    """For every fold (n, 2, m): the covariance of all points with the fold's, times the probes, px²."""

    @classmethod
    def of(cls, fit: Fit, xy_px: Array, footprint_px: float, folds: Folds) -> SharedNoise:
        """Return the noise that a fit, the most flexible there is, finds in (n, 2) points (col, row)."""
        probes = random_signs(xy_px, 2 * PROBES).reshape(len(xy_px), 2, PROBES)
        if footprint_px <= 0:
            return cls(probes, tuple(np.zeros_like(probes) for _ in folds.tests))
        precision = (fit.whitener**2).sum(axis=(1, 2)) / 2
        sigma = (
            np.sqrt(fit.errors.scale * fit.errors.alpha / precision)[:, None, None]
            * fit.inlier[:, None, None]
        )
        parts = np.stack([probes * sigma * test[:, None, None] for test in folds.tests], axis=1)
        shared = sigma[:, None] * Overlaps.of(xy_px, footprint_px).times(parts)
        return cls(probes, tuple(shared[:, fold] for fold in range(len(folds.tests))))


def left_out_errors(fit: Fit, folds: Folds, noise: SharedNoise) -> Array:
    """Return the (n,) squared errors of points predicted without their fold, px².

    A point's error and its prediction from points whose windows overlap its own have errors in common, which
    flatter the prediction: their covariance is added twice, as expected of the model and the noise.

    Raises
    ------
    InputError
        If the points outside some fold do not determine the model.
    """
    squared = np.empty(len(noise.probes))
    for test, shared in zip(folds.tests, noise.shared, strict=True):
        values = np.concatenate([fit.remainder_px[:, :, None], shared], axis=2)
        predicted = fit.predictions(~test, test, values)
        missed = fit.remainder_px[test] - predicted[:, :, 0]
        flattery = (noise.probes[test] * predicted[:, :, 1:]).sum(axis=(1, 2)) / PROBES
        squared[test] = (missed**2).sum(axis=1) + 2 * flattery
    return squared
