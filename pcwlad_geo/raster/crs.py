"""CRSs: transformations between them, with warnings where inaccurate, and lengths on the ground."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
import pyproj
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup
from rasterio.crs import CRS
from rasterio.errors import CRSError

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import solve
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class GroundParameters:
    """How lengths on the map and on the ground are converted into one another."""

    probe_m: float = 50.0
    """Length of the steps along the map's axes with which the ground length of a map unit is measured."""
    rounds: int = 4
    """Most iterations of the conversion from metres to map units; each reduces the error to the share by
    which the map's scale changes along the displacement."""
    tolerance_m: float = 1e-6
    """Error at which the iteration ends."""


GROUND: Final = GroundParameters()
"""Those in use."""
WGS84: Final = CRS.from_epsg(4326)
"""CRS of longitudes and latitudes, in this order in all arrays."""


@lru_cache(maxsize=64)
def to_pyproj(crs: CRS) -> pyproj.CRS:
    """Return the pyproj form of a rasterio CRS.

    Raises `InputError` if PROJ does not understand it.
    """
    try:
        # The code keeps what WKT 1 loses (datum ensembles), and with it the choice of transformation.
        code = crs.to_epsg()
        return pyproj.CRS.from_epsg(code) if code else pyproj.CRS.from_wkt(crs.to_wkt())
    except (ProjError, CRSError) as error:
        raise InputError(f"the CRS {name_of(crs)} is not understood: assign another one ({error})") from error


def name_of(crs: CRS | None) -> str:
    """Return a short name of a CRS for messages: its EPSG code, or the name in its WKT."""
    if crs is None:
        return "no CRS"
    code = crs.to_epsg()
    if code:
        return f"EPSG:{code}"
    parts = crs.to_wkt().split('"')
    return f"'{parts[1]}'" if len(parts) > 1 else "without a name"


