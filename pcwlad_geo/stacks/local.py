"""Where in the scene a pair is displaced: means over the squares of a coarse net."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.stacks.cells import cell_means

SQUARES: Final = 8
"""Along the longer side of the target."""


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
    return [
        LocalMean(((col + 0.5) * side, (row + 0.5) * side), cell.n, cell.mean_px)
        for (col, row), cell in cell_means(points.predicted_px, points.displacement_px, side).items()
    ]
