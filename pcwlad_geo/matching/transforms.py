"""Transformations of the plane as matrices, of px (col, row)."""

from __future__ import annotations

import numpy as np

from pcwlad_geo.types import Float64


def similarity_between(from_xy: Float64, to_xy: Float64) -> Float64:
    """Return the (3, 3) similarity of least squares between the (n, 2) points `from_xy` and `to_xy`."""
    z, moved = from_xy @ (1, 1j), to_xy @ (1, 1j)
    spread = float((np.abs(z - z.mean()) ** 2).sum())
    factor = ((z - z.mean()).conj() * (moved - moved.mean())).sum() / spread if spread > 0 else 1.0 + 0j
    origin = moved.mean() - factor * z.mean()
    rows = [factor.real, -factor.imag, origin.real], [factor.imag, factor.real, origin.imag], [0, 0, 1]
    return np.array(rows, np.float64)


def mapped(matrix: Float64, xy: Float64) -> Float64:
    """Return the (n, 2) positions to which the (3, 3) affine `matrix` takes the (n, 2) `xy`."""
    return np.asarray(xy @ matrix[:2, :2].T + matrix[:2, 2], np.float64)
