"""The output of the command line for finished jobs and batches."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.text import visible


def columns(rows: Sequence[Sequence[str]], left: Collection[int]) -> list[str]:
    """Return lines of aligned columns, numbers on the right, without columns that are empty but for a header.

    The rows are of equal length, and the first is the header. Those with an index in `left` are aligned on
    the left.
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


COLUMNS: Final = ("target", "status", "points", "RMSE px", "shift px", "folder or reason")
"""Columns of the table of a batch."""
NUMBERS: Final = ("points", "RMSE px", "shift px")
"""Columns of that table with numbers, aligned on the right."""


def table(rows: Sequence[Mapping[str, object]]) -> str:
    """Return the pairs as a table: drawn for a terminal, plain columns otherwise.

    Parameters
    ----------
    rows : sequence of mappings
        Lines of the summary of a batch.
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


FIGURES = (
    *("status", "quality", "passed", "requirements", "tie_points", "displacement_px", "displacement_m"),
    *("accuracy", "warnings"),
)
"""Entries of report.json that the result event repeats."""

HEADER: Final = ("", "n", "mean col, row", "std col, row", "LE90 col, row", "RMSE", "CE90", "net", "CE90 m")
"""Header of the table of statistics."""
ROWS: Final = (
    ("displacement before, px", "before", "all"),
    ("residual after, fit, px", "after", "fit"),
    ("residual after, check, px", "after", "check"),
)
"""Rows of the table of statistics: title, and keys of the statistics in the report."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The content of `report.json` and the paths of the written files."""

    summary: Mapping[str, Any]
    """Content of report.json."""
    paths: Mapping[str, Path]
    """Written files by kind; `report` is the page."""

    @staticmethod
    def read(paths: Mapping[str, Path]) -> Outcome:
        """Read the report.json of a finished job and select the paths of the files that it wrote.

        Parameters
        ----------
        paths : mapping
            Path of each kind of output, including `numbers` (report.json).
        """
        summary = json.loads(paths["numbers"].read_text(encoding="utf-8"))
        written = {kind: path for kind, path in paths.items() if path.is_file()}
        if summary.get("passed") is False and not summary["settings"]["keep"]:
            written.pop("raster", None)  # an existing one outside of the folder is not from this job
        return Outcome(summary, written)

    def figures(self) -> dict[str, object]:
        """Return the values of the result event."""
        return {
            **{name: self.summary.get(name) for name in FIGURES},
            "paths": {kind: str(path.absolute()) for kind, path in self.paths.items()},
        }

    def text(self) -> str:
        """Return the summary that is printed."""
        counts, displacement = self.summary["tie_points"], self.summary["displacement_px"]
        kept = counts["total"] - counts["rejected"]
        lines = [f"{self.summary['status']}: {kept} tie points ({counts['rejected']} rejected)"]
        if displacement:
            col, row = displacement["median"]
            lines.append(f"median displacement: {col:+.3f} px in column, {row:+.3f} px in row")
        lines += self._accuracy()
        lines += self._table() + self._quality()
        lines += self._requirements()
        lines.append(f"report: {self.paths.get('report', self.paths['numbers'])}")
        return "\n".join(lines) + "\n"

    def _accuracy(self) -> list[str]:
        """Return the line of the check points, or of the fit points if there are too few check points."""
        for group in ("check", "fit"):
            px, m = self.summary["accuracy"][group]["px"], self.summary["accuracy"][group]["m"]
            if px:
                rmse, ce90 = (
                    f"{px[name]:.3f} px" + (f" ({m[name]:.2f} m)" if m else "") for name in ("rmse", "ce90")
                )
                return [f"accuracy at {px['n']} {group} points: RMSE {rmse}, CE90 {ce90}"]
        return []

    def _quality(self) -> list[str]:
        """Return the line of the grade, whose reasons are given by warnings."""
        quality = self.summary.get("quality")
        if not quality:
            return []
        expected, metres = quality["expected_ce90_px"], quality["expected_ce90_m"]
        size = f"{expected:.2f} px" + (f" ({metres:.2f} m)" if metres is not None else "")
        return [f"quality: {quality['grade']}; 90 % of the common ground is expected to lie within {size}"]

    def _requirements(self) -> list[str]:
        """Return a line for each requirement, and the verdict."""
        lines = [each["message"] for each in self.summary.get("requirements") or ()]
        if not lines:
            return []
        if self.summary["passed"]:
            return [*lines, "PASSED"]
        withheld = self.summary["status"] == "registered" and "raster" not in self.paths
        return [*lines, "FAILED: no corrected raster is written without --keep" if withheld else "FAILED"]

    def _table(self) -> list[str]:
        """Return the statistics before and after the correction, in columns."""
        statistics = self.summary.get("statistics") or {}
        found = [(title, statistics.get(when, {}).get(group)) for title, when, group in ROWS]
        rows = [_row(title, each) for title, each in found if each]
        return columns([HEADER, *rows], (0,)) if rows else []


def _row(title: str, statistics: Mapping[str, Any]) -> tuple[str, ...]:
    px, m = statistics["px"], statistics["m"]
    col, row, radial = px["col"], px["row"], px["radial"]
    return (
        title,
        str(statistics["n"]),
        f"{col['mean']:+.3f} {row['mean']:+.3f}",
        f"{col['std']:.3f} {row['std']:.3f}",
        f"{col['le90']:.3f} {row['le90']:.3f}",
        f"{radial['rmse']:.3f}",
        f"{radial['ce90']:.3f}",
        f"{px['net']['ce90']:.3f}",
        f"{m['radial']['ce90']:.2f}" if m else "",
    )
