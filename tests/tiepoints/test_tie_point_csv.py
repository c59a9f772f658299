"""tiepoints.csv: columns, precision, empty cells, and the way back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import TiePointTable
from tests.tables import read_table

HEADER = (
    "id,ref_col,ref_row,tgt_col,tgt_row,x,y,d_col,d_row,d_x_m,d_y_m,"
    "sigma_col,sigma_row,correlation,score,residual_col,residual_row,status"
)


def table(n: int = 40, crs: CRS | None = None) -> TiePointTable:
    rng = np.random.default_rng(7)
    predicted = rng.uniform(0, 10980, (n, 2))
    return TiePointTable(
        reference_px=rng.uniform(0, 10980, (n, 2)),
        target_px=predicted + rng.normal(0, 1, (n, 2)),
        predicted_px=predicted,
        xy=rng.uniform(4_000_000, 5_000_000, (n, 2)),
        displacement_m=rng.normal(0, 30, (n, 2)),
        covariance_px2=np.eye(2) * rng.uniform(0.01, 0.1, (n, 2, 1)) ** 2,
        score=rng.uniform(0, 1, n),
        residual_px=rng.normal(0, 0.1, (n, 2)),
        status=rng.choice(["fit", "check", "unused", "rejected"], n),
        crs=crs,
    )


def test_what_was_written_is_read_back(tmp_path: Path) -> None:
    written = table()
    write_csv(written, tmp_path / "tiepoints.csv")
    read = read_table(tmp_path / "tiepoints.csv", CRS.from_epsg(32633))
    for name in ("reference_px", "target_px", "predicted_px", "displacement_m", "residual_px", "score"):
        assert np.abs(getattr(read, name) - getattr(written, name)).max() < 1.1e-6, name
    assert np.abs(read.xy - written.xy).max() < 1e-8
    assert np.abs(read.sigma_px - written.sigma_px).max() < 1e-6
    assert list(read.status) == list(written.status)
    assert read.crs == CRS.from_epsg(32633)


def test_the_text_is_exactly_this(tmp_path: Path) -> None:
    one = TiePointTable(
        reference_px=np.array([[10.5, 20.25]]),
        target_px=np.array([[11.0, 19.0]]),
        predicted_px=np.array([[10.75, 19.0]]),
        xy=np.array([[500000.1, -33.123456789012]]),
        displacement_m=np.full((1, 2), np.nan),
        covariance_px2=np.array([[[0.04, 0.01], [0.01, 0.09]]]),
        score=np.array([0.5]),
        residual_px=np.array([[-1e-9, np.nan]]),
        status=np.array(["matched"]),
        crs=None,
    )
    write_csv(one, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_bytes().decode() == (
        HEADER + "\n1,10.500000,20.250000,11.000000,19.000000,500000.1,-33.123456789012,0.250000,0.000000,,,"
        "0.200000,0.300000,0.166667,0.500000,0.000000,,matched\n"
    )


def test_an_empty_table_is_a_header(tmp_path: Path) -> None:
    write_csv(table()[:0], tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == HEADER + "\n"


def test_correlations_are_read_back_and_lie_within_one(tmp_path: Path) -> None:
    covariance_px2 = np.array([[[0.04, -0.03], [-0.03, 0.09]], [[0.01, 0.0], [0.0, 0.04]]])
    write_csv(replace(table(2), covariance_px2=covariance_px2), tmp_path / "t.csv")
    np.testing.assert_allclose(read_point_file(tmp_path / "t.csv").correlation, [-0.5, 0.0], atol=1e-6)
    text = "ref_col,ref_row,tgt_col,tgt_row,sigma_col,sigma_row,correlation\n1,2,3,4,.1,.1,{}\n"
    for cell, value in (("", 0.0), ("1", 0.999999)):
        (tmp_path / "a.csv").write_text(text.format(cell))
        assert read_point_file(tmp_path / "a.csv").correlation == pytest.approx([value])
    (tmp_path / "a.csv").write_text(text.format("1.5"))
    with pytest.raises(InputError, match=r"line 2: correlation lies beyond -1 to 1"):
        read_point_file(tmp_path / "a.csv")
