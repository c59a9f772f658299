"""Names and messages of strangers on a terminal."""

from __future__ import annotations

import io

import pytest

from pcwlad_geo.cli.batch import pair_table
from pcwlad_geo.cli.progress import show_error
from pcwlad_geo.text import one_line, visible


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("b4.tif", "b4.tif"),
        ("Größe 北 \u0646\u200c\u0627\ttwo\nlines", "Größe 北 \u0646\u200c\u0627\ttwo\nlines"),
        ("\x1b[31mred\x07", "\\x1b[31mred\\x07"),
        ("a\u202egnp.tif", "a\\u202egnp.tif"),
        ("no text \udc80", "no text \\udc80"),
        ("a\rb\u2028c\x9b2J", "a\\rb\\u2028c\\x9b2J"),
    ],
)
def test_control_characters_are_seen(text: str, seen: str) -> None:
    assert visible(text) == seen


def test_a_message_is_one_line() -> None:
    assert one_line("a\n b\r\n\x1b]0;title\x07") == "a b \\x1b]0;title\\x07"
    errors = io.StringIO()
    show_error("no\x1b[2Jsuch file", errors)
    assert errors.getvalue() == "error: no\\x1b[2Jsuch file\n"


def test_the_table_of_pairs_paints_nothing() -> None:
    row = {
        "target": "b\x1b[31m.tif",
        "status": "failed",
        "done_before": False,
        "tie_points": None,
        "rmse_px": None,
        "d_col_px": None,
        "d_row_px": None,
        "reason": "gone\x1b[0m",
        "out_dir": "",
    }
    assert "\x1b" not in pair_table([row])
    assert "b\\x1b[31m.tif" in pair_table([row])
