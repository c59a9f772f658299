"""Correction models: affine, projective, polynomial and spline, with their inverses and their JSON."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike

from pcwlad_geo.correction.dense import Lattice, in_chunks, invert, positions
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse, least_squares
from pcwlad_geo.types import Float64, Index

MAX_ORDER: Final = 3
"""Largest order of a polynomial."""
MAX_WAVES: Final = 100
"""Largest number of waves of a jitter correction in a report.json."""
MAX_STEPS: Final = 20
"""Largest number of steps of a composition in a report.json."""
MAX_STRETCH: Final = 1e6
"""Largest factor by which an affine correction may stretch or shrink the image; real ones have about one."""


@dataclass(frozen=True, slots=True, eq=False)
class Correction(ABC):
    """Maps the target pixel that the original georeferencing predicts to the one observed.

    Pixel coordinates are (col, row), corner-based, of the original target file. ``later @ first`` is the
    correction that applies `first`, then `later`.
    """

    name: str
    """The model, a key of `fit.MODELS`; of a composition those of its steps."""

    @property
    def homogeneous(self) -> Float64 | None:
        """(3, 3) matrix of a mapping (w·col, w·row, w) = matrix · (col, row, 1); None for other mappings."""
        return None

    @abstractmethod
    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels; NaN where the model has none."""

    @abstractmethod
    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels; NaN where the model has none."""

    def at_nodes(self, nodes_px: Float64) -> Float64:
        """Map the (rows, cols, 2) `nodes_px` of a lattice to observed target pixels, of the same shape."""
        return self.forward(nodes_px.reshape(-1, 2)).reshape(nodes_px.shape)

    @abstractmethod
    def _parameters(self) -> dict[str, object]:
        """Return the type and the parameters of the mapping as report.json holds them."""

    def to_dict(self) -> dict[str, object]:
        """Return the model as report.json holds it, which alone is enough to warp (see `from_dict`)."""
        return {"name": self.name, "forward": self._parameters()}

    def invert(self) -> Correction:
        """Return the correction that maps observed to predicted pixels."""
        return Composition(self.name, ((self, True),))

    def __matmul__(self, first: Correction) -> Correction:
        if self.homogeneous is not None and first.homogeneous is not None:
            matrix = self.homogeneous @ first.homogeneous
            if isinstance(self, AffineCorrection) and isinstance(first, AffineCorrection):
                return AffineCorrection(self.name if self.name == first.name else "affine", matrix[:2])
            return ProjectiveCorrection("projective", matrix)
        steps = [each.steps if isinstance(each, Composition) else ((each, False),) for each in (first, self)]
        return Composition(f"{first.name}, {self.name}", (*steps[0], *steps[1]))

    def to_gdal(self) -> tuple[float, float, float, float, float, float]:
        """Return the geotransform, in GDAL's order, that places observed at predicted pixels.

        The corrected geotransform of a target is this one followed by its own. Raises `InputError` for a
        model that is no affine.
        """
        raise InputError(f"a geotransform holds no {self.name} model: use GCPs, or warp the raster")

    def to_skimage(self) -> Any:  # noqa: ANN401  # of scikit-image, which has no types
        """Return the correction as a transform of scikit-image, in its coordinates.

        scikit-image counts from the centre of the first pixel, this package from its corner: what `forward`
        maps from (0.5, 0.5) to (1.5, 0.5), the transform maps from (0, 0) to (1, 0). It takes and returns
        (n, 2) arrays of (col, row), and ``skimage.transform.warp(target, transform)`` is the corrected target
        on its own pixels.

        Returns
        -------
        skimage.transform.AffineTransform, ProjectiveTransform, or a callable like these
            Shift, drift and affine; projective; other models, exactly, with the attribute `inverse`.
        """
        from skimage.transform import AffineTransform, ProjectiveTransform  # slow to load

        to_corner = AffineCorrection("shift", np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5]]))
        centred = to_corner.invert() @ self @ to_corner
        if centred.homogeneous is None:
            return CallableTransform(centred)
        affine = isinstance(centred, AffineCorrection)
        return (AffineTransform if affine else ProjectiveTransform)(matrix=centred.homogeneous)


@dataclass(frozen=True, slots=True, eq=False)
class CallableTransform:
    """A correction as scikit-image calls a transform."""

    correction: Correction

    def __call__(self, coords: ArrayLike) -> Float64:
        """Map (n, 2) coordinates (col, row)."""
        return self.correction.forward(np.asarray(coords, dtype=np.float64))

    @property
    def inverse(self) -> CallableTransform:
        """The inverse transform."""
        return CallableTransform(self.correction.invert())


@dataclass(frozen=True, slots=True, eq=False)
class Composition(Correction):
    """Corrections one after another."""

    steps: tuple[tuple[Correction, bool], ...]
    """Pairs of a correction and whether it is inverted, in the order in which they are applied."""

    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels; NaN where a step has none."""
        for step, inverted in self.steps:
            predicted_px = step.inverse(predicted_px) if inverted else step.forward(predicted_px)
        return predicted_px

    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels; NaN where a step has none."""
        return self.invert().forward(observed_px)

    def invert(self) -> Correction:
        """Return the correction that maps observed to predicted pixels."""
        steps = tuple((step, not inverted) for step, inverted in reversed(self.steps))
        return steps[0][0] if len(steps) == 1 and not steps[0][1] else Composition(self.name, steps)

    def _parameters(self) -> dict[str, object]:
        steps = [{"inverted": inverted, **step.to_dict()} for step, inverted in self.steps]
        return {"type": "composition", "steps": steps}


@dataclass(frozen=True, slots=True, eq=False)
class SmoothCorrection(Correction):
    """A correction with known derivatives, which Newton's method inverts."""

    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels (col, row)."""
        return in_chunks(self._forward, predicted_px)

    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels, to 1e-8 px; NaN where there is none."""
        return in_chunks(lambda at_px: invert(self._forward, self._slopes, at_px), observed_px)

    @abstractmethod
    def _forward(self, at_px: Float64) -> Float64:
        """Map (n, 2) predicted px to observed ones."""

    @abstractmethod
    def _slopes(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) derivatives of the observed px (last axis: by col, row)."""


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialBasis:
    """Products of powers of centred, scaled col and row up to an order.

    A power u^k is continued beyond the box of the tie points by its tangent there, so that a cubic does not
    grow without limit where there are no points.
    """

    order: int
    centre_px: tuple[float, float]
    radius_px: float
    """u = (col - centre) / radius, and the same for row."""
    low_px: tuple[float, float]
    high_px: tuple[float, float]
    """The box (col, row) beyond which powers are continued by their tangents."""

    @property
    def exponents(self) -> tuple[tuple[int, int], ...]:
        """Powers of (col, row) of the terms: 1, col, row, col², col·row, row² and so on."""
        return tuple((total - row, row) for total in range(self.order + 1) for row in range(total + 1))

    def values(self, at_px: Float64) -> Float64:
        """Return the (n, terms) values of the terms at the (n, 2) positions `at_px` (col, row)."""
        powers, _ = self._powers(at_px)
        return np.stack([powers[:, 0, i] * powers[:, 1, j] for i, j in self.exponents], axis=1)

    def slopes(self, at_px: Float64) -> Float64:
        """Return the (n, terms, 2) derivatives of the terms by col and row, 1/px, at the (n, 2) `at_px`."""
        powers, slopes = self._powers(at_px)
        by_col = [slopes[:, 0, i] * powers[:, 1, j] for i, j in self.exponents]
        by_row = [powers[:, 0, i] * slopes[:, 1, j] for i, j in self.exponents]
        return np.stack([np.stack(by_col, axis=1), np.stack(by_row, axis=1)], axis=2) / self.radius_px

    def factors(self, at_px: Float64, axis: int) -> Float64:
        """Return the (n, order + 1) powers of col (`axis` 0) or row at the (n, 2) positions `at_px`."""
        return self._powers(at_px)[0][:, axis]

    def _powers(self, at_px: Float64) -> tuple[Float64, Float64]:
        """Return powers 0 to order and their derivatives: (n, 2, order + 1), (n, 2, order + 1)."""
        u, low, high = (
            (np.asarray(px, dtype=np.float64) - self.centre_px) / self.radius_px
            for px in (at_px, self.low_px, self.high_px)
        )
        inside = np.clip(u, low, high)
        powers, slopes = np.ones((2, self.order + 1, *u.shape))  # by products: ten times as fast as **
        slopes[0] = 0.0
        for k in range(1, self.order + 1):
            powers[k], slopes[k] = powers[k - 1] * inside, k * powers[k - 1]
        powers += slopes * (u - inside)
        return np.moveaxis(powers, 0, 2), np.moveaxis(slopes, 0, 2)


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialCorrection(SmoothCorrection):
    """observed = predicted + Σ coefficient · term."""

    basis: PolynomialBasis
    coefficients_px: Float64
    """(terms, 2): displacement (col, row) per term."""

    def _parameters(self) -> dict[str, object]:
        return {
            "type": "polynomial",
            "order": self.basis.order,
            "centre": list(self.basis.centre_px),
            "radius": self.basis.radius_px,
            "box": [list(self.basis.low_px), list(self.basis.high_px)],
            "exponents": [list(pair) for pair in self.basis.exponents],
            "coefficients": self.coefficients_px.tolist(),
        }

    def _forward(self, at_px: Float64) -> Float64:
        return at_px + self.basis.values(at_px) @ self.coefficients_px

    def _slopes(self, at_px: Float64) -> Float64:
        slopes = np.einsum("itb,ta->iab", self.basis.slopes(at_px), self.coefficients_px)
        return np.asarray(np.eye(2) + slopes)

    def at_nodes(self, nodes_px: Float64) -> Float64:
        """Map the (rows, cols, 2) `nodes_px` of a lattice to observed target pixels, of the same shape."""
        coefficients_px = np.zeros((self.basis.order + 1, self.basis.order + 1, 2))
        for (col, row), coefficient_px in zip(self.basis.exponents, self.coefficients_px, strict=True):
            coefficients_px[row, col] = coefficient_px
        return nodes_px + _tensor_product(self.basis, coefficients_px, nodes_px)


@dataclass(frozen=True, slots=True)
class SplineGrid:
    """A rectangle of square cells that carries cubic B-splines."""

    origin_px: tuple[float, float]
    """Corner (col, row) of least col and row."""
    spacing_px: float
    """Side of a cell."""
    cells: tuple[int, int]
    """Number of cells along (col, row)."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the coefficients: three more than cells."""
        return self.cells[1] + 3, self.cells[0] + 3

    def nonzero_splines(self, at_px: Float64) -> tuple[Index, Float64, Float64]:
        """Return indices, values and slopes of the B-splines that are not zero at (n, 2) positions `at_px`.

        Beyond the rectangle each direction is continued by its tangent, so a spline is once continuously
        differentiable everywhere. The results are, along (col, row), the (n, 2) int index of the first of
        four coefficients, the (n, 2, 4) values of the four B-splines, and their (n, 2, 4) derivatives, 1/px.
        """
        place = (np.asarray(at_px, dtype=np.float64) - self.origin_px) / self.spacing_px
        inside = np.clip(place, 0.0, np.array(self.cells, dtype=np.float64))
        first = np.minimum(inside.astype(np.intp), np.array(self.cells) - 1)
        values, slopes, _ = cubic_b_splines(inside - first)
        values = values + slopes * (place - inside)[:, :, None]
        return first, values, slopes / self.spacing_px

    def factors(self, at_px: Float64, axis: int) -> Float64:
        """Return the (n, k) values of all k B-splines along cols (`axis` 0) or rows at the (n, 2) `at_px`."""
        first, values, _ = self.nonzero_splines(at_px)
        all_values = np.zeros((len(first), self.shape[1 - axis]))
        np.put_along_axis(all_values, first[:, axis, None] + np.arange(4), values[:, axis], axis=1)
        return all_values

    def nodes_px(self) -> Float64:
        """Return the (k, 2) positions (col, row) of the coefficients, row by row, px.

        The coefficients of a plane are its values there.
        """
        place = positions(*(np.arange(count + 3.0) - 1 for count in self.cells))
        return self.origin_px + self.spacing_px * place

    def design(self, at_px: Float64) -> scipy.sparse.csr_array:
        """Return the (n, k) values of all B-splines, row by row of the grid, at the (n, 2) `at_px`."""
        first, values, _ = self.nonzero_splines(at_px)
        cols = first[:, 0, None, None] + np.arange(4)
        rows = first[:, 1, None, None] + np.arange(4)[:, None]
        index = rows * self.shape[1] + cols
        data = values[:, 1, :, None] * values[:, 0, None, :]
        pointer = np.arange(0, 16 * len(first) + 1, 16)
        shape = (len(first), self.shape[0] * self.shape[1])
        return scipy.sparse.csr_array((data.ravel(), index.ravel(), pointer), shape=shape)


