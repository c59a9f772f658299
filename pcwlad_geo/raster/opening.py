"""The one door to GDAL: every raster is opened here, by the permissions of the user.

GDAL opens the files that a raster names: sources of a VRT, overviews and masks, arrays of coordinates,
external storage, the servers of a WMS description. This module opens the raster itself and files in its own
folder or below, by drivers whose files name no others, unless the user allows more (`trust`). The rules are
documented in docs/security.md.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

import rasterio
from rasterio.env import get_gdal_config
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.raster.cubes import CubeReader, as_vrt
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS, ignoring, reading
from pcwlad_geo.raster.trust.checks import check_file, check_named_by
from pcwlad_geo.raster.trust.destinations import Destination, destination, gdal_name
from pcwlad_geo.raster.trust.file_kinds import (
    MARKS_OF_OTHERS,
    NETWORK_DRIVERS,
    PLAIN_DRIVERS,
    drivers_for,
)
from pcwlad_geo.raster.trust.local_files import SIDECARS, Place, UntrustedFileError, place_of
from pcwlad_geo.raster.trust.permissions import current_trust
from pcwlad_geo.raster.trust.signing import signed
from pcwlad_geo.text import check_regular, check_sidecars, is_uri, joined, part_of_jpeg

TRUST_VRT: Final = "give --trust-vrt if you trust whoever made it with all files that you can read"
"""The advice at the end of messages about rasters that name other files."""
SIGNATURES: Final = {"HDF4": b"\x0e\x03\x13\x01", "HDF5": b"\x89HDF\r\n", "ISIS3": b"Object = IsisCube"}
"""First bytes of files, by GDAL's driver, that not every build of GDAL reads."""


def open_for_reading(uri: str, **options: object) -> DatasetReader:
    """Open a raster that may be untrusted.

    Raises `TrustError` if it is on a network, or it, or a file that it names, needs to be trusted by the
    user, and `rasterio.errors.RasterioError` if it cannot be opened. The `uri` is a path or a GDAL URI; the
    options are GDAL's.
    """
    trust, address = current_trust(), destination(uri)
    if trust.composed and uri == trust.composed:
        return _dataset_of(uri, ["VRT"], options)
    if address.where == "network" and not trust.remote:
        raise TrustError(f"{uri} is read over a network: give --allow-remote to allow that")
    if trust.vrt:
        if trust.remote:
            return _dataset_of(uri, None, options)
        with rasterio.Env() as environment:
            local = sorted(set(environment.drivers()) - set(NETWORK_DRIVERS))
        return _dataset_of(uri, local, options)
    try:
        place = place_of(address) if address.where in ("file", "archive") else None
        dataset = _dataset_of(uri, _drivers(uri, address, place), options)
        try:
            check_named_by(dataset, place)
        except BaseException:
            dataset.close()
            raise
    except UntrustedFileError as error:
        raise TrustError(f"{uri} is not opened, as {error}: {TRUST_VRT}") from error
    return dataset


def check_source(path: str) -> None:
    """Raise `TrustError` if a file must not be opened by GDAL itself, as a source of a VRT of ours."""
    try:
        if not current_trust().vrt:
            check_file(place_of(destination(path)), any_driver=True)
    except UntrustedFileError as error:
        raise TrustError(f"{path} is not opened, as {error}: {TRUST_VRT}") from error


def open_own(path: str | os.PathLike[str], **options: object) -> DatasetReader:
    """Open a file that this program has written or composed itself, from rasters that were checked."""
    return rasterio.open(path, **options)


def _dataset_of(uri: str, drivers: list[str] | None, options: dict[str, object]) -> DatasetReader:
    cube = as_vrt(uri)
    if cube is not None:
        return CubeReader(uri, cube, options)
    return DatasetReader(gdal_name(signed(uri)), driver=drivers, **options)


def _drivers(uri: str, address: Destination, place: Place | None) -> list[str]:
    """Return the drivers for an untrusted file."""
    view = uri.startswith("vrt://")
    if place is None:
        if address.where == "unknown" or view:
            raise UntrustedFileError("it cannot be looked at before GDAL opens it")
        if address.where == "network":
            _check_remote_sidecars(uri)
        return list(PLAIN_DRIVERS)
    if view:  # GDAL opens what it shows by itself
        check_file(place, any_driver=True)
        return ["VRT"]
    return list(drivers_for(check_file(place)))


def _check_remote_sidecars(uri: str) -> None:
    """Raise if GDAL would find overviews or a mask beside a remote raster that are VRTs."""
    if get_gdal_config("GDAL_DISABLE_READDIR_ON_OPEN") == "EMPTY_DIR":
        return  # it does not look
    for ending in SIDECARS:
        with suppress(RasterioError):
            _dataset_of(uri + ending, ["VRT"], {}).close()
            raise UntrustedFileError(f"{uri}{ending} is a VRT")


