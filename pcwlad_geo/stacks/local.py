"""Where in the scene a pair is displaced: means over the squares of a coarse net."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.raster.tie_point_table import TiePointTable

SQUARES: Final = 8
"""Along the longer side of the target."""
LEAST_POINTS: Final = 3


@dataclass(frozen=True, slots=True)
class LocalMean:
    """Mean displacement of the tie points in a square."""

    at_px: tuple[float, float]
    """Middle of the square (col, row), px of the target."""
    n: int
    mean_px: tuple[float, float]
    """(col, row)."""


def local_means(points: TiePointTable, shape: tuple[int, int]) -> list[LocalMean]:
    """Return the mean displacement in each square with enough tie points.

    Parameters
    ----------
    points : TiePointTable
    shape : (rows, cols)
        Of the target.
    """
    side = max(shape) / SQUARES
    squares = np.floor(points.predicted_px / side).astype(np.intp)
    moved = points.displacement_px
    found = []
    for square in np.unique(squares, axis=0):
        inside = (squares == square).all(axis=1)
        if inside.sum() >= LEAST_POINTS:
            col, row = ((square + 0.5) * side).tolist()
            d_col, d_row = moved[inside].mean(axis=0).tolist()
            found.append(LocalMean((col, row), int(inside.sum()), (d_col, d_row)))
    return found
