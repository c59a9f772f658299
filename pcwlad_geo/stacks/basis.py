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


def terms_of(basis: Basis) -> int:
    """Return the number of functions of a basis."""
    return int(basis.values(np.array([basis.centre_px])).shape[1])


def penalty_of(basis: Basis) -> Float64:
    """Return the (terms, terms) normal matrix of what is known of coefficients beforehand: of a spline."""
    terms = terms_of(basis)
    return basis.penalty if isinstance(basis, SplineBasis) else np.zeros((terms, terms))


def basis_over(places: Sequence[Float64], model: str, roughness: float = ROUGHNESS[1]) -> Basis:
    """Return the functions of a model over the ground of (n, 2) places (x, y), map units.

    Parameters
    ----------
    places : sequence of (n, 2) array
        Positions of tie points.
    model : str
        One of `MODELS`.
    roughness : float
        Of a spline, see `SplineBasis`.
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
