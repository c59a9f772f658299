"""Tables that commands print."""

from __future__ import annotations

import io
import sys
from collections.abc import Collection, Sequence


def columns(rows: Sequence[Sequence[str]], texts: Collection[int]) -> list[str]:
    """Return lines of aligned columns, numbers on the right, without columns that are empty but for a header.

    The rows are of equal length, and the first is the header. Those with an index in `texts` are aligned on
    the left.
    """
    filled = [index for index in range(len(rows[0])) if any(row[index] for row in rows[1:])]
    widths = {index: max(len(row[index]) for row in rows) for index in filled}
    return [
        "  ".join(
            row[index].ljust(width) if index in texts else row[index].rjust(width)
            for index, width in widths.items()
        ).rstrip()
        for row in rows
    ]


def table(header: Sequence[str], rows: Sequence[Sequence[str]], numbers: Collection[str]) -> str:
    """Return rows as a table: drawn for a terminal, plain columns otherwise.

    The `numbers` are the names in the header of columns that are aligned on the right.
    """
    if sys.stdout.isatty():
        return _drawn(header, rows, numbers)
    texts = [index for index, name in enumerate(header) if name not in numbers]
    return "\n".join(columns([header, *rows], texts))


def _drawn(header: Sequence[str], rows: Sequence[Sequence[str]], numbers: Collection[str]) -> str:
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    grid = Table(box=box.SIMPLE_HEAD)
    for name in header:
        grid.add_column(name, justify="right" if name in numbers else "left", overflow="fold")
    for cells in rows:
        grid.add_row(*(Text(cell) for cell in cells))
    text = io.StringIO()
    console = Console(file=text, force_terminal=True, width=Console().width)
    console.print(grid)
    return text.getvalue().rstrip("\n")
