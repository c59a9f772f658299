"""How far the columns of an image's lines lie from those of its RPC."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.raster.rpc.dem import bilinear
from pcwlad_geo.types import Float64

_STEPS: Final = 4
"""Steps of the inversion: shifts change by a hundredth from column to column at most."""


@dataclass(frozen=True, slots=True, eq=False)
class LineShifts:
    """Shifts of columns between nodes, constant beyond the outermost; pixels are (col, row), corner-based.

    A radar image on ground range has a projection of its own in each group of lines, which no RPC follows.
    """

    rows_px: Float64
    """(k,) rows of the nodes, in order."""
    step_px: float
    """Columns from one node to the next, from the first column on."""
    shifts_px: Float64
    """(k, n) columns of the RPC less those of the file, at rows and columns of the file."""

    def to_rpc(self, file_px: Float64) -> Float64:
        """Map (n, 2) pixels `file_px` of the file to (n, 2) of the RPC."""
        moved = np.array(file_px, dtype=np.float64)
        moved[:, 0] += self._at(moved)
        return moved

    def to_file(self, rpc_px: Float64) -> Float64:
        """Map (n, 2) pixels `rpc_px` of the RPC to (n, 2) of the file."""
        moved = np.array(rpc_px, dtype=np.float64)
        for _ in range(_STEPS):
            moved[:, 0] = rpc_px[:, 0] - self._at(moved)
        return moved

    def _at(self, file_px: Float64) -> Float64:
        shifts = np.full(len(file_px), np.nan)
        finite = np.isfinite(file_px).all(axis=1)
        col = np.clip(file_px[finite, 0] / self.step_px, 0, self.shifts_px.shape[1] - 1)
        row = np.interp(file_px[finite, 1], self.rows_px, np.arange(len(self.rows_px), dtype=np.float64))
        shifts[finite] = bilinear(self.shifts_px, np.column_stack([col, row]))
        return shifts
