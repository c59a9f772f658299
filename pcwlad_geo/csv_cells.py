"""Text in cells of CSV files, which spreadsheets take for formulas where it begins like one."""

from __future__ import annotations

from typing import Final, TypeVar

T = TypeVar("T")

_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")  # full-width ones count too


def cell(value: T) -> T | str:
    """Return a value as it is written to a CSV file: text that begins like a formula gets an apostrophe.

    File names, names of bands and messages may be a stranger's. A spreadsheet shows the apostrophe or hides
    it, and calculates nothing. Numbers stay as they are.
    """
    if isinstance(value, str) and value.lstrip(" ").startswith(_FORMULA):
        return f"'{value}"
    return value
