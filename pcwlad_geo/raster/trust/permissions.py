"""Permissions to open more than plain rasters of this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Trust:
    """Permissions to open more than plain rasters of this machine; small and picklable."""

    remote: bool = False
    """Rasters over a network that the user names."""
    vrt: bool = False
    """All files that a raster names, wherever they are, and formats whose files name others."""
    sign: str = ""
    """Function of the user that signs addresses, ``module:function``; empty: none does."""
    composed: str = ""
    """VRT that this program has written of rasters that were checked, wherever they are; empty: none."""


_current: Final[ContextVar[Trust]] = ContextVar("pcwlad_geo_trust", default=Trust())  # noqa: B039  # frozen


def current_trust() -> Trust:
    """Return the permissions that apply in this thread."""
    return _current.get()


@contextmanager
def trusting(trust: Trust) -> Iterator[None]:
    """Apply permissions to the opening of rasters within the context.

    Threads that are started within it do not inherit it by themselves (see `contextvars.copy_context`); tasks
    in other processes receive it with their call.
    """
    token = _current.set(trust)
    try:
        yield
    finally:
        _current.reset(token)
