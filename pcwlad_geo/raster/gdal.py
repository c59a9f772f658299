"""The one door to GDAL: opening of rasters, its errors translated, expected warnings ignored, a small cache.

GDAL opens the files that a raster names: sources of a VRT, overviews and masks, arrays of coordinates,
external storage, the servers of a WMS description. This module opens the raster itself and files in its own
folder or below, by drivers whose files name no others, unless the user allows more (`trust`). The rules are
documented in docs/security.md.
"""

from __future__ import annotations

import errno
import logging
import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from pyproj.exceptions import ProjError
from rasterio._err import CPLE_BaseError
from rasterio.env import get_gdal_config, set_gdal_config
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader

from pcwlad_geo.errors import ExecutionError, InputError, PcwladGeoError, TrustError
from pcwlad_geo.limits import CHECKED_PX, MIN_STORED, check_block, check_shape, check_stored
from pcwlad_geo.raster.trust import (
    NETWORK_DRIVERS,
    PLAIN_DRIVERS,
    SIDECARS,
    Destination,
    Place,
    UntrustedFileError,
    check_file,
    check_named_by,
    current_trust,
    destination,
    drivers_for,
    gdal_name,
    place_of,
)
from pcwlad_geo.text import joined

# Warning filters belong to the process: two threads that swap them would restore each other's.
_filters = threading.RLock()


@contextmanager
def ignoring(category: type[Warning]) -> Iterator[None]:
    """Ignore warnings of a category within the context; other threads that want the same wait for its end."""
    with _filters, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


GDAL_ERRORS: Final = (RasterioError, CPLE_BaseError)
"""Exceptions that rasterio raises for failures of GDAL; they have no common base class."""

CACHE_BYTES: Final = 2**26
"""Largest size of GDAL's block cache; its default is a twentieth of the machine's memory."""


class _Records(logging.Handler):
    """Keeps what is logged."""

    def __init__(self, level: int) -> None:
        super().__init__(level)
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)


@contextmanager
def gdal_log(level: int, *, passes_on: bool = True) -> Iterator[list[logging.LogRecord]]:
    """Give the list of what GDAL reports within the context, which rasterio passes on to its log only.

    Levels of `logging` below `level` are left out; other handlers receive it as well if `passes_on`.
    """
    kept, logger = _Records(level), logging.getLogger("rasterio._env")
    before = logger.level, logger.propagate
    logger.addHandler(kept)
    logger.setLevel(level)
    logger.propagate = passes_on and logger.propagate
    try:
        yield kept.records
    finally:
        logger.removeHandler(kept)
        logger.setLevel(before[0])
        logger.propagate = before[1]


@contextmanager
def raising_gdal_reports() -> Iterator[None]:
    """Raise what GDAL reports within the context without failing: a write that the disk refuses.

    GDAL writes blocks later, when its cache is full or the file is closed, and says then what went wrong;
    rasterio passes that on to its log only, at the level INFO. A raster may lack its pixels after it. Raises
    `OSError` with the first report of this thread.
    """
    with gdal_log(logging.INFO) as records:
        yield
    for record in records:
        message = record.getMessage()
        signalled = record.levelno >= logging.ERROR or message.startswith("GDAL signalled an error")
        if signalled and record.thread == threading.get_ident():
            raise OSError(message.partition("msg=")[2].strip("'\"") or message)


def root_cause(error: BaseException) -> str:
    """Return the message of the innermost cause: GDAL's own, which rasterio chains below its exception."""
    while error.__cause__ is not None:
        error = error.__cause__
    return joined(error)


@contextmanager
def small_block_cache() -> Iterator[None]:
    """Limit GDAL's block cache, which belongs to the process, to `CACHE_BYTES` within the context."""
    before = get_gdal_config("GDAL_CACHEMAX")
    set_gdal_config("GDAL_CACHEMAX", min(before, CACHE_BYTES))
    try:
        yield
    finally:
        set_gdal_config("GDAL_CACHEMAX", before)


_SHORTAGES: Final = ("cannot allocate", "insufficient memory", "out of memory", "output buffer")
"""What messages of GDAL, libtiff and OpenCV about a lack of memory hold, in lower case."""


def lacks_memory(reason: str) -> bool:
    """Return whether a message of GDAL or OpenCV speaks of a lack of memory, not of a file or a disk."""
    return any(words in reason.lower() for words in _SHORTAGES)


def question(reason: str) -> str:
    """Return what to check after writing a raster failed for a reason, in GDAL's words."""
    if lacks_memory(reason):
        return "there is not enough memory; end other programs, or give --jobs 1"
    return "is the disk full, or too little memory left?"  # GDAL does not always pass on which it was


LIBRARY_ERRORS: Final = (*GDAL_ERRORS, CRSError, ProjError, UnicodeError, OverflowError, RecursionError)
"""Exceptions of GDAL, PROJ and their bindings for values that they cannot use, such as too deep JSON."""


@contextmanager
def reading(uri: str) -> Iterator[None]:
    """Convert exceptions of GDAL and PROJ within the context to an error that names the raster.

    Raises `InputError` if one of `LIBRARY_ERRORS` is raised within the context.
    """
    try:
        yield
    except LIBRARY_ERRORS as error:
        if lacks_memory(root_cause(error)):
            raise InputError(
                f"{uri} cannot be read: {root_cause(error)}; {question(root_cause(error))}"
            ) from error
        raise InputError(
            f"{uri} cannot be read: it, or a file beside it, is damaged ({root_cause(error)}); get it again, "
            "or copy what can be read of it (gdal_translate)"
        ) from error


def explained(error: BaseException) -> PcwladGeoError | None:
    """Return the error to show for a library error that names no file; None for any other exception."""
    memory = isinstance(error, MemoryError) or isinstance(error.__cause__, MemoryError)  # OpenCV wraps it
    if memory or lacks_memory(root_cause(error)):
        return ExecutionError(
            f"this needs more memory than there is ({root_cause(error) or 'none left'}): give --jobs 1, a "
            "smaller --window or --search-radius, or smaller rasters"
        )
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return InputError(f"there can be no file of so long a name: {error.filename}: give a shorter one")
    if isinstance(error, LIBRARY_ERRORS):
        return InputError(
            f"the input cannot be used: {root_cause(error)}; check the rasters' files and CRSs (gdalinfo)"
        )
    return None


TRUST_VRT: Final = "give --trust-vrt if you trust whoever made it with all files that you can read"
"""The advice at the end of messages about rasters that name other files."""


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
        if trust.remote:
            return _opened(uri, None, options)
        with rasterio.Env() as environment:
            local = sorted(set(environment.drivers()) - set(NETWORK_DRIVERS))
        return _opened(uri, local, options)
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
        check_file(place, any_driver=True)
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
    places = [np.unique(np.linspace(0, count - 1, 16).astype(int)).tolist() for count in counts]
    found = [
        dataset.get_tag_item(f"BLOCK_OFFSET_{col}_{row}", "TIFF", bidx=band) is not None
        for row in places[0]
        for col in places[1]
    ]
    return sum(found) / len(found)
