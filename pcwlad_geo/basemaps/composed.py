"""References that a job composes for its target: the fetched part of a web map, or a VRT of tiles."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pcwlad_geo.basemaps.services import is_service
from pcwlad_geo.basemaps.tiles import gather, is_tiles
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import Inputs

Composed = Literal["basemap", "tiles"]
"""What is composed, which is the kind of output too."""


def composed_as(name: str) -> Composed | None:
    """Return what a job composes of the reference that the user names; None where it is a raster itself."""
    return "basemap" if is_service(name) else "tiles" if is_tiles(name) else None


def resolvable(name: str, composed: Composed | None) -> str:
    """Return the name of a reference as `resolve` takes it before it is composed, not for a folder."""
    return f"tiles:{name}" if composed == "tiles" else name


def compose(
    name: str, composed: Composed | None, inputs: Inputs, path: Path, on_event: EventCallback
) -> Settings:
    """Write the reference that a target needs to a file; return the settings to match with it.

    Raises `InputError` and `TrustError` as `fetching.fetch` and `tiles.gather` do.
    """
    if composed == "tiles":
        return gather(name, inputs, path)
    from pcwlad_geo.basemaps.fetching import fetch  # slow to load, and rarely needed

    return fetch(name, inputs, path, on_event)
