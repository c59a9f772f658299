"""The end of a job that did its work, as the command line tells it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.cli.columns import columns

FIGURES = (
    "status",
    "quality",
    "passed",
    "requirements",
    "tie_points",
    "displacement_px",
    "displacement_m",
    "accuracy",
    "warnings",
)
"""Entries of report.json that the result event repeats."""

HEADER: Final = ("", "n", "mean col, row", "std col, row", "LE90 col, row", "RMSE", "CE90", "net", "CE90 m")
ROWS: Final = (
    ("displacement before, px", "before", "all"),
    ("residual after, fit, px", "after", "fit"),
    ("residual after, check, px", "after", "check"),
)
"""Rows of the table, and where their statistics are."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What `report.json` says, and where the files are."""

    summary: Mapping[str, Any]
    """Content of report.json."""
    paths: Mapping[str, Path]
    """Files written, by what they are; `report` is the page."""

    @staticmethod
    def read(paths: Mapping[str, Path]) -> Outcome:
        """Read the report.json of a finished job and keep the paths of what it wrote.

        Parameters
        ----------
        paths : mapping
            Where each kind of output goes, `numbers` (report.json) among them.
        """
        summary = json.loads(paths["numbers"].read_text(encoding="utf-8"))
        written = {kind: path for kind, path in paths.items() if path.is_file()}
        if summary.get("passed") is False and not summary["settings"]["keep"]:
            written.pop("raster", None)  # one that is there, outside of the folder, is not of this job
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
        """Return the line of the check points, of the fit points where there are too few of those."""
        for group in ("check", "fit"):
            px, m = self.summary["accuracy"][group]["px"], self.summary["accuracy"][group]["m"]
            if px:
                rmse, ce90 = (
                    f"{px[name]:.3f} px" + (f" ({m[name]:.2f} m)" if m else "") for name in ("rmse", "ce90")
                )
                return [f"accuracy at {px['n']} {group} points: RMSE {rmse}, CE90 {ce90}"]
        return []

    def _quality(self) -> list[str]:
        """Return the line of the grade; the warnings have told the reasons."""
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
