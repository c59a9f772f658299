"""What GDAL would open besides a raster as it lies beside it or is named in it: checked unopened."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from rasterio.errors import RasterioError
from rasterio.io import DatasetReader

from pcwlad_geo.raster.file_heads import SIGNED_DRIVERS, Kind, kind_of_head
from pcwlad_geo.raster.file_places import Place, Stamp, UntrustedFileError
from pcwlad_geo.raster.uri import destination
from pcwlad_geo.raster.vrt_names import HEAD_BYTES, MOST_BYTES, UntrustedVrtError, named_files

_NAMING_TAGS: Final = (
    ("OVERVIEWS", "OVERVIEW_FILE"),
    ("GEOLOCATION", "X_DATASET"),
    ("GEOLOCATION", "Y_DATASET"),
)
_BASE: Final = ":::BASE:::"
"""GDAL's sign for the folder of the file in the name of its overviews."""


def check_file(file: Place) -> Kind:
    """Check what GDAL opens besides a file, and return what kind of raster that itself is.

    Raises
    ------
    UntrustedFileError
        If any of it lies elsewhere than in the file's folder or below, or is of a format whose files may name
        others; the message tells which.
    """
    return _checked(file, set(), any_driver=False)


def check_source(file: Place) -> None:
    """Check a file that GDAL will open by itself, with whichever driver.

    Raises
    ------
    UntrustedFileError
        As `check_file`, and where it does not begin as rasters of one of the common formats do.
    """
    _checked(file, set(), any_driver=True)


def check_named_by(dataset: DatasetReader, file: Place | None) -> None:
    """Check the files that the metadata of an open raster name, which GDAL has not opened yet.

    Parameters
    ----------
    dataset : DatasetReader
    file : Place, optional
        Where it lies; None: nowhere on this machine, and no file may be named.

    Raises
    ------
    UntrustedFileError
        As `check_source`.
    """
    for name in _names_in_tags(dataset):
        if file is None:
            raise UntrustedFileError(f"its metadata name {name}")
        _check_named(file, name, set())


def _checked(file: Place, seen: set[Place], *, any_driver: bool) -> Kind:
    stamp = file.stamp()
    if any_driver and file.is_other():  # whole folders are formats of rasters too
        raise UntrustedFileError(f"it needs {file.uri}, which is no regular file")
    if file in seen or not stamp:
        return "other"  # checked already, a folder that the user has named, or nothing
    seen.add(file)
    kind = _kind(file, stamp)
    if any_driver and kind not in ("signed", "vrt", "classic netCDF"):
        raise UntrustedFileError(f"it needs {file.uri}, which is no raster of a common format")
    if kind == "vrt":
        _check_vrt(file, seen)
    elif any_driver:
        for name in _tags_of(file, stamp):
            _check_named(file, name, seen)
    for beside in file.beside():
        _checked(beside, seen, any_driver=True)
    return kind


def _check_vrt(file: Place, seen: set[Place]) -> None:
    text = file.read(MOST_BYTES + 1)
    if len(text) > MOST_BYTES:
        raise UntrustedFileError(f"{file.uri} is a VRT of more than {MOST_BYTES} bytes")
    try:
        names = named_files(text)
    except UntrustedVrtError as error:
        raise UntrustedFileError(f"{file.uri} is a VRT, and {error}") from error
    for each in names:
        _checked(file.named(each.name, relative=each.relative), seen, any_driver=True)


def _check_named(file: Place, name: str, seen: set[Place]) -> None:
    """Check a name in metadata, which GDAL takes from the file's folder or from the working folder."""
    found = destination(name.removeprefix(_BASE).lstrip("/") if name.startswith(_BASE) else name)
    if found.where != "file":
        raise UntrustedFileError(f"its metadata name {name}, which is no plain file")
    for relative in (True, False):
        other = file.named(found.path, relative=relative)
        if other != file:
            _checked(other, seen, any_driver=True)
        if name.startswith(_BASE):
            return


@lru_cache(maxsize=4096)
def _kind(file: Place, _: Stamp) -> Kind:
    return kind_of_head(file.read(HEAD_BYTES))


@lru_cache(maxsize=4096)
def _tags_of(file: Place, _: Stamp) -> tuple[str, ...]:
    try:
        with DatasetReader(file.uri, driver=list(SIGNED_DRIVERS)) as dataset:
            return _names_in_tags(dataset)
    except RasterioError:
        return ()  # GDAL cannot open it either


def _names_in_tags(dataset: DatasetReader) -> tuple[str, ...]:
    found = (dataset.tags(ns=domain).get(key) for domain, key in _NAMING_TAGS)
    return tuple(name for name in found if name)
