"""What became of each pair: read from its report, kept as a table."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from pcwlad_geo.batches.pairs import Pair
from pcwlad_geo.csv_cells import cell
from pcwlad_geo.disk import disk_errors, make_folders, seal
from pcwlad_geo.errors import OutputError

SUMMARY: Final = "summary.csv"
STATUSES: Final = ("registered", "rejected", "unusable", "failed")

Status = Literal["registered", "rejected", "unusable", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class PairOutcome:
    """What became of a pair."""

    pair: Pair
    status: Status
    """`unusable`: an input, an option or the output folder; `failed`: unexpectedly."""
    reason: str | None = None
    """Why there is no registered raster, or which requirements are not met."""
    done_before: bool = False
    """An earlier run has done it."""
    report: Mapping[str, Any] = field(default_factory=dict)
    """Content of its report.json, if it has one."""
    error: Exception | None = None
    """What was raised."""

    @property
    def passed(self) -> bool | None:
        """Whether all requirements of a pair that is registered are met; None where nothing was required."""
        passed: bool | None = self.report.get("passed") if self.status == "registered" else None
        return passed

    def row(self) -> dict[str, object]:
        """Return its line of the summary; values that do not exist are None."""
        report = self.report
        counts = report.get("tie_points") or {}
        displacement = (report.get("displacement_px") or {}).get("median") or (None, None)
        group, accuracy = _accuracy(report)
        px, m = accuracy.get("px") or {}, accuracy.get("m") or {}
        return {
            "line": self.pair.line,
            "reference": self.pair.reference,
            "target": self.pair.target,
            "out_dir": str(self.pair.out_dir),
            "status": self.status,
            "done_before": self.done_before,
            "tie_points": counts["total"] - counts["rejected"] if counts else None,
            "rejected": counts.get("rejected"),
            "d_col_px": displacement[0],
            "d_row_px": displacement[1],
            "quality": (report.get("quality") or {}).get("grade"),
            "expected_ce90_px": (report.get("quality") or {}).get("expected_ce90_px"),
            "model": (report.get("model") or {}).get("name"),
            "accuracy_at": group,
            "rmse_px": px.get("rmse"),
            "ce90_px": px.get("ce90"),
            "rmse_m": m.get("rmse"),
            "ce90_m": m.get("ce90"),
            "passed": self.passed,
            "warnings": len(report["warnings"]) if report else None,
            "seconds": round(sum(report["seconds"].values()), 1) if report else None,
            "reason": self.reason,
        }


def read_report(out_dir: Path) -> dict[str, Any]:
    """Return the report.json of a folder; empty where there is none of this program."""
    try:
        report = json.loads((out_dir / "report.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    known = isinstance(report, dict) and "schema_version" in report and "settings" in report
    return report if known else {}


def check_summary(path: Path) -> None:
    """Raise where a file that is no summary of ours is in the way.

    Raises
    ------
    OutputError
        Then.
    """
    if not os.path.lexists(path):
        return
    try:
        ours = path.read_text(encoding="utf-8").startswith("line,reference,target,")
    except (OSError, ValueError):
        ours = False
    if not ours:
        raise OutputError(f"{path} is in the way and no summary of a batch: choose another output folder")


def write_summary(path: Path, outcomes: Sequence[PairOutcome]) -> None:
    """Write the table of the pairs that are done; it is there complete or as it was.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    text = io.StringIO()
    rows = [outcome.row() for outcome in outcomes]
    rows = [{name: cell(_word(value)) for name, value in row.items()} for row in rows]
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    with disk_errors(path):
        make_folders(path.parent)
        try:
            beside.write_text(text.getvalue(), encoding="utf-8", newline="")
            seal(beside)
            beside.replace(path)
        finally:
            with suppress(OSError):
                beside.unlink(missing_ok=True)


def _word(value: object) -> object:
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else value


def _accuracy(report: Mapping[str, Any]) -> tuple[str | None, Mapping[str, Any]]:
    """Return the accuracy at the check points, at the fit points where there are too few of those."""
    for group in ("check", "fit"):
        found = (report.get("accuracy") or {}).get(group) or {}
        if found.get("px"):
            return group, found
    return None, {}
