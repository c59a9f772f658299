"""Lengths on the ground: pixel sizes and displacements in metres, on the ellipsoid of whatever CRS."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pyproj
from numpy.typing import NDArray
from pyproj.exceptions import ProjError
from rasterio.crs import CRS

from pcwlad_geo.raster.crs import to_pyproj, with_arrays
from pcwlad_geo.raster.grid import Grid

Array = NDArray[np.float64]

_PROBE_M = 50.0
"""Length of the steps along the map's axes that tell how long a map unit is on the ground."""
_ROUNDS = 4
"""Of the way from metres back to map units; each leaves a share of the error as small as the share by which
the map's scale changes along the way."""


def pixel_size_m(grid: Grid, at_px: tuple[float, float] | Array) -> tuple[float, float] | None:
    """Measure a pixel step along the columns' and the rows' axis on the ground.

    Parameters
    ----------
    grid : Grid
    at_px : (col, row)
        Where: the scale of a map changes from place to place.

    Returns
    -------
    tuple of float or None
        Metres per step of one column and of one row; None without a CRS.
    """
    sizes = pixel_sizes_m(grid, np.asarray(at_px, dtype=np.float64).reshape(1, 2))
    return None if sizes is None else (float(sizes[0, 0]), float(sizes[0, 1]))


def pixel_sizes_m(grid: Grid, at_px: Array) -> Array | None:
    """Measure the pixels of a grid at (n, 2) positions (col, row), see `pixel_size_m`.

    Returns
    -------
    (n, 2) array or None
        Metres per step of one column and of one row; None without a CRS.
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
    """Measure a pixel in the middle of a grid, see `pixel_size_m`."""
    rows, cols = grid.shape
    return pixel_size_m(grid, (cols / 2, rows / 2))


def displacement_m(xy_from: Array, xy_to: Array, crs: CRS | None) -> Array:
    """Measure the way from one point to another on the ground, along the axes of a CRS.

    The length is that of the geodesic. Its direction is that of the map, stretched as the map's scale along
    and across its axes demands (the symmetric square root of the metric tensor at the middle of the way): the
    direction in the map itself where the projection is conformal, east and north for a geographic CRS.

    Parameters
    ----------
    xy_from, xy_to : (n, 2) arrays
        Map coordinates (x, y).
    crs : CRS or None

    Returns
    -------
    (n, 2) array
        Metres along x and y; NaN without a CRS. Where the CRS has no ellipsoid, the map is taken for the
        ground.
    """
    xy_from, xy_to = np.asarray(xy_from, dtype=np.float64), np.asarray(xy_to, dtype=np.float64)
    if crs is None:
        return np.full(xy_to.shape, np.nan)
    ground = _ground_of(crs)
    step = xy_to - xy_from
    if ground is None:
        return np.asarray(step * _unit(to_pyproj(crs)))
    step = ground.shortest(step)
    along: Array = np.einsum("nij,nj->ni", ground.stretch(xy_from + step / 2), step)
    length, as_long = ground.length_m(xy_from, xy_to), np.hypot(along[:, 0], along[:, 1])
    exact = np.divide(length, as_long, out=np.ones_like(length), where=as_long > 0)
    return np.asarray(along * exact[:, None])


def moved_xy(xy: Array, along_m: Array, crs: CRS) -> Array:
    """Return where ways on the ground lead to: the inverse of `displacement_m`.

    Parameters
    ----------
    xy : (n, 2) array
        Map coordinates (x, y) that the ways start from.
    along_m : (n, 2) array
        Metres along x and y, as `displacement_m` returns them.
    crs : CRS

    Returns
    -------
    (n, 2) array
        Map coordinates.
    """
    ground = _ground_of(crs)
    if ground is None:
        return np.asarray(xy + along_m / _unit(to_pyproj(crs)))
    step = np.zeros_like(xy)
    for _ in range(_ROUNDS):
        missing_m = along_m - displacement_m(xy, xy + step, crs)
        step = step + np.linalg.solve(ground.stretch(xy + step / 2), missing_m[..., None])[..., 0]
    return np.asarray(xy + step)


class _Ground:
    """The ellipsoid below a map."""

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

    def shortest(self, step: Array) -> Array:
        """Return map steps the short way round the earth, where x is a longitude."""
        if math.isinf(self._round):
            return step
        return step - np.column_stack([np.rint(step[:, 0] / self._round) * self._round, 0.0 * step[:, 1]])

    def length_m(self, xy_from: Array, xy_to: Array) -> Array:
        """Return the lengths (n,) of geodesics between (n, 2) map coordinates."""
        (lon_from, lat_from), (lon_to, lat_to) = self._lon_lat(xy_from), self._lon_lat(xy_to)
        return with_arrays(self._ellipsoid.inv, lon_from, lat_from, lon_to, lat_to)[2]

    def stretch(self, xy: Array) -> Array:
        """Return (n, 2, 2): metres on the ground by map unit, symmetric, at (n, 2) map coordinates.

        The lengths of the two axes and of a diagonal are the metric tensor; this is its square root.
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

    def _lon_lat(self, xy: Array) -> tuple[Array, Array]:
        """Return longitudes and latitudes, degrees; NaN where the projection has none."""
        x, y = xy[:, 0], xy[:, 1]
        if self._to_lon_lat is not None:
            x, y = with_arrays(self._to_lon_lat.transform, x, y)
        lon, lat = np.asarray(x) * self._degrees, np.asarray(y) * self._degrees
        known = np.isfinite(lon) & np.isfinite(lat)
        return np.where(known, lon, np.nan), np.where(known, lat, np.nan)


@lru_cache(maxsize=64)
def _ground_of(crs: CRS) -> _Ground | None:
    """Return the ellipsoid below a map; None for a plane that lies on none."""
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