def cubic_b_splines(fraction: Float64) -> tuple[Float64, Float64, Float64]:
    """Return value, first and second derivative of the four uniform cubic B-splines in a cell of side 1.

    The (...,) `fraction` is the position in the cell, 0 to 1; the results are three (..., 4) arrays.
    """
    t, s = fraction, 1 - fraction
    values = np.stack([s**3, 4 - 3 * t**2 * (1 + s), 4 - 3 * s**2 * (1 + t), t**3], axis=-1) / 6
    slopes = np.stack([-(s**2), 3 * t**2 - 4 * t, 4 * s - 3 * s**2, t**2], axis=-1) / 2
    return values, slopes, np.stack([s, 3 * t - 2, 3 * s - 2, t], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class SplineCorrection(SmoothCorrection):
    """observed = predicted + bicubic spline."""

    grid: SplineGrid
    coefficients_px: Float64
    """(rows, columns, 2) displacement coefficients (col, row)."""

    def _parameters(self) -> dict[str, object]:
        return {
            "type": "bicubic_spline",
            "origin": list(self.grid.origin_px),
            "spacing": self.grid.spacing_px,
            "cells": list(self.grid.cells),
            "coefficients": self.coefficients_px.tolist(),
        }

    def _forward(self, at_px: Float64) -> Float64:
        first, values, _ = self.grid.nonzero_splines(at_px)
        return at_px + self._sum(first, values[:, 1], values[:, 0])

    def _slopes(self, at_px: Float64) -> Float64:
        first, values, slopes = self.grid.nonzero_splines(at_px)
        by_col = self._sum(first, values[:, 1], slopes[:, 0])
        by_row = self._sum(first, slopes[:, 1], values[:, 0])
        return np.eye(2) + np.stack([by_col, by_row], axis=2)

    def _sum(self, first: Index, along_rows: Float64, along_cols: Float64) -> Float64:
        """Return the (n, 2) sums of coefficients times the (n, 4) B-splines along rows and cols."""
        col, row = first.T
        total = np.zeros((len(first), 2))
        for j in range(4):
            parts = (along_cols[:, i, None] * self.coefficients_px[row + j, col + i] for i in range(4))
            total += along_rows[:, j, None] * sum(parts)
        return total

    def at_nodes(self, nodes_px: Float64) -> Float64:
        """Map the (rows, cols, 2) `nodes_px` of a lattice to observed target pixels, of the same shape."""
        return nodes_px + _tensor_product(self.grid, self.coefficients_px, nodes_px)


def _tensor_product(
    basis: PolynomialBasis | SplineGrid, coefficients_px: Float64, nodes_px: Float64
) -> Float64:
    """Return the (rows, cols, 2) values of a tensor-product basis with (j, i, 2) coefficients at a lattice.

    There are j functions of the row and i of the col. Summing one axis after the other costs a small part of
    evaluating each position by itself.
    """
    by_row, by_col = basis.factors(nodes_px[:, 0], 1), basis.factors(nodes_px[0], 0)
    summed = np.tensordot(by_row, coefficients_px, axes=1)
    return np.asarray(by_col @ summed)


@dataclass(frozen=True, slots=True, eq=False)
class AffineCorrection(Correction):
    """observed = matrix · (predicted col, predicted row, 1); a shift is the affine with identity."""

    matrix: Float64
    """(2, 3); the last column in px."""

    @property
    def homogeneous(self) -> Float64:
        """(3, 3) matrix of the mapping."""
        return np.vstack([self.matrix, [0.0, 0.0, 1.0]])

    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels (col, row)."""
        return np.asarray(predicted_px, dtype=np.float64) @ self.matrix[:, :2].T + self.matrix[:, 2]

    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels (col, row)."""
        moved = np.asarray(observed_px, dtype=np.float64) - self.matrix[:, 2]
        return moved @ inverse(self.matrix[:, :2]).T

    def invert(self) -> AffineCorrection:
        """Return the affine that maps observed to predicted pixels."""
        c, a, b, f, d, e = self.to_gdal()
        return AffineCorrection(self.name, np.array([[a, b, c], [d, e, f]]))

    def to_gdal(self) -> tuple[float, float, float, float, float, float]:
        """Return the geotransform, in GDAL's order, that places observed at predicted pixels."""
        (a, b, c), (d, e, f) = self.matrix.tolist()
        scale = 1 / (a * e - b * d)
        a, b, d, e = e * scale, -b * scale, -d * scale, a * scale
        return -c * a - f * b, a, b, -c * d - f * e, d, e

    def _parameters(self) -> dict[str, object]:
        return {"type": "affine", "matrix": self.matrix.tolist()}


def affine_between(from_xy: Float64, to_xy: Float64) -> Float64:
    """Return the (2, 3) affine matrix of least squares between the (n, 2) points `from_xy` and `to_xy`."""
    # Relative to the means: eastings and northings have more digits than normal equations keep.
    centre, moved = from_xy.mean(axis=0), to_xy.mean(axis=0)
    linear = least_squares(from_xy - centre, to_xy - moved).T
    return np.column_stack([linear, moved - linear @ centre])


@dataclass(frozen=True, slots=True, eq=False)
class ProjectiveCorrection(Correction):
    """(w·observed col, w·observed row, w) = matrix · (predicted col, predicted row, 1)."""

    matrix: Float64
    """(3, 3), of positive w where the tie points are."""

    @property
    def homogeneous(self) -> Float64:
        """(3, 3) matrix of the mapping."""
        return self.matrix

    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels; NaN beyond the horizon."""
        return _homogeneous(self.matrix, predicted_px)

    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels; NaN beyond the horizon."""
        return _homogeneous(inverse(self.matrix), observed_px)

    def invert(self) -> ProjectiveCorrection:
        """Return the projective that maps observed to predicted pixels."""
        return ProjectiveCorrection(self.name, inverse(self.matrix))

    def _parameters(self) -> dict[str, object]:
        return {"type": "projective", "matrix": self.matrix.tolist()}


@dataclass(frozen=True, slots=True, eq=False)
class JitterWave:
    """A wave of the displacement that depends on one coordinate of the target alone."""

    along: Literal["column", "row"]
    """The coordinate."""
    period_px: float
    origin_px: float
    """Coordinate at which the phase is zero."""
    coefficients_px: Float64
    """(2, 2) amplitudes (col, row) of the cosine, then of the sine."""

    def at(self, at_px: Float64) -> tuple[Float64, Float64]:
        """Return (n, 2) displacements at the (n, 2) `at_px` (col, row), and their (n, 2) slopes, 1/px."""
        frequency = 2 * np.pi / self.period_px
        phase = frequency * (np.asarray(at_px, dtype=np.float64)[:, self.axis] - self.origin_px)
        cosine, sine = np.cos(phase)[:, None], np.sin(phase)[:, None]
        of_cosine, of_sine = self.coefficients_px
        displacements = cosine * of_cosine + sine * of_sine
        return displacements, frequency * (cosine * of_sine - sine * of_cosine)

    @property
    def axis(self) -> int:
        """Index of the coordinate."""
        return 0 if self.along == "column" else 1

    def to_dict(self) -> dict[str, object]:
        """Return it as report.json holds it."""
        return {
            "along": self.along,
            "period": self.period_px,
            "origin": self.origin_px,
            "coefficients": self.coefficients_px.tolist(),
        }


@dataclass(frozen=True, slots=True, eq=False)
class JitterCorrection(SmoothCorrection):
    """observed = affine(predicted) + waves along the rows or the columns."""

    affine: AffineCorrection
    waves: tuple[JitterWave, ...]
    """The significant waves; empty where there are none."""

    @property
    def variance_px2(self) -> float:
        """Variance of the waves, of both components, px²."""
        return sum(float((wave.coefficients_px**2).sum()) / 2 for wave in self.waves)

    def _parameters(self) -> dict[str, object]:
        waves = [wave.to_dict() for wave in self.waves]
        return {"type": "jitter", "matrix": self.affine.matrix.tolist(), "waves": waves}

    def _forward(self, at_px: Float64) -> Float64:
        moved = self.affine.forward(at_px)
        for wave in self.waves:
            moved = moved + wave.at(at_px)[0]
        return moved

    def _slopes(self, at_px: Float64) -> Float64:
        slopes = np.tile(self.affine.matrix[:, :2], (len(at_px), 1, 1))
        for wave in self.waves:
            slopes[:, :, wave.axis] += wave.at(at_px)[1]
        return slopes


def _homogeneous(matrix: Float64, at_px: Float64) -> Float64:
    moved = np.asarray(at_px, dtype=np.float64) @ matrix[:, :2].T + matrix[:, 2]
    w = np.where(moved[:, 2:] > 0, moved[:, 2:], np.nan)
    return moved[:, :2] / w


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
    matrix = _numbers(forward["matrix"], (2, 3))
    large, small = np.linalg.svd(matrix[:, :2], compute_uv=False).tolist()
    if not 1 / MAX_STRETCH <= small <= large <= MAX_STRETCH:
        raise ValueError("its matrix cannot be inverted, or stretches the image beyond measure")
    return AffineCorrection(name, matrix)


def _projective(name: str, forward: Mapping[str, Any]) -> Correction:
    matrix = _numbers(forward["matrix"], (3, 3))
    if not np.linalg.cond(matrix) * np.finfo(np.float64).eps < 1:
        raise ValueError("its matrix cannot be inverted")
    return ProjectiveCorrection(name, matrix)


def _polynomial(name: str, forward: Mapping[str, Any]) -> Correction:
    (low, high), centre = _numbers(forward["box"], (2, 2)), _numbers(forward["centre"], (2,))
    order = int(forward["order"])
    if not 1 <= order <= MAX_ORDER:  # before its terms are counted, which could be more than fit into memory
        raise ValueError(f"expected an order from 1 to {MAX_ORDER}, found {order}")
    basis = PolynomialBasis(
        order=order,
        centre_px=(float(centre[0]), float(centre[1])),
        radius_px=_length(forward["radius"]),
        low_px=(float(low[0]), float(low[1])),
        high_px=(float(high[0]), float(high[1])),
    )
    return PolynomialCorrection(name, basis, _numbers(forward["coefficients"], (len(basis.exponents), 2)))


def _spline(name: str, forward: Mapping[str, Any]) -> Correction:
    origin, (cols, rows) = _numbers(forward["origin"], (2,)), forward["cells"]
    if not min(int(cols), int(rows)) >= 1:
        raise ValueError(f"expected at least one cell along each axis, found {cols} x {rows}")
    spacing = _length(forward["spacing"])
    grid = SplineGrid((float(origin[0]), float(origin[1])), spacing, (int(cols), int(rows)))
    return SplineCorrection(name, grid, _numbers(forward["coefficients"], (*grid.shape, 2)))


def _jitter(name: str, forward: Mapping[str, Any]) -> Correction:
    affine, waves = _affine("affine", forward), []
    for wave in forward["waves"]:
        along, origin = wave["along"], float(wave["origin"])
        if along not in ("column", "row") or not np.isfinite(origin) or len(forward["waves"]) > MAX_WAVES:
            raise ValueError("expected few waves along columns or rows, with a finite origin")
        coefficients = _numbers(wave["coefficients"], (2, 2))
        waves.append(JitterWave(along, _length(wave["period"]), origin, coefficients))
    return JitterCorrection(name, affine, tuple(waves))


def _composition(name: str, forward: Mapping[str, Any]) -> Correction:
    steps = forward["steps"]
    if not 1 <= len(steps) <= MAX_STEPS or any(each["forward"]["type"] == "composition" for each in steps):
        raise ValueError(f"expected 1 to {MAX_STEPS} steps, none of them a composition")
    return Composition(name, tuple((from_dict(each), bool(each["inverted"])) for each in steps))


def _length(value: float | str) -> float:
    length = float(value)
    if not 0.0 < length < float("inf"):
        raise ValueError(f"expected a length above zero, found {length}")
    return length


def _numbers(values: object, shape: tuple[int, ...]) -> Float64:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers of shape {shape}, found shape {array.shape}")
    return array


_READERS = {
    "affine": _affine,
    "projective": _projective,
    "polynomial": _polynomial,
    "bicubic_spline": _spline,
    "jitter": _jitter,
    "composition": _composition,
}


def has_foldover(correction: Correction, low_px: Float64, high_px: Float64) -> bool:
    """Return whether a correction has a foldover, or no value, anywhere in a box of predicted pixels.

    The (2,) `low_px` and `high_px` are corners of the box (col, row), px.
    """
    if isinstance(correction, AffineCorrection):
        (a, b, _), (d, e, _) = correction.matrix.tolist()
        return not a * e - b * d > 0
    # Four nodes per cell of the finest spline.
    lattice = Lattice.over(low_px, high_px, float((high_px - low_px).max()) / 320)
    nodes_px = lattice.nodes_px().reshape(*lattice.shape, 2)
    moved = correction.at_nodes(nodes_px)
    along_cols, along_rows = np.diff(moved, axis=1), np.diff(moved, axis=0)
    return not all(
        (cols[..., 0] * rows[..., 1] - cols[..., 1] * rows[..., 0] > 0).all()  # area of the cell's image
        for cols in (along_cols[:-1], along_cols[1:])
        for rows in (along_rows[:, :-1], along_rows[:, 1:])
    )
