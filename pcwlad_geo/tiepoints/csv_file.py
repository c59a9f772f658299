"""The file tiepoints.csv, and any CSV with its four columns of positions."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, Final

import numpy as np

from pcwlad_geo.tiepoints.cells import Table
from pcwlad_geo.tiepoints.format import PointFile, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.table import POINT_COLUMNS, TiePointTable, columns_of

POSITIONS: Final = ("ref_col", "ref_row", "tgt_col", "tgt_row")
"""The columns that a CSV of tie points must have."""


def write_csv(table: TiePointTable, path: Path) -> None:
    """Write the table as UTF-8 CSV, one row a tie point; NaN becomes an empty cell.

    Pixels and metres are written to 1e-6, map coordinates to 15 significant digits.
    """
    cells = [_cells(name, values.tolist()) for name, values in columns_of(table).items()]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(POINT_COLUMNS)
        writer.writerows(zip(*cells, strict=True))


def _cells(name: str, values: list[Any]) -> list[str]:
    """Return the texts of a column."""
    if not values or not isinstance(values[0], float):
        return list(map(str, values))
    form = "{:.15g}" if name in ("x", "y") else "{:.6f}"
    zero = form.format(-0.0)
    texts = ["" if text in ("nan", "inf", "-inf") else text for text in map(form.format, values)]
    return [text[1:] if text == zero else text for text in texts]


def points_of(table: Table) -> PointFile:
    """Return the tie points of a table with the columns of tiepoints.csv."""
    statuses = table.texts("status")
    sides = {name: table.pair(f"{name}_col", f"{name}_row") for name in ("ref", "tgt")}
    return PointFile(
        sides["ref"],
        sides["tgt"],
        np.array([text != "rejected" for text in statuses]),
        "px",
        "px",
        sigma_px=table.sigmas(),
        correlation=table.correlations(),
        score=table.numbers("score") if "score" in table.columns else None,
        xy=table.pair("x", "y", optional=True),
        displacement_px=table.pair("d_col", "d_row", optional=True),
        displacement_m=table.pair("d_x_m", "d_y_m", optional=True),
        status=np.array(statuses, dtype="<U8") if "status" in table.columns else None,
    )


def _recognises(source: PointSource) -> bool:
    return all(name in source.first_line for name in POSITIONS)


CSV: Final = TiePointFormat(
    "csv", _recognises, lambda source: points_of(Table.read(source.path, source.lines or ()))
)
"""The format of tiepoints.csv, which each job writes."""
