"""The `.points` files of the QGIS Georeferencer."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import Grid
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS
from pcwlad_geo.text import write_lines
from pcwlad_geo.tiepoints.cells import Table
from pcwlad_geo.tiepoints.format import PointFile, PointRasters, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.table import TiePointTable

CRS_LINE: Final = "#CRS:"
"""Beginning of the line of a `.points` file that holds the CRS."""
_QGIS_SOURCE: Final = (("sourcex", "sourcey"), ("pixelx", "pixely"))


def write_points(
    table: TiePointTable, path: Path, target_info_georeferenced: bool, target_grid: Grid
) -> None:
    """Write a `.points` file of the QGIS Georeferencer; rejected points are included, but not enabled.

    Points without a position in both files and on the map are left out, as in all files of control points.
    mapX, mapY = `xy`; dX, dY = -`residual_px`, 0 where unknown: QGIS defines residuals as predicted minus
    observed, in pixels, columns to the right and rows down. It loads `<target file name>.points` with the
    raster beside it, and expects layer coordinates where that is georeferenced, otherwise (col, -row).
    """
    table = table.placed
    if target_info_georeferenced:
        source_xy = target_grid.to_xy(table.target_px)
    else:
        source_xy = table.target_px * np.array([1.0, -1.0])
    qgis_residual_px = -np.nan_to_num(table.residual_px)
    lines = [] if table.crs is None else [f"#CRS: {' '.join(table.crs.to_wkt(version='WKT2_2019').split())}"]
    lines.append("mapX,mapY,sourceX,sourceY,enable,dX,dY,residual")
    for xy, source, (d_x, d_y), status in zip(
        table.xy, source_xy, qgis_residual_px, table.status, strict=True
    ):
        numbers = [_number(value) for value in (*xy, *source)]
        residuals = [_number(round(value, 6)) for value in (d_x, d_y, np.hypot(d_x, d_y))]
        lines.append(",".join([*numbers, "0" if status == "rejected" else "1", *residuals]))
    write_lines(path, lines)


def _number(value: float) -> str:
    return f"{value + 0.0:.15g}"


def _read(source: PointSource) -> PointFile:
    path, lines = source.path, source.lines or ()
    crs = _crs_of(path, next((line for line in lines if line.startswith(CRS_LINE)), CRS_LINE))
    body = [line for line in lines if not line.startswith("#")]
    table = Table.read(path, body)
    sides = next((pair for pair in _QGIS_SOURCE if set(pair) <= set(table.columns)), None)
    if sides is None or "mapy" not in table.columns:
        raise InputError(
            f"{path} has the columns {', '.join(table.columns)}: a .points file of the QGIS Georeferencer "
            "has mapX, mapY and sourceX, sourceY (or pixelX, pixelY)"
        )
    enabled = np.ones(len(table.rows), bool)
    if "enable" in table.columns:
        enabled = table.numbers("enable") != 0  # an empty cell is NaN, which is not 0
    return PointFile(table.pair("mapx", "mapy"), table.pair(*sides), enabled, "map", "layer", crs)


def _crs_of(path: str, line: str) -> CRS | None:
    text = line.removeprefix(CRS_LINE).strip()
    if not text:
        return None
    try:
        return CRS.from_user_input(text)
    except LIBRARY_ERRORS as error:
        raise InputError(f"{path}: the CRS in its first line is not understood: {text[:80]}") from error


def _write(table: TiePointTable, path: Path, rasters: PointRasters) -> None:
    write_points(table, path, rasters.target_on_map, rasters.target.grid)


QGIS: Final = TiePointFormat(
    "points",
    lambda source: "mapx" in source.first_line,
    _read,
    "{name}.points",
    "tie points for the QGIS Georeferencer",
    _write,
)
"""The format of the QGIS Georeferencer."""
