"""Tie points as text: `tiepoints.csv`, and the GCP files of QGIS, ENVI and GDAL."""

from __future__ import annotations

import csv
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.tiepoints.table import COLUMNS, TiePointTable, columns_of


def write_csv(table: TiePointTable, path: Path) -> None:
    """Write the table as UTF-8 CSV, one row a tie point; NaN becomes an empty cell.

    Parameters
    ----------
    table : TiePointTable
        Pixels and metres are written to 1e-6, map coordinates to 15 significant digits.
    path : pathlib.Path
        The file to write.
    """
    columns = columns_of(table)
    cells = [[_cell(name, value) for value in values.tolist()] for name, values in columns.items()]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(zip(*cells, strict=True))


def _cell(name: str, value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    if not math.isfinite(value):
        return ""
    # Adding zero converts -0.0 to 0.0.
    return f"{value:.15g}" if name in ("x", "y") else f"{round(value, 6) + 0.0:.6f}"


# ENVI counts from (1, 1) at the top-left corner of the first pixel, GDAL from (0, 0).
_ENVI_ORIGIN_PX = 1.0


def write_points(
    table: TiePointTable, path: Path, target_info_georeferenced: bool, target_grid: Grid
) -> None:
    """Write a `.points` file of the QGIS Georeferencer; rejected points are included, but not enabled.

    Points without a position in both files and on the map are left out, as in all files of control points.

    Parameters
    ----------
    table : TiePointTable
        mapX, mapY = `xy`; dX, dY = -`residual_px`, 0 where unknown: QGIS defines residuals as predicted minus
        observed, in pixels, columns to the right and rows down.
    path : pathlib.Path
        `<target file name>.points`: QGIS loads it with the raster beside it.
    target_info_georeferenced : bool
        Whether the target is georeferenced: QGIS then expects layer coordinates, otherwise (col, -row).
    target_grid : Grid
        Original grid of the target.
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
        Base = `reference_px`, warp = `target_px`, both + 1 because ENVI counts from 1.
    path : pathlib.Path
        The file to write.
    reference_name, target_name : str
        Names of the base and the warp file, for the header.
    """
    used = table[table.status != "rejected"].placed
    lines = [
        "; ENVI Image to Image GCP File",
        f"; base file: {_without_line_breaks(reference_name)}",
        f"; warp file: {_without_line_breaks(target_name)}",
        "; Base Image (x,y), Warp Image (x,y)",
        ";",
    ]
    for base, warp in zip(used.reference_px + _ENVI_ORIGIN_PX, used.target_px + _ENVI_ORIGIN_PX, strict=True):
        lines.append(" ".join(f"{value:14.6f}" for value in (*base, *warp)))
    _write_lines(path, lines)


def _number(value: float) -> str:
    return f"{value + 0.0:.15g}"


def _without_line_breaks(name: str) -> str:
    """Return a file name without line breaks, as the next line would be read as a tie point."""
    return "_".join(name.splitlines())


def _write_lines(path: Path, lines: list[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")


def write_gcps_vrt(
    path: Path, target_path: str | Path, table: TiePointTable, crs: CRS | None, *, final_path: Path
) -> None:
    """Write a VRT of the target with the tie points as ground control points; rejected ones are left out.

    Parameters
    ----------
    path : pathlib.Path
        Path to which the file is written now.
    target_path : str or pathlib.Path
        The original target: a path or a GDAL URI.
    table : TiePointTable
        Pixel, line = `target_px`; X, Y = `xy`.
    crs : rasterio.crs.CRS or None
        The CRS of `xy`; None for the pixel plane, y = -row.
    final_path : pathlib.Path
        Final path of the file: the path to the target is relative to its folder.
    """
    tree = vrt.describe_file(target_path, final_path)
    # Copies of a file with GCPs and AREA_OR_POINT=Point would be shifted by a pixel.
    for item in tree.iter("MDI"):
        if item.get("key") == "AREA_OR_POINT":
            item.text = "Area"
    tree.insert(0, _gcp_list(table[table.status != "rejected"].placed, crs))
    vrt.write(tree, path)


def _gcp_list(table: TiePointTable, crs: CRS | None) -> ET.Element:
    gcps = ET.Element("GCPList")
    if crs is not None:
        gcps.set("Projection", crs.to_wkt(version="WKT2_2019"))
    for number, (pixel, xy) in enumerate(zip(table.target_px, table.xy, strict=True), start=1):
        attributes = {"Id": str(number), "Pixel": f"{pixel[0]:.6f}", "Line": f"{pixel[1]:.6f}"}
        ET.SubElement(gcps, "GCP", attributes, X=repr(float(xy[0])), Y=repr(float(xy[1])))
    return gcps
