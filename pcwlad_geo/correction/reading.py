"""Corrections read back from the model of a report.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from pcwlad_geo.correction.models import AffineCorrection, Composition, Correction, ProjectiveCorrection
from pcwlad_geo.correction.polynomials import PolynomialBasis, PolynomialCorrection
from pcwlad_geo.correction.splines import SplineCorrection, SplineGrid
from pcwlad_geo.correction.waves import JitterCorrection, JitterWave
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.transforms import AffineTransform, ProjectiveTransform, finite_array


@dataclass(frozen=True, slots=True)
class ReadingLimits:
    """What a model may have at most, so that no file makes a run need unlimited memory or time."""

    order: int = 3
    """Order of a polynomial."""
    waves: int = 100
    """Number of waves of a jitter correction."""
    steps: int = 20
    """Number of steps of a composition."""


READING_LIMITS: Final = ReadingLimits()
"""Those in use."""


def from_dict(model: Mapping[str, Any]) -> Correction:
    """Make a correction from the `model` of a report.json.

    Raises `InputError` if the mapping does not describe a correction model. The `model` has `name` and
    `forward`, as `Correction.to_dict` returns it; other entries are ignored.
    """
    try:
        name, forward = str(model["name"]), model["forward"]
        return _READERS[forward["type"]](name, forward)
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InputError(
            f"this is no correction model ({type(error).__name__}: {error}): give the entry 'model' of the "
            "report.json of a finished registration"
        ) from error


def _affine(name: str, forward: Mapping[str, Any]) -> AffineCorrection:
    return AffineCorrection(name, AffineTransform.from_numbers(forward["matrix"]).rows)


def _projective(name: str, forward: Mapping[str, Any]) -> Correction:
    return ProjectiveCorrection(name, ProjectiveTransform.from_numbers(forward["matrix"]).matrix)


def _polynomial(name: str, forward: Mapping[str, Any]) -> Correction:
    (low, high), centre = finite_array(forward["box"], (2, 2)), finite_array(forward["centre"], (2,))
    order = int(forward["order"])
    if (
        not 1 <= order <= READING_LIMITS.order
    ):  # before its terms are counted, which could be more than fit into memory
        raise ValueError(f"expected an order from 1 to {READING_LIMITS.order}, found {order}")
    basis = PolynomialBasis(
        order=order,
        centre_px=(float(centre[0]), float(centre[1])),
        radius_px=_length(forward["radius"]),
        low_px=(float(low[0]), float(low[1])),
        high_px=(float(high[0]), float(high[1])),
    )
    return PolynomialCorrection(name, basis, finite_array(forward["coefficients"], (len(basis.exponents), 2)))


def _spline(name: str, forward: Mapping[str, Any]) -> Correction:
    origin, (cols, rows) = finite_array(forward["origin"], (2,)), forward["cells"]
    if not min(int(cols), int(rows)) >= 1:
        raise ValueError(f"expected at least one cell along each axis, found {cols} x {rows}")
    spacing = _length(forward["spacing"])
    grid = SplineGrid((float(origin[0]), float(origin[1])), spacing, (int(cols), int(rows)))
    return SplineCorrection(name, grid, finite_array(forward["coefficients"], (*grid.shape, 2)))


def _jitter(name: str, forward: Mapping[str, Any]) -> Correction:
    affine, waves = _affine("affine", forward), []
    for wave in forward["waves"]:
        along, origin = wave["along"], float(wave["origin"])
        if (
            along not in ("column", "row")
            or not np.isfinite(origin)
            or len(forward["waves"]) > READING_LIMITS.waves
        ):
            raise ValueError("expected few waves along columns or rows, with a finite origin")
        coefficients = finite_array(wave["coefficients"], (2, 2))
        waves.append(JitterWave(along, _length(wave["period"]), origin, coefficients))
    return JitterCorrection(name, affine, tuple(waves))


def _composition(name: str, forward: Mapping[str, Any]) -> Correction:
    steps = forward["steps"]
    if not 1 <= len(steps) <= READING_LIMITS.steps or any(
        step["forward"]["type"] == "composition" for step in steps
    ):
        raise ValueError(f"expected 1 to {READING_LIMITS.steps} steps, none of them a composition")
    return Composition(name, tuple((from_dict(step), bool(step["inverted"])) for step in steps))


def _length(value: float | str) -> float:
    length = float(value)
    if not 0.0 < length < float("inf"):
        raise ValueError(f"expected a length above zero, found {length}")
    return length


_READERS = {
    "affine": _affine,
    "projective": _projective,
    "polynomial": _polynomial,
    "bicubic_spline": _spline,
    "jitter": _jitter,
    "composition": _composition,
}
