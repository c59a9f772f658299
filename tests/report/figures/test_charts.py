"""Charts: round ticks, marks at their places, colours in order, and nothing but valid SVG."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from pcwlad_geo.report.charts import Box, Chart, coloured, day_ticks, shades, tick_texts, ticks_between


@pytest.mark.parametrize(
    ("limits", "texts"),
    [
        ((0, 256), ["0", "100", "200"]),
        ((256, 0), ["0", "100", "200"]),
        ((-0.13, 0.13), ["−0.1", "0.0", "0.1"]),
        ((0, 1), ["0.00", "0.25", "0.50", "0.75", "1.00"]),
        ((0.0612, 0.0714), ["0.065", "0.070"]),
        ((3.0, 3.0), ["3"]),
        ((0, 3e9), ["0", "1e+09", "2e+09", "3e+09"]),
    ],
)
def test_ticks_are_round_and_few(limits: tuple[float, float], texts: list[str]) -> None:
    assert [text for _, text in tick_texts(*limits)] == texts


@pytest.mark.parametrize("span", np.geomspace(1e-9, 1e12, 60).tolist())
def test_ticks_of_any_span(span: float) -> None:
    ticks = ticks_between(-0.3 * span, 0.7 * span)
    assert 2 <= len(ticks) <= 5
    assert min(ticks) >= -0.3 * span * (1 + 1e-6)
    assert max(ticks) <= 0.7 * span * (1 + 1e-6)


@pytest.mark.parametrize(
    ("first", "last", "texts"),
    [
        ("2020-01-05", "2020-01-09", [f"2020-01-0{day}" for day in range(5, 10)]),
        ("2020-01-05", "2020-09-05", ["2020-01", "2020-03", "2020-05", "2020-07", "2020-09"]),
        ("2000-03-01", "2020-09-05", ["2000", "2004", "2008", "2012", "2016", "2020"]),
    ],
)
def test_dates_are_round(first: str, last: str, texts: list[str]) -> None:
    assert [text for _, text in day_ticks(np.datetime64(first), np.datetime64(last))] == texts


def test_marks_are_at_their_places_and_nothing_at_unknown_ones() -> None:
    chart = Chart(100.0)
    panel = chart.panel(Box(10, 20, 200, 50), (0, 100), (0, 10))
    panel.dots(np.array([[0, 0], [50, 10], [np.nan, 3]]), 1, "#000")
    panel.line(np.array([0, 50, 60, 100.0]), np.array([0, 5, np.nan, 10]), "#111")
    svg = chart.svg()
    ElementTree.fromstring(svg)
    assert 'd="M10.0 70.0h.01M110.0 20.0h.01"' in svg
    assert 'd="M10.0 70.0L110.0 45.0M210.0 20.0"' in svg


def test_texts_of_strangers_are_escaped() -> None:
    chart = Chart(100.0)
    chart.text(1, 2, "<script>&")
    assert "".join(ElementTree.fromstring(chart.svg()).itertext()) == "<script>&"


def test_every_mark_is_valid_and_a_hatch_is_defined_once() -> None:
    chart = Chart(300.0)
    panel = chart.panel(Box(60, 20, 200, 200), (-1, 1), (1, -1))
    at, where = np.array([[0.0, 0.5], [0.2, -0.4]]), np.array([[True, False], [False, True]])
    panel.picture(np.zeros((3, 4), np.uint8), smooth=True)
    panel.picture(np.zeros((3, 4, 4), np.uint8))
    for hatch in ("..", "oo", "//", "xx", "\\\\", "//"):
        panel.squares(where, "#abcdef", hatch=hatch)  # type: ignore[arg-type]
    panel.rings(at, 3, "#000")
    panel.crosses(at, 3, "#000")
    panel.error_bars(at, np.array([0.1, 0.2]), "#000")
    panel.area(at[:, 0], at[:, 1], "#000", hatch="xx")
    panel.circle(0.5, "#000")
    panel.arrows(at, at + 0.3, ["#000", "#fff"])
    panel.bar("viridis", 0.3, "px")
    panel.x_ticks(grid=True)
    panel.y_ticks()
    panel.frame("x", "y", "title")
    svg = chart.svg()
    ElementTree.fromstring(svg)
    names = re.findall(r' id="([^"]*)"', svg)
    assert len(names) == len(set(names))
    assert set(re.findall(r"url\(#([^)]*)\)", svg)) <= set(names)


def test_colours_are_in_order() -> None:
    lightness = coloured(np.linspace(0, 2, 9), 0, 2, "viridis").mean(axis=1)
    assert (np.diff(lightness) > 0).all()
    np.testing.assert_array_equal(coloured(np.array([-1.0, 3.0]), 0, 2, "viridis")[0], [0x44, 0x01, 0x54])
    assert len(set(shades(np.linspace(0, 1, 999), 1.0, "viridis"))) <= 25
