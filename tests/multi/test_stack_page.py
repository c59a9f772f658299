"""The page of a stack: the net drawn, wrong pairs first, names of strangers escaped."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.multi.stack.adjustment import adjust
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.page import stack_page
from pcwlad_geo.multi.stack.pair import StackPair
from pcwlad_geo.multi.stack.pairs import MeasuredPair
from pcwlad_geo.multi.stack.positions import stack_of
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import describe
from tests.multi.test_adjustment import make, ring
from tests.scenes import make_grid, render, write

GRID = make_grid((200, 200))


@pytest.fixture(scope="module")
def without_pictures() -> None:
    """Draw them: here is what tests these pages."""


def make_stack(folder: Path, names: list[str]) -> Stack:
    """A stack of simulated tie points, in which the first pair is wrong and one was refused."""
    rng = np.random.default_rng(4)
    truth, pairs = make(rng, len(names)), ring(len(names))
    edges = [
        truth.edge(rng, *pair, shared=0.02, sigma=0.05, off=2.0 if number == 0 else 0.0)
        for number, pair in enumerate(pairs)
    ]
    info = describe(write(folder / "image.tif", render(GRID), GRID))
    blank = StackPair(names[0], names[3], "refused", "no better than chance", folder / "x")
    measured = [
        MeasuredPair(
            replace(
                blank,
                reference=names[one],
                target=names[other],
                reason=None,
                folder=folder / f"{one}_{other}",
            ),
            edge,
        )
        for edge, (one, other) in zip(edges, pairs, strict=True)
    ]
    frame = StackFrame(names, [info] * len(names), GRID, True)
    found = adjust(edges, len(names))
    return stack_of(
        frame, [*measured, MeasuredPair(blank)], found, folder, Settings(), [], {"late.tif": "no raster"}
    )


def test_the_net_is_drawn_and_what_does_not_fit_comes_first(tmp_path: Path) -> None:
    names = [f"date{number}" for number in range(9)]
    text = stack_page(make_stack(tmp_path, names))
    drawing = text.partition('<svg class="net')[2].partition("</svg>")[0]
    assert drawing.count("<circle") == 9
    assert drawing.count("<line") == len(ring(9)) + 1
    assert drawing.count('class="left-out"') == 1
    assert drawing.count('class="refused"') == 1
    rows = re.findall(r'<a href="pairs/[^"]*/report.html">([^<]*)</a>', text)
    assert rows[:2] == ["date0 – date1", "date0 – date3"]
    assert "1 pair contradicts" in text
    assert "late.tif could not be read" in text
    assert "of each is an affine." in text


def test_pairs_that_nothing_checks_are_not_said_to_agree(tmp_path: Path) -> None:
    found = make_stack(tmp_path, [f"date{number}" for number in range(9)])
    used = sum(pair.status == "used" for pair in found.pairs)
    assert f"{used} of {used + 1} pairs agree to " in stack_page(found)
    pairs = tuple(replace(pair, redundancy=0.0) for pair in found.pairs)
    text = stack_page(replace(found, pairs=pairs))
    assert f"{used} pairs that form no cycle cannot check each other; 1 pair contradicts the others." in text
    assert "agree to" not in text
    text = stack_page(replace(found, pairs=(found.pairs[0], *pairs[1:3], *found.pairs[3:])))
    assert "(RMS), 2 of them checked by no other; 1 pair contradicts" in text


def test_a_pair_without_a_page_leads_to_its_numbers(tmp_path: Path) -> None:
    found = make_stack(tmp_path, ["date0", "date1", "date2", "date3"])
    bare, full = (pair.folder for pair in found.pairs[:2])
    for file in (bare / "report.json", full / "report.json", full / "report.html"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    text = stack_page(found)
    assert f'href="pairs/{bare.name}/report.json"' in text
    assert f'href="pairs/{full.name}/report.html"' in text


def test_dates_are_drawn_as_a_series_and_cycles_name_the_pair_to_blame(tmp_path: Path) -> None:
    found = make_stack(tmp_path, [f"date{number}" for number in range(9)])
    assert "Shifts in time" not in stack_page(found)
    assert "Pair to blame" in stack_page(found)
    images = tuple(
        replace(image, given=replace(image.given, date=f"2020-0{number + 1}-05"))
        for number, image in enumerate(found.images)
    )
    text = stack_page(replace(found, images=images))
    picture, shown = re.findall(
        r'<img src="data:image/svg\+xml;base64,([^"]*)" alt="Shifts by date[^"]*: ([^"]*)."', text
    )[0]
    assert shown == "9 images from 2020-01-05 to 2020-09-05"
    moved = replace(images[4], shift_px=(images[4].shift_px[0] + 1.0, images[4].shift_px[1]))
    assert picture not in stack_page(replace(found, images=(*images[:4], moved, *images[5:])))


def test_names_of_strangers_are_text(tmp_path: Path) -> None:
    names = ["<script>alert(1)</script>", *(f"date{number}" for number in range(8))]
    text = stack_page(make_stack(tmp_path, names))
    assert "<script" not in text
    assert "&lt;script&gt;" in text


def test_long_names_are_shortened_in_the_drawing_alone(tmp_path: Path) -> None:
    long = "LC08_L1TP_198030_20200809_20200918_02_T1_B5"
    text = stack_page(make_stack(tmp_path, [long, *(f"date{number}" for number in range(8))]))
    assert f"<title>{long}</title>" in text
    assert ">LC08_L1TP_198030_202008…</text>" in text
