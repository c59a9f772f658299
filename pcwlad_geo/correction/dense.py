"""Inversion of mappings, and their evaluation on a lattice, whose cost does not depend on the tie points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class LatticeParameters:
    """How mappings are evaluated on a lattice."""

    places_at_once: int = 1 << 16
    """Number of positions evaluated at once, which limits the memory for a raster of any size."""
    first_cells: int = 64
    """Number of cells along the longer side of the first lattice: no correction has detail between them."""
    min_step_px: float = 1.0
    """Least step of the lattice."""
    tested_at: tuple[tuple[float, float], ...] = (
        *((0.5, 0.5), (0.5, 0.0), (0.0, 0.5), (0.25, 0.25), (0.75, 0.25)),
    )
    """Positions in a cell (col, row) at which the interpolation is compared with the mapping."""


LATTICE: Final = LatticeParameters()
"""Those in use."""


def in_chunks(function: Callable[[Float64], Float64], at_px: Float64) -> Float64:
    """Apply `function` to the (n, 2) positions `at_px` in chunks; return its (n, ...) values."""
    at_px = np.asarray(at_px, dtype=np.float64)
    step = LATTICE.places_at_once
    if len(at_px) <= step:
        return function(at_px)
    return np.concatenate([function(at_px[start : start + step]) for start in range(0, len(at_px), step)])


def invert(
    forward: Callable[[Float64], Float64], slopes: Callable[[Float64], Float64], observed_px: Float64
) -> Float64:
    """Return the predicted pixels that `forward` maps to the observed ones.

    It maps (n, 2) predicted px to observed ones, and `slopes` to their (n, 2, 2) derivatives (last axis: by
    col, row). For the (n, 2) `observed_px` (col, row) the result is of shape (n, 2), good to 1e-8 px; NaN
    where the iteration does not converge, as where the correction has a foldover.
    """
    observed = np.asarray(observed_px, dtype=np.float64)
    predicted = observed.copy()
    # Coordinates of a million px have no more digits than that.
    tolerance = 1e-9 + 4 * np.finfo(np.float64).eps * np.abs(observed).max(axis=1)
    moving = np.isfinite(observed).all(axis=1)
    predicted[~moving] = np.nan
    index = np.flatnonzero(moving)
    for _ in range(60):
        miss = observed[index] - forward(predicted[index])
        unsolved = ~(np.abs(miss).max(axis=1) <= tolerance[index])
        index, miss = index[unsolved], miss[unsolved]
        if len(index) == 0:
            break
        predicted[index] += solve_2x2(slopes(predicted[index]), miss)
        index = index[np.isfinite(predicted[index]).all(axis=1)]
    predicted[~np.isfinite(predicted).all(axis=1)] = np.nan
    predicted[index] = np.nan
    return predicted


def solve_2x2(matrices: Float64, vectors: Float64) -> Float64:
    """Return the (n, 2) x of (n, 2, 2) `matrices` · x = (n, 2) `vectors`; not finite where singular."""
    (a, b), (c, d) = matrices.transpose(1, 2, 0)
    x, y = vectors.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, None])


def positions(cols: NDArray[np.floating[Any]], rows: NDArray[np.floating[Any]]) -> Float64:
    """Return the (m · k, 2) positions (col, row) of a lattice of (m,) `cols` and (k,) `rows`, row by row."""
    return np.stack(np.meshgrid(cols, rows), axis=-1, dtype=np.float64).reshape(-1, 2)


class TensorBasis(Protocol):
    """Products of functions of the col and of the row."""

    def factors(self, at_px: Float64, axis: int) -> Float64:
        """Return the (n, k) values of the functions of col (`axis` 0) or row at the (n, 2) `at_px`."""


def tensor_product(basis: TensorBasis, coefficients_px: Float64, nodes_px: Float64) -> Float64:
    """Return the (rows, cols, 2) values of a tensor-product basis at the (rows, cols, 2) `nodes_px`.

    The (j, i, 2) `coefficients_px` are of j functions of the row and i of the col. Summing one axis after the
    other costs a small part of evaluating each position by itself.
    """
    by_row, by_col = basis.factors(nodes_px[:, 0], 1), basis.factors(nodes_px[0], 0)
    summed = np.tensordot(by_row, coefficients_px, axes=1)
    return np.asarray(by_col @ summed)


@dataclass(frozen=True, slots=True)
class Lattice:
    """Nodes at origin + index · step along each axis."""

    origin_px: tuple[float, float]
    """First node (col, row)."""
    step_px: tuple[float, float]
    shape: tuple[int, int]
    """Rows and columns of nodes, at least two each."""

    @classmethod
    def over(cls, low_px: Float64, high_px: Float64, step_px: float, most: int | None = None) -> Lattice:
        """Return a lattice that spans the box with the (2,) corners `low_px` and `high_px` (col, row).

        Its steps are at most `step_px` long, unless that takes more than `most` nodes along an axis.
        """
        extent = np.maximum(high_px - low_px, 1e-9)
        steps = np.maximum(np.ceil(extent / step_px * (1 - 1e-9)), 1)
        if most is not None:
            steps = np.minimum(steps, most - 1)
        col, row = (extent / steps).tolist()
        return cls((float(low_px[0]), float(low_px[1])), (col, row), (int(steps[1]) + 1, int(steps[0]) + 1))

    def nodes_px(self) -> Float64:
        """Return the (rows · columns, 2) positions (col, row) of the nodes, row by row, px."""
        cols, rows = (
            origin + step * np.arange(count)
            for origin, step, count in zip(self.origin_px, self.step_px, self.shape[::-1], strict=True)
        )
        return positions(cols, rows)

    def interpolated(self, values: Float64, at_px: Float64) -> Float64:
        """Return the (n, ...) values at positions, interpolated bilinearly.

        The (rows, columns, ...) `values` are those at the nodes. Beyond the lattice its outermost cells are
        continued to the (n, 2) positions `at_px` (col, row).
        """
        place = (np.asarray(at_px, dtype=np.float64) - self.origin_px) / self.step_px
        first = np.clip(np.floor(place), 0, np.array(self.shape[::-1]) - 2).astype(np.intp)
        part = place - first
        col, row = first.T
        right, down = (part[:, axis].reshape(-1, *(1,) * (values.ndim - 2)) for axis in (0, 1))
        upper = values[row, col] * (1 - right) + values[row, col + 1] * right
        lower = values[row + 1, col] * (1 - right) + values[row + 1, col + 1] * right
        return np.asarray(upper * (1 - down) + lower * down)


Mapping = Callable[[Float64], Float64]
"""A function from (n, 2) positions to (n, 2) positions (col, row), px; NaN where it has no value."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseMapping:
    """A mapping given by its values on a lattice."""

    lattice: Lattice
    moved_px: Float64
    """(rows, columns, 2) mapped positions (col, row) of the nodes; NaN where the mapping has no value."""
    error_px: float
    """Largest interpolation error; of several places where it is too large, that of the first, px."""

    def __call__(self, at_px: Float64) -> Float64:
        """Map (n, 2) positions (col, row) within the box, px."""
        return in_chunks(lambda part: self.lattice.interpolated(self.moved_px, part), at_px)


