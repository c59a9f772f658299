"""Closure of triangles of bands: a check of the matching that needs no truth.

The way from A to B and on to C must be the way from A to C. The three are measured independently, so what
is missing is their error: not that of the bands, whose true displacements cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.raster.geodesy import middle_pixel_size_m
from pcwlad_geo.raster.grid import Grid, map_px
from pcwlad_geo.stacks.bands import Band
from pcwlad_geo.stacks.cells import cell_means
from pcwlad_geo.stacks.pairs import PairResult

Array = NDArray[np.float64]
Pair = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Triangle:
    """How well a triangle of bands closes, in px (col, row) of the coarsest of the three."""

    bands: tuple[str, str, str]
    cells: int
    """Places, one matching window each, where all three pairs have tie points."""
    mean_px: Pair | None
    """Mean over the cells of AB + BC − AC; None where the three share no ground."""
    error_px: Pair | None
    """Standard error of that mean, from the scatter between cells; None with a single cell."""
    rms_px: Pair | None
    """Root mean square over the cells."""
    px_m: Pair | None
    """Size of that pixel in metres."""

    @property
    def name(self) -> str:
        """The three bands."""
        return " – ".join(self.bands)

    @property
    def mean_m(self) -> Pair | None:
        """The mean in metres, along columns and rows."""
        if self.mean_px is None or self.px_m is None:
            return None
        return self.mean_px[0] * self.px_m[0], self.mean_px[1] * self.px_m[1]


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """Tie points of one pair on the pixels of a grid."""

    at_px: Array
    """(n, 2) where, (col, row)."""
    moved_px: Array
    """(n, 2) displacement."""

    @staticmethod
    def of(pair: PairResult, grid: Grid) -> Leg:
        """Express the tie points of a measured pair in the pixels of a grid."""
        if pair.points is None:
            raise ValueError(f"{pair.name} was refused")
        own = pair.target.info.grid
        predicted = map_px(pair.points.predicted_px, own, grid)
        moved = map_px(pair.points.target_px, own, grid) - predicted
        finite = np.isfinite(moved).all(axis=1)
        return Leg(predicted[finite], moved[finite])


def close_triangles(bands: Sequence[Band], pairs: Sequence[PairResult], cell_px: float) -> list[Triangle]:
    """Close every triangle whose three pairs were measured.

    Parameters
    ----------
    bands : sequence of Band
        In the order of the pairs: the reference of a pair comes first.
    pairs : sequence of PairResult
    cell_px : float
        Side of the cells, px of the coarsest band: tie points within one matching window are not independent.
    """
    by_names = {(pair.reference.name, pair.target.name): pair for pair in pairs if pair.status == "measured"}
    triangles = []
    for a, b, c in combinations(bands, 3):
        sides = [by_names.get((first.name, second.name)) for first, second in ((a, b), (b, c), (a, c))]
        found = [side for side in sides if side is not None]
        if len(found) == 3:
            coarsest = max((a, b, c), key=lambda band: band.px_m[0] * band.px_m[1] if band.px_m else 0.0)
            grid = coarsest.info.grid
            legs = [Leg.of(side, grid) for side in found]
            triangles.append(close((a.name, b.name, c.name), legs, cell_px, middle_pixel_size_m(grid)))
    return triangles


def close(
    names: tuple[str, str, str], legs: Sequence[Leg], cell_px: float, px_m: Pair | None = None
) -> Triangle:
    """Close one triangle on the ground that its three legs share.

    Parameters
    ----------
    names : three of str
    legs : three of Leg
        A to B, B to C, A to C, on one grid.
    cell_px : float
        Side of the cells.
    px_m : (float, float), optional
        Size of the grid's pixel.
    """
    ab, bc, ac = (cell_means(leg.at_px, leg.moved_px, cell_px) for leg in legs)
    shared = sorted(set(ab) & set(bc) & set(ac))
    if not shared:
        return Triangle(names, 0, None, None, None, px_m)
    gaps = np.array([np.add(ab[cell].mean_px, bc[cell].mean_px) - ac[cell].mean_px for cell in shared])
    error = gaps.std(axis=0, ddof=1) / np.sqrt(len(gaps)) if len(gaps) > 1 else None
    return Triangle(
        names,
        len(gaps),
        _pair(gaps.mean(axis=0)),
        None if error is None else _pair(error),
        _pair(np.sqrt((gaps**2).mean(axis=0))),
        px_m,
    )


def _pair(values: Array) -> Pair:
    return float(values[0]), float(values[1])
