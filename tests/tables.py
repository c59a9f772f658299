"""Reading of tiepoints.csv as it was written: every column, nothing checked."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64


def read_table(path: Path, crs: CRS | None = None) -> TiePointTable:
    """Return the table of a file; the covariance between the axes, which is not in it, is 0."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))

    def numbers(*names: str) -> Float64:
        values = [[float(row[name] or "nan") for name in names] for row in rows]
        return np.array(values).reshape(-1, len(names))

    target_px = numbers("tgt_col", "tgt_row")
    sigma_px, correlation = numbers("sigma_col", "sigma_row"), numbers("correlation")
    alike = np.where(np.eye(2) > 0, 1.0, correlation[:, :, None])
    return TiePointTable(
        reference_px=numbers("ref_col", "ref_row"),
        target_px=target_px,
        predicted_px=target_px - numbers("d_col", "d_row"),
        xy=numbers("x", "y"),
        displacement_m=numbers("d_x_m", "d_y_m"),
        covariance_px2=sigma_px[:, :, None] * sigma_px[:, None] * alike,
        score=numbers("score")[:, 0],
        residual_px=numbers("residual_col", "residual_row"),
        status=np.array([row["status"] for row in rows], dtype=np.str_),
        crs=crs,
    )
