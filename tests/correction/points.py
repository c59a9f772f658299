"""Tie points with known truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.fitted import Fit
from pcwlad_geo.correction.models import AffineCorrection, ProjectiveCorrection
from pcwlad_geo.correction.polynomials import PolynomialBasis, PolynomialCorrection
from pcwlad_geo.correction.splines import SplineCorrection, SplineGrid

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


def projective(side_px: float = 512) -> ProjectiveCorrection:
    """Return a projective that moves the corners of the image by about 2 px beyond an affine."""
    matrix = np.array([[1.002, 0.001, 0.4], [-0.003, 0.999, -1.2], [4e-3 / side_px, -3e-3 / side_px, 1.0]])
    return ProjectiveCorrection("projective", matrix)


def polynomial(order: int, seed: int = 0, side_px: float = 512, size_px: float = 2.0) -> PolynomialCorrection:
    """Return a polynomial over a square image whose terms are of this size at its sides."""
    centre = (side_px / 2, side_px / 2)
    basis = PolynomialBasis(order, centre, side_px / 2, (0.0, 0.0), (side_px, side_px))
    terms = len(basis.exponents)
    return PolynomialCorrection(
        f"polynomial{order}", basis, np.random.default_rng([4, seed]).uniform(-size_px, size_px, (terms, 2))
    )


def spline(seed: int = 0, side_px: float = 512, size_px: float = 2.0, cells: int = 5) -> SplineCorrection:
    """Return a spline over a square image with random coefficients of this size."""
    grid = SplineGrid((0.0, 0.0), side_px / cells, (cells, cells))
    coefficients = np.random.default_rng([5, seed]).uniform(-size_px, size_px, (*grid.shape, 2))
    return SplineCorrection("tps", grid, coefficients)


def waves(seed: int, at_px: Array, size_px: float, wavelength_px: float) -> Array:
    """Return (n, 2) displacements that wave: amplitude per axis, shortest wavelength."""
    random = np.random.default_rng([6, seed])
    turn, phase = random.uniform(0, 2 * np.pi, (2, 2))
    along = at_px @ np.stack([np.cos(turn), np.sin(turn)]) / (wavelength_px * np.array([1.0, 1.4]))
    return size_px * np.sin(2 * np.pi * along + phase)


def inside(side_px: float = 512, step: int = 25, margin: float = 0.04) -> Array:
    """Return (n, 2) places on a lattice within a square image, a margin off its sides."""
    line = np.linspace(margin, 1 - margin, step) * side_px
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def predicted_sigma(fit: Fit, at_px: Array) -> Array:
    """Return the (n, 2) standard deviation (col, row), px, of a correction at the (n, 2) places."""
    return np.sqrt(np.diagonal(fit.covariance(at_px), axis1=1, axis2=2))
