"""GDAL's errors and reports translated, expected warnings ignored, and its cache limited."""

from __future__ import annotations

import errno
import logging
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from pyproj.exceptions import ProjError
from rasterio._err import CPLE_BaseError
from rasterio.env import get_gdal_config, set_gdal_config
from rasterio.errors import CRSError, RasterioError

from pcwlad_geo.errors import ExecutionError, InputError, PcwladGeoError
from pcwlad_geo.text import joined

GDAL_ERRORS: Final = (RasterioError, CPLE_BaseError)
"""Exceptions that rasterio raises for failures of GDAL; they have no common base class."""
CACHE_BYTES: Final = 2**26
"""Largest size of GDAL's block cache; its default is a twentieth of the machine's memory."""
_SHORTAGES: Final = ("cannot allocate", "insufficient memory", "out of memory", "output buffer")
"""What messages of GDAL, libtiff and OpenCV about a lack of memory hold, in lower case."""
LIBRARY_ERRORS: Final = (*GDAL_ERRORS, CRSError, ProjError, UnicodeError, OverflowError, RecursionError)
"""Exceptions of GDAL, PROJ and their bindings for values that they cannot use, such as too deep JSON."""

# Warning filters belong to the process: two threads that swap them would restore each other's.
_filters = threading.RLock()


@contextmanager
def ignoring(category: type[Warning]) -> Iterator[None]:
    """Ignore warnings of a category within the context; other threads that want the same wait for its end."""
    with _filters, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


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
    handler, logger = _Records(level), logging.getLogger("rasterio._env")
    before = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(level)
    logger.propagate = passes_on and logger.propagate
    try:
        yield handler.records
    finally:
        logger.removeHandler(handler)
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


def lacks_memory(reason: str) -> bool:
    """Return whether a message of GDAL or OpenCV speaks of a lack of memory, not of a file or a disk."""
    return any(words in reason.lower() for words in _SHORTAGES)


def question(reason: str) -> str:
    """Return what to check after writing a raster failed for a reason, in GDAL's words."""
    if lacks_memory(reason):
        return "there is not enough memory; end other programs, or give --jobs 1"
    return "is the disk full, or too little memory left?"  # GDAL does not always pass on which it was


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
