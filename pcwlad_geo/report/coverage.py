"""Which squares of the reference have tie points, and what is known of those that have none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.report.statistics import KEPT

SQUARES = 12
"""Along the longer side of the reference."""
LEAST_DATA = 0.1
"""A square with a smaller share of valid pixels counts as without data."""

Counts = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Tie points by square of the reference."""

    shape_px: tuple[int, int]
    """Rows and columns of the reference."""
    kept: Counts
    """(rows, columns) tie points that agree with the others."""
    rejected: Counts
    """(rows, columns) matches that contradict the others."""
    without_data: NDArray[np.bool_]
    """(rows, columns) True where the reference has no valid pixels; all False where that is not known."""

    @classmethod
    def of(cls, table: TiePointTable, shape_px: tuple[int, int], valid: NDArray[np.bool_] | None) -> Coverage:
        """Count the points.

        Parameters
        ----------
        table : TiePointTable
        shape_px : (rows, cols)
            Of the reference.
        valid : (m, n) bool array, optional
            Where the reference has data, of any size.
        """
        step = max(shape_px) / SQUARES
        squares = (max(1, round(shape_px[0] / step)), max(1, round(shape_px[1] / step)))
        kept, rejected = (
            _count(table.select(*names).reference_px, shape_px, squares) for names in (KEPT, ("rejected",))
        )
        bare = np.zeros(squares, dtype=bool) if valid is None else _share(valid, squares) < LEAST_DATA
        return cls(shape_px, kept, rejected, bare & (kept == 0))

    @property
    def empty(self) -> NDArray[np.bool_]:
        """(rows, columns) True where there is data, or may be, and no tie point that agrees."""
        return np.asarray((self.kept == 0) & ~self.without_data)

    @property
    def empty_share(self) -> float:
        """Part of the squares with data that has no tie point."""
        return float(self.empty.sum() / max(int((~self.without_data).sum()), 1))


def _count(at_px: NDArray[np.float64], shape_px: tuple[int, int], squares: tuple[int, int]) -> Counts:
    sides = np.array([shape_px[1], shape_px[0]])
    most = np.array([squares[1], squares[0]])
    col, row = np.clip((at_px * most / sides).astype(int), 0, most - 1).T
    return np.bincount(row * squares[1] + col, minlength=squares[0] * squares[1]).reshape(squares)


def _share(valid: NDArray[np.bool_], squares: tuple[int, int]) -> NDArray[np.float64]:
    """Return the share of True in each square of a mask."""
    parts = [np.array_split(half, squares[1], axis=1) for half in np.array_split(valid, squares[0], axis=0)]
    return np.array([[part.mean() if part.size else 1.0 for part in row] for row in parts])
