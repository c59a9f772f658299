"""A first guess of a smooth field: robust surfaces through the neighbours of its points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.estimation.robust import irls
from pcwlad_geo.estimation.solving import solve
from pcwlad_geo.estimation.surfaces import surface_terms
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class SurfaceParameters:
    """How the surfaces are fitted."""

    neighbours: int = 40
    """Number of neighbours that a surface is fitted to."""
    rounds: int = 8
    """Number of times that they are weighted by their distance from it."""


SURFACE: Final = SurfaceParameters()
"""Those in use."""


def local_surface(xy_px: Float64, values_px: Float64, parameters: SurfaceParameters = SURFACE) -> Float64:
    """Return the (n, 2) values, px, of robust quadratic surfaces through the nearest neighbours of points.

    The points are at (n, 2) `xy_px` (col, row), px, and have (n, 2) `values_px`, such as displacements. Of
    fewer than 40 points the surface is a plane.
    """
    n = len(xy_px)
    _, index = cKDTree(xy_px).query(xy_px, k=np.arange(1, min(parameters.neighbours, n) + 1))
    offset = xy_px[index] - xy_px[:, None]
    offset /= np.maximum(np.abs(offset).max(axis=(1, 2)), 1e-9)[:, None, None]
    design = surface_terms(offset, 1 if n < parameters.neighbours else 2)
    around = values_px[index]

    def solve_all(divisor: Float64) -> tuple[Float64, Float64]:
        turned = (design / divisor[..., None]).transpose(0, 2, 1)
        normal = turned @ design
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(design.shape[2])
        coefficients = solve(normal, turned @ around)
        return coefficients[:, 0], around - design @ coefficients

    def divisors(scatter: Float64) -> Float64:
        """Return (n, k) inverse weights of the (n, k, 2) distances of the neighbours from a surface."""
        size = np.hypot(scatter[..., 0], scatter[..., 1])
        scale = np.maximum(np.median(size, axis=1, keepdims=True), 1e-6)  # 0 where the fit is exact
        return np.asarray(1 + (size / (2 * scale)) ** 2)

    start = divisors(around - np.median(around, axis=1, keepdims=True))
    return irls(solve_all, divisors, start, parameters.rounds)[0]
