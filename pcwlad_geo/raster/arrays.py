"""Rasters in memory: NumPy arrays, xarray.DataArrays and open datasets, handed on as files and back."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, TypeAlias, TypeGuard

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.in_memory import is_array, nodata_of, pixels_of
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS, ignoring
from pcwlad_geo.raster.grid import apply, apply_inverse
from pcwlad_geo.raster.opening import open_own
from pcwlad_geo.text import Shown
from pcwlad_geo.types import PathLike

X_NAMES: Final = ("x", "lon", "longitude")
"""Dimensions of a DataArray that are columns."""
Y_NAMES: Final = ("y", "lat", "latitude")
"""Dimensions of a DataArray that are rows."""
_STORED: Final[Mapping[str, str]] = {"bool": "uint8", "float16": "float32"}
"""Data types that GDAL has none for, and what holds their values."""
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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Raster(Shown):
    """Bands held in memory, and where their pixels lie.

    Parameters
    ----------
    array : (rows, cols) or (bands, rows, cols) array
        Any real dtype. What a `numpy.ma.MaskedArray` masks is not valid.
    transform : Affine or six numbers, optional
        Geotransform: pixel (col, row), corner-based, to map coordinates (x, y); a, b, c, d, e, f.
    crs : CRS, str or int, optional
        Coordinate reference system of x and y: as rasterio takes it, such as ``"EPSG:32633"``.
    nodata : float, optional
        Value of pixels that are not valid.

    Raises
    ------
    InputError
        If these describe no raster.
    """

    array: NDArray[Any]
    transform: Affine | None = None
    crs: CRS | None = None
    nodata: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "array", _checked(self.array))
        object.__setattr__(self, "transform", _transform(self.transform))
        object.__setattr__(self, "crs", _crs(self.crs))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        rows, cols = self.array.shape[-2:]
        return rows, cols

    def _facts(self) -> dict[str, str]:
        rows, cols = self.shape
        bands = self.array.shape[0] if self.array.ndim == 3 else 1
        facts = {"size": f"{cols} x {rows} px", "bands": f"{bands} band{'s' if bands > 1 else ''}"}
        facts["data type"] = str(self.array.dtype)
        facts["CRS"] = self.crs.to_string() if self.crs else "no CRS"
        return facts | ({} if self.nodata is None else {"nodata": f"nodata {self.nodata:g}"})


RasterLike: TypeAlias = PathLike | DatasetReader | NDArray[Any] | Raster | DataArrayLike
"""What a raster may be given as: a path or GDAL URI, an open rasterio dataset, a NumPy array, a `Raster`, an
`xarray.DataArray` with the coordinates that rioxarray gives it."""


class Scratch:
    """A folder for the files of arrays, removed when nothing refers to it any more."""

    def __init__(self) -> None:
        try:
            self.folder = Path(tempfile.mkdtemp(prefix="pcwlad-geo-"))
        except OSError as error:
            raise OutputError(f"no temporary folder can be made ({error}): set TMPDIR to one") from error
        weakref.finalize(self, _remove, self.folder, os.getpid())

    def file_of(self, raster: RasterLike, name: str) -> str:
        """Return the path or URI of a raster; what is in memory is written to a GeoTIFF of this name.

        Raises `InputError` if it is none of what `RasterLike` lists, or cannot be written.
        """
        if (place := _place_of(raster)) is not None:
            return place
        path = self.folder / f"{name}.tif"
        if is_dataset(raster):
            _copy(raster, path)
        else:
            write_raster(to_raster(raster), path)
        return str(path)


def _remove(folder: Path, process_id: int) -> None:
    if os.getpid() == process_id:  # a forked worker has a copy of the object, not the folder
        shutil.rmtree(folder, ignore_errors=True)


def file_of(raster: object) -> str:
    """Return the path or URI of a raster that must be a file: results refer to it.

    Raises `InputError` if it is in memory only.
    """
    if (place := _place_of(raster)) is not None:
        return place
    raise InputError(
        f"{_kind(raster)} cannot be registered into a folder, whose files refer to the raster: give a path "
        "or an open dataset of a file, or compose open_pair, match and fit, which take rasters in memory"
    )


def _place_of(raster: object) -> str | None:
    """Return the path or URI of a raster; None of one in memory."""
    if isinstance(raster, str | os.PathLike):
        return os.fspath(raster)
    return str(raster.name) if is_dataset(raster) and _has_file(raster) else None


def is_dataset(raster: object) -> TypeGuard[DatasetReader]:
    """Return whether this is a dataset of rasterio, a WarpedVRT included; a closed one has no profile."""
    return all(hasattr(type(raster), name) for name in ("read", "profile", "dataset_mask", "closed"))


def is_data_array(raster: object) -> TypeGuard[DataArrayLike]:
    """Return whether this is an `xarray.DataArray`; its pixels, which may be computed late, are not asked."""
    return is_array(raster) and all(hasattr(raster, name) for name in ("dims", "coords", "attrs", "encoding"))


def _has_file(dataset: DatasetReader) -> bool:
    """Return whether others can open what a dataset shows; raise where it is closed or being written."""
    if dataset.closed:
        raise InputError(f"the dataset {dataset.name} is closed: open it again, or give its path")
    if getattr(dataset, "mode", "r") != "r":
        raise InputError(f"{dataset.name} is open for writing: close it, and open it for reading")
    return isinstance(dataset, DatasetReader) and not str(dataset.name).startswith("/vsimem/")


def _copy(dataset: DatasetReader, path: Path) -> None:
    """Copy a dataset that has no file: pixels, masks, georeferencing."""
    try:
        pixels = dataset.read(masked=dataset.nodata is None)
        gcps, gcps_crs = dataset.gcps
        rpcs = dataset.rpcs
    except (*LIBRARY_ERRORS, OSError, ValueError) as error:
        raise InputError(f"the dataset {dataset.name} cannot be read: {error}") from error
    transform = None if dataset.transform == Affine.identity() else dataset.transform
    write_raster(Raster(pixels, transform, dataset.crs, dataset.nodata), path)
    if gcps or rpcs:
        file: Any
        with ignoring(NotGeoreferencedWarning), open_own(path, mode="r+") as file:
            if gcps:
                file.gcps = gcps, gcps_crs
            if rpcs:
                file.rpcs = rpcs


def to_raster(raster: object) -> Raster:
    """Return an array or a DataArray as a `Raster`.

    Raises `InputError` if it is neither, or its axes or coordinates are not those of a raster.
    """
    if isinstance(raster, Raster):
        return raster
    if is_data_array(raster):
        return _from_data_array(raster)
    if is_array(raster):
        return Raster(raster)
    raise InputError(
        f"{_kind(raster)} is no raster: give a path, an open rasterio dataset, a NumPy array, "
        "pcwlad_geo.Raster(array, transform, crs), or an xarray.DataArray"
    )


def _kind(value: object) -> str:
    return f"a {type(value).__module__}.{type(value).__qualname__}".replace("builtins.", "")


def _checked(array: object) -> NDArray[Any]:
    """Return an array that GDAL can hold."""
    shape = array.shape if is_array(array) else ()
    if len(shape) not in (2, 3) or 0 in shape:
        raise InputError(
            f"{_kind(array)} of shape {shape} is no raster: give an array of (rows, cols) or (bands, rows, "
            "cols)"
        )
    array = pixels_of(array)
    array = array.astype(_STORED.get(array.dtype.name, array.dtype), copy=False)
    if array.dtype.kind not in "uif" or array.dtype.itemsize > 8:
        raise InputError(
            f"an array of {array.dtype} cannot be matched: give real numbers of at most 64 bits "
            "(of complex ones the amplitude)"
        )
    return array


def _transform(transform: object) -> Affine | None:
    if transform is None or isinstance(transform, Affine):
        return transform
    try:
        numbers: tuple[float, ...] = tuple(transform)  # type: ignore[arg-type]  # whatever a caller gives
        return Affine(*map(float, numbers[:6]))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"transform = {transform!r}: give an affine.Affine, or its numbers a, b, c, d, e, f"
        ) from error


def _crs(crs: object) -> CRS | None:
    if crs is None or isinstance(crs, CRS):
        return crs
    try:
        return CRS.from_user_input(crs)
    except (*LIBRARY_ERRORS, ValueError) as error:
        raise InputError(f"crs = {crs!r} is no CRS: give one such as 'EPSG:32633' ({error})") from error


def write_raster(raster: Raster, path: Path) -> None:
    """Write a raster as a GeoTIFF.

    Raises `InputError` if its nodata value does not fit its data type, and `OutputError` if the file cannot
    be written.
    """
    bands = raster.array if raster.array.ndim == 3 else raster.array[None]
    mask = np.ma.getmaskarray(bands).any(axis=0) if np.ma.isMaskedArray(bands) else None
    count, rows, cols = bands.shape
    profile: dict[str, Any] = {"driver": "GTiff", "count": count, "height": rows, "width": cols}
    profile |= {"dtype": bands.dtype.name, "crs": raster.crs, "nodata": raster.nodata}
    profile |= {"tiled": True, "bigtiff": "IF_SAFER", "transform": raster.transform}
    try:
        with (
            rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
            ignoring(NotGeoreferencedWarning),
            rasterio.open(path, "w", **{k: v for k, v in profile.items() if v is not None}) as file,
        ):
            file.write(np.ma.getdata(bands))
            if mask is not None and mask.any():
                if raster.nodata is None:
                    file.write_mask(np.where(mask, 0, 255).astype(np.uint8))
                else:
                    file.write(np.where(mask, raster.nodata, np.ma.getdata(bands)).astype(bands.dtype))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"the array of {bands.dtype} cannot be written as a raster: {error}") from error
    except (*LIBRARY_ERRORS, OSError) as error:
        raise OutputError(f"cannot write {path}: {error}; is the disk full?") from error


def read_raster(path: str | Path) -> Raster:
    """Read a raster of our own whole: (bands, rows, cols), masked where it is not valid."""
    with ignoring(NotGeoreferencedWarning), open_own(path) as file:
        transform = None if file.transform == Affine.identity() else file.transform
        return Raster(file.read(masked=True), transform, file.crs, file.nodata)


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


def like_the_source(raster: Raster, source: object) -> object:
    """Return a warped raster as its source was given: `Raster`, DataArray or masked array.

    The raster is of (bands, rows, cols), masked where nothing is known; of an array of (rows, cols) it comes
    back as such.
    """
    pixels = source.array if isinstance(source, Raster) else source
    if not is_dataset(source) and len(getattr(pixels, "shape", ())) == 2:
        raster = Raster(raster.array[0], raster.transform, raster.crs, raster.nodata)
    if is_data_array(source):
        return _to_data_array(raster, source)
    return raster.array if is_array(source) else raster


def _to_data_array(raster: Raster, source: DataArrayLike) -> DataArrayLike:
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
