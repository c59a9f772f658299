"""Images in memory, whatever holds them: their pixels in plain arrays, masked where they do not count."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final, TypeGuard

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.types import Bool

NODATA_NAMES: Final = ("_FillValue", "missing_value", "nodata", "nodatavals")
"""Attributes and encodings of xarray, rioxarray and rasterio that hold the value of what is not valid."""


def is_array(image: object) -> TypeGuard[NDArray[Any]]:
    """Return whether NumPy reads this as a (…,) array: of NumPy, dask, xarray and others; lists are none."""
    return all(hasattr(image, name) for name in ("__array__", "dtype", "shape"))


def pixels_of(image: object) -> NDArray[Any]:
    """Return the pixels of an array, a DataArray or a `Raster`, of native byte order and row by row.

    The (…, rows, cols) pixels are a masked array where a mask, an attribute or an encoding says that some do
    not count. NaN is for the caller. Raises `InputError` if this is no array.
    """
    values: Any = getattr(image, "array", image)
    while hasattr(
        values, "compute"
    ):  # xarray gives what it holds, dask its result, with the mask that it has
        values = values.data if hasattr(values, "dims") else values.compute()
    if not is_array(values):
        raise InputError(f"{type(image).__name__} is no array: give one of NumPy, dask or xarray")
    values = values if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
    native = np.ascontiguousarray(np.ma.getdata(values), dtype=values.dtype.newbyteorder("="))
    mask = np.broadcast_to(np.ma.getmaskarray(values), native.shape)
    if native.dtype.kind in "uif":
        for nodata in _nodata_values(image):
            mask = mask | equals_nodata(native, nodata)
    return np.ma.masked_array(native, mask) if mask.any() else native


def nodata_of(image: object, dtype: np.dtype[Any]) -> float | None:
    """Return the first value of what is not valid that a data type holds; None if there is none."""
    limits = (-np.inf, np.inf) if dtype.kind == "f" else (np.iinfo(dtype).min, np.iinfo(dtype).max)
    candidates = (value for value in _nodata_values(image) if dtype.kind == "f" or value.is_integer())
    return next((value for value in candidates if np.isnan(value) or limits[0] <= value <= limits[1]), None)


def _nodata_values(image: object) -> Iterator[float]:
    """Yield what is stated as not valid; of packed values, which are unpacked already, it is NaN."""
    attributes, encoding = (getattr(image, name, {}) for name in ("attrs", "encoding"))
    places = [attributes, {"nodata": getattr(image, "nodata", None)}]
    places += [] if {"scale_factor", "add_offset"} & set(encoding) else [encoding]
    for place in places:
        for name in NODATA_NAMES if isinstance(place, Mapping) else ():
            try:
                values = np.ravel(np.array(place.get(name)))
                yield from (float(value) for value in values if value is not None)
            except (TypeError, ValueError, OverflowError) as error:
                raise InputError(f"{name} = {place[name]!r:.99} of an image: give a number") from error


def equals_nodata(values: NDArray[np.generic], nodata: float | None) -> Bool:
    """Return which of the (…,) `values` are nodata, (…,) bool.

    Whole numbers may not be able to hold the value of `nodata`. Numbers of 64 bits may have been written as
    ones of 32, or declared so.
    """
    if nodata is None or np.isnan(nodata):
        return np.zeros(values.shape, dtype=bool)
    if np.issubdtype(values.dtype, np.integer):
        limits = np.iinfo(str(values.dtype))
        if not float(nodata).is_integer() or not limits.min <= nodata <= limits.max:
            return np.zeros(values.shape, dtype=bool)
        return np.asarray(values == values.dtype.type(int(nodata)))
    with np.errstate(over="ignore"):
        rounded = values.dtype.type if values.dtype.itemsize < 8 else np.float32
        return np.asarray(values.astype(rounded, copy=False) == rounded(nodata))
