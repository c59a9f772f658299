"""`tiepoints.csv`: the tie points as a table, written and read."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.tie_point_table import TiePointTable

Array = NDArray[np.float64]

COLUMNS = (
    "id",
    "ref_col",
    "ref_row",
    "tgt_col",
    "tgt_row",
    "x",
    "y",
    "d_col",
    "d_row",
    "d_x_m",
    "d_y_m",
    "sigma_col",
    "sigma_row",
    "score",
    "residual_col",
    "residual_row",
    "status",
)


def columns_of(table: TiePointTable) -> dict[str, NDArray[np.generic]]:
    """Return the columns of the CSV, in order, each (n,): id from 1, status a string, the rest float64."""
    pairs = {
        ("ref_col", "ref_row"): table.reference_px,
        ("tgt_col", "tgt_row"): table.target_px,
        ("x", "y"): table.xy,
        ("d_col", "d_row"): table.displacement_px,
        ("d_x_m", "d_y_m"): table.displacement_m,
        ("sigma_col", "sigma_row"): table.sigma_px,
        ("residual_col", "residual_row"): table.residual_px,
    }
    columns: dict[str, NDArray[np.generic]] = {
        "id": np.arange(1, len(table) + 1),
        "score": table.score,
        "status": table.status,
    }
    for names, values in pairs.items():
        columns |= {name: values[:, axis] for axis, name in enumerate(names)}
    return {name: columns[name] for name in COLUMNS}


def write(table: TiePointTable, path: Path) -> None:
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
    # Adding zero turns -0.0 into 0.0.
    return f"{value:.15g}" if name in ("x", "y") else f"{round(value, 6) + 0.0:.6f}"


def read(path: Path, *, crs: CRS | None = None) -> TiePointTable:
    """Read a table that `write` wrote, or another program with the same columns.

    The file holds no CRS and no covariance between the axes: the former is given, the latter 0.

    Parameters
    ----------
    path : pathlib.Path
        UTF-8 CSV with the columns of `COLUMNS`, in any order; others are ignored.
    crs : rasterio.crs.CRS, optional
        The CRS of x, y.

    Raises
    ------
    InputError
        If the file cannot be read, lacks a column, or a cell is no number.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
            if missing:
                raise InputError(f"{path} lacks the columns {', '.join(missing)}: give a tiepoints.csv")
            rows = [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} cannot be read as a table of tie points: {error}") from error
    pair = {
        name: np.column_stack([_numbers(path, rows, f"{name}{axis}") for axis in axes])
        for name, axes in {
            "ref_": ("col", "row"),
            "tgt_": ("col", "row"),
            "": ("x", "y"),
            "d_": ("col", "row", "x_m", "y_m"),
            "sigma_": ("col", "row"),
            "residual_": ("col", "row"),
        }.items()
    }
    return TiePointTable(
        reference_px=pair["ref_"],
        target_px=pair["tgt_"],
        predicted_px=pair["tgt_"] - pair["d_"][:, :2],
        xy=pair[""],
        displacement_m=pair["d_"][:, 2:],
        covariance_px2=pair["sigma_"][:, :, None] ** 2 * np.eye(2),
        score=_numbers(path, rows, "score"),
        residual_px=pair["residual_"],
        status=np.array([row["status"] or "" for _, row in rows], dtype=np.str_),
        crs=crs,
    )


def _numbers(path: Path, rows: list[tuple[int, dict[str, str]]], name: str) -> Array:
    values = np.full(len(rows), np.nan)
    for index, (line, row) in enumerate(rows):
        text = (row[name] or "").strip()
        try:
            values[index] = float(text) if text else math.nan
        except ValueError as error:
            raise InputError(f"{path}, line {line}: {name} is '{text}', not a number") from error
    return values
