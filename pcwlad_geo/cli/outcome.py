"""The end of a job that did its work, as the command line tells it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FIGURES = ("status", "tie_points", "displacement_px", "displacement_m", "accuracy", "warnings")
"""Entries of report.json that the result event repeats."""


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
        return Outcome(summary, {kind: path for kind, path in paths.items() if path.is_file()})

    def figures(self) -> dict[str, object]:
        """Return the values of the result event."""
        return {
            **{name: self.summary[name] for name in FIGURES},
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
