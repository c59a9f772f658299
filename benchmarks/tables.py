"""Tables and must-reach checks as aligned text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

Cell = str | int | float


@dataclass(frozen=True, slots=True)
class Check:
    """A figure, the limit it must reach, and whether it does."""

    what: str
    value: str
    limit: str
    holds: bool


@dataclass(frozen=True, slots=True)
class Table:
    """What a study found: rows of figures, and the checks that follow from them."""

    title: str
    header: tuple[str, ...]
    rows: Sequence[Sequence[Cell]]
    checks: Sequence[Check] = field(default=())


def at_most(what: str, value: float, limit: float, unit: str = "", digits: int = 3) -> Check:
    """Check value <= limit; NaN misses."""
    return Check(
        what, _with_unit(value, unit, digits), f"<= {_with_unit(limit, unit, digits)}", value <= limit
    )


def at_least(what: str, value: float, limit: float, unit: str = "", digits: int = 3) -> Check:
    """Check value >= limit; NaN misses."""
    return Check(
        what, _with_unit(value, unit, digits), f">= {_with_unit(limit, unit, digits)}", value >= limit
    )


def within(what: str, value: float, low: float, high: float, unit: str = "", digits: int = 1) -> Check:
    """Check low <= value <= high; NaN misses."""
    limit = f"{low:.{digits}f} to {_with_unit(high, unit, digits)}"
    return Check(what, _with_unit(value, unit, digits), limit, low <= value <= high)


def as_text(table: Table) -> str:
    """Return the table and its checks as aligned lines."""
    parts = [table.title, "=" * len(table.title), *_aligned([table.header, *table.rows])]
    if table.checks:
        checks = [(c.what, c.value, c.limit, "ok" if c.holds else "MISSES") for c in table.checks]
        parts += ["", *_aligned([("must reach", "value", "limit", ""), *checks])]
    return "\n".join(parts)


def _with_unit(value: float, unit: str, digits: int) -> str:
    return f"{value:.{digits}f}{unit if unit in ('', '%') else ' ' + unit}"


def _aligned(rows: Sequence[Sequence[Cell]]) -> list[str]:
    """Left column to the left, the others to the right."""
    text = [[_cell(value) for value in row] for row in rows]
    widths = [max(len(row[column]) for row in text) for column in range(len(text[0]))]
    lines = []
    for row in text:
        first = row[0].ljust(widths[0])
        lines.append(
            "  ".join([first, *(v.rjust(w) for v, w in zip(row[1:], widths[1:], strict=True))]).rstrip()
        )
    return lines


def _cell(value: Cell) -> str:
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.3f}"
    return str(value)
