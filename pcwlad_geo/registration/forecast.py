"""About how many tiles a job will have, known before the libraries are loaded that plan them.

Workers are made ready then: they have their libraries by the time that the tiles are planned.
"""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.source import open_raster
from pcwlad_geo.registration.settings import Settings

ONE_TILE: Final = 1.3
"""A scene is one tile up to this many tile sizes."""


def tiles_along(length_px: int, tile_size: int) -> int:
    """Return into how many about equal parts of at most ONE_TILE tile sizes a length is divided."""
    return 1 if length_px <= ONE_TILE * tile_size else math.ceil(length_px / tile_size)


def likely_tiles(
    reference: str | os.PathLike[str], target: str | os.PathLike[str], settings: Settings
) -> int:
    """Return about how many tiles two files make if they show the same ground; 0 where that is not known.

    The coarser one counts, as matching happens on its grid. Files that are not on this machine are not asked,
    nor are products; what cannot be read is the job's to tell.
    """
    if not (Path(reference).is_file() and Path(target).is_file()):
        return 0
    shapes = []
    with suppress(InputError):
        for path in (reference, target):
            with open_raster(os.fspath(path)) as dataset:
                shapes.append(dataset.shape)
        least = map(min, zip(*shapes, strict=True))
        return math.prod(tiles_along(length, settings.tile_size) for length in least)
    return 0
