"""Opening of all rasters, with checks of which other files an untrusted raster may make GDAL open.

GDAL opens the files that a raster names: sources of a VRT, overviews and masks, arrays of coordinates,
external storage, the servers of a WMS description. This module opens the raster itself and files in its own
folder or below, by drivers whose files name no others, unless the user allows more (`trust`). The rules are
documented in docs/security.md.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from rasterio.env import get_gdal_config
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.limits import CHECKED_PX, MIN_STORED, check_block, check_shape, check_stored
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.raster.trust import (
    NETWORK_DRIVERS,
    PLAIN_DRIVERS,
    SIDECARS,
    Destination,
    Place,
    Trust,
    UntrustedFileError,
    check_file,
    check_named_by,
    check_source,
    current_trust,
    destination,
    drivers_for,
    gdal_name,
    place_of,
)

TRUST_VRT: Final = "give --trust-vrt if you trust whoever made it with all files that you can read"
"""The advice at the end of messages about rasters that name other files."""
_NO_FILE: Final = "{none}"
"""A suffix that no file on a server has."""


def network_settings() -> dict[str, str]:
    """Return the GDAL settings that block network access; empty where the user allows it."""
    return {} if current_trust().remote else {"CPL_VSIL_CURL_ALLOWED_EXTENSIONS": _NO_FILE}


def open_for_reading(uri: str, **options: object) -> DatasetReader:
    """Open a raster that may be untrusted.

    Raises `TrustError` if it is on a network, or it, or a file that it names, needs to be trusted by the
    user, and `rasterio.errors.RasterioError` if it cannot be opened. The `uri` is a path or a GDAL URI; the
    options are GDAL's.
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
    """Open a file that this program has written or composed itself, from rasters that were checked."""
    return rasterio.open(path, **options)


def _opened(uri: str, drivers: list[str] | None, options: dict[str, object]) -> DatasetReader:
    return DatasetReader(gdal_name(uri), driver=drivers, **options)


def _drivers_of_trust(trust: Trust) -> list[str] | None:
    """Return the drivers for files that the user trusts; None for all."""
    if trust.remote:
        return None
    with rasterio.Env() as environment:
        return sorted(set(environment.drivers()) - set(NETWORK_DRIVERS))


def _drivers(uri: str, found: Destination, place: Place | None) -> list[str]:
    """Return the drivers for an untrusted file."""
    view = uri.startswith("vrt://")
    if place is None:
        if found.where == "unknown" or view:
            raise UntrustedFileError("it cannot be looked at before GDAL opens it")
        if found.where == "network":
            _check_remote_sidecars(uri)
        return list(PLAIN_DRIVERS)
    if view:  # GDAL opens what it shows by itself
        check_source(place)
        return ["VRT"]
    drivers = drivers_for(check_file(place))
    if not drivers:
        raise UntrustedFileError("files of HDF5 and netCDF-4 can hold values of any other file")
    return list(drivers)


def _check_remote_sidecars(uri: str) -> None:
    """Raise if GDAL would find overviews or a mask beside a remote raster that are VRTs."""
    if get_gdal_config("GDAL_DISABLE_READDIR_ON_OPEN") == "EMPTY_DIR":
        return  # it does not look
    for ending in SIDECARS:
        with suppress(RasterioError):
            _opened(uri + ending, ["VRT"], {}).close()
            raise UntrustedFileError(f"{uri}{ending} is a VRT")


_SAMPLES: Final = 16
"""Number of blocks sampled along each side of a large TIFF."""


def check_dataset(uri: str, dataset: DatasetReader, band: int) -> None:
    """Check that a raster declares no more pixels than its files can hold and fit into memory.

    Raises `InputError` if it declares more than its files can hold, or more than fits into memory. The `band`
    that is read counts from 1; `uri` is the name for the message.
    """
    _check_pixels(uri, dataset, band)
    _check_sources(dataset, {dataset.name})


def _check_sources(dataset: DatasetReader, visited: set[str]) -> None:
    """Check the source rasters of a VRT, about which its own size says nothing."""
    if dataset.driver != "VRT":
        return
    for name in dataset.files:
        if name in visited:
            continue
        visited.add(name)
        with (
            suppress(RasterioError),  # it is no raster, or reading it will raise
            ignoring(NotGeoreferencedWarning),
            open_for_reading(name) as source,
        ):
            if source.count:
                _check_pixels(name, source, 1)
            _check_sources(source, visited)


def _check_pixels(uri: str, dataset: DatasetReader, band: int) -> None:
    shape = dataset.shape
    check_shape(uri, shape, dataset.count)
    _ = dataset.overviews(band), dataset.colorinterp  # GDAL searches for them: better now than after the work
    rows, cols = dataset.block_shapes[band - 1]
    size = np.dtype(dataset.dtypes[band - 1]).itemsize
    together = dataset.count if dataset.tags(ns="IMAGE_STRUCTURE").get("INTERLEAVE") == "PIXEL" else 1
    check_block(uri, (rows, cols), size * together)
    if shape[0] * shape[1] <= CHECKED_PX:
        return
    sizes = list(_file_sizes(dataset))
    if sizes:  # on this machine
        check_stored(uri, shape, sum(sizes))
    if dataset.driver == "GTiff" and _stored_share(dataset, band) < MIN_STORED:
        raise InputError(
            f"{uri} declares {shape[1]} x {shape[0]} pixels, and hardly a block of them is in the file "
            f"(less than {MIN_STORED:.1%}): it is empty; crop it to where it holds data"
        )


def _file_sizes(dataset: DatasetReader) -> Iterator[int]:
    """Yield the sizes in bytes of the files of a raster."""
    for name in dataset.files:
        try:
            yield Path(name).stat().st_size
        except (OSError, ValueError):
            continue


def _stored_share(dataset: DatasetReader, band: int) -> float:
    """Return the share of evenly spread sample blocks of a TIFF that are stored in the file."""
    rows, cols = dataset.block_shapes[band - 1]
    counts = -(-dataset.height // rows), -(-dataset.width // cols)
    places = [np.unique(np.linspace(0, count - 1, _SAMPLES).astype(int)).tolist() for count in counts]
    found = [
        dataset.get_tag_item(f"BLOCK_OFFSET_{col}_{row}", "TIFF", bidx=band) is not None
        for row in places[0]
        for col in places[1]
    ]
    return sum(found) / len(found)
