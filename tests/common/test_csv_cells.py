"""Cells of CSV files are no formulas, whoever named files and bands."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.multi.batch.summary import PairOutcome, write_summary
from pcwlad_geo.multi.batch.table import BatchPair
from pcwlad_geo.multi.qa.numbers import summarise, to_csv
from pcwlad_geo.options import Settings
from pcwlad_geo.text import cell
from pcwlad_geo.tiepoints.envi import write_envi
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import TiePointTable
from tests.multi.measured_bands import make_band, refused
from tests.multi.test_qa_page import make_result

FORMULAS = ["=1+1", "+1", "-cmd|' /C calc'!A0", "@SUM(A1)", "\t=1", "\r=1", "  =1", "＝1"]


@pytest.mark.parametrize("text", FORMULAS)
def test_text_like_a_formula(text: str) -> None:
    assert cell(text) == f"'{text}"


@pytest.mark.parametrize("value", [-1.5, 3, None, True, "b4.tif", "/data/-b4.tif", ""])
def test_all_else_stays(value: object) -> None:
    assert cell(value) is value


def test_summary_of_a_batch(tmp_path: Path) -> None:
    pair = BatchPair(2, "=1+1.tif", '=HYPERLINK("x").tif', tmp_path, Settings(), {})
    write_summary(tmp_path / "summary.csv", [PairOutcome(pair, "unusable", "@reason")])
    (row,) = csv.DictReader(io.StringIO((tmp_path / "summary.csv").read_text()))
    assert (row["reference"], row["target"]) == ("'=1+1.tif", '\'=HYPERLINK("x").tif')
    assert row["reason"] == "'@reason"


def test_table_of_bands() -> None:
    bands = [make_band("=1+1"), make_band("-b")]
    numbers = summarise(make_result(bands, [refused(*bands, "+why")]), [])
    (row,) = csv.DictReader(io.StringIO(to_csv(numbers)))
    assert (row["reference"], row["target"], row["reason"]) == ("'=1+1", "'-b", "'+why")


def test_a_file_name_adds_no_tie_points(tmp_path: Path) -> None:
    points = np.array([[10.0, 20.0], [30.0, 5.0], [7.0, 8.0]])
    table = TiePointTable(
        *(points, points, points, points, np.zeros((3, 2)), np.zeros((3, 2, 2)), np.ones(3)),
        np.zeros((3, 2)),
        np.full(3, "fit"),
        None,
    )
    write_envi(table, tmp_path / "t.pts", "a.tif\n1 2 3 4", "b\r\n5 6 7 8\x0b9 9 9 9.tif")
    assert len(read_point_file(tmp_path / "t.pts").target) == 3
