"""Transformation of coordinates between CRSs, with warnings where it is inaccurate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pyproj
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup
from rasterio.crs import CRS
from rasterio.errors import CRSError

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.types import Float64


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
    """Map coordinates of one CRS to another.

    Raises `InputError` if no transformation exists between the two, or only one of them is None.

    Parameters
    ----------
    xy : (n, 2) array
        Coordinates (x, y) in the units of `from_crs`; longitude before latitude.
    from_crs, to_crs : CRS or None
        Equal CRSs, None included, leave the coordinates unchanged.

    Returns
    -------
    (n, 2) array
        Coordinates (x, y) in the units of `to_crs`; NaN where the transformation is not defined.
    """
    xy = np.asarray(xy, dtype=np.float64)
    if from_crs == to_crs:
        return xy
    if from_crs is None or to_crs is None:
        raise InputError("cannot transform coordinates from or to a raster without a CRS: assign one")
    moved = np.column_stack(with_arrays(_transformer(from_crs, to_crs).transform, xy[:, 0], xy[:, 1]))
    return np.where(np.isfinite(moved), moved, np.nan)


def with_arrays(method: Callable[..., Sequence[Any]], *arrays: Float64) -> tuple[Float64, ...]:
    """Call a `method` of pyproj on (n,) coordinate `arrays` and return its results as (n,) arrays.

    Units are those of the method. Before 3.7.2, pyproj converts an array of one element to a number, for
    which NumPy issues a warning; such an array is passed as a number.
    """
    given = [array.item() for array in arrays] if len(arrays[0]) == 1 else arrays
    return tuple(np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in method(*given))


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
    used = group.transformers[0] if group.transformers else None
    if used and any(step.has_ballpark_transformation for step in used.operations or ()):
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
