"""The functions of place by which images of a stack are displaced: polynomials, splines, homographies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

import numpy as np

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.polynomials import PolynomialBasis
from pcwlad_geo.correction.splines import SplineGrid
from pcwlad_geo.correction.thin_plate import bending
from pcwlad_geo.multi.stack.parameters import SPLINES, SplineParameters
from pcwlad_geo.types import Float64

SPLINE: Final = "tps"
"""The model whose displacement is a smooth spline."""
IMAGE_MODELS: Final = (*(name for name, model in MODELS.items() if model.order is not None), SPLINE)
"""Models of an image, the simpler first."""


def lossless(basis: Basis) -> bool:
    """Return whether images of a model keep their pixels, with a corrected geotransform."""
    return isinstance(basis, PolynomialBasis) and basis.order <= 1


class Basis(Protocol):
    """Functions of place."""

    @property
    def low_px(self) -> tuple[float, float]:
        """Corner (x, y) of the ground, map units."""

    @property
    def centre_px(self) -> tuple[float, float]:
        """Its middle."""

    def values(self, at_px: Float64) -> Float64:
        """Return the (n, terms) values of the functions at the (n, 2) positions `at_px` (x, y)."""


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """Bicubic B-splines on a coarse grid; planes cost nothing, bending does."""

    grid: SplineGrid
    centre_px: tuple[float, float]
    low_px: tuple[float, float]
    roughness: float
    """Standard deviation, map units, of what the bending of a cell is expected to be."""

    def values(self, at_px: Float64) -> Float64:
        """Return the (n, terms) values of the B-splines, row by row of the grid, at the (n, 2) `at_px`."""
        return np.asarray(self.grid.design(np.asarray(at_px, dtype=np.float64)).toarray())

    @cached_property
    def penalty(self) -> Float64:
        """The (terms, terms) normal matrix of what is known beforehand: little bending."""
        return np.asarray(bending(self.grid).toarray()) / self.roughness**2


@dataclass(frozen=True, slots=True, eq=False)
class HomographyBasis(PolynomialBasis):
    """An infinitesimal homography: a polynomial of order 2, of eight unknowns for both axes together."""

    @property
    def mixing(self) -> Float64:
        """The (12, 8) coefficients, axis by axis, by the parameters of a homography.

        These are the displacement and slopes of each axis, then those of the horizon, which move (u, v) by
        u (u, v) and by v (u, v).
        """
        matrix = np.zeros((12, 8))
        for axis in range(2):
            for term in range(3):
                matrix[6 * axis + term, 3 * axis + term] = 1.0
        matrix[3, 6] = matrix[10, 6] = 1.0  # u² along x, uv along y
        matrix[4, 7] = matrix[11, 7] = 1.0  # uv along x, v² along y
        return matrix


def mixing_of(basis: Basis) -> Float64 | None:
    """Return the (2 * terms, p) coefficients of an image by p unknowns; None where they are the unknowns."""
    return basis.mixing if isinstance(basis, HomographyBasis) else None


def terms_of(basis: Basis) -> int:
    """Return the number of functions of a basis."""
    return int(basis.values(np.array([basis.centre_px])).shape[1])


def penalty_of(basis: Basis) -> Float64:
    """Return the (terms, terms) normal matrix of what is known of coefficients beforehand: of a spline."""
    terms = terms_of(basis)
    return basis.penalty if isinstance(basis, SplineBasis) else np.zeros((terms, terms))


def polynomial_over(
    places: Sequence[Float64], order: int, kind: type[PolynomialBasis] = PolynomialBasis
) -> PolynomialBasis:
    """Return the terms of a polynomial about the middle of the ground of (n, 2) `places` (x, y)."""
    low = np.min([place.min(axis=0) for place in places], axis=0)
    high = np.max([place.max(axis=0) for place in places], axis=0)
    centre, radius = (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)
    return kind(order, float_pair(centre), radius, float_pair(low), float_pair(high))


def basis_over(
    places: Sequence[Float64],
    model: str,
    roughness: float | None = None,
    parameters: SplineParameters = SPLINES,
) -> Basis:
    """Return the functions of a model, one of `IMAGE_MODELS`, over the ground of tie points.

    The `places` of these are (n, 2) positions (x, y), map units; for the `roughness` see `SplineBasis`, by
    default it is the middle one of those that are tried.
    """
    polynomial = polynomial_over(places, MODELS[model].order or 0)
    if model != SPLINE:
        return polynomial
    spacing = 2 * polynomial.radius_px / parameters.cells
    size = np.subtract(polynomial.high_px, polynomial.low_px)
    across, down = (max(1, int(np.ceil(side / spacing - 1e-9))) for side in size)
    grid = SplineGrid(polynomial.low_px, spacing, (across, down))
    return SplineBasis(grid, polynomial.centre_px, polynomial.low_px, roughness or parameters.roughness[1])
