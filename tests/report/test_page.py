from __future__ import annotations

import base64
import hashlib
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcwlad_geo.correction.selection import choose
from pcwlad_geo.registration import Registration
from pcwlad_geo.report.answers import MARKS, headline
from pcwlad_geo.report.page import compose, report_page, warp_line
from pcwlad_geo.report.summary import summarise
from pcwlad_geo.report.views import VIEWS
from tests.chromium import show
from tests.registrations import of_files, write_pair

Make = Callable[..., Registration]
VOID = {"meta", "br", "img", "input", "link"}
OUTPUTS = ["report.html", "tiepoints.csv"]


class Reader(HTMLParser):
    """Collects text and what would be loaded from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.text = ""
        self.tags: list[str] = []
        self.sources: list[str] = []
        self.open: list[str] = []
        self.alt = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "img":
            assert dict(attrs).get("alt")
        self.sources += [value or "" for name, value in attrs if name == "src"]
        self.alt += dict(attrs).get("alt") or ""

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def page_of(made: Registration, gcps_vrt: str | None = "b10_gcps.vrt") -> str:
    report = summarise(made, OUTPUTS)
    return report_page(report, compose(made, report, gcps_vrt))


def read(made: Registration, gcps_vrt: str | None = "b10_gcps.vrt") -> Reader:
    reader = Reader()
    reader.feed(page_of(made, gcps_vrt))
    assert reader.open == []
    reader.text = re.sub(r"\s+", " ", reader.text)
    return reader


@pytest.mark.usefixtures("text_alone")
@pytest.mark.parametrize(
    ("check_px", "fit_px", "sigma_px", "said"),
    [(0.1, 0.05, 0.1, False), (0.1, 0.05, 0.01, False), (0.9, 0.1, 0.05, True), (0.9, 0.1, 1.2, False)],
)
def test_a_model_is_doubted_for_more_than_noise(
    registration: Make, check_px: float, fit_px: float, sigma_px: float, said: bool
) -> None:
    """Errors of check points that are noticeable, larger than those of fit points, and not matching noise."""
    made = registration()
    table = made.tie_points
    rng = np.random.default_rng(3)
    size = np.where(table.status == "check", check_px, fit_px)[:, None]
    table = replace(
        table,
        residual_px=size * rng.normal(size=(len(table), 2)),
        covariance_px2=np.tile(sigma_px**2 * np.eye(2), (len(table), 1, 1)),
    )
    page = read(replace(made, tie_points=table))
    assert ("the model does not hold between its points" in page.text) == said


def test_says_verdict_accuracy_and_points(registration: Make) -> None:
    made = registration()
    page = read(made)
    check = made.accuracy["check_px"]
    assert "Registered" in page.text
    assert f"90 % of the {check.n} check points" in page.text
    assert f"{check.ce90:.3f} px" in page.text
    assert f"{made.accuracy['check_m'].ce90:.2f} m" in page.text
    assert "84 fit, 24 check" in page.text
    assert "gdalwarp -tps -r lanczos b10_gcps.vrt b10_tps.tif" in page.text


def test_is_self_contained_and_escaped(registration: Make) -> None:
    page = read(registration(name="a & <b>.tif"))
    assert page.tags.count("script") == 1  # the slider's
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
    assert ("figures of a refused pair" in page.text) == (n > 1)
    assert "chance" not in page.text  # the reason alone says why


def test_match_without_vrt(registration: Make) -> None:
    page = read(registration("matched"), gcps_vrt=None)
    assert "Tie points matched" in page.text
    assert "gdalwarp" not in page.text


def test_warp_line_survives_a_shell() -> None:
    line = warp_line("a & b's_gcps.vrt")
    assert shlex.split(line)[-2:] == ["a & b's_gcps.vrt", "a & b's_tps.tif"]


@pytest.mark.usefixtures("text_alone")
def test_shows_the_table_of_models_and_not_their_thousands_of_numbers(registration: Make) -> None:
    made = registration()
    points = made.tie_points.select("fit")
    args = points.predicted_px, points.target_px, points.covariance_px2, 41.0
    by_hand = choose(*args, ("tps",))
    page = read(replace(made, selection=by_hand, model=by_hand.fit.correction))
    assert "tps" in page.text
    assert "coefficients" not in page.text
    chosen = choose(*args)
    page = read(replace(made, selection=chosen, model=chosen.fit.correction))
    assert "does not predict significantly better than shift" in page.text
    assert f"{chosen.candidates[0].rmse_px:.3f} ±" in page.text


@pytest.mark.usefixtures("text_alone")
def test_a_raster_named_like_a_tag_stays_a_name(registration: Make) -> None:
    name = "<script>alert(2)<!-- \"' --></script>.tif"
    made = registration(name=name)
    page = read(replace(made, target=replace(made.target, uri=name)))
    assert page.tags.count("script") == 1
    assert "<script>alert(2)<!--" in page.text


@pytest.mark.usefixtures("text_alone")
def test_questions_are_answered_at_the_top(registration: Make) -> None:
    page = read(registration())
    top = page.text[: page.text.index("Numbers")]
    assert "How well? CE90" in top
    assert "Where not?" in top
    assert "only 24 check points, 30 are asked for" in top
    assert "no reliable" not in top


def test_without_the_files_there_are_no_views(registration: Make) -> None:
    page = read(registration())
    assert "Before and after" not in page.text


def test_the_slider_moves_in_chromium_without_a_complaint(registration: Make, tmp_path: Path) -> None:
    """No error on the console (a request would be one: the page forbids all); skipped without Chromium."""
    page = page_of(of_files(registration(), *write_pair(tmp_path)))
    assert "default-src 'none'" in page
    move = """<script>for (const slider of document.querySelectorAll("input[data-views]")) {
      slider.value = 20; slider.dispatchEvent(new Event("input")); }
      document.querySelector("input[data-checkered]").click();
      document.querySelector("input[value=edged]").click();</script></body>"""
    allowed = re.sub(r"script-src '[^']*'", r"\g<0> 'unsafe-hashes'", page)
    digest = base64.b64encode(hashlib.sha256(move[8 : -len("</script></body>")].encode()).digest()).decode()
    path = tmp_path / "report.html"
    path.write_text(
        allowed.replace("'unsafe-hashes'", f"'sha256-{digest}'").replace("</body>", move), encoding="utf-8"
    )
    shown = show(path)
    assert not shown.complaints
    assert shown.page.count('style="--cut: 20%;"') == VIEWS.places
    assert shown.page.count('aria-valuetext="20 % reference"') == VIEWS.places
    assert shown.page.count('class="sheets edged"') == 1
    assert shown.page.count('class="views checkered"') == 1


@pytest.mark.parametrize(
    ("status", "grade", "text", "state"),
    [
        ("registered", "good", "Registered", "good"),
        ("registered", "fair", "Registered, with care", "caution"),
        ("registered", "poor", "Registered, poorly", "bad"),
        ("rejected", None, "Could not be registered reliably", "bad"),
        ("matched", None, "Tie points matched", "good"),
    ],
)
def test_the_headline_is_that_of_the_grade(status: Any, grade: Any, text: str, state: str) -> None:
    made = headline(status, grade)
    assert (made.text, made.state) == (text, state)
    assert MARKS[made.state]


@pytest.mark.usefixtures("text_alone")
def test_good_and_bad_pages_differ_at_a_glance(registration: Make) -> None:
    """The figure of a poor registration is marked, and a refused one has its advice open."""
    made = registration()
    table = made.tie_points
    poor = replace(table, residual_px=table.residual_px * 20)
    assert '<li class="good"><strong><span class="mark">✓</span> How well?' in page_of(made)
    assert '<li class="bad"><strong><span class="mark">✗</span> How well?' in page_of(
        replace(made, tie_points=poor)
    )
    assert '<details class="advice" open>' in page_of(registration("rejected"))
    assert '<details class="advice">' in page_of(made)
