"""Tie points as the GCP files of QGIS and ENVI."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.tie_point_table import TiePointTable

# ENVI counts from (1, 1) at the top-left corner of the first pixel, GDAL from (0, 0).
_ENVI_ORIGIN_PX = 1.0


def write_points(
    table: TiePointTable, path: Path, target_info_georeferenced: bool, target_grid: Grid
) -> None:
    """Write a `.points` file of the QGIS Georeferencer; rejected points are there, not enabled.

    Parameters
    ----------
    table : TiePointTable
        mapX, mapY = `xy`; dX, dY = -`residual_px`, 0 where unknown: QGIS counts predicted minus observed,
        in pixels, columns to the right and rows down.
    path : pathlib.Path
        `<target file name>.points`: QGIS loads it with the raster it lies beside.
    target_info_georeferenced : bool
        QGIS wants the layer's coordinates of a georeferenced source, (col, -row) otherwise.
    target_grid : Grid
        Original grid of the target.

    Points without a place are left out, as in all files of control points.
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
    _write_lines(path, lines)


def write_envi(table: TiePointTable, path: Path, reference_name: str, target_name: str) -> None:
    """Write an ENVI image-to-image `.pts` file; rejected points are left out.

    Parameters
    ----------
    table : TiePointTable
        Base = `reference_px`, warp = `target_px`, both + 1: ENVI's origin.
    path : pathlib.Path
        The file to write.
    reference_name, target_name : str
        Names of the base and the warp file, for the header.
    """
    used = table[table.status != "rejected"].placed
    lines = [
        "; ENVI Image to Image GCP File",
        f"; base file: {_one_line(reference_name)}",
        f"; warp file: {_one_line(target_name)}",
        "; Base Image (x,y), Warp Image (x,y)",
        ";",
    ]
    for base, warp in zip(used.reference_px + _ENVI_ORIGIN_PX, used.target_px + _ENVI_ORIGIN_PX, strict=True):
        lines.append(" ".join(f"{value:14.6f}" for value in (*base, *warp)))
    _write_lines(path, lines)


def _number(value: float) -> str:
    return f"{value + 0.0:.15g}"


def _one_line(name: str) -> str:
    """Return a file name without line breaks: what follows one would count as tie points."""
    return "_".join(name.splitlines())


def _write_lines(path: Path, lines: list[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")
