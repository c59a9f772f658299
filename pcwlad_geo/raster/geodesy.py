"""Lengths on the ground: pixel sizes and displacements in metres, on the ellipsoid of any CRS."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pyproj
from pyproj.exceptions import ProjError
from rasterio.crs import CRS

from pcwlad_geo.estimation.solving import solve
from pcwlad_geo.raster.crs import to_pyproj, with_arrays
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.types import Float64

_PROBE_M = 50.0
"""Length of the steps along the map's axes with which the ground length of a map unit is measured."""
_ROUNDS = 4
"""Iterations of the conversion from metres to map units; each reduces the error to the share by which the
map's scale changes along the displacement."""


def pixel_size_m(grid: Grid, at_px: tuple[float, float] | Float64) -> tuple[float, float] | None:
    """Measure the ground length of one pixel along the column and the row axis.

    Metres are returned, None without a CRS. The scale of a map varies, so they hold at `at_px`, a (2,)
    position (col, row).
    """
    sizes = pixel_sizes_m(grid, np.asarray(at_px, dtype=np.float64).reshape(1, 2))
    return None if sizes is None else (float(sizes[0, 0]), float(sizes[0, 1]))


def pixel_sizes_m(grid: Grid, at_px: Float64) -> Float64 | None:
    """Return the (n, 2) sizes of the pixels of a grid at the (n, 2) `at_px` (col, row), see `pixel_size_m`.

    They are metres per step of one column and of one row; None without a CRS.
    """
    if grid.crs is None:
        return None
    at_px = np.asarray(at_px, dtype=np.float64)
    sides = []
    for step in np.array([[0.5, 0.0], [0.0, 0.5]]):
        across = displacement_m(grid.to_xy(at_px - step), grid.to_xy(at_px + step), grid.crs)
        sides.append(np.hypot(across[:, 0], across[:, 1]))
    return np.column_stack(sides)


def middle_pixel_size_m(grid: Grid) -> tuple[float, float] | None:
    """Return the pixel size in the middle of a grid, metres (column, row), see `pixel_size_m`."""
    return pixel_size_m(grid, grid.middle_px)


def displacement_m(xy_from: Float64, xy_to: Float64, crs: CRS | None) -> Float64:
    """Return displacements between points on the ground, metres along the axes of a CRS.

    The length is that of the geodesic. The direction is that of the displacement on the map, multiplied by
    the symmetric square root of the metric tensor at its middle: the direction on the map itself where the
    projection is conformal, east and north for a geographic CRS. The (n, 2) arrays `xy_from` and `xy_to` are
    map coordinates (x, y) in the units of the CRS, and the result is (n, 2) metres along x and y, NaN without
    a CRS. Where the CRS has no ellipsoid, map lengths count as ground lengths.
    """
    xy_from, xy_to = np.asarray(xy_from, dtype=np.float64), np.asarray(xy_to, dtype=np.float64)
    if crs is None:
        return np.full(xy_to.shape, np.nan)
    ground = _ground_of(crs)
    step = xy_to - xy_from
    if ground is None:
        return step * _unit(to_pyproj(crs))
    step = ground.shortest(step)
    along: Float64 = np.einsum("nij,nj->ni", ground.stretch(xy_from + step / 2), step)
    length, as_long = ground.length_m(xy_from, xy_to), np.hypot(along[:, 0], along[:, 1])
    exact = np.divide(length, as_long, out=np.ones_like(length), where=as_long > 0)
    return along * exact[:, None]


def moved_xy(xy: Float64, along_m: Float64, crs: CRS) -> Float64:
    """Return the (n, 2) ends of displacements on the ground: the inverse of `displacement_m`.

    They start at the (n, 2) map coordinates `xy` (x, y), in units of the CRS, and have the (n, 2) metres
    `along_m` along x and y.
    """
    ground = _ground_of(crs)
    if ground is None:
        return xy + along_m / _unit(to_pyproj(crs))
    step = np.zeros_like(xy)
    for _ in range(_ROUNDS):
        missing_m = along_m - displacement_m(xy, xy + step, crs)
        step = step + solve(ground.stretch(xy + step / 2), missing_m[..., None])[..., 0]
    return xy + step