@contextmanager
def open_raster(uri: str, **options: object) -> Iterator[DatasetReader]:
    """Open a raster for reading within the context, with GDAL on one thread.

    The files that an untrusted raster may make GDAL open are restricted, see `gdal`. Nothing is written
    beside it (GDAL would store properties of a .gz file there). Raises `InputError` if it cannot be opened,
    or reading within the context fails. The `uri` is a path or a GDAL URI; the options are GDAL's.
    """
    if "\0" in uri:  # where GDAL would end the name
        raise InputError(f"the name {uri!r} holds a NUL character: no file has such a name")
    check_regular(uri)  # GDAL could wait for a pipe for ever
    check_sidecars(uri)
    with _opened(open_for_reading, uri, options) as dataset:
        yield dataset


@contextmanager
def open_written_raster(uri: str) -> Iterator[DatasetReader]:
    """Open a raster that this program has written, as `open_raster` does, wherever its sources are.

    Temporary files of GDAL (of a warp by a table of positions) lie beside it. GDAL itself would choose the
    working folder, which need not be one that can be written.
    """
    options = {} if uri.startswith("<") else {"CPL_TMPDIR": str(Path(uri).parent)}
    with rasterio.Env(**options), _opened(open_own, uri, {}) as dataset:
        yield dataset


@contextmanager
def _opened(
    opener: Callable[..., DatasetReader], uri: str, options: Mapping[str, object]
) -> Iterator[DatasetReader]:
    settings = {"GDAL_NUM_THREADS": "1", "CPL_VSIL_GZIP_WRITE_PROPERTIES": "NO"}
    if not current_trust().remote:  # a suffix that no file on a server has
        settings["CPL_VSIL_CURL_ALLOWED_EXTENSIONS"] = "{none}"
    if current_trust().vrt:  # GDAL 3.12 refuses raw bands of files elsewhere by itself
        settings["GDAL_VRT_RAWRASTERBAND_ALLOWED_SOURCE"] = "ALL"
    with rasterio.Env(**settings):
        try:
            with ignoring(NotGeoreferencedWarning):
                dataset = opener(uri, **options)
        except (*LIBRARY_ERRORS, OSError, ValueError) as error:
            raise InputError(_why_not_opened(uri, error)) from error
        with dataset, reading(uri):
            yield dataset


def _why_not_opened(uri: str, error: Exception) -> str:
    path = Path(uri)
    if isinstance(error, UnicodeError):
        return f"the name of {uri!r} is not UTF-8, which GDAL needs: rename it"
    try:
        if path.is_dir():
            return (
                f"{uri} is a folder, and neither a Landsat scene nor a Sentinel-1 or Sentinel-2 product: "
                "give a raster file"
            )
        if path.is_file():
            if not os.access(path, os.R_OK):
                return f"{uri} cannot be read: change its permissions"
            reason, missing = joined(error), _missing_driver(path)
            trust = current_trust()
            if not (trust.vrt and trust.remote) and _names_others(path):
                return (
                    f"{uri} names other files or servers: give --trust-vrt, and --allow-remote for servers, "
                    "if you trust whoever made it"
                )
            if missing is not None:
                return (
                    f"{uri} is of the format {missing}, for which this GDAL has no driver: convert it first"
                )
            if "not recognized" in reason and not trust.vrt:
                reason += " (formats whose files name other files are read with --trust-vrt only)"
            return f"{uri} is not a raster that GDAL can read, or it is damaged: {reason}"
    except (OSError, ValueError):  # too long or odd for a path, as GDAL URIs may be
        pass
    if part_of_jpeg(uri):
        return f"{uri} is a part of a JPEG, which is not taken here: give the file that register wrote"
    if is_uri(uri):
        return f"{uri} cannot be opened: {joined(error)}"
    return f"{uri} does not exist: check the path"


def _names_others(path: Path) -> bool:
    """Return whether a file is a description of tiles or servers, which GDAL opens where it may."""
    with path.open("rb") as file:
        head = file.read(1024)
    return any(mark in head for mark in MARKS_OF_OTHERS)


def _missing_driver(path: Path) -> str | None:
    """Return the driver that a file needs, where GDAL was built without it."""
    with path.open("rb") as file:
        head = file.read(64).lstrip()
    with rasterio.Env() as environment:
        built = environment.drivers()
    return next(
        (name for name, sign in SIGNATURES.items() if head.startswith(sign) and name not in built), None
    )
