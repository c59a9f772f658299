"""Rasters in memory handed on as files: of GDAL in memory, or in a temporary folder."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.raster.arrays import RasterLike, is_dataset, to_raster
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS, ignoring
from pcwlad_geo.raster.opening import open_own
from pcwlad_geo.raster.raster import Raster, type_name, write_raster
from pcwlad_geo.raster.writing import MemoryFolder


@dataclass(frozen=True, slots=True)
class ScratchParameters:
    """Where what is in memory is handed on."""

    most_bytes: int = 2**28
    """Largest array that is handed on in memory, a second time; larger ones go to a file. It holds the tile
    of 4,096 px a side with all that matching reads of it, in whatever data type."""


class Scratch:
    """The files of arrays, in GDAL's memory or a folder, removed when nothing refers to them any more.

    Parameters
    ----------
    in_memory : bool
        Whether arrays that are not too large stay in memory, where this process alone finds them.
    """

    def __init__(
        self, *, in_memory: bool = False, parameters: ScratchParameters = ScratchParameters()
    ) -> None:
        self._memory = MemoryFolder() if in_memory else None
        self._most_bytes = parameters.most_bytes
        self._folder: Path | None = None

    @property
    def folder(self) -> Path:
        """The folder on the disk, made when it is first asked for."""
        if self._folder is None:
            try:
                self._folder = Path(tempfile.mkdtemp(prefix="pcwlad-geo-"))
            except OSError as error:
                raise OutputError(f"no temporary folder can be made ({error}): set TMPDIR to one") from error
            weakref.finalize(self, _remove, self._folder, os.getpid())
        return self._folder

    def file_of(self, raster: RasterLike, name: str, *, unit: str | None = None) -> str:
        """Return the path or URI of a raster; what is in memory is written to a GeoTIFF of this name.

        Its first band gets the `unit`, if there is one.

        Raises `InputError` if it is none of what `RasterLike` lists, or cannot be written.
        """
        if (place := Scratch.place_of(raster)) is not None:
            return place
        source = raster if is_dataset(raster) else to_raster(raster)
        path = self._path(source, f"{name}.tif")
        if isinstance(source, Raster):
            write_raster(source, path)
        else:
            _copy(source, path)
        file: Any
        if unit is not None:
            with ignoring(NotGeoreferencedWarning), open_own(path, mode="r+") as file:
                file.set_band_unit(1, unit)
        return path

    def holds(self, *uris: str) -> bool:
        """Return whether one of these is the file of an array."""
        places = [str(self._folder)] if self._folder else []
        places += [self._memory.path("")] if self._memory else []
        return any(uri.startswith(place) for uri in uris for place in places)

    def copy(self, uri: str, folder: Path, *, overwrite: bool) -> str:
        """Copy a GeoTIFF of ours into a folder, which is made, and return its path.

        Raises `OutputError` if it exists and `overwrite` is False, or cannot be written.
        """
        place = folder.absolute() / uri.rpartition("/")[2].rpartition(os.sep)[2]
        if place.exists() and not overwrite:
            raise OutputError(
                f"{place} exists: give overwrite=True (--overwrite) to replace it, or another folder"
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
                rasterio.shutil.copy(uri, str(place), driver="GTiff")
        except (*LIBRARY_ERRORS, OSError) as error:
            raise OutputError(f"cannot write {place}: {error}") from error
        return str(place)

    @staticmethod
    def place_of(raster: object) -> str | None:
        """Return the path or URI of a raster; None of one in memory."""
        if isinstance(raster, str | os.PathLike):
            return os.fspath(raster)
        if isinstance(raster, Raster):
            return raster.source
        return str(raster.name) if is_dataset(raster) and _has_file(raster) else None

    def _path(self, source: Raster | DatasetReader, name: str) -> str:
        rows, cols = source.shape
        size = rows * cols * source.count * 8  # of the largest data type
        in_memory = self._memory is not None and size <= self._most_bytes
        return self._memory.path(name) if self._memory and in_memory else str(self.folder / name)


def _remove(folder: Path, process_id: int) -> None:
    if os.getpid() == process_id:  # a forked worker has a copy of the object, not the folder
        shutil.rmtree(folder, ignore_errors=True)


def file_of(raster: object) -> str:
    """Return the path or URI of a raster that must be a file: results refer to it.

    Raises `InputError` if it is in memory only.
    """
    if (place := Scratch.place_of(raster)) is not None:
        return place
    raise InputError(
        f"{type_name(raster)} has no file, to which the results would refer: give a path, or an open dataset "
        "of a file"
    )


def _has_file(dataset: DatasetReader) -> bool:
    """Return whether others can open what a dataset shows; raise where it is closed or being written."""
    if dataset.closed:
        raise InputError(f"the dataset {dataset.name} is closed: open it again, or give its path")
    if getattr(dataset, "mode", "r") != "r":
        raise InputError(f"{dataset.name} is open for writing: close it, and open it for reading")
    return isinstance(dataset, DatasetReader) and not str(dataset.name).startswith("/vsimem/")


def _copy(dataset: DatasetReader, path: str) -> None:
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