class _Ground:
    """Lengths on the ellipsoid of a CRS."""

    def __init__(self, described: pyproj.CRS, geographic: pyproj.CRS, ellipsoid: pyproj.Geod) -> None:
        self._ellipsoid = ellipsoid
        self._to_lon_lat = (
            None
            if described.is_geographic
            else pyproj.Transformer.from_crs(described, geographic, always_xy=True)
        )
        self._degrees = math.degrees(_unit(geographic))
        # a degree of a meridian is 111 km, within 1 %
        self._probe = _PROBE_M / (111e3 * self._degrees if described.is_geographic else _unit(described))
        self._round = 360.0 / self._degrees if described.is_geographic else math.inf

    def shortest(self, step: Float64) -> Float64:
        """Return (n, 2) map steps, those in longitude reduced to at most half a turn."""
        if math.isinf(self._round):
            return step
        return step - np.column_stack([np.rint(step[:, 0] / self._round) * self._round, 0.0 * step[:, 1]])

    def length_m(self, xy_from: Float64, xy_to: Float64) -> Float64:
        """Return the lengths (n,) of geodesics between (n, 2) map coordinates."""
        (lon_from, lat_from), (lon_to, lat_to) = self._lon_lat(xy_from), self._lon_lat(xy_to)
        return with_arrays(self._ellipsoid.inv, lon_from, lat_from, lon_to, lat_to)[2]

    def stretch(self, xy: Float64) -> Float64:
        """Return the (n, 2, 2) symmetric matrices of metres on the ground per map unit at (n, 2) `xy`.

        They are the square roots of the metric tensor, which is measured along both axes and both diagonals.
        """
        along_x, along_y = np.array([self._probe, 0.0]) / 2, np.array([0.0, self._probe]) / 2
        x, y, up, down = (
            (self.length_m(xy - half, xy + half) / self._probe) ** 2
            for half in (along_x, along_y, along_x + along_y, along_x - along_y)
        )
        across = (up - down) / 4
        # of a 2 x 2 matrix M, by Cayley-Hamilton: (M + sqrt(det M)) / sqrt(trace M + 2 sqrt(det M))
        area = np.sqrt(np.maximum(x * y - across**2, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.array([[x + area, across], [across, y + area]]) / np.sqrt(x + y + 2 * area)
        return np.moveaxis(root, 2, 0)

    def _lon_lat(self, xy: Float64) -> tuple[Float64, Float64]:
        """Return (n,) longitudes and latitudes, degrees; NaN where the projection is not defined."""
        x, y = xy[:, 0], xy[:, 1]
        if self._to_lon_lat is not None:
            x, y = with_arrays(self._to_lon_lat.transform, x, y)
        lon, lat = np.asarray(x) * self._degrees, np.asarray(y) * self._degrees
        known = np.isfinite(lon) & np.isfinite(lat)
        return np.where(known, lon, np.nan), np.where(known, lat, np.nan)


@lru_cache(maxsize=64)
def _ground_of(crs: CRS) -> _Ground | None:
    """Return the ellipsoid of a CRS; None for a CRS without one."""
    described = to_pyproj(crs)
    geographic, ellipsoid = described.geodetic_crs, described.get_geod()
    if geographic is None or ellipsoid is None or described.is_geocentric:
        return None
    try:
        return _Ground(described, geographic, ellipsoid)
    except ProjError:
        return None


def _unit(described: pyproj.CRS) -> float:
    """Return metres, or radians, per unit of the first axis."""
    return described.axis_info[0].unit_conversion_factor if described.axis_info else 1.0
