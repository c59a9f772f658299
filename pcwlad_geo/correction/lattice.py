"""Values on a regular lattice, interpolated bilinearly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Lattice:
    """Nodes at origin + index · step along each axis."""

    origin_px: tuple[float, float]
    """First node (col, row)."""
    step_px: tuple[float, float]
    shape: tuple[int, int]
    """Rows and columns of nodes, at least two each."""

    @classmethod
    def over(cls, low_px: Array, high_px: Array, step_px: float, most: int | None = None) -> Lattice:
        """Return a lattice that spans a box (col, row).

        Its steps are at most `step_px` long, unless that takes more than `most` nodes along an axis.
        """
        extent = np.maximum(high_px - low_px, 1e-9)
        steps = np.maximum(np.ceil(extent / step_px * (1 - 1e-9)), 1)
        if most is not None:
            steps = np.minimum(steps, most - 1)
        col, row = (extent / steps).tolist()
        return cls((float(low_px[0]), float(low_px[1])), (col, row), (int(steps[1]) + 1, int(steps[0]) + 1))

    def nodes_px(self) -> Array:
        """Return the (rows · columns, 2) nodes (col, row), row after row."""
        cols, rows = (
            origin + step * np.arange(count)
            for origin, step, count in zip(self.origin_px, self.step_px, self.shape[::-1], strict=True)
        )
        return np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)

    def interpolated(self, values: Array, at_px: Array) -> Array:
        """Return values at (n, 2) positions: (n, …).

        Parameters
        ----------
        values : (rows, columns, …) array of float
        at_px : (n, 2) array of float
            Positions (col, row); beyond the lattice its outermost cells are continued.
        """
        place = (np.asarray(at_px, dtype=np.float64) - self.origin_px) / self.step_px
        first = np.clip(np.floor(place), 0, np.array(self.shape[::-1]) - 2).astype(np.intp)
        part = place - first
        col, row = first.T
        right, down = (part[:, axis].reshape(-1, *(1,) * (values.ndim - 2)) for axis in (0, 1))
        upper = values[row, col] * (1 - right) + values[row, col + 1] * right
        lower = values[row + 1, col] * (1 - right) + values[row + 1, col + 1] * right
        return np.asarray(upper * (1 - down) + lower * down)
