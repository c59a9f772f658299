"""Corrections by bicubic splines on a grid of square cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from pcwlad_geo.correction.dense import positions, tensor_product
from pcwlad_geo.correction.models import SmoothCorrection
from pcwlad_geo.types import Float64, Index


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
        return nodes_px + tensor_product(self.grid, self.coefficients_px, nodes_px)
