"""What the heights of a DEM are above: the ellipsoid, or a geoid, and how far that is from the ellipsoid."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import numpy as np
import pyproj
from numpy.typing import NDArray
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import name_of, to_pyproj, with_arrays
from pcwlad_geo.raster.dem import Dem, Undulation
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.quiet import ignoring
from pcwlad_geo.raster.source import RasterInfo, describe, open_raster

Array = NDArray[np.float64]
Bounds = tuple[float, float, float, float]
Vertical = float | str | os.PathLike[str] | None

STEP_DEG: Final = 0.02
"""Between the nodes of an undulation; geoid grids have 0.016 to 0.25."""
ELLIPSOIDAL: Final = pyproj.CRS.from_epsg(4979)
_UNITS_M: Final = {
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), 0.3048),
    **dict.fromkeys(("us survey foot", "us-ft", "ftus", "us foot", "foot_us"), 1200 / 3937),
}


def open_dem(path: str | os.PathLike[str], vertical: Vertical, bounds: Bounds) -> Dem:
    """Describe a DEM and find out what its heights are above.

    Parameters
    ----------
    path : path-like or GDAL URI
        Band 1 holds the heights, in metres unless its CRS or its unit says feet.
    vertical : float, path-like or None
        Metres between the ellipsoid and what the heights are above (a geoid's undulation; 0: they are
        above the ellipsoid), a raster of them, or None: the DEM's own CRS tells.
    bounds : (west, south, east, north)
        Of the scene, degrees.

    Raises
    ------
    InputError
        If the DEM cannot be used, or the heights' datum is not known or cannot be transformed.
    """
    info = describe(path)
    if not info.georeferenced or info.grid.crs is None:
        raise InputError(f"the DEM {info.uri} has no georeferencing (CRS and geotransform): assign it")
    crs = to_pyproj(info.grid.crs)
    return Dem(
        info.uri,
        Grid(info.grid.shape, info.grid.transform, _horizontal(info.grid.crs, crs)),
        _metres_per_unit(info, crs),
        _undulation(info, crs, vertical, bounds),
    )


def _horizontal(crs: CRS, described: pyproj.CRS) -> CRS:
    if not described.is_compound:
        return crs
    horizontal = described.sub_crs_list[0]
    code = horizontal.to_epsg()
    return CRS.from_epsg(code) if code else CRS.from_wkt(horizontal.to_wkt())


def _metres_per_unit(info: RasterInfo, crs: pyproj.CRS) -> float:
    vertical = crs.sub_crs_list[1] if crs.is_compound else crs
    up = [axis for axis in vertical.axis_info if axis.direction == "up"]
    if up:
        return float(up[0].unit_conversion_factor)
    with open_raster(info.uri) as dataset:
        unit = (dataset.units[0] or "").strip().lower()
    return _UNITS_M.get(unit, 1.0)


def _undulation(info: RasterInfo, crs: pyproj.CRS, vertical: Vertical, bounds: Bounds) -> Undulation:
    if isinstance(vertical, int | float):
        return Undulation.constant(vertical)
    if vertical is not None:
        return _from_grid(os.fspath(vertical), bounds)
    if crs.is_compound:
        return _from_crs(info, crs, bounds)
    if any(axis.direction == "up" for axis in crs.axis_info):  # three-dimensional: ellipsoidal
        return Undulation.constant(0.0)
    raise InputError(
        f"the CRS of the DEM {info.uri} ({name_of(info.grid.crs)}) does not say what its heights are above: "
        "give --dem-vertical 0 if it is the WGS 84 ellipsoid, else the geoid's height above the ellipsoid "
        "there in metres (about -100 to 85), or a geoid grid file"
    )


def _from_grid(path: str, bounds: Bounds) -> Undulation:
    """Sample a file of undulations, whose longitudes may run to 180 or to 360 degrees."""
    if not Path(path).exists() and ":" not in path and not path.startswith("/vsi"):
        raise InputError(f"--dem-vertical {path}: neither a number of metres nor a file that exists")
    info = describe(path)
    if not info.georeferenced:
        raise InputError(f"the geoid grid {path} has no georeferencing (CRS and geotransform): assign it")
    geoid = Dem(info.uri, info.grid, 1.0, Undulation.constant(0.0))

    def at(lon_lat: Array) -> Array:
        found = geoid.at(lon_lat)
        for turn in (360.0, -360.0):
            if info.grid.crs is not None and info.grid.crs.is_geographic:
                around = geoid.at_px(info.grid.to_px(lon_lat + np.array([turn, 0.0])), lon_lat)
                found = np.where(np.isnan(found), around, found)
        return found

    undulation = Undulation.sampled(at, bounds, STEP_DEG)
    if not np.isfinite(undulation.values_m).all():
        raise InputError(
            f"the geoid grid {path} does not cover the target ({_in_words(bounds)}): give one that does, or "
            "the undulation in metres"
        )
    if np.abs(undulation.values_m).max() > 150.0:
        raise InputError(
            f"the geoid grid {path} holds {np.abs(undulation.values_m).max():.0f} m: no geoid is as far from "
            "the ellipsoid; give a file of undulations, not of heights"
        )
    return undulation


def _from_crs(info: RasterInfo, crs: pyproj.CRS, bounds: Bounds) -> Undulation:
    """Let PROJ tell how far the vertical datum is from the ellipsoid, if it really knows."""
    advice = (
        "give --dem-vertical: the geoid's height above the ellipsoid there in metres, or a geoid grid file"
    )
    what = f"the heights of the DEM {info.uri} ({crs.name}) cannot be transformed to the ellipsoid"
    # from geographic coordinates: only the vertical part is wanted
    geographic = pyproj.CRS.from_epsg(4326)
    source = pyproj.crs.CompoundCRS("DEM", [geographic, crs.sub_crs_list[1]])
    try:
        with ignoring(UserWarning):  # pyproj's own words on missing grids
            group = TransformerGroup(source, ELLIPSOIDAL, always_xy=True, allow_ballpark=False)
    except ProjError as error:
        raise InputError(f"{what}: {error}; {advice}") from error
    if not group.transformers:
        grids = sorted({grid.short_name for op in group.unavailable_operations for grid in op.grids})
        missing = f"PROJ lacks the grid {' or '.join(grids)}" if grids else "PROJ knows no transformation"
        raise InputError(f"{what}: {missing} (a ballpark one would be off by the undulation); {advice}")
    transformer = group.transformers[0]

    def at(lon_lat: Array) -> Array:
        return with_arrays(transformer.transform, lon_lat[:, 0], lon_lat[:, 1], np.zeros(len(lon_lat)))[2]

    undulation = Undulation.sampled(at, bounds, STEP_DEG)
    if not np.isfinite(undulation.values_m).all():
        raise InputError(f"{what} at {_in_words(bounds)}; {advice}")
    return undulation


def _in_words(bounds: Bounds) -> str:
    west, south, east, north = bounds
    return f"longitude {west:.4f} to {east:.4f}, latitude {south:.4f} to {north:.4f}"
