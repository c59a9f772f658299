"""The boundary to the libraries: what GDAL and PROJ raise becomes an error that names the file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from pyproj.exceptions import ProjError
from rasterio.errors import CRSError

from pcwlad_geo.errors import ExecutionError, InputError, PcwladGeoError
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause

LIBRARY_ERRORS: Final = (*GDAL_ERRORS, CRSError, ProjError, UnicodeError, OverflowError)
"""What GDAL, PROJ and their bindings raise for values that they cannot use."""


@contextmanager
def reading(uri: str) -> Iterator[None]:
    """Turn what the libraries raise while a raster is read into an error that names it.

    Raises
    ------
    InputError
        Then.
    """
    try:
        yield
    except LIBRARY_ERRORS as error:
        raise InputError(
            f"{uri} cannot be read: it, or a file beside it, is damaged ({root_cause(error)}); get it again, "
            "or copy what can be read of it (gdal_translate)"
        ) from error


def explained(error: BaseException) -> PcwladGeoError | None:
    """Return the error that people see for one of the libraries that names no file; None for any other."""
    if isinstance(error, MemoryError):
        return ExecutionError(
            f"this needs more memory than there is ({root_cause(error) or 'none left'}): give --jobs 1, a "
            "smaller --window or --search-radius, or smaller rasters"
        )
    if isinstance(error, LIBRARY_ERRORS):
        return InputError(
            f"the input cannot be used: {root_cause(error)}; check the rasters' files and CRSs (gdalinfo)"
        )
    return None
