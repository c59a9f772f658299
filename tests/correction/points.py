"""Tie points with known truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.models import AffineCorrection

Array = NDArray[np.float64]


def scattered(seed: int, n: int, side_px: float = 512) -> Array:
    """Return (n, 2) points in a square image."""
    return np.random.default_rng([1, seed]).uniform(0, side_px, (n, 2))


def noise(seed: int, n: int, sigma_px: float) -> Array:
    """Return (n, 2) independent errors."""
    return np.random.default_rng([2, seed]).normal(0, sigma_px, (n, 2))


def isotropic(n: int, sigma_px: float) -> Array:
    """Return (n, 2, 2) equal covariances."""
    return np.tile(np.eye(2) * sigma_px**2, (n, 1, 1))


def window_noise(seed: int, xy_px: Array, side_px: int, window_px: int) -> Array:
    """Return (n, 2) errors of unit variance that windows share: means of white noise over the window."""
    size = side_px + window_px
    white = np.random.default_rng([3, seed]).normal(size=(2, size + 1, size + 1))
    white[:, 0, :] = white[:, :, 0] = 0
    total = white.cumsum(axis=1).cumsum(axis=2)
    col, row = xy_px.astype(int).T
    sums = (
        total[:, row + window_px, col + window_px]
        - total[:, row, col + window_px]
        - total[:, row + window_px, col]
        + total[:, row, col]
    )
    return sums.T / window_px


def affine(stretch_px: float, side_px: float = 512) -> AffineCorrection:
    """Return an affine that gains so many px in col from one side of the image to the other."""
    gain = stretch_px / side_px
    return AffineCorrection("affine", np.array([[1 + gain, 0, 0.4 - gain * side_px / 2], [0, 1, -1.2]]))
