"""The one door through which rasters are opened: what a stranger's file may make GDAL open, and what not.

GDAL opens what a file names: sources of a VRT, overviews and masks, arrays of coordinates, external storage,
the servers of a WMS description. Here only the raster itself is opened, and what lies in its own folder or
below, by drivers whose files name no others, unless the user trusts more (`trust`). docs/security.md tells
users the same.
"""

from __future__ import annotations

import os
from contextlib import suppress
from typing import Final

import rasterio
from rasterio._env import get_gdal_config
from rasterio._path import _parse_path
from rasterio.errors import RasterioError
from rasterio.io import DatasetReader

from pcwlad_geo.errors import TrustError
from pcwlad_geo.raster.file_heads import NETWORK_DRIVERS, PLAIN_DRIVERS, drivers_for
from pcwlad_geo.raster.file_places import Place, UntrustedFileError, place_of
from pcwlad_geo.raster.named_files import check_file, check_named_by, check_source
from pcwlad_geo.raster.trust import Trust, current_trust
from pcwlad_geo.raster.uri import Destination, destination

TRUST_VRT: Final = "give --trust-vrt if you trust whoever made it with all files that you can read"
_NO_FILE: Final = "{none}"
"""An ending that no file on a server has."""
_BESIDE: Final = (".ovr", ".msk")


def network_settings() -> dict[str, str]:
    """Return the settings that keep GDAL's file systems off the network, where that is not allowed."""
    return {} if current_trust().remote else {"CPL_VSIL_CURL_ALLOWED_EXTENSIONS": _NO_FILE}


def open_for_reading(uri: str, **options: object) -> DatasetReader:
    """Open a raster that may be a stranger's.

    Parameters
    ----------
    uri : str
        Path or GDAL URI.
    **options
        Open options of GDAL.

    Raises
    ------
    TrustError
        If it is on a network, or it, or a file that it names, is one that the user has to trust.
    rasterio.errors.RasterioError
        If it cannot be opened.
    """
    trust, found = current_trust(), destination(uri)
    if found.where == "network" and not trust.remote:
        raise TrustError(f"{uri} is read over a network: give --allow-remote to allow that")
    if trust.vrt:
        return _opened(uri, _drivers_of_trust(trust), options)
    try:
        place = place_of(found) if found.where in ("file", "archive") else None
        dataset = _opened(uri, _drivers(uri, found, place), options)
        try:
            check_named_by(dataset, place)
        except BaseException:
            dataset.close()
            raise
    except UntrustedFileError as error:
        raise TrustError(f"{uri} is not opened, as {error}: {TRUST_VRT}") from error
    return dataset


def open_own(path: str | os.PathLike[str], **options: object) -> DatasetReader:
    """Open what this program itself has just written or composed, of rasters that came through the door."""
    return rasterio.open(path, **options)


def _opened(uri: str, drivers: list[str] | None, options: dict[str, object]) -> DatasetReader:
    return DatasetReader(_parse_path(uri), driver=drivers, **options)


def _drivers_of_trust(trust: Trust) -> list[str] | None:
    """Return the drivers for files that the user trusts; None is all."""
    if trust.remote:
        return None
    with rasterio.Env() as environment:
        return sorted(set(environment.drivers()) - set(NETWORK_DRIVERS))


def _drivers(uri: str, found: Destination, place: Place | None) -> list[str]:
    """Return the drivers for a file that nobody vouches for."""
    view = uri.startswith("vrt://")
    if place is None:
        if found.where == "unknown" or view:
            raise UntrustedFileError("it cannot be looked at before GDAL opens it")
        if found.where == "network":
            _check_beside_remote(uri)
        return list(PLAIN_DRIVERS)
    if view:  # GDAL opens what it shows by itself
        check_source(place)
        return ["VRT"]
    drivers = drivers_for(check_file(place))
    if not drivers:
        raise UntrustedFileError("files of HDF5 and netCDF-4 can hold values of any other file")
    return list(drivers)


def _check_beside_remote(uri: str) -> None:
    """Raise where GDAL would find overviews or a mask beside a remote raster that are VRTs."""
    if get_gdal_config("GDAL_DISABLE_READDIR_ON_OPEN") == "EMPTY_DIR":
        return  # it does not look
    for ending in _BESIDE:
        with suppress(RasterioError):
            _opened(uri + ending, ["VRT"], {}).close()
            raise UntrustedFileError(f"{uri}{ending} is a VRT")
