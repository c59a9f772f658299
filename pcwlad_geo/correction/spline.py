"""Bicubic spline corrections: coefficients on a regular grid, continued linearly beyond it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from pcwlad_geo.correction.inversion import in_chunks, invert

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SplineGrid:
    """A rectangle of square cells, on which cubic B-splines stand."""

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

    def taps(self, at_px: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Return which B-splines reach (n, 2) positions, and how much.

        Beyond the rectangle each direction is continued by its tangent, so a spline is once continuously
        differentiable everywhere.

        Returns
        -------
        first : (n, 2) array of int
            Index of the first of four coefficients along (col, row).
        values : (n, 2, 4) array of float
        slopes : (n, 2, 4) array of float
            Derivatives, per px.
        """
        place = (np.asarray(at_px, dtype=np.float64) - self.origin_px) / self.spacing_px
        inside = np.clip(place, 0.0, np.array(self.cells, dtype=np.float64))
        first = np.minimum(inside.astype(np.intp), np.array(self.cells) - 1)
        values, slopes, _ = cubic_b_splines(inside - first)
        values = values + slopes * (place - inside)[:, :, None]
        return first, values, slopes / self.spacing_px

    def nodes_px(self) -> Array:
        """Return where the coefficients stand, row after row: those of a plane are its values there."""
        cols, rows = (np.arange(count + 3.0) - 1 for count in self.cells)
        place = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
        return np.asarray(self.origin_px + self.spacing_px * place)

    def design(self, at_px: Array) -> scipy.sparse.csr_array:
        """Return the (n, coefficients) values of all B-splines, row after row of the grid."""
        first, values, _ = self.taps(at_px)
        cols = first[:, 0, None, None] + np.arange(4)
        rows = first[:, 1, None, None] + np.arange(4)[:, None]
        index = rows * self.shape[1] + cols
        data = values[:, 1, :, None] * values[:, 0, None, :]
        pointer = np.arange(0, 16 * len(first) + 1, 16)
        shape = (len(first), self.shape[0] * self.shape[1])
        return scipy.sparse.csr_array((data.ravel(), index.ravel(), pointer), shape=shape)


def cubic_b_splines(fraction: Array) -> tuple[Array, Array, Array]:
    """Return value, first and second derivative of the four uniform cubic B-splines in a cell of side 1.

    Parameters
    ----------
    fraction : (...) array of float
        Place in the cell, 0 to 1.

    Returns
    -------
    Three (..., 4) arrays of float.
    """
    t, s = fraction, 1 - fraction
    values = np.stack([s**3, 4 - 3 * t**2 * (1 + s), 4 - 3 * s**2 * (1 + t), t**3], axis=-1) / 6
    slopes = np.stack([-(s**2), 3 * t**2 - 4 * t, 4 * s - 3 * s**2, t**2], axis=-1) / 2
    return values, slopes, np.stack([s, 3 * t - 2, 3 * s - 2, t], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class SplineCorrection:
    """observed = predicted + bicubic spline."""

    name: str
    """tps."""
    grid: SplineGrid
    coefficients_px: Array
    """(rows, columns, 2) displacement coefficients (col, row)."""

    def forward(self, predicted_px: Array) -> Array:
        """Map (n, 2) predicted to observed target pixels."""
        return in_chunks(self._forward, predicted_px)

    def inverse(self, observed_px: Array) -> Array:
        """Map (n, 2) observed to predicted target pixels, to 1e-8 px; NaN where there is none."""
        return in_chunks(lambda at_px: invert(self._forward, self._slopes, at_px), observed_px)

    def to_dict(self) -> dict[str, object]:
        """Return what report.json holds: enough, alone, to warp."""
        return {
            "name": self.name,
            "forward": {
                "type": "bicubic_spline",
                "origin": list(self.grid.origin_px),
                "spacing": self.grid.spacing_px,
                "cells": list(self.grid.cells),
                "coefficients": self.coefficients_px.tolist(),
            },
        }

    def _forward(self, at_px: Array) -> Array:
        first, values, _ = self.grid.taps(at_px)
        return at_px + self._sum(first, values[:, 1], values[:, 0])

    def _slopes(self, at_px: Array) -> Array:
        first, values, slopes = self.grid.taps(at_px)
        by_col = self._sum(first, values[:, 1], slopes[:, 0])
        by_row = self._sum(first, slopes[:, 1], values[:, 0])
        return np.eye(2) + np.stack([by_col, by_row], axis=2)

    def _sum(self, first: NDArray[np.intp], along_rows: Array, along_cols: Array) -> Array:
        total = np.zeros((len(first), 2))
        for j in range(4):
            row = np.zeros((len(first), 2))
            for i in range(4):
                row += along_cols[:, i, None] * self.coefficients_px[first[:, 1] + j, first[:, 0] + i]
            total += along_rows[:, j, None] * row
        return total
