"""Longitudes on both sides of 180 degrees: 180.04 and -179.96 are the same meridian."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from affine import Affine

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.source import RasterInfo

TURN: float = 360.0
"""Degrees."""


def moved_beside(reference: RasterInfo, target: RasterInfo) -> RasterInfo:
    """Return a reference in degrees with its longitudes counted so that they are nearest the target's.

    Any other is returned as it is. The reference is moved, as no result is made of its pixels: what is
    written has the longitudes of the target.

    Raises
    ------
    InputError
        If the reference has a mask that lies on other pixels and would have to be moved.
    """
    crs = reference.grid.crs
    if crs is None or target.grid.crs is None or not crs.is_geographic:
        return reference
    if not crs.units_factor[0].lower().startswith("degree"):
        return reference
    middle = transform_xy(_middle_xy(target.grid), target.grid.crs, crs)
    apart = float(middle[0, 0] - _middle_xy(reference.grid)[0, 0])
    turns = round(apart / TURN) if np.isfinite(apart) else 0
    if turns == 0:
        return reference
    mask = reference.mask_grid
    if mask is not None and mask.crs is not None and mask != reference.grid:
        raise InputError(
            f"{reference.uri} and {target.uri} count longitudes differently across 180 degrees, and the mask "
            f"{reference.mask_uri} has other pixels than {reference.uri}: give a mask of the same pixels"
        )
    moved = _moved(reference.grid, turns)
    return replace(reference, grid=moved, mask_grid=moved if mask == reference.grid else mask)


def _middle_xy(grid: Grid) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    rows, cols = grid.shape
    return np.asarray(grid.to_xy(np.array([[cols / 2, rows / 2]])))


def _moved(grid: Grid, turns: int) -> Grid:
    a, b, c, d, e, f = tuple(grid.transform)[:6]
    return replace(grid, transform=Affine(a, b, c + turns * TURN, d, e, f))