def utm_zone_of(lon_lat: Float64) -> CRS:
    """Return the UTM zone (WGS 84) of `lon_lat`, a (2,) longitude and latitude in degrees.

    Beyond 84 degrees of latitude it is the polar stereographic CRS.
    """
    lon, lat = lon_lat.tolist()
    if abs(lat) > 84.0:
        return CRS.from_epsg(5041 if lat > 0 else 5042)
    zone = int((lon + 180.0) % 360.0 // 6.0) + 1
    return CRS.from_epsg((32600 if lat >= 0 else 32700) + zone)


def transform_xy(xy: Float64, from_crs: CRS | None, to_crs: CRS | None) -> Float64:
    """Map the (n, 2) coordinates `xy` of one CRS to another; equal CRSs, None included, leave them unchanged.

    They are (x, y) in the units of the CRS, longitude before latitude; those of the result, (n, 2), are NaN
    where the transformation is not defined. Raises `InputError` if no transformation exists between the two,
    or only one of them is None.
    """
    xy = np.asarray(xy, dtype=np.float64)
    if from_crs == to_crs:
        return xy
    if from_crs is None or to_crs is None:
        raise InputError("cannot transform coordinates from or to a raster without a CRS: assign one")
    xy = in_turn(xy, 0.0, turn_of(from_crs))  # PROJ finds operations by the longitudes from -180 to 180
    mapped_xy = np.column_stack(with_arrays(_transformer(from_crs, to_crs).transform, xy[:, 0], xy[:, 1]))
    return np.where(np.isfinite(mapped_xy), mapped_xy, np.nan)


@lru_cache(maxsize=64)
def turn_of(crs: CRS | None) -> float:
    """Return by how many map units x grows in one turn around the earth.

    It is infinite where that is no place on the map again: in all but geographic CRSs and cylindrical
    projections, in which x is proportional to the longitude at every latitude.
    """
    if crs is None:
        return math.inf
    described = to_pyproj(crs)
    if described.is_geographic:
        return 2 * math.pi / _unit(described)
    if described.geodetic_crs is None or not described.is_projected:
        return math.inf
    to_map = pyproj.Transformer.from_crs(described.geodetic_crs, described, always_xy=True)
    lon, lat = np.meshgrid([-119.0, 1.0, 61.0], [-50.0, 0.0, 37.0])
    with np.errstate(invalid="ignore"):
        degree = np.abs(np.subtract(to_map.transform(lon, lat)[0], to_map.transform(lon - 1.0, lat)[0]))
    return 360.0 * float(degree[0, 0]) if np.ptp(degree) <= 1e-9 * degree[0, 0] else math.inf


def in_turn(xy: Float64, x: float, turn: float) -> Float64:
    """Return the (n, 2) map coordinates `xy`, whole turns around the earth added: each is nearest `x`.

    What is half a turn away, but for rounding, stays as it is: the edge of a map of the whole earth.
    """
    if math.isinf(turn):
        return xy
    return np.column_stack([xy[:, 0] - turn * np.rint((xy[:, 0] - x) / turn * (1 - 1e-9)), xy[:, 1]])


def with_arrays(method: Callable[..., Sequence[Any]], *arrays: Float64) -> tuple[Float64, ...]:
    """Call a `method` of pyproj on (n,) coordinate `arrays` and return its results as (n,) arrays.

    Units are those of the method. Before 3.7.2, pyproj converts an array of one element to a number, for
    which NumPy issues a warning; such an array is passed as a number.
    """
    arguments = [array.item() for array in arrays] if len(arrays[0]) == 1 else arrays
    return tuple(np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in method(*arguments))


def transformation_warnings(from_crs: CRS | None, to_crs: CRS | None) -> tuple[str, ...]:
    """Return warnings where the transformation between `from_crs` and `to_crs` may be off by metres.

    Raises `InputError` if no transformation exists between the two.
    """
    if from_crs is None or to_crs is None or from_crs == to_crs:
        return ()
    _transformer(from_crs, to_crs)
    with ignoring(UserWarning):  # pyproj's own warning about missing grids
        group = TransformerGroup(to_pyproj(from_crs), to_pyproj(to_crs), always_xy=True)
    pair = f"from {name_of(from_crs)} to {name_of(to_crs)}"
    operation = group.transformers[0] if group.transformers else None
    if operation and any(step.has_ballpark_transformation for step in operation.operations or ()):
        return (f"the transformation {pair} is a ballpark one: it may be hundreds of metres off",)
    if not group.best_available:
        return (f"the best transformation {pair} needs a grid that is missing here: it may be metres off",)
    return ()


@lru_cache(maxsize=64)
def _transformer(from_crs: CRS, to_crs: CRS) -> pyproj.Transformer:
    try:
        return pyproj.Transformer.from_crs(to_pyproj(from_crs), to_pyproj(to_crs), always_xy=True)
    except ProjError as error:
        raise InputError(
            f"cannot transform coordinates from {name_of(from_crs)} to {name_of(to_crs)}: "
            f"give both rasters a CRS that PROJ can relate"
        ) from error


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
    step = in_turn(step, 0.0, turn_of(crs))
    return ground.along_m(xy_from, step, ground.stretch(xy_from + step / 2))


def moved_xy(xy: Float64, along_m: Float64, crs: CRS) -> Float64:
    """Return the (n, 2) ends of displacements on the ground: the inverse of `displacement_m`.

    They start at the (n, 2) map coordinates `xy` (x, y), in units of the CRS, and have the (n, 2) metres
    `along_m` along x and y.
    """
    ground = _ground_of(crs)
    if ground is None:
        return xy + along_m / _unit(to_pyproj(crs))
    step = np.zeros_like(xy)
    for _ in range(GROUND.rounds):
        stretch = ground.stretch(xy + step / 2)
        missing_m = along_m - ground.along_m(xy, step, stretch)
        step = step + solve(stretch, missing_m[..., None])[..., 0]
        if not np.nanmax(np.abs(missing_m), initial=0.0) > GROUND.tolerance_m:
            break
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
        metres = 111e3 * self._degrees if described.is_geographic else _unit(described)
        self._probe = GROUND.probe_m / metres

    def length_m(self, xy_from: Float64, xy_to: Float64) -> Float64:
        """Return the lengths (n,) of geodesics between (n, 2) map coordinates."""
        (lon_from, lat_from), (lon_to, lat_to) = self._lon_lat(xy_from), self._lon_lat(xy_to)
        return with_arrays(self._ellipsoid.inv, lon_from, lat_from, lon_to, lat_to)[2]

    def along_m(self, xy: Float64, step: Float64, stretch: Float64) -> Float64:
        """Return (n, 2) metres along the axes of (n, 2) steps from `xy`, by the `stretch` at their middle."""
        along: Float64 = np.einsum("nij,nj->ni", stretch, step)
        length, as_long = self.length_m(xy, xy + step), np.hypot(along[:, 0], along[:, 1])
        exact = np.divide(length, as_long, out=np.ones_like(length), where=as_long > 0)
        return along * exact[:, None]

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
        defined = np.isfinite(lon) & np.isfinite(lat)
        return np.where(defined, lon, np.nan), np.where(defined, lat, np.nan)


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
