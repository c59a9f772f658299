"""Ground control points as a table that GDAL takes: ``gdal raster edit --gcp @file`` (3.12 or newer)."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.text import write_lines
from pcwlad_geo.tiepoints.cells import Table
from pcwlad_geo.tiepoints.format import PointFile, PointRasters, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.table import TiePointTable

COLUMNS: Final = ("column", "line", "x", "y")
"""Names that GDAL looks for."""


def _recognises(source: PointSource) -> bool:
    return set(COLUMNS) <= {cell.strip(' "') for cell in source.first_line.split(",")}


def _read(source: PointSource) -> PointFile:
    table = Table.read(source.path, source.lines or ())
    target_px = table.pair("column", "line")
    return PointFile(table.pair("x", "y"), target_px, np.ones(len(target_px), bool), "map", "px")


def _write(table: TiePointTable, path: Path, _: PointRasters) -> None:
    """Write pixel, line = `target_px`; x, y = `xy`; rejected points are left out."""
    accepted = table[table.status != "rejected"].placed
    lines = [",".join(COLUMNS)]
    for pixel, xy in zip(accepted.target_px.tolist(), accepted.xy.tolist(), strict=True):
        lines.append(",".join([*(f"{value:.6f}" for value in pixel), *(f"{value:.15g}" for value in xy)]))
    write_lines(path, lines)


GDAL_CSV: Final = TiePointFormat(
    "gcps_csv", _recognises, _read, "{stem}_gcps.csv", "the GCPs as a table, for `gdal raster edit`", _write
)
"""The table of GCPs of GDAL."""
