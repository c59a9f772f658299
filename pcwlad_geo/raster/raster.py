"""A raster as an object: its pixels on demand, and where they lie."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.in_memory import is_array, pixels_of
from pcwlad_geo.raster.file_tree import file_name
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS, ignoring
from pcwlad_geo.raster.grid import Grid, Window
from pcwlad_geo.raster.masks import accepted
from pcwlad_geo.raster.opening import open_own, open_raster
from pcwlad_geo.raster.pixels import valid_in_mask_file
from pcwlad_geo.raster.source import RasterInfo, check_part
from pcwlad_geo.raster.trust.permissions import Trust, trusting
from pcwlad_geo.text import Shown
from pcwlad_geo.types import Bool, PathLike

_STORED: Final = {"bool": "uint8", "float16": "float32"}
"""Data types that GDAL has none for, and what holds their values."""


class Raster(Shown):
    """Bands of pixels, and where they lie. Those of a file are read when they are first asked for.

    Parameters
    ----------
    array : (rows, cols) or (bands, rows, cols) array
        Any real dtype. What a `numpy.ma.MaskedArray` masks is not valid.
    transform : Affine, six numbers or Grid, optional
        Geotransform: pixel (col, row), corner-based, to map coordinates (x, y); a, b, c, d, e, f. A `Grid`
        has the CRS too.
    crs : CRS, str or int, optional
        Coordinate reference system of x and y: as rasterio takes it, such as ``"EPSG:32633"``.
    nodata : float, optional
        Value of pixels that are not valid.
    mask : (rows, cols) array or Raster, optional
        0 where pixels do not count either.

    Raises
    ------
    InputError
        If these describe no raster.
    """

    def __init__(
        self,
        array: NDArray[Any],
        transform: Affine | Grid | None = None,
        crs: CRS | None = None,
        nodata: float | None = None,
        *,
        mask: Raster | NDArray[Any] | None = None,
    ) -> None:
        self._array: NDArray[Any] | None = _checked(array)
        if isinstance(transform, Grid):
            if transform.shape != self._array.shape[-2:]:
                raise InputError(
                    f"the array has {self._array.shape[-2:]} px (rows, cols), its grid {transform.shape}: "
                    "give the grid of these pixels"
                )
            crs = transform.crs if crs is None else crs
            transform = transform.transform if transform.located else None
        rows, cols = self._array.shape[-2:]
        self.transform = _transform(transform)
        self.crs = _crs(crs)
        self.nodata = nodata
        self.shape: tuple[int, int] = (rows, cols)
        self.mask_source: str | Raster | None = _mask_source(mask)
        """What excludes pixels besides: a path, or a raster of zeros."""
        if isinstance(self.mask_source, Raster) and self.mask_source.shape != self.shape:
            raise InputError(
                f"the mask has {self.mask_source.shape} px (rows, cols), the raster {self.shape}: give one "
                "of that size"
            )
        self._info: RasterInfo | None = None
        self._whole = True
        self.trust = Trust()
        self._keep: object = None

    @classmethod
    def of_file(
        cls,
        info: RasterInfo,
        *,
        whole: bool = True,
        mask: NDArray[Any] | Raster | None = None,
        trust: Trust | None = None,
        keep: object = None,
    ) -> Raster:
        """Return the raster of a file that is described; its pixels are not read yet.

        Parameters
        ----------
        info : RasterInfo
            The band, or the first one of several.
        whole : bool
            Whether all bands of the file count, not this one alone.
        mask : (rows, cols) array or Raster, optional
            As for `Raster`; one in a file is in the description.
        trust : Trust, optional
            What the file may open.
        keep : object
            What the file is removed with.
        """
        raster = cls.__new__(cls)
        grid = info.grid if info.on_map else None
        raster._array, raster._info, raster._whole = None, info, whole
        raster.transform = grid.transform if grid else info.plane_transform
        raster.crs = grid.crs if grid else None
        raster.nodata, raster.shape = info.nodata, info.grid.shape
        raster.mask_source = info.mask_uri if mask is None else _mask_source(mask)
        raster.trust, raster._keep = trust or Trust(), keep
        return raster

    @property
    def array(self) -> NDArray[Any]:
        """(rows, cols) or (bands, rows, cols) pixels, masked where a file says that they are not valid."""
        if self._array is None:
            if self._info is None:
                raise TypeError("a raster has an array or a file")
            with trusting(self.trust):
                self._array = self._read(self._info)
        return self._array

    @property
    def source(self) -> str | None:
        """Path or GDAL URI of the file; None of an array."""
        return None if self._info is None else self._info.uri

    @property
    def band(self) -> int | None:
        """Number of the only band of the file that counts, from 1; None where all do."""
        return None if self._info is None or self._whole else self._info.band

    @property
    def count(self) -> int:
        """Number of bands."""
        if self._info is not None:
            return self._info.band_count if self._whole else 1
        return self.array.shape[0] if self.array.ndim == 3 else 1

    @property
    def grid(self) -> Grid:
        """Shape, geotransform and CRS; the identity and None where the raster has none."""
        return Grid(self.shape, self.transform or Affine.identity(), self.crs)

    @property
    def mask(self) -> Bool:
        """(rows, cols) True where a pixel does not count, in any of the bands."""
        values = self.array if self.array.ndim == 3 else self.array[None]
        mask = np.ma.getmaskarray(values).any(axis=0)
        if values.dtype.kind == "f":
            mask = mask | np.isnan(np.ma.getdata(values)).any(axis=0)
        with trusting(self.trust):
            return np.asarray(mask | self._excluded())

    def save(self, path: PathLike, *, overwrite: bool = False) -> Path:
        """Write the raster as a GeoTIFF, and return its path.

        Raises `OutputError` if the file exists and `overwrite` is False, or cannot be written, and
        `InputError` if its name ends in neither .tif nor .tiff.
        """
        place = Path(path)
        if place.suffix.lower() not in (".tif", ".tiff"):
            raise InputError(f"{place} is no name of a GeoTIFF, as save writes: give one that ends in .tif")
        if place.exists() and not overwrite:
            raise OutputError(f"{place} exists: give overwrite=True to replace it, or another path")
        staged = place.with_name(f".{place.name}.{os.getpid()}")
        try:
            write_raster(self, staged)
            staged.replace(place)
        except OSError as error:
            raise OutputError(f"cannot write {place}: {error.strerror}") from error
        finally:
            staged.unlink(missing_ok=True)
        return place

    def _read(self, info: RasterInfo) -> NDArray[Any]:
        check_part(info, self.shape)
        with open_raster(info.uri) as file:
            return _checked(file.read(info.band if self.count == 1 else None, masked=True))

    def _excluded(self) -> Bool:
        """Return which of the (rows, cols) pixels the mask excludes."""
        if isinstance(self.mask_source, Raster):
            values = self.mask_source.array
            return ~accepted("zeros", np.ma.filled(values if values.ndim == 3 else values[None], 0))
        if self.mask_source is None or self._info is None:
            return np.zeros(self.shape, dtype=bool)
        return ~valid_in_mask_file(self._info, Window.whole(self.shape))

    def _facts(self) -> dict[str, str]:
        rows, cols = self.shape
        facts = {} if self._info is None else {"file": file_name(self._info.uri)}
        facts |= {"size": f"{cols} x {rows} px", "bands": f"{self.count} band{'s' if self.count > 1 else ''}"}
        facts["data type"] = str(self.array.dtype) if self._info is None else self._info.dtype
        facts["CRS"] = self.crs.to_string() if self.crs else "no CRS"
        return facts | ({} if self.nodata is None else {"nodata": f"nodata {self.nodata:g}"})


def _mask_source(mask: Raster | NDArray[Any] | None) -> Raster | None:
    return mask if mask is None or isinstance(mask, Raster) else Raster(mask)


def type_name(value: object) -> str:
    """Return the type of a value as messages name it."""
    return f"a {type(value).__module__}.{type(value).__qualname__}".replace("builtins.", "")


def _checked(array: object) -> NDArray[Any]:
    """Return an array that GDAL can hold."""
    shape = array.shape if is_array(array) else ()
    if len(shape) not in (2, 3) or 0 in shape:
        raise InputError(
            f"{type_name(array)} of shape {shape} is no raster: give an array of (rows, cols) or (bands, "
            "rows, cols)"
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


def write_raster(raster: Raster, path: Path | str) -> None:
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
