"""The functions of place of which the displacement of an image is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

import numpy as np

from pcwlad_geo.correction.models import PolynomialBasis, SplineGrid
from pcwlad_geo.correction.thin_plate_system import bending
from pcwlad_geo.types import Float64

ORDERS: Final[Mapping[str, int]] = {"shift": 0, "affine": 1, "polynomial2": 2, "polynomial3": 3}
"""Order of the polynomial of each model that is one."""
SPLINE: Final = "tps"
"""The model whose displacement is a smooth spline."""
MODELS: Final = (*ORDERS, SPLINE)
"""Models of an image, the simpler first."""
SPLINE_CELLS: Final = 4
"""Cells of a spline along the longer side of the ground."""
ROUGHNESS: Final = (0.1, 1.0, 10.0)
"""Bendings of a spline that are tried, map units over the side of a cell: of the deviation of neighbouring
coefficients from a plane, standard deviation."""


class Basis(Protocol):
    """Functions of place."""

    @property
    def low_px(self) -> tuple[float, float]:
        """Corner (x, y) of the ground, map units."""

    @property
    def centre_px(self) -> tuple[float, float]:
        """Its middle."""

    @property
    def radius_px(self) -> float:
        """Half of its longer side."""

    def values(self, at_px: Float64) -> Float64:
        """Return the (n, terms) values of the functions at the (n, 2) positions `at_px` (x, y)."""


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """Bicubic B-splines on a coarse grid; planes cost nothing, bending does."""

    grid: SplineGrid
    centre_px: tuple[float, float]
    radius_px: float
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


@dataclass(frozen=True, eq=False)
class HomographyBasis:
    """An infinitesimal homography: a polynomial of order 2, of eight unknowns for both axes together."""

    polynomial: PolynomialBasis

    @property
    def low_px(self) -> tuple[float, float]:
        """Corner (x, y) of the ground, map units."""
        return self.polynomial.low_px

    @property
    def centre_px(self) -> tuple[float, float]:
        """Its middle."""
        return self.polynomial.centre_px

    @property
    def radius_px(self) -> float:
        """Half of its longer side."""
        return self.polynomial.radius_px

    def values(self, at_px: Float64) -> Float64:
        """Return the (n, 6) values of 1, u, v, u², uv, v² at the (n, 2) positions `at_px` (x, y)."""
        return self.polynomial.values(at_px)

    @property
    def mixing(self) -> Float64:
        """The (12, 8) coefficients, axis by axis, by the parameters of a homography.

        These are the displacement and slopes of each axis, then those of the horizon, which move (u, v) by
        u (u, v) and by v (u, v).
        """
        found = np.zeros((12, 8))
        for axis in range(2):
            for term in range(3):
                found[6 * axis + term, 3 * axis + term] = 1.0
        found[3, 6] = found[10, 6] = 1.0  # u² along x, uv along y
        found[4, 7] = found[11, 7] = 1.0  # uv along x, v² along y
        return found


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


def basis_over(places: Sequence[Float64], model: str, roughness: float = ROUGHNESS[1]) -> Basis:
    """Return the functions of a model, one of `MODELS`, over the ground of tie points.

    The `places` of these are (n, 2) positions (x, y), map units; for the `roughness` see `SplineBasis`.
    """
    low = np.min([place.min(axis=0) for place in places], axis=0)
    high = np.max([place.max(axis=0) for place in places], axis=0)
    centre, radius = (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)
    if model != SPLINE:
        return PolynomialBasis(ORDERS[model], _xy(centre), radius, _xy(low), _xy(high))
    spacing = 2 * radius / SPLINE_CELLS
    across, down = (max(1, int(np.ceil(side / spacing - 1e-9))) for side in high - low)
    return SplineBasis(
        SplineGrid(_xy(low), spacing, (across, down)), _xy(centre), radius, _xy(low), roughness
    )


def _xy(values: Float64) -> tuple[float, float]:
    return float(values[0]), float(values[1])
