"""What a raster may be given as: NumPy arrays, xarray.DataArrays and open datasets, and the way back."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any, Final, Protocol, TypeAlias, TypeGuard

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError
from pcwlad_geo.in_memory import is_array, nodata_of, pixels_of
from pcwlad_geo.raster.grid import Grid, apply, apply_inverse
from pcwlad_geo.raster.raster import Raster, type_name
from pcwlad_geo.types import PathLike

X_NAMES: Final = ("x", "lon", "longitude")
"""Dimensions of a DataArray that are columns."""
Y_NAMES: Final = ("y", "lat", "latitude")
"""Dimensions of a DataArray that are rows."""
_WIDER: Final = ("uint8", "int8", "uint16", "int16")
"""Whole numbers that float32 holds exactly."""


class DataArrayLike(Protocol):
    """What is used of an `xarray.DataArray`, which need not be installed."""

    @property
    def dims(self) -> tuple[Hashable, ...]:
        """Names of the axes."""

    @property
    def coords(self) -> Mapping[Any, Any]:
        """Coordinates by name, `spatial_ref` among them."""

    @property
    def attrs(self) -> Mapping[Any, Any]:
        """Attributes, `_FillValue` among them."""

    @property
    def values(self) -> NDArray[Any]:
        """The pixels, (rows, cols) or (bands, rows, cols) as `dims` says, of any dtype."""

    @property
    def encoding(self) -> Mapping[Any, Any]:
        """How it was stored, and the name of the coordinate with the CRS."""

    @property
    def name(self) -> Hashable | None:
        """Its name."""


RasterLike: TypeAlias = (
    PathLike | DatasetReader | NDArray[Any] | tuple[NDArray[Any], Grid] | Raster | DataArrayLike
)
"""What a raster may be given as: a path or GDAL URI, an open rasterio dataset, a NumPy array, an array and
its `Grid`, a `Raster`, an `xarray.DataArray` with the coordinates that rioxarray gives it."""


def is_dataset(raster: object) -> TypeGuard[DatasetReader]:
    """Return whether this is a dataset of rasterio, a WarpedVRT included; a closed one has no profile."""
    return all(hasattr(type(raster), name) for name in ("read", "profile", "dataset_mask", "closed"))


def is_data_array(raster: object) -> TypeGuard[DataArrayLike]:
    """Return whether this is an `xarray.DataArray`; its pixels, which may be computed late, are not asked."""
    return is_array(raster) and all(hasattr(raster, name) for name in ("dims", "coords", "attrs", "encoding"))


def to_raster(raster: object) -> Raster:
    """Return an array or a DataArray as a `Raster`.

    Raises `InputError` if it is neither, or its axes or coordinates are not those of a raster.
    """
    if isinstance(raster, Raster):
        return raster
    if isinstance(raster, tuple) and len(raster) == 2 and isinstance(raster[1], Grid):
        return Raster(*raster)
    if is_data_array(raster):
        return _from_data_array(raster)
    if is_array(raster):
        return Raster(raster)
    raise InputError(
        f"{type_name(raster)} is no raster: give a path, an open rasterio dataset, a NumPy array, "
        "pcwlad_geo.Raster(array, transform, crs), or an xarray.DataArray"
    )


def _from_data_array(data: DataArrayLike) -> Raster:
    """Return a DataArray as a raster, placed by its coordinates and its `spatial_ref`."""
    values = pixels_of(data)
    if values.ndim not in (2, 3) or str(data.dims[-1]) not in X_NAMES or str(data.dims[-2]) not in Y_NAMES:
        raise InputError(
            f"a DataArray with the dimensions {', '.join(map(str, data.dims)) or 'none'} is no raster: they "
            "must be (y, x) or (band, y, x) (transpose, isel)"
        )
    return Raster(values, *georeferencing_of(data), nodata_of(data, values.dtype))


def georeferencing_of(data: DataArrayLike) -> tuple[Affine | None, object]:
    """Return the geotransform and the CRS of a DataArray whose last axes are rows and columns.

    Its pixels are not read. The CRS is that of its `spatial_ref`, or of the coordinate `epsg` of stackstac.
    Raises `InputError` if the coordinates are not evenly spaced.
    """
    name = _mapping_name(data)
    place: Mapping[Any, Any] = data.coords[name].attrs if name in data.coords else {}
    text: object = place.get("crs_wkt") or place.get("spatial_ref")
    if text is None and "epsg" in data.coords and np.ndim(data.coords["epsg"].values) == 0:
        text = f"EPSG:{int(data.coords['epsg'].values)}"
    return _transform_of(data, place), text


def _mapping_name(data: DataArrayLike) -> str:
    """Return the name of the coordinate that holds the CRS."""
    return str(data.encoding.get("grid_mapping", data.attrs.get("grid_mapping", "spatial_ref")))


def _transform_of(data: DataArrayLike, place: Mapping[Any, Any]) -> Affine | None:
    """Return the geotransform: of the coordinates, which a cut moves, else the one that is written down."""
    text = place.get("GeoTransform")
    written = None if text is None else Affine.from_gdal(*map(float, str(text).split()))
    if written is not None and (written.b or written.d):
        return written
    axes = []
    for name in (data.dims[-1], data.dims[-2]):
        centres = np.asarray(data.coords[name].values, dtype=float) if name in data.coords else np.empty(0)
        if centres.ndim != 1 or len(centres) < 2:
            return written
        step = (centres[-1] - centres[0]) / (len(centres) - 1)
        even = np.abs(np.diff(centres) - step).max() <= 1e-3 * abs(step)
        if step == 0 or not even:
            raise InputError(
                f"the coordinate {name} of the DataArray is not evenly spaced: resample it to a regular grid"
            )
        axes.append((step, centres[0] - step / 2 + _to_centres(data, name) * step, len(centres)))
    (a, c, cols), (e, f, rows) = axes
    from_axes = Affine(a, 0.0, float(c), 0.0, e, float(f))
    if written is None:
        return from_axes
    corners_px = np.array([[0.0, 0.0], [cols, rows]])
    off_px = np.abs(apply_inverse(from_axes, apply(written, corners_px)) - corners_px).max()
    return written if off_px <= 1e-6 else from_axes  # rounding of the coordinates


def _to_centres(data: DataArrayLike, name: Hashable) -> float:
    """Return how far coordinates lie before the centres of pixels: half a px by stackstac's default."""
    grid = data.attrs.get("transform")
    if "epsg" not in data.coords or not isinstance(grid, Affine):
        return 0.0
    origin, step = (grid.c, grid.a) if str(name) in X_NAMES else (grid.f, grid.e)
    off = (float(data.coords[name].values[0]) - origin) / step
    return 0.5 if abs(off - round(off)) < 0.25 else 0.0


