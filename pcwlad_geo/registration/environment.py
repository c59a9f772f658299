"""What a task needs of its process: GDAL's settings as its sender has them, one thread a library."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final, TypeVar

import rasterio.env

from pcwlad_geo.raster.trust import Trust, trusting

T = TypeVar("T")

_FORWARDED: Final = re.compile(
    "CPL_VSIL_|VSI_CACHE|VSIS3_|GDAL_HTTP_|GDAL_DISABLE_READDIR_ON_OPEN$|GDAL_INGESTED_BYTES_AT_OPEN$|"
    "GDAL_CACHEMAX$|AWS_"
)
"""Variables of the environment that set how GDAL reads over a network; none names a file of this machine."""
_SECRET: Final = re.compile(
    "SECRET|TOKEN|KEY|PASS|PWD|BEARER|AUTH|HEADER|COOKIE|CREDENTIAL|PROFILE|FILE|ROLE"
)


def gdal_settings() -> dict[str, str]:
    """Return GDAL's settings of this process that tasks elsewhere need too: data for `in_environment`.

    They are those of an open ``rasterio.Env``, and of the environment variables those for reading over a
    network. Credentials are left out: messages to workers are no place for them, each worker has its own.
    """
    settings: dict[str, Any] = {name: value for name, value in os.environ.items() if _FORWARDED.match(name)}
    if rasterio.env.hasenv():
        settings |= rasterio.env.getenv()
    kept = {name: value for name, value in settings.items() if not _SECRET.search(name.upper())}
    return {**kept, "GDAL_NUM_THREADS": "1"}


def in_environment(
    settings: Mapping[str, Any], trust: Trust, function: Callable[..., T], arguments: tuple[Any, ...]
) -> T:
    """Do a task with these settings of GDAL, opening rasters with this trust, OpenCV on one thread."""
    import cv2  # inside: slow to load, and workers may be started before

    if cv2.getNumThreads() != 1:
        cv2.setNumThreads(1)
    with trusting(trust), rasterio.Env(**settings):
        return function(*arguments)


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Keep OpenCV on one thread in this process for as long as the context lasts."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
