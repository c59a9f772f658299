"""A web map: its grid at each zoom, and the addresses of its tiles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import urlsplit

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import Grid

Url = Callable[[int, int, int], str]
"""Gives the address of a tile by zoom, row and column."""


@dataclass(frozen=True, slots=True)
class Service:
    """A map of square tiles: at each zoom twice as many along each side as at the one before."""

    name: str
    """For people: without the query of an address, which may hold a key."""
    first: Grid
    """The grid at zoom 0."""
    tile_px: int
    finest: int
    """The largest zoom that there may be."""
    url: Url

    def level(self, zoom: int) -> Grid:
        """Return the grid of the whole map at a zoom."""
        rows, cols = self.first.shape
        return self.first.scaled((rows << zoom, cols << zoom))


def public_name(url: str) -> str:
    """Return an address without its query and login, which may hold a key."""
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise InputError(f"{url.partition('?')[0]!r} is no address of a server: give http://… or https://…")
    port = f":{parts.port}" if parts.port else ""
    return f"{parts.scheme}://{parts.hostname}{port}{parts.path}"
