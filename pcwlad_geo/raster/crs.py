"""Coordinates from one CRS to another, and how far the transformation can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pyproj
from numpy.typing import NDArray
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup
from rasterio.crs import CRS
from rasterio.errors import CRSError

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.quiet import ignoring

Array = NDArray[np.float64]


@lru_cache(maxsize=64)
def to_pyproj(crs: CRS) -> pyproj.CRS:
    """Return the pyproj form of a rasterio CRS.

    Raises
    ------
    InputError
        If PROJ does not understand it.
    """
    try:
        # The code keeps what WKT 1 loses (datum ensembles), and with it the choice of transformation.
        code = crs.to_epsg()
        return pyproj.CRS.from_epsg(code) if code else pyproj.CRS.from_wkt(crs.to_wkt())
    except (ProjError, CRSError) as error:
        raise InputError(f"the CRS {name_of(crs)} is not understood: assign another one ({error})") from error


def name_of(crs: CRS | None) -> str:
    """Return a short name for messages: the code, or the name in the WKT."""
    if crs is None:
        return "no CRS"
    code = crs.to_epsg()
    if code:
        return f"EPSG:{code}"
    parts = crs.to_wkt().split('"')
    return f"'{parts[1]}'" if len(parts) > 1 else "without a name"


def utm_zone_of(lon_lat: Array) -> CRS:
    """Return the UTM zone (WGS 84) of a longitude and latitude, degrees; polar stereographic near a pole."""
    lon, lat = lon_lat.tolist()
    if abs(lat) > 84.0:
        return CRS.from_epsg(5041 if lat > 0 else 5042)
    zone = int((lon + 180.0) % 360.0 // 6.0) + 1
    return CRS.from_epsg((32600 if lat >= 0 else 32700) + zone)


def transform_xy(xy: Array, from_crs: CRS | None, to_crs: CRS | None) -> Array:
    """Map (n, 2) coordinates (x, y) of one CRS to another; NaN where that is impossible.

    Raises
    ------
    InputError
        If no transformation exists between the two.
    """
    xy = np.asarray(xy, dtype=np.float64)
    if from_crs == to_crs:
        return xy
    if from_crs is None or to_crs is None:
        raise InputError("cannot transform coordinates from or to a raster without a CRS: assign one")
    moved = np.column_stack(with_arrays(_transformer(from_crs, to_crs).transform, xy[:, 0], xy[:, 1]))
    return np.where(np.isfinite(moved), moved, np.nan)


def with_arrays(method: Callable[..., Sequence[Any]], *arrays: Array) -> tuple[Array, ...]:
    """Return what a method of pyproj makes of (n,) arrays, as arrays.

    Before 3.7.2, pyproj takes an array of one element for a number, of which NumPy warns.
    """
    given = [array.item() for array in arrays] if len(arrays[0]) == 1 else arrays
    return tuple(np.atleast_1d(np.asarray(made, dtype=np.float64)) for made in method(*given))


def transformation_warnings(from_crs: CRS | None, to_crs: CRS | None) -> tuple[str, ...]:
    """Say where the transformation between two CRSs may be off by metres.

    Raises
    ------
    InputError
        If no transformation exists between the two.
    """
    if from_crs is None or to_crs is None or from_crs == to_crs:
        return ()
    _transformer(from_crs, to_crs)
    with ignoring(UserWarning):  # pyproj's own words on missing grids
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