def like_the_source(raster: Raster, source: object, like: object = None) -> object:
    """Return a warped raster as its source was given: `Raster`, DataArray or masked array.

    The raster is of (bands, rows, cols), masked where nothing is known; of an array of (rows, cols) it comes
    back as such. Of `like`, a DataArray on the same pixels, a DataArray gets the very coordinates.
    """
    if not is_array(source):
        is_flat = _is_flat(source) and raster.source is None and raster.array.ndim == 3
        return Raster(raster.array[0], raster.grid, nodata=raster.nodata) if is_flat else raster
    array = raster.array if raster.array.ndim == 3 else raster.array[None]
    raster = Raster(array[0] if _is_flat(source) else array, raster.grid, nodata=raster.nodata)
    return _to_data_array(raster, source, like) if is_data_array(source) else raster.array


def _is_flat(source: object) -> bool:
    """Return whether the pixels of a raster are (rows, cols)."""
    if isinstance(source, tuple):
        source = source[0]
    if isinstance(source, Raster):
        return source.count == 1 if source.source is not None else source.array.ndim == 2
    return not is_dataset(source) and len(getattr(source, "shape", ())) == 2


def _to_data_array(raster: Raster, source: DataArrayLike, like: object) -> DataArrayLike:
    """Return a DataArray like another one, on the grid of a raster."""
    values = _filled(raster)
    transform = raster.transform or Affine.identity()
    rows, cols = raster.shape
    text = "" if raster.crs is None else raster.crs.to_wkt()
    place = {"crs_wkt": text, "spatial_ref": text} if text else {}
    place["GeoTransform"] = " ".join(repr(float(value)) for value in transform.to_gdal())
    dims = (*source.dims[:-2], "y", "x")
    coords: dict[Any, Any] = {
        name: coord
        for name, coord in source.coords.items()
        if name != _mapping_name(source) and set(coord.dims) <= set(source.dims[:-2])
    }
    coords["spatial_ref"] = ((), 0, place)
    if not (transform.b or transform.d):
        coords["x"] = (("x",), transform.c + transform.a * (np.arange(cols) + 0.5))
        coords["y"] = (("y",), transform.f + transform.e * (np.arange(rows) + 0.5))
    if is_data_array(like) and to_raster(like).grid == raster.grid:
        places = zip(("y", "x"), like.dims[-2:], strict=True)  # sums are taken where these are equal
        coords |= {name: (name, like.coords[dim].values) for name, dim in places if dim in like.coords}
    make: Callable[..., Any] = type(source)
    attrs = {name: value for name, value in source.attrs.items() if name != "grid_mapping"}
    data = make(values, dims=dims, coords=coords, attrs=attrs, name=source.name)
    data.encoding["grid_mapping"] = "spatial_ref"
    array: DataArrayLike = data
    return array


def _filled(raster: Raster) -> NDArray[Any]:
    """Return the pixels with nodata where not valid; whole numbers without a nodata value become float."""
    values, mask = np.ma.getdata(raster.array), np.ma.getmaskarray(raster.array)
    if raster.nodata is not None:
        return np.where(mask, values.dtype.type(raster.nodata), values)
    if values.dtype.kind != "f":
        values = values.astype("float32" if values.dtype.name in _WIDER else "float64")
    return np.where(mask, values.dtype.type(np.nan), values)
