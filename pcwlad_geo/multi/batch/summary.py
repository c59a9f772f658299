"""The outcomes of the pairs of a batch, and the summary of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.multi.batch.table import BatchPair
from pcwlad_geo.outputs.places import HOST, disk_errors, make_folders, seal
from pcwlad_geo.outputs.stages import of_dead_processes
from pcwlad_geo.report.read_figures import ReadFigures, read_report
from pcwlad_geo.text import check_regular, csv_of

SUMMARY: Final = "summary.csv"
"""File name of the summary in the output folder."""
_SUMMARY_START: Final = b"line,reference,target,"
"""First bytes of the file of that name."""
OutcomeStatus = Literal["registered", "rejected", "unusable", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class PairOutcome:
    """The outcome of a pair."""

    pair: BatchPair
    status: OutcomeStatus
    """`unusable`: an input, an option or the output folder cannot be used; `failed`: an unexpected error."""
    reason: str | None = None
    """Reason why there is no registered raster, or the requirements that are not met."""
    done_before: bool = False
    """Whether the pair was finished by an earlier run."""
    figures: Mapping[str, Any] = field(default_factory=dict)
    """What the summary tells of its report.json; empty without one."""
    error: Exception | None = None
    """The exception that was raised, without what it held of the pair: that would add up over many."""

    @property
    def report(self) -> Mapping[str, Any]:
        """Content of its report.json, read from its folder; empty if it has none."""
        return read_report(self.pair.out_dir) if self.figures else {}

    @property
    def passed(self) -> bool | None:
        """Whether all requirements of a registered pair are met; None without requirements."""
        return self.figures.get("passed") if self.status == "registered" else None

    def row(self) -> dict[str, object]:
        """Return the line of the pair in the summary; missing values are None."""
        return {
            "line": self.pair.line,
            "reference": self.pair.reference,
            "target": self.pair.target,
            "out_dir": str(self.pair.out_dir),
            "status": self.status,
            "done_before": self.done_before,
            **(self.figures or figures_of(None)),
            "passed": self.passed,
            "reason": self.reason,
        }


def figures_of(report: ReadFigures | None) -> dict[str, Any]:
    """Return the figures of a report that the summary has; all are None without one."""
    read = report or ReadFigures()
    counts, quality = read.tie_points, read.quality
    d_col, d_row = (None, None) if read.displacement_px is None else read.displacement_px.median
    by_group = ((group, read.accuracy.get(group, {})) for group in ("check", "fit"))
    group, accuracy = next((entry for entry in by_group if entry[1].get("px")), (None, {}))
    px, m = accuracy.get("px"), accuracy.get("m")
    return {
        "tie_points": counts["total"] - counts["rejected"] if counts else None,
        "rejected": counts.get("rejected"),
        "d_col_px": d_col,
        "d_row_px": d_row,
        "quality": quality and quality.grade,
        "expected_ce90_px": quality and quality.expected_ce90_px,
        "model": read.model and read.model["name"],
        "accuracy_at": group,
        "rmse_px": px and px.rmse,
        "ce90_px": px and px.ce90,
        "rmse_m": m and m.rmse,
        "ce90_m": m and m.ce90,
        "passed": read.passed,
        "warnings": len(read.warnings) if report else None,
        "seconds": round(sum(read.seconds.values()), 1) if report else None,
    }


def check_summary(path: Path) -> None:
    """Check that the path of the summary is free or holds a summary of this program.

    Raises `OutputError` if another file is at that path.
    """
    if not os.path.lexists(path):
        return
    try:
        check_regular(path)
        with path.open("rb") as file:
            ours = file.read(len(_SUMMARY_START)) == _SUMMARY_START
    except (OSError, InputError):
        ours = False
    if not ours:
        raise OutputError(f"{path} is in the way and no summary of a batch: choose another output folder")


def write_summary(path: Path, outcomes: Sequence[PairOutcome]) -> None:
    """Write the summary of finished pairs, `outcomes`, to `path`: the file is complete or unchanged.

    Raises `OutputError` if the file cannot be written.
    """
    text = csv_of([outcome.row() for outcome in outcomes])
    start = f".{path.name}.{HOST}-"
    staged = path.with_name(f"{start}{os.getpid()}")
    with disk_errors(path):
        make_folders(path.parent)
        for remnant in of_dead_processes(path.parent, start):
            remnant.unlink(missing_ok=True)
        try:
            staged.write_text(text, encoding="utf-8", errors="backslashreplace", newline="")
            seal(staged)
            staged.replace(path)
        finally:
            with suppress(OSError):
                staged.unlink(missing_ok=True)


@contextmanager
def summary_writer(path: Path, outcomes: Sequence[PairOutcome], step: int) -> Iterator[Callable[[], None]]:
    """Yield a function that writes the summary where one of `step` outcomes is new, or one of the first.

    Writing all after each of many pairs that are unusable, and take no time, would take longer than they do.
    The rest is written at the end, however that comes.
    """
    written = 0

    def keep(*, least: int | None = None) -> None:
        nonlocal written
        new = len(outcomes) - written
        if new >= (max(1, written // step) if least is None else least):
            write_summary(path, outcomes)
            written = len(outcomes)

    try:
        yield keep
    finally:
        keep(least=1)
