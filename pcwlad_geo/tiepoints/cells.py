"""Tables of text cells: numbers of tie points, and which of them are allowed."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.types import Float64

MOST_CORRELATED: Final = 0.999999
"""Largest correlation that is taken: at 1 no error would be left across."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a header, its column names in lower case."""

    path: str
    columns: tuple[str, ...]
    rows: list[tuple[int, dict[str, str]]]
    """Line number and cells by column."""

    @staticmethod
    def read(path: str, lines: Sequence[str]) -> Table:
        """Read lines with commas, tabs or semicolons between the cells; raises `InputError` if they fail."""
        header = next(line for line in lines if line.strip())
        delimiter = "\t" if "\t" in header else "," if "," in header else ";"
        reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
        columns: tuple[str, ...] = ()
        rows: list[tuple[int, dict[str, str]]] = []
        try:
            for cells in reader:
                if not any(cell.strip() for cell in cells):
                    continue
                if not columns:
                    columns = tuple(cell.strip().lower() for cell in cells)
                    continue
                check_count(path, len(rows) + 1, LIMITS.points, "points")
                rows.append((reader.line_num, dict(zip(columns, cells, strict=False))))
        except csv.Error as error:
            raise InputError(f"{path} cannot be read as a table: {error}") from error
        return Table(path, columns, rows)

    def texts(self, column: str) -> list[str]:
        """Return the cells of a column, empty ones for a column that is missing."""
        return [row.get(column, "").strip() for _, row in self.rows]

    def numbers(self, column: str) -> Float64:
        """Return the (n,) numbers of a column, NaN for empty cells."""
        values = [
            number_in(self.path, line, column, row.get(column, "").strip() or "nan")
            for line, row in self.rows
        ]
        return np.array(values, dtype=np.float64)

    def sigmas(self) -> Float64:
        """Return (n, 2) sigma_col and sigma_row, px, all positive; NaN for empty cells."""
        sigma_px = self.pair("sigma_col", "sigma_row", optional=True)
        for column, values in zip(("sigma_col", "sigma_row"), sigma_px.T, strict=True):
            if column in self.columns:
                texts = self.texts(column)
                for (line, _), text, value in zip(self.rows, texts, values, strict=True):
                    check_sigma(self.path, line, column, text, value)
        return sigma_px

    def correlations(self) -> Float64 | None:
        """Return (n,) correlations, 0 for empty cells; None without that column."""
        if "correlation" not in self.columns:
            return None
        values = np.nan_to_num(self.numbers("correlation"))
        if (np.abs(values) > 1).any():
            line = self.rows[int(np.argmax(np.abs(values)))][0]
            raise InputError(f"{self.path}, line {line}: correlation lies beyond -1 to 1: correct it")
        return np.clip(values, -MOST_CORRELATED, MOST_CORRELATED)

    def pair(self, first: str, second: str, *, optional: bool = False) -> Float64:
        """Return the (n, 2) numbers of two columns; NaN if they are `optional` and missing."""
        if optional and not {first, second} <= set(self.columns):
            return np.full((len(self.rows), 2), np.nan)
        return np.column_stack([self.numbers(first), self.numbers(second)])


def number_in(path: str, line: int, name: str, text: str) -> float:
    """Return the number in a cell, NaN for one that is not finite; raises `InputError` if it is no number.

    The file, the line and what the cell holds are for the message.
    """
    try:
        value = float(text)
    except ValueError as error:
        raise InputError(f"{path}, line {line}: {name} is '{text}', not a number") from error
    return value if math.isfinite(value) else math.nan


def check_sigma(path: Path | str, line: int, column: str, text: str, value: float) -> None:
    """Check that a cell with a standard deviation is empty or a positive number within `sigma_px``.

    Raises `InputError`, with the path, line and column, if the cell is neither; `value` is NaN for an empty
    one.
    """
    least, most = LIMITS.sigma_px
    if text and not least <= value <= most:
        raise InputError(
            f"{path}, line {line}: {column} is '{text}': give a positive number from {least:g} to {most:g} "
            "px, or leave it empty"
        )
