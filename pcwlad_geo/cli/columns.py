"""Aligned columns, for the screen."""

from __future__ import annotations

from collections.abc import Collection, Sequence


def columns(rows: Sequence[Sequence[str]], left: Collection[int]) -> list[str]:
    """Return lines of aligned columns, numbers to the right, without columns that hold a header only.

    Parameters
    ----------
    rows : sequence of rows
        Of equal length, the first the header.
    left : collection of int
        Columns that are aligned to the left.
    """
    filled = [index for index in range(len(rows[0])) if any(row[index] for row in rows[1:])]
    widths = {index: max(len(row[index]) for row in rows) for index in filled}
    return [
        "  ".join(
            row[index].ljust(width) if index in left else row[index].rjust(width)
            for index, width in widths.items()
        ).rstrip()
        for row in rows
    ]
