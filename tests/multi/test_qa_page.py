"""The page: says the verdict, needs nothing else, and shows hostile names as text."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

from pcwlad_geo.multi.pages import figure, signed
from pcwlad_geo.multi.qa.band_pairs import PairResult
from pcwlad_geo.multi.qa.bands import Band
from pcwlad_geo.multi.qa.closure import close_triangles, closes
from pcwlad_geo.multi.qa.numbers import QaResult, summarise
from pcwlad_geo.multi.qa.page import crs_name, qa_page
from pcwlad_geo.multi.qa.requirements import judge_pairs, judge_triangles, read_requirement
from pcwlad_geo.multi.qa.run import closure_note
from pcwlad_geo.options import Settings
from tests.chromium import show
from tests.multi.measured_bands import make_band, make_pair, refused

VOID = {"meta", "br", "line", "path", "circle", "rect", "polyline", "link", "img", "input"}


@pytest.fixture(scope="module")
def without_pictures() -> None:
    """Draw them: here is what tests these pages."""


class Reader(HTMLParser):
    """Collects text, tags and links, and holds the tags against each other."""

    def __init__(self) -> None:
        super().__init__()
        self.text = ""
        self.tags: list[str] = []
        self.links: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    reader.text = re.sub(r"\s+", " ", reader.text)
    assert reader.open == []
    return reader


def make_result(
    bands: list[Band], pairs: list[PairResult], require: tuple[str, ...] = (), against: Band | None = None
) -> QaResult:
    triangles = close_triangles(bands, pairs, 81) if against is None else []
    wanted = [read_requirement(text) for text in require]
    verdicts = [
        judge_triangles(each, triangles) if each.rule.statistic == "closure" else judge_pairs(each, pairs)
        for each in wanted
    ]
    return QaResult(
        tuple(bands), against, tuple(pairs), tuple(triangles), tuple(verdicts), Settings(), 1.0, Path("out")
    )


def page_of(*arguments: Any, **keywords: Any) -> Reader:
    return read(qa_page(summarise(make_result(*arguments, **keywords), ["qa.json"])))


BANDS = [make_band(name) for name in ("b2", "b4", "b5")]
GOOD = [make_pair(*two, (0.01, -0.02)) for two in combinations(BANDS, 2)]
MIXED = [GOOD[0], make_pair(BANDS[0], BANDS[2], (1.5, 0.0)), refused(BANDS[1], BANDS[2])]


@pytest.mark.parametrize(
    ("pairs", "require", "headline"),
    [
        (GOOD, (), "3 pairs measured"),
        (GOOD, ("CE90<=0.3px",), "✓ Passed: all 3 pairs meet the requirement"),
        (GOOD, ("CE90<=0.3px", "closure<=0.1px"), "✓ Passed: all 3 pairs meet the requirements"),
        (GOOD, ("CE90<=0.01px",), "✗ Failed: 3 of 3 pairs miss CE90 ≤ 0.01 px"),
        (GOOD, ("closure<=0.001px",), "✗ Failed: triangles do not close"),
        (MIXED, ("CE90<=0.3px",), "✗ Failed: 2 of 3 pairs, 1 of them refused"),
        (MIXED, (), "1 of 3 pairs could not be measured"),
    ],
)
def test_the_headline_says_it_all(pairs: list[PairResult], require: tuple[str, ...], headline: str) -> None:
    page = qa_page(summarise(make_result(BANDS, pairs, require), []))
    match = re.search(r"<h1[^>]*>(.*?)</h1>", page, re.DOTALL)
    assert match is not None
    assert match[1] == headline


def test_the_matrix_has_the_figures_of_every_pair() -> None:
    px = MIXED[1].statistics["px"]
    assert px is not None
    page = page_of(BANDS, MIXED, ("CE90<=0.3px",))
    assert f"{figure(px.radial.ce90)} ✗ fails" in page.text
    assert f"mean {signed(px.col.mean)}, {signed(px.row.mean)}" in page.text
    assert f"LE90 {figure(px.col.le90)}, {figure(px.row.le90)}" in page.text
    assert "n 400" in page.text
    assert "✗ refused" in page.text
    assert "b4 – b5 could not be measured: only 7 of 900 agree" in page.text
    assert page.tags.count("svg") == 1 + 2  # an arrow for the pair that is displaced, and the maps


def test_closure_or_why_there_is_none() -> None:
    assert "b2 – b4 – b5" in page_of(BANDS, GOOD).text
    assert "no triangle of three bands whose pairs were all measured" in page_of(BANDS, MIXED).text
    one = page_of(BANDS, GOOD[:2], against=BANDS[0]).text
    assert "compared with b2 only, so this check was not made" in one


def test_triangles_that_do_not_close_are_told() -> None:
    off = [GOOD[0], GOOD[1], make_pair(BANDS[1], BANDS[2], (0.66, 0.0))]
    assert "Triangles do not close, the worst by 0." in page_of(BANDS, off).text
    assert "do not close" not in page_of(BANDS, GOOD).text
    note = closure_note(close_triangles(BANDS, off, 81))
    assert note is not None
    assert note.startswith("1 of 1 triangles do not close, b2 – b4 – b5 by 0.")
    assert closure_note(close_triangles(BANDS, GOOD, 81)) is None


def test_a_warning_stands_under_the_matrix_with_its_pairs() -> None:
    told = [replace(pair, warnings=("clouds moved",)) for pair in GOOD[:2]]
    text = page_of(BANDS, [*told, GOOD[2]]).text
    assert "clouds moved (b2 – b4, b2 – b5)" in text
    assert text.index("Displacement of every pair") < text.index("clouds moved") < text.index("Closure of")


def test_a_triangle_closes_within_the_limit_or_its_error() -> None:
    good = {"mean_px": (0.04, -0.05), "error_px": (0.001, 0.001)}
    assert closes(good["mean_px"], good["error_px"])
    assert closes((0.2, 0.0), (0.1, 0.0))
    assert not closes((0.2, 0.0), (0.02, 0.0))
    assert not closes((0.2, 0.0), None)
    assert not closes(None, None)


def test_hostile_names_and_reasons_are_text() -> None:
    evil = make_band("<script>alert('x')</script>")
    odd = replace(make_band("a & b"), description="<img src=http://x>")
    pairs = [refused(odd, evil, "<b>no</b> & never")]
    page = page_of([odd, evil], pairs)
    assert "script" not in page.tags
    assert "img" not in page.tags
    assert "b" not in page.tags
    assert "<script>alert('x')</script>" in page.text
    assert "<b>no</b> & never" in page.text


def test_needs_nothing_from_elsewhere() -> None:
    page = qa_page(summarise(make_result(BANDS, GOOD), []))
    assert set(read(page).links) == {"qa.json", "qa.csv"}
    assert "url(" not in page
    assert "@import" not in page
    assert "http" not in page


def test_native_pixels_and_missing_metres() -> None:
    thermal = [make_band("red"), make_band("b10", native_m=100.0)]
    assert "native px" in page_of(thermal, [make_pair(*thermal)]).text
    bare = [make_band("red", georeferenced=False), make_band("nir", georeferenced=False)]
    assert "Without a CRS there are no metres" in page_of(bare, [make_pair(*bare)]).text


def test_native_pixels_of_unknown_size_are_left_out() -> None:
    bands = [make_band("red"), make_band("b10", native_m=100.0)]
    pair = make_pair(*bands)
    unknown = replace(pair, statistics={**pair.statistics, "native px": None, "m": None})
    assert "native px" not in page_of(bands, [unknown]).text


def test_many_triangles_are_cut_to_the_worst() -> None:
    bands = [make_band(f"b{number}") for number in range(8)]
    pairs = [make_pair(*two, n=60) for two in combinations(bands, 2)]
    assert "the other 32 are in qa.json" in page_of(bands, pairs).text


def test_figures() -> None:
    assert [figure(value) for value in (-0.004, -0.126, None, 1.0)] == ["0.00", "−0.13", "–", "1.00"]
    assert [signed(value) for value in (0.004, 0.126, -1.0, None)] == ["0.00", "+0.13", "−1.00", "–"]
    assert crs_name('PROJCS["WGS 84 / UTM",GEOGCS["x"]]') == "WGS 84 / UTM"
    assert crs_name(None) == "none"


def test_chromium_shows_it_without_a_complaint(tmp_path: Path) -> None:
    """No error on the console, and the text is there; skipped where there is no Chromium."""
    path = tmp_path / "qa.html"
    path.write_text(qa_page(summarise(make_result(BANDS, MIXED, ("CE90<=0.3px",)), [])), encoding="utf-8")
    shown = show(path)
    assert "Failed: 2 of 3 pairs" in shown.page
    assert not shown.complaints
