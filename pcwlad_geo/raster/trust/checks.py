"""The check of the files that GDAL would open besides a raster."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from rasterio.errors import RasterioError
from rasterio.io import DatasetReader

from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.trust import hdf4, hdf5
from pcwlad_geo.raster.trust.destinations import destination
from pcwlad_geo.raster.trust.file_kinds import HEAD_BYTES, SIGNED_DRIVERS, Kind, kind_of_head
from pcwlad_geo.raster.trust.local_files import Place, Stamp, UntrustedFileError
from pcwlad_geo.raster.trust.vrt_elements import UntrustedVrtError, files_named_by, parse_vrt

_NAMING_TAGS: Final = (
    ("OVERVIEWS", "OVERVIEW_FILE"),
    ("GEOLOCATION", "X_DATASET"),
    ("GEOLOCATION", "Y_DATASET"),
)
_BASE: Final = ":::BASE:::"
"""GDAL's placeholder for the folder of the file in the name of its overviews."""


def check_file(file: Place, *, any_driver: bool = False) -> Kind:
    """Check the files that GDAL opens besides a file, and return the kind of the file itself.

    Raises `UntrustedFileError` if one of them is not in the file's folder or below, or has a format whose
    files may name others; the message says which. A file that GDAL will open by itself, with `any_driver`,
    must also begin like a raster of a common format.
    """
    return _checked(file, set(), any_driver=any_driver)


def check_named_by(dataset: DatasetReader, file: Place | None) -> None:
    """Check the files named by the metadata of an open raster, which GDAL has not opened yet.

    Raises `UntrustedFileError` as for `check_file`. The `file` is the raster's; None for one that is not on
    this machine, whose metadata may name no file.
    """
    for name in _names_in_tags(dataset):
        if file is None:
            raise UntrustedFileError(f"its metadata name {name}")
        _check_named(file, name, set())


def _checked(file: Place, visited: set[Place], *, any_driver: bool) -> Kind:
    stamp = file.stamp()
    if any_driver and file.is_other():  # a folder may be a raster as well
        raise UntrustedFileError(f"it needs {file.uri}, which is no regular file")
    if file in visited or not stamp:
        return "other"  # checked already, a folder that the user has named, or nothing
    visited.add(file)
    kind = _kind(file, stamp)
    reason_against = {"HDF4": hdf4.reason_against, "HDF5": hdf5.reason_against}.get(kind)
    if reason_against is not None and (reason := reason_against(file)):
        raise UntrustedFileError(f"{file.uri}: {reason}" if any_driver else reason)
    if any_driver and kind not in ("signed", "vrt", "classic netCDF", "HDF4", "HDF5"):
        raise UntrustedFileError(f"it needs {file.uri}, which is no raster of a common format")
    if kind == "vrt":
        _check_vrt(file, visited)
    elif any_driver and kind == "signed":
        for name in _tags_of(file, stamp):
            _check_named(file, name, visited)
    for sidecar in file.sidecars():
        _checked(sidecar, visited, any_driver=True)
    return kind


def _check_vrt(file: Place, visited: set[Place]) -> None:
    text = file.read(LIMITS.vrt_bytes + 1)
    if len(text) > LIMITS.vrt_bytes:
        raise UntrustedFileError(f"{file.uri} is a VRT of more than {LIMITS.vrt_bytes} bytes")
    try:
        names = list(dict.fromkeys(files_named_by(parse_vrt(text))))
    except UntrustedVrtError as error:
        raise UntrustedFileError(f"{file.uri} is a VRT, and {error}") from error
    for reference in names:
        _checked(file.named(reference.name, relative=reference.relative), visited, any_driver=True)


def _check_named(file: Place, name: str, visited: set[Place]) -> None:
    """Check a name in metadata, which GDAL resolves in the file's folder or in the working folder."""
    place = destination(name.removeprefix(_BASE).lstrip("/") if name.startswith(_BASE) else name)
    if place.where != "file":
        raise UntrustedFileError(f"its metadata name {name}, which is no plain file")
    for relative in (True, False):
        other = file.named(place.path, relative=relative)
        if other != file:
            _checked(other, visited, any_driver=True)
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
    names = (dataset.tags(ns=domain).get(key) for domain, key in _NAMING_TAGS)
    return tuple(name for name in names if name)
