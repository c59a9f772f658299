"""Lengths on the ground: pixel sizes and displacements in metres."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.raster.crs import to_pyproj
from pcwlad_geo.raster.grid import Grid

Array = NDArray[np.float64]


def pixel_size_m(grid: Grid, at_px: tuple[float, float] | Array) -> tuple[float, float] | None:
    """Measure a pixel step along the columns' and the rows' axis.

    Parameters
    ----------
    grid : Grid
    at_px : (col, row)
        Where; it matters for a geographic CRS.

    Returns
    -------
    tuple of float or None
        Metres per step of one column and of one row; None without a CRS.
    """
    if grid.crs is None:
        return None
    centre = np.asarray(at_px, dtype=np.float64).reshape(1, 2)
    steps = np.array([[0.5, 0.0], [0.0, 0.5]])
    across = displacement_m(grid.to_xy(centre - steps), grid.to_xy(centre + steps), grid.crs)
    width_m, height_m = np.hypot(across[:, 0], across[:, 1]).tolist()
    return width_m, height_m


def middle_pixel_size_m(grid: Grid) -> tuple[float, float] | None:
    """Measure a pixel in the middle of a grid, see `pixel_size_m`."""
    rows, cols = grid.shape
    return pixel_size_m(grid, (cols / 2, rows / 2))


def displacement_m(xy_from: Array, xy_to: Array, crs: CRS | None) -> Array:
    """Measure the way from one point to another along the axes of a CRS.

    Parameters
    ----------
    xy_from, xy_to : (n, 2) arrays
        Map coordinates (x, y).
    crs : CRS or None

    Returns
    -------
    (n, 2) array
        Metres along x and y (east and north); on the ellipsoid for a geographic CRS; NaN without a CRS.
    """
    xy_from, xy_to = np.asarray(xy_from, dtype=np.float64), np.asarray(xy_to, dtype=np.float64)
    if crs is None:
        return np.full(xy_to.shape, np.nan)
    described = to_pyproj(crs)
    unit = described.axis_info[0].unit_conversion_factor if described.axis_info else 1.0
    if not described.is_geographic:
        return (xy_to - xy_from) * unit
    ellipsoid = described.get_geod()
    if ellipsoid is None:
        return np.full(xy_to.shape, np.nan)
    lon_from, lat_from = (xy_from * math.degrees(unit)).T
    lon_to, lat_to = (xy_to * math.degrees(unit)).T
    azimuth_deg, _, distance_m = ellipsoid.inv(lon_from, lat_from, lon_to, lat_to)
    azimuth = np.radians(azimuth_deg)
    return np.column_stack([distance_m * np.sin(azimuth), distance_m * np.cos(azimuth)])
