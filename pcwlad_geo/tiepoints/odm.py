"""The `gcp_list.txt` of OpenDroneMap and WebODM: points on the ground, each with its pixel in one image."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.raster import file_name
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS
from pcwlad_geo.tiepoints.cells import number_in
from pcwlad_geo.tiepoints.format import PointFile, PointSource, TiePointFormat


@dataclass(frozen=True, slots=True)
class OdmFile:
    """How the file is written."""

    cells: int = 6
    """Least cells of a line: x, y, height, column, row, name of the image."""
    utm_north: int = 32600
    """EPSG code of zone 0 of UTM (WGS 84) on the northern half of the earth."""
    utm_south: int = 32700
    """The same on the southern half."""


ODM_FILE: Final = OdmFile()
"""As the program documents it."""
_UTM: Final = re.compile(r"wgs84\s+utm\s+(\d{1,2})\s*([ns])", re.IGNORECASE)


def _recognises(source: PointSource) -> bool:
    first = source.first_line.strip()
    return first.startswith(("+proj=", "epsg:")) or _UTM.fullmatch(first) is not None


def _read(source: PointSource) -> PointFile:
    """Read the points that are seen in the target, or in the only image of the file."""
    lines = [
        (number, line)
        for number, line in enumerate(source.lines or (), start=1)
        if line.strip() and not line.startswith("#")
    ]
    check_count(source.path, len(lines), LIMITS.points, "lines")
    crs = _crs_of(source.path, lines[0][1].strip())
    points = list(_seen(source.path, lines[1:]))
    names, image_name = {image for *_, image in points}, file_name(source.target_name)
    if len(names) > 1 and image_name not in names:
        raise InputError(
            f"{source.path} has points of {', '.join(sorted(names)[:5])}, and none of {image_name}: name the "
            "target as the file does"
        )
    ours = [(*ground, *pixel) for ground, pixel, image in points if image == image_name or len(names) == 1]
    numbers = np.array(ours, dtype=np.float64).reshape(-1, 4)
    return PointFile(numbers[:, :2], numbers[:, 2:], np.ones(len(numbers), bool), "map", "px", crs)


def _seen(
    path: str, lines: Sequence[tuple[int, str]]
) -> Iterator[tuple[tuple[float, float], tuple[float, float], str]]:
    """Yield map coordinates, pixel (col, row) and image of each point."""
    for number, line in lines:
        cells = line.split()
        if len(cells) < ODM_FILE.cells:
            raise InputError(
                f"{path}, line {number} has {len(cells)} cells: a line of a gcp_list.txt has x, y, height, "
                "column, row and the name of an image"
            )
        x, y, _, col, row = (number_in(path, number, "a coordinate", cell) for cell in cells[:5])
        yield (x, y), (col, row), file_name(cells[5])


def _crs_of(path: str, text: str) -> CRS:
    utm = _UTM.fullmatch(text)
    try:
        if utm is None:
            return CRS.from_user_input(text)
        base = ODM_FILE.utm_north if utm[2].lower() == "n" else ODM_FILE.utm_south
        return CRS.from_epsg(base + int(utm[1]))
    except LIBRARY_ERRORS as error:
        raise InputError(f"{path}: the CRS in its first line is not understood: {text[:80]}") from error


ODM: Final = TiePointFormat("odm", _recognises, _read)
"""The format of OpenDroneMap, which is only read."""
