"""Names of band files, which all kinds of products share, and the images of folders."""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in
from pcwlad_geo.raster.masks import is_quality_raster
from pcwlad_geo.types import PathLike

BAND_OF: Final = re.compile(
    r"(?P<scene>.+?)_(?:(?:SR|ST)_)?(?P<band>B(?:\d{1,2}|8A))(?:_VCID_\d|_\d\dm)?", re.IGNORECASE
)
"""File name, without its suffix, of a band of a product."""
DATE: Final = re.compile(r"(?<!\d)((?:19|20)\d\d)([-_]?)(0[1-9]|1[0-2])\2(0[1-9]|[12]\d|3[01])(?!\d)")
"""A date in a name."""
_DAY_OF_YEAR: Final = re.compile(
    r"(?<!\d)((?:19|20)\d\d(?:[0-2]\d\d|3[0-5]\d|36[0-6]))(?:T\d{6}|\.\d{4})(?!\d)"
)
"""A date and time in the names of HLS, VIIRS and MODIS, with the number of the day in its year."""
_OF_ASTER: Final = re.compile(r"AST_(?:L1B|08)_\d{3}(?P<month_day>[01]\d[0-3]\d)(?P<year>20\d\d)\d{6}_.*")
"""A name of ASTER, whose second date is that of the processing."""
RASTERS: Final = (".tif", ".tiff", ".vrt", ".jp2", ".img")
"""Endings of the files of a folder that are taken for images."""
PICTURES: Final = (".jpg", ".jpeg", ".png")
"""The same where a folder has none of these: frames, which beside others are previews."""

HDF5_ENDINGS: Final = (".h5", ".he5", ".nc")
"""Endings of the files of swaths and cubes."""


def date_in(path: str) -> str | None:
    """Return the date, ISO 8601, in the last part of a path that tells one."""
    parts = [_OF_ASTER.sub(r"\g<year>\g<month_day>", part) for part in reversed(Path(path).parts)]
    match = next(filter(None, map(DATE.search, parts)), None)
    if match:
        return f"{match[1]}-{match[3]}-{match[4]}"
    day = next(filter(None, map(_DAY_OF_YEAR.search, parts)), None)
    if day is None or int(day[1][4:]) < 1:
        return None
    begin = datetime.date(int(day[1][:4]), 1, 1)
    return (begin + datetime.timedelta(days=int(day[1][4:]) - 1)).isoformat()


def rasters_of(folder: PathLike) -> list[str]:
    """Return the images of a folder that is no product: all rasters but quality rasters, by name."""
    entries = sorted(Path(folder).iterdir())
    files = [file for file in entries if file.suffix.casefold() in RASTERS]
    files = files or [file for file in entries if file.suffix.casefold() in PICTURES]
    return [os.fspath(file) for file in files if not is_quality_raster(file.name)]


def cubes_of(folder: PathLike) -> list[str]:
    """Return the files of a folder that are HDF5 or netCDF by their endings."""
    return [
        os.fspath(file) for file in sorted(Path(folder).iterdir()) if file.suffix.casefold() in HDF5_ENDINGS
    ]


def by_scene(names: Iterable[str], pattern: re.Pattern[str]) -> dict[str, dict[str, str]]:
    """Return the files of each scene by their parts in capitals.

    The `pattern` of a file's name has the groups ``scene`` and ``part``.
    """
    scenes: dict[str, dict[str, str]] = {}
    for name in names:
        match = pattern.fullmatch(name_in(name))
        if match:
            scenes.setdefault(match["scene"], {})[match["part"].upper()] = name
    return scenes


def beside(path: Path) -> FileTree:
    """Return the files of a file's folder, without those of folders in it."""
    return FileTree(
        path.parent, tuple(sorted(entry.name for entry in path.parent.iterdir() if entry.is_file()))
    )


def scene_by(pattern: re.Pattern[str], path: Path) -> str | None:
    """Return the scene of a file by its name; None for another file."""
    match = pattern.fullmatch(path.name)
    return match["scene"] if match else None
