"""Names of band files, which all kinds of products share, and the images of folders."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

from pcwlad_geo.raster.masks import is_quality_raster
from pcwlad_geo.types import PathLike

BAND_OF: Final = re.compile(
    r"(?P<scene>.+?)_(?:(?:SR|ST)_)?(?P<band>B(?:\d{1,2}|8A))(?:_VCID_\d|_\d\dm)?", re.IGNORECASE
)
"""File name, without its suffix, of a band of a product."""
DATE: Final = re.compile(r"(?<!\d)((?:19|20)\d\d)([-_]?)(0[1-9]|1[0-2])\2([0-2]\d|3[01])(?!\d)")
"""A date in a name."""
RASTERS: Final = (".tif", ".tiff", ".vrt", ".jp2", ".img")
"""Endings of the files of a folder that are taken for images."""
PICTURES: Final = (".jpg", ".jpeg", ".png")
"""The same where a folder has none of these: frames, which beside others are previews."""


def date_in(path: str) -> str | None:
    """Return the date, ISO 8601, in the last part of a path that tells one."""
    match = next(filter(None, (DATE.search(part) for part in reversed(Path(path).parts))), None)
    return f"{match[1]}-{match[3]}-{match[4]}" if match else None


def rasters_of(folder: PathLike) -> list[str]:
    """Return the images of a folder that is no product: all rasters but quality rasters, by name."""
    entries = sorted(Path(folder).iterdir())
    files = [file for file in entries if file.suffix.casefold() in RASTERS]
    files = files or [file for file in entries if file.suffix.casefold() in PICTURES]
    return [os.fspath(file) for file in files if not is_quality_raster(file.name)]
