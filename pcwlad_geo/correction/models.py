"""Corrections: from predicted to observed target pixels, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.polynomial import PolynomialBasis, PolynomialCorrection
from pcwlad_geo.correction.spline import SplineCorrection, SplineGrid
from pcwlad_geo.errors import InputError

__all__ = [
    "AffineCorrection",
    "Correction",
    "PolynomialCorrection",
    "ProjectiveCorrection",
    "SplineCorrection",
    "from_json",
]

Array = NDArray[np.float64]


class Correction(Protocol):
    """Maps the target pixel that the original georeferencing predicts to the one observed.

    Pixel coordinates are (col, row), corner-based, of the original target file.
    """

    @property
    def name(self) -> str:
        """The model's name, such as shift or affine."""

    def forward(self, predicted_px: Array) -> Array:
        """Map (n, 2) predicted to observed target pixels; NaN where the model has none."""

    def inverse(self, observed_px: Array) -> Array:
        """Map (n, 2) observed to predicted target pixels; NaN where the model has none."""

    def to_dict(self) -> dict[str, object]:
        """Return what report.json holds: enough, alone, to warp (see `from_json`)."""


@dataclass(frozen=True, slots=True, eq=False)
class AffineCorrection:
    """observed = matrix · (predicted col, predicted row, 1); a shift is the affine with identity."""

    name: str
    """shift, drift or affine."""
    matrix: Array
    """(2, 3)."""

    def forward(self, predicted_px: Array) -> Array:
        """Map (n, 2) predicted to observed target pixels."""
        return np.asarray(predicted_px, dtype=np.float64) @ self.matrix[:, :2].T + self.matrix[:, 2]

    def inverse(self, observed_px: Array) -> Array:
        """Map (n, 2) observed to predicted target pixels."""
        moved = np.asarray(observed_px, dtype=np.float64) - self.matrix[:, 2]
        return moved @ np.linalg.inv(self.matrix[:, :2]).T

    def to_dict(self) -> dict[str, object]:
        """Return what report.json holds: enough, alone, to warp."""
        return {"name": self.name, "forward": {"type": "affine", "matrix": self.matrix.tolist()}}


@dataclass(frozen=True, slots=True, eq=False)
class ProjectiveCorrection:
    """(w·observed col, w·observed row, w) = matrix · (predicted col, predicted row, 1)."""

    name: str
    """projective."""
    matrix: Array
    """(3, 3), of positive w where the tie points are."""

    def forward(self, predicted_px: Array) -> Array:
        """Map (n, 2) predicted to observed target pixels; NaN on the far side of the horizon."""
        return _homogeneous(self.matrix, predicted_px)

    def inverse(self, observed_px: Array) -> Array:
        """Map (n, 2) observed to predicted target pixels; NaN beyond the horizon."""
        return _homogeneous(np.asarray(np.linalg.inv(self.matrix), dtype=np.float64), observed_px)

    def to_dict(self) -> dict[str, object]:
        """Return what report.json holds: enough, alone, to warp."""
        return {"name": self.name, "forward": {"type": "projective", "matrix": self.matrix.tolist()}}


def _homogeneous(matrix: Array, at_px: Array) -> Array:
    moved = np.asarray(at_px, dtype=np.float64) @ matrix[:, :2].T + matrix[:, 2]
    w = np.where(moved[:, 2:] > 0, moved[:, 2:], np.nan)
    return np.asarray(moved[:, :2] / w)


def from_json(model: Mapping[str, Any]) -> Correction:
    """Make a correction from the `model` of a report.json.

    Parameters
    ----------
    model : mapping
        With `name` and `forward`, as `Correction.to_dict` returns it; other entries are passed over.

    Raises
    ------
    InputError
        If it is no such model.
    """
    try:
        name, forward = str(model["name"]), model["forward"]
        kind = forward["type"]
        made = _READERS[kind](name, forward)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            f"this is no correction model ({type(error).__name__}: {error}): give the entry 'model' of the "
            "report.json of a finished registration"
        ) from error
    return made


def _affine(name: str, forward: Mapping[str, Any]) -> Correction:
    return AffineCorrection(name, _numbers(forward["matrix"], (2, 3)))


def _projective(name: str, forward: Mapping[str, Any]) -> Correction:
    return ProjectiveCorrection(name, _numbers(forward["matrix"], (3, 3)))


def _polynomial(name: str, forward: Mapping[str, Any]) -> Correction:
    (low, high), centre = _numbers(forward["box"], (2, 2)), _numbers(forward["centre"], (2,))
    basis = PolynomialBasis(
        order=int(forward["order"]),
        centre_px=(float(centre[0]), float(centre[1])),
        radius_px=float(forward["radius"]),
        low_px=(float(low[0]), float(low[1])),
        high_px=(float(high[0]), float(high[1])),
    )
    return PolynomialCorrection(basis, _numbers(forward["coefficients"], (len(basis.exponents), 2)))


def _spline(name: str, forward: Mapping[str, Any]) -> Correction:
    origin, (cols, rows) = _numbers(forward["origin"], (2,)), forward["cells"]
    grid = SplineGrid((float(origin[0]), float(origin[1])), float(forward["spacing"]), (int(cols), int(rows)))
    return SplineCorrection(name, grid, _numbers(forward["coefficients"], (*grid.shape, 2)))


def _numbers(values: object, shape: tuple[int, ...]) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers of shape {shape}, found shape {array.shape}")
    return array


_READERS = {
    "affine": _affine,
    "projective": _projective,
    "polynomial": _polynomial,
    "bicubic_spline": _spline,
}
