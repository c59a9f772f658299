"""Points that a hand has made, opened in the editor, refined by matching, and those that contradict."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Finished
from osgeo import gdal
from qgis.core import QgsPointXY
from qgis.PyQt.QtCore import QObject, Qt
from test_window import PICTURES, keep_pictures, run_in_window

WRONG_PX = (60.0, -45.0)


@pytest.fixture(scope="module")
def seen(
    profile: Path, finished: Finished, scene: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Any]:
    """Open nine points that are up to 2 px off, and one that is wrong, in the window."""
    folder = tmp_path_factory.mktemp("points")
    places = {}
    for name, path in zip(("reference", "target"), scene):
        places[name] = str(shutil.copy(path, folder / path.name))
    table = Path(finished.outcome["paths"]["tiepoints"])
    with table.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["status"] == "fit"]
    rng = np.random.default_rng(12)
    inside = [row for row in rows if all(70 < float(row[f"tgt_{axis}"]) < 350 for axis in ("col", "row"))]
    chosen = [inside[k] for k in rng.permutation(len(inside))[:10]]
    x, width, _, y, _, height = gdal.Open(places["target"]).GetGeoTransform()
    lines = ["#CRS: EPSG:32633", "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"]
    for number, row in enumerate(chosen):
        off = WRONG_PX if number == 4 else rng.uniform(-2.0, 2.0, 2)
        col, line = float(row["tgt_col"]) + off[0], float(row["tgt_row"]) + off[1]
        lines.append(f"{row['x']},{row['y']},{x + col * width},{y + line * height},1,0,0,0")
    places["points"] = str(folder / "hand.points")
    Path(places["points"]).write_text("\n".join(lines) + "\n", encoding="utf-8")
    places["nonsense"] = str(folder / "notes.txt")
    Path(places["nonsense"]).write_text("buy milk\n", encoding="utf-8")
    found = run_in_window("points.py", profile, folder, places)
    if PICTURES:
        keep_pictures(folder, Path(PICTURES))
    return found


def test_a_long_table_is_sorted_by_values_that_are_asked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    from pcwlad_geo_qgis.process.points import Point, Points
    from pcwlad_geo_qgis.widgets.points_table import PointsModel, SortedPoints

    lengths = [*np.random.default_rng(3).uniform(0.1, 9.0, 199).tolist(), float("nan")]
    points = Points([Point(k, 0.0, 0.0, (0.0, 0.0), 0.1, "fit", (at, 0.0)) for k, at in enumerate(lengths)])
    asked, value = [], PointsModel.value
    monkeypatch.setattr(PointsModel, "value", lambda self, *cell: asked.append(cell) or value(self, *cell))
    parent = QObject()
    model = PointsModel(points, lambda row: QgsPointXY())
    table = SortedPoints(points, model, parent)
    table.sort(model.residual_column, Qt.SortOrder.DescendingOrder)
    rows = [table.mapToSource(table.index(row, 0)).row() for row in range(200)]
    assert rows == [*sorted(range(199), key=lambda row: -lengths[row]), 199]
    assert len(asked) == 200
    points.points[rows[5]].residual_px = (20.0, 0.0)
    model.refresh()
    assert table.mapToSource(table.index(0, 0)).row() == rows[5]


def test_a_file_without_points_is_told(seen: dict[str, Any]) -> None:
    assert "✖" in seen["nonsense"]
    assert "notes.txt is no file of tie points" in seen["nonsense"]
    assert seen["errors"] == []
    assert seen["modal"] == []


def test_hand_made_points_are_refined_and_the_wrong_one_is_selected(seen: dict[str, Any]) -> None:
    assert seen["page"] is True
    assert "Tie points: 9" in seen["verdict"]
    assert seen["off"] == [4]  # which the others contradict so much that it is off at first
    assert "9 of 10 points are refined by matching. The others contradict 1" in seen["told"]
    assert seen["chosen"] == [5]  # its number
    assert seen["rows"] == [10, 9]


def test_the_fit_is_that_of_matching_then_and_can_be_taken_back(seen: dict[str, Any]) -> None:
    before, with_wrong, after, back = seen["rmse"]
    assert with_wrong > 10 > before
    assert after < min(before, 0.5)
    assert back == pytest.approx(before)
    assert seen["undone"] >= 10


def test_the_layer_lies_over_the_map_and_moves_with_each_edit(seen: dict[str, Any]) -> None:
    """The sample's thermal band belongs 1.2 px to the left and 0.75 px lower, of 30 m."""
    before, with_wrong, refined, back = seen["live"]
    assert refined[:2] == [pytest.approx(-37, abs=8), pytest.approx(-23, abs=8)]
    assert refined[2:] == [pytest.approx(1, abs=0.005), pytest.approx(1, abs=0.005)]
    assert back == pytest.approx(before)
    assert with_wrong == pytest.approx(before, rel=1e-5)  # the fit gives it no weight
    assert np.hypot(refined[0] - before[0], refined[1] - before[1]) > 5
    assert seen["live_shift"] == pytest.approx([seen["live_shift"][0], 1, 0, seen["live_shift"][3], 0, 1])
    assert seen["live_left"] == [True, False]  # another page took it away
    assert seen["live_without_points"] is False
    assert seen["live_closed"] == 0
