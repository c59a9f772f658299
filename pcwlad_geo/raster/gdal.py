"""What GDAL needs around long work: its errors told apart, its block cache kept small."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from rasterio._env import get_gdal_config, set_gdal_config
from rasterio._err import CPLE_BaseError
from rasterio.errors import RasterioError

GDAL_ERRORS: Final = (RasterioError, CPLE_BaseError)
"""What rasterio raises for failures of GDAL: not all of it has its own base class."""

CACHE_BYTES: Final = 2**26
"""GDAL's own default is a twentieth of the machine's memory."""


def root_cause(error: BaseException) -> str:
    """Return GDAL's own words, which rasterio hangs below its "see previous exception"."""
    while error.__cause__ is not None:
        error = error.__cause__
    return " ".join(str(error).split())


@contextmanager
def small_block_cache() -> Iterator[None]:
    """Keep GDAL's block cache, which belongs to the process, small for a while."""
    before = get_gdal_config("GDAL_CACHEMAX")
    set_gdal_config("GDAL_CACHEMAX", min(before, CACHE_BYTES))
    try:
        yield
    finally:
        set_gdal_config("GDAL_CACHEMAX", before)