def dense_mapping(
    mapping: Mapping,
    low_px: tuple[float, float],
    high_px: tuple[float, float],
    *,
    tolerance_px: float = 0.01,
    parameters: LatticeParameters = LATTICE,
) -> DenseMapping:
    """Evaluate a mapping on a lattice fine enough to interpolate bilinearly.

    The step is halved until the error between the nodes is within the tolerance at all positions tested, or
    the step is one pixel. The `mapping`, such as `Correction.forward`, maps (n, 2) to (n, 2) positions (col,
    row), px; the lattice covers the box from `low_px` to `high_px`.
    """
    low, high = np.array(low_px, dtype=np.float64), np.array(high_px, dtype=np.float64)
    least = parameters.min_step_px
    step = max(float((high - low).max()) / parameters.first_cells, least)
    while True:
        lattice = Lattice.over(low, high, step)
        nodes = in_chunks(mapping, lattice.nodes_px()).reshape(*lattice.shape, 2)
        error = _largest_error(mapping, lattice, nodes, 0.7 * tolerance_px, parameters)
        if error <= 0.7 * tolerance_px or step <= least:
            return DenseMapping(lattice, nodes, error)
        step = max(step / 2, least)


def _largest_error(
    mapping: Mapping, lattice: Lattice, mapped_px: Float64, enough_px: float, parameters: LatticeParameters
) -> float:
    """Return the largest error in the cells whose corners have a value, or one of more than `enough_px`.

    It is 0 where there is no such cell.
    """
    rows, cols = lattice.shape
    finite = np.asarray(np.isfinite(mapped_px).all(axis=2))
    whole = finite[:-1, :-1] & finite[:-1, 1:] & finite[1:, :-1] & finite[1:, 1:]
    corner = lattice.nodes_px().reshape(rows, cols, 2)[:-1, :-1][whole]
    largest = 0.0
    for place in parameters.tested_at:
        at_px = corner + np.array(place) * lattice.step_px
        error = np.abs(in_chunks(mapping, at_px) - lattice.interpolated(mapped_px, at_px))
        largest = max(largest, float(np.nan_to_num(error).max(initial=0.0)))
        if largest > enough_px:
            break
    return largest
