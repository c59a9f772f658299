"""What the user lets the rasters of a job make GDAL open: nothing but themselves, unless told."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Trust:
    """What may be opened besides plain rasters of this machine; small and picklable."""

    remote: bool = False
    """Rasters over a network, which the user has named."""
    vrt: bool = False
    """Whatever a raster names, wherever it is, and formats whose files name others."""


_NOTHING: Final = Trust()
_current: Final[ContextVar[Trust]] = ContextVar("pcwlad_geo_trust", default=_NOTHING)


def current_trust() -> Trust:
    """Return what holds in this thread."""
    return _current.get()


@contextmanager
def trusting(trust: Trust) -> Iterator[None]:
    """Let rasters be opened with this trust for as long as the context lasts.

    Threads that are started meanwhile do not inherit it by themselves (`contextvars.copy_context`), tasks in
    other processes receive it with their call.
    """
    token = _current.set(trust)
    try:
        yield
    finally:
        _current.reset(token)
