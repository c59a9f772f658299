"""The summary of a batch on the screen."""

from __future__ import annotations

import io
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from pcwlad_geo.cli.columns import columns
from pcwlad_geo.cli.visible import visible

COLUMNS: Final = ("target", "status", "points", "RMSE px", "shift px", "folder or reason")
NUMBERS: Final = ("points", "RMSE px", "shift px")


def table(rows: Sequence[Mapping[str, object]]) -> str:
    """Return the pairs as a table: drawn for a terminal, plain columns otherwise.

    Parameters
    ----------
    rows : sequence of mappings
        Lines of the summary.
    """
    cells = [_cells(row) for row in rows]
    return _drawn(cells) if sys.stdout.isatty() else _plain(cells)


def _cells(row: Mapping[str, object]) -> list[str]:
    shift = [row["d_col_px"], row["d_row_px"]]
    cells = [
        Path(str(row["target"])).name,
        f"{row['status']}{' before' if row['done_before'] else ''}",
        str(row["tie_points"]) if row["tie_points"] is not None else "",
        _figure(row["rmse_px"]),
        " ".join(f"{value:+.2f}" for value in shift if isinstance(value, float)),
        str(row["reason"] or row["out_dir"]),
    ]
    return [visible(cell) for cell in cells]


def _figure(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else ""


def _plain(cells: list[list[str]]) -> str:
    words = [index for index, name in enumerate(COLUMNS) if name not in NUMBERS]
    return "\n".join(columns([COLUMNS, *cells], words))


def _drawn(cells: list[list[str]]) -> str:
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    drawn = Table(box=box.SIMPLE_HEAD)
    for name in COLUMNS:
        drawn.add_column(name, justify="right" if name in NUMBERS else "left", overflow="fold")
    for line in cells:
        drawn.add_row(*(Text(cell) for cell in line))
    text = io.StringIO()
    console = Console(file=text, force_terminal=True, width=Console().width)
    console.print(drawn)
    return text.getvalue().rstrip("\n")
