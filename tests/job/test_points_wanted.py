"""`points` N on an image that is matched whole: N tie points are what every output holds."""

from __future__ import annotations

import csv
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from scipy.spatial import cKDTree

import pcwlad_geo
from pcwlad_geo.job import match_files
from pcwlad_geo.raster import describe, plan_views
from pcwlad_geo.registration import Registration
from pcwlad_geo.report.statistics import coverage_of
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.table import place
from tests.scenes import make_grid, render, write

SMALL: Any = {"template": 61, "window": 41, "features": 150, "jobs": 1}
WANTED = 25


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("pair")
    grid = make_grid((200, 200))
    return (
        write(folder / "ref.tif", render(grid), grid),
        write(folder / "tgt.tif", 255 - render(grid, displacement_px=(1.3, -0.6)), grid),
    )


@pytest.fixture(scope="module")
def registered(pair: tuple[Path, Path]) -> tuple[Registration, Path]:
    out_dir = pair[0].parent / "registered"
    return pcwlad_geo.register(*pair, out_dir=out_dir, points=WANTED, **SMALL), out_dir


def held(folder: Path) -> dict[str, int]:
    """Tie points in each file of a folder, the rejected ones left out."""
    with (folder / "tiepoints.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    _, _, geometry, (status,) = pyogrio.raw.read(
        folder / "tiepoints.gpkg", layer="tie_points", columns=["status"]
    )
    _, _, arrows, (arrow_status,) = pyogrio.raw.read(
        folder / "tiepoints.gpkg", layer="displacements", columns=["status"]
    )
    assert (len(geometry), len(arrows)) == (len(rows), len(rows))
    qgis = (folder / "tgt.tif.points").read_text().splitlines()[2:]
    envi = (folder / "tgt.pts").read_text().splitlines()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(folder / "tgt_gcps.vrt") as file:
            gcps = len(file.gcps[0])
    counts = json.loads((folder / "report.json").read_text())["tie_points"]
    return {
        "csv": sum(row["status"] != "rejected" for row in rows),
        "gpkg": int(np.count_nonzero(status != "rejected")),
        "arrows": int(np.count_nonzero(arrow_status != "rejected")),
        "qgis": sum(line.split(",")[4] == "1" for line in qgis),
        "envi": sum(bool(line) and not line.startswith(";") for line in envi),
        "gcps": gcps,
        "report": counts["total"] - counts["rejected"],
    }


def test_every_output_of_register_holds_as_many(registered: tuple[Registration, Path]) -> None:
    found, folder = registered
    assert set(held(folder).values()) == {WANTED}
    assert np.count_nonzero(found.tie_points.status != "rejected") == WANTED
    assert found.counts["tie_points"] == WANTED
    assert found.counts["thinned"] > 20


def test_every_output_of_match_holds_as_many(pair: tuple[Path, Path], tmp_path: Path) -> None:
    found = match_files(*pair, out_dir=tmp_path / "m", points=WANTED, **SMALL)
    assert set(held(tmp_path / "m").values()) == {WANTED}
    assert np.count_nonzero(found.tie_points.status == "matched") == WANTED


def test_they_are_spread_over_the_image(registered: tuple[Registration, Path]) -> None:
    found, _ = registered
    points = found.tie_points.select("fit", "check", "unused")
    nearest, _ = cKDTree(points.reference_px).query(points.reference_px, k=2)
    assert nearest[:, 1].min() > 5
    assert (np.ptp(points.reference_px, axis=0) > 100).all()


def test_squares_whose_points_were_left_out_are_not_called_unmatched(
    registered: tuple[Registration, Path],
) -> None:
    found, _ = registered
    assert found.record is not None
    coverage = coverage_of(found.tie_points, (200, 200), found.record)
    col, row = (found.record.thinned_px / (200 / 12)).astype(int).T
    assert set(coverage.reason[row, col]) <= {"", "not_asked"}


def test_more_than_are_found_are_all_that_are_found(pair: tuple[Path, Path], tmp_path: Path) -> None:
    every = match_files(*pair, out_dir=tmp_path / "all", **SMALL)
    more = match_files(*pair, out_dir=tmp_path / "more", points=5000, **SMALL)
    np.testing.assert_array_equal(more.tie_points.target_px, every.tie_points.target_px)
    assert more.counts["tie_points"] == every.counts["tie_points"]
    assert set(held(tmp_path / "more").values()) == {every.counts["tie_points"]}


def test_those_of_a_file_are_thinned_too_and_30_are_check_points(
    pair: tuple[Path, Path], tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    reference_px = rng.uniform(5, 195, (400, 2))
    target_px = reference_px + rng.normal((1.3, -0.6), 0.1, (400, 2))
    table = place(
        reference_px,
        target_px,
        np.tile(np.eye(2) * 0.01, (400, 1, 1)),
        np.ones(400),
        plan_views(*map(describe, pair)),
    )
    write_csv(table, tmp_path / "points.csv")
    found = pcwlad_geo.register(
        *pair, out_dir=tmp_path / "out", tie_points=tmp_path / "points.csv", points=120, jobs=1
    )
    assert set(held(tmp_path / "out").values()) == {120}
    assert len(found.tie_points.select("check")) >= 30
