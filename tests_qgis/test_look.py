"""Ways to look at a result: red and cyan, edges, the reference while Space is held, the residuals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from conftest import Finished
from qgis.PyQt.QtGui import QColor, QImage, QPainter, qAlpha, qBlue, qGreen, qRed
from test_window import PICTURES, keep_pictures, run_in_window


@pytest.fixture(scope="module")
def seen(profile: Path, finished: Finished, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Look at a finished pair in the window, and return what was seen."""
    folder = tmp_path_factory.mktemp("window")
    done = str(Path(finished.outcome["paths"]["numbers"]).parent)
    found = run_in_window("look.py", profile, folder, {"done": done})
    if PICTURES:
        keep_pictures(folder, Path(PICTURES))
    return found


def square(at: int, colour: str = "#ffffff") -> QImage:
    """Return a square of 60 px on transparent ground, some pixels from the upper left."""
    image = QImage(200, 200, QImage.Format.Format_ARGB32_Premultiplied)
    image.fill(QColor(0, 0, 0, 0))
    painter = QPainter(image)
    painter.fillRect(at, at, 60, 60, QColor(colour))
    painter.end()
    return image


def test_what_agrees_is_grey_and_what_does_not_red_or_cyan(monkeypatch: pytest.MonkeyPatch) -> None:
    from pcwlad_geo_qgis.widgets import composite

    asked, levels = [], composite._levels
    monkeypatch.setattr(composite, "_levels", lambda *given: asked.append(given) or levels(*given))
    made = composite.red_cyan(square(70), square(60))
    assert len(asked) == 2  # it takes longer than all the rest

    def at(place: int) -> tuple[int, int, int]:
        pixel = made.pixel(place, place)
        return qRed(pixel), qGreen(pixel), qBlue(pixel)

    assert at(100) == (255, 255, 255)  # both
    assert at(65) == (255, 0, 0)  # the reference alone
    assert at(125) == (0, 255, 255)
    assert at(20) == (0, 0, 0)


def test_edges_of_the_reference_lie_over_the_image() -> None:
    from pcwlad_geo_qgis.widgets.composite import edges

    made = edges(square(70, "#808080"), square(60))
    inside, edge, outside = (made.pixel(col, 100) for col in (90, 60, 30))
    assert (qRed(inside), qGreen(inside), qBlue(inside)) == (128, 128, 128)
    assert qRed(edge) > 150 > 100 > qGreen(edge)
    assert qAlpha(outside) == 0


def test_one_way_to_look_is_on_and_draws_the_whole_map(seen: dict[str, Any]) -> None:
    assert seen["errors"] == []
    assert seen["modal"] == []
    assert seen["drawn"] == [seen["size"]] * 2
    assert seen["one_is_on"] == [False, True]
    assert seen["blinks_alone"] == [False, True]
    assert seen["blink_is_off"] == [False, False]
    assert seen["page_left"] == [False, True]
    assert seen["without_reference"] == [False, True]


def test_the_result_is_transparent_over_what_it_is_compared_with(seen: dict[str, Any]) -> None:
    (first, opacity, before), (again, _, reference) = seen["fade"]
    assert [first, again] == [True, True]
    assert opacity == pytest.approx(0.4)
    assert [Path(each).name for each in before + reference] == ["landsat_b10.tif", "landsat_b4.tif"]
    assert seen["fade stops edges"] is False
    assert seen["edges stop fade"] == [1.0, 0, True]
    assert seen["opaque again"] == 1.0


def test_space_shows_the_reference_while_it_is_held(seen: dict[str, Any]) -> None:
    layers, composite = seen["held"]
    assert [Path(each).name for each in layers] == ["landsat_b4.tif"]
    assert composite is False
    assert seen["let_go"] == [True, True]


def test_the_map_of_residuals_is_high_where_they_are(seen: dict[str, Any]) -> None:
    low, high = seen["heat"]
    assert seen["heat_points"] > 100
    assert high > 1.5 * low
    assert seen["heat_off"] is False
    assert seen["heat_removed"] is False
