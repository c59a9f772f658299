"""JSON of strangers: what `parse_json` takes, and what it refuses."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcwlad_geo.limits import LIMITS
from pcwlad_geo.multi.stack.numbers import StackNumbers
from pcwlad_geo.raster import Bands
from pcwlad_geo.text import mismatch, parse_json, plain, whole

PLAIN = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
)
VALUES = st.recursive(PLAIN, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20)


@given(VALUES)
def test_plain_json_is_what_json_says(value: object) -> None:
    text = json.dumps(value)
    assert parse_json(text) == json.loads(text)


@pytest.mark.parametrize(
    "text",
    [
        "NaN",
        "[-Infinity]",
        '{"a": 1e999}',
        "9" * (LIMITS.json_digits + 1),
        "[" * (LIMITS.json_depth + 1) + "]" * (LIMITS.json_depth + 1),
        '{"a":' * 100_000,
        "[" * 5000 + "]" * 5000,
        "",
    ],
)
def test_what_no_result_holds_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse_json(text)


def test_the_deepest_and_longest_that_are_read() -> None:
    assert parse_json("[" * LIMITS.json_depth + "]" * LIMITS.json_depth) is not None
    assert parse_json("9" * LIMITS.json_digits) == int("9" * LIMITS.json_digits)


def test_numbers_that_json_cannot_hold_become_null() -> None:
    given = {"a": [1.5, float("nan"), (float("inf"), "x")], "b": None}
    assert plain(given) == {"a": [1.5, None, [None, "x"]], "b": None}


def test_what_is_read_back_has_the_types_that_were_written() -> None:
    image = {"name": "a\ud800", "registered": None, "shift_px": [0.5, 1], "later": "unknown"}
    assert mismatch({"schema_version": 1, "images": [image], "block": None}, StackNumbers) is None
    for name, value in {"registered": [], "name": 5, "shift_px": [1.0], "size": {}}.items():
        reason = mismatch({"images": [image, {**image, name: value}]}, StackNumbers)
        assert (reason is None) == (name == "size")
        assert reason is None or reason.startswith(f"images.1.{name}")
    assert mismatch({"images": {}, "pairs": 3}, StackNumbers) is not None
    assert mismatch([], StackNumbers) is not None


@pytest.mark.parametrize(
    ("text", "number"), [("12", 12), (" 7", 7), ("", None), ("-1", None), ("1.0", None), ("²", None)]
)
def test_whole_numbers(text: str, number: int | None) -> None:
    assert whole(text) == number


def test_numbers_of_thousands_of_digits_are_no_bands() -> None:
    digits = "9" * 5000  # more than Python converts
    assert whole(digits) is None
    for choice in (digits, f"pca:1-{digits}", f"2,{digits}", "1-"):
        assert Bands.of_file("a.tif", choice) is None
