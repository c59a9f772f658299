"""Transformations of the plane as matrices, of px (col, row)."""

from __future__ import annotations

import math

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import SCALE
from pcwlad_geo.types import Float64


def affine_matrix(linear: Float64, origin: Float64) -> Float64:
    """Return the (3, 3) matrix of a (2, 2) `linear` part and the (2,) `origin`, to which it takes (0, 0)."""
    return np.vstack([np.column_stack([linear, origin]), [0.0, 0.0, 1.0]])


def square(matrix: Float64) -> Float64:
    """Return an affine transformation as a (3, 3) matrix; `matrix` is (2, 3) or (3, 3)."""
    return affine_matrix(matrix[:2, :2], matrix[:2, 2])


def shift(xy: Float64) -> Float64:
    """Return the (3, 3) matrix that adds (2,) `xy` to positions."""
    return affine_matrix(np.eye(2), xy)


def rotation(angle_rad: float) -> Float64:
    """Return the (2, 2) matrix that turns by an angle."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, -sin], [sin, cos]])


def scale_of(matrix: Float64) -> float:
    """Return by how much an affine `matrix`, (2, 3) or (3, 3), scales lengths in the mean."""
    return math.sqrt(abs(float(np.linalg.det(matrix[:2, :2]))))


def scale_at(homography: Float64, at_px: Float64) -> float:
    """Return by how much a (3, 3) `homography`, maybe affine, scales lengths at the (2,) place `at_px`."""
    depth = float(homography[2] @ [*at_px, 1.0])
    return math.sqrt(abs(float(np.linalg.det(homography / depth))))


def inverse_of_step(step: Float64) -> Float64:
    """Return the (3, 3) inverse of the transformation that adds a (2, 3) `step`, times position, to it."""
    (a, b, x), (c, d, y) = step.tolist()
    a, d = 1 + a, 1 + d
    size = a * d - b * c
    if size == 0:
        raise InputError(f"{SCALE} (a step of the search has none)")
    rows = (d, -b, b * y - d * x), (-c, a, c * x - a * y), (0.0, 0.0, size)
    return np.asarray(np.array(rows) / size, np.float64)


def similarity_between(from_xy: Float64, to_xy: Float64) -> Float64:
    """Return the (3, 3) similarity of least squares between the (n, 2) points `from_xy` and `to_xy`."""
    z, target = from_xy @ (1, 1j), to_xy @ (1, 1j)
    spread = float((np.abs(z - z.mean()) ** 2).sum())
    factor = ((z - z.mean()).conj() * (target - target.mean())).sum() / spread if spread > 0 else 1.0 + 0j
    origin = target.mean() - factor * z.mean()
    rows = [factor.real, -factor.imag, origin.real], [factor.imag, factor.real, origin.imag], [0, 0, 1]
    return np.array(rows, np.float64)


def mapped(matrix: Float64, xy: Float64) -> Float64:
    """Return the (n, 2) positions to which the (3, 3) affine `matrix` takes the (n, 2) `xy`."""
    return np.asarray(xy @ matrix[:2, :2].T + matrix[:2, 2], np.float64)
