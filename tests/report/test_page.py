from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from pcwlad_geo.correction.selection import choose
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.report.page import render, warp_line
from pcwlad_geo.report.summary import summarise

Make = Callable[..., Registration]
OUTPUTS = ["report.html", "tiepoints.csv"]


class Reader(HTMLParser):
    """Collects text and what would be loaded from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.text = ""
        self.tags: list[str] = []
        self.sources: list[str] = []
        self.alt = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [value or "" for name, value in attrs if name == "src"]
        self.alt += dict(attrs).get("alt") or ""

    def handle_data(self, data: str) -> None:
        self.text += data


def read(made: Registration, gcps_vrt: str | None = "b10_gcps.vrt") -> Reader:
    reader = Reader()
    reader.feed(render(made, summarise(made, OUTPUTS), gcps_vrt))
    reader.text = re.sub(r"\s+", " ", reader.text)
    return reader


def test_says_verdict_accuracy_and_points(registration: Make) -> None:
    made = registration()
    page = read(made)
    check = made.accuracy["check_px"]
    assert "Registered" in page.text
    assert f"90 % of the {check.n} check points" in page.text
    assert f"{check.ce90:.3f} px" in page.text
    assert f"{made.accuracy['check_m'].ce90:.2f} m" in page.text
    assert "84 fit, 24 check" in page.text
    assert "gdalwarp -tps -r cubic b10_gcps.vrt b10_tps.tif" in page.text


def test_is_self_contained_and_escaped(registration: Make) -> None:
    page = read(registration(name="a & <b>.tif"))
    assert "script" not in page.tags
    assert "link" not in page.tags
    assert "<script>alert(1)</script>" in page.text  # as text
    assert "a & <b>.tif" in page.text
    assert page.sources
    assert all(source.startswith("data:") for source in page.sources)
    assert "tie points" in page.alt


@pytest.mark.parametrize("n", [0, 1, 60])
def test_rejection_leads_with_the_reason(registration: Make, n: int) -> None:
    page = read(registration("rejected", n=n))
    assert "Could not be registered reliably" in page.text
    assert "raise --search-radius" in page.text
    assert "After correction" not in page.text


def test_match_without_vrt(registration: Make) -> None:
    page = read(registration("matched"), gcps_vrt=None)
    assert "Tie points matched" in page.text
    assert "gdalwarp" not in page.text


def test_warp_line_survives_a_shell() -> None:
    line = warp_line("a & b's_gcps.vrt")
    assert shlex.split(line)[-2:] == ["a & b's_gcps.vrt", "a & b's_tps.tif"]


def test_shows_the_table_of_models_and_not_their_thousands_of_numbers(registration: Make) -> None:
    made = registration()
    points = made.tie_points.select("fit")
    args = points.predicted_px, points.target_px, points.covariance_px2, 41.0
    by_hand = choose(*args, ("tps",))
    page = read(replace(made, selection=by_hand, correction=by_hand.fit.correction))
    assert "tps" in page.text
    assert "coefficients" not in page.text
    chosen = choose(*args)
    page = read(replace(made, selection=chosen, correction=chosen.fit.correction))
    assert "does not predict significantly better than shift" in page.text
    assert f"{chosen.candidates[0].rmse_px:.3f} ±" in page.text
