"""The batch job: registration of all pairs of a table, and the summary of their outcomes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from pcwlad_geo.batches.pairs import Pair, read_pairs
from pcwlad_geo.errors import (
    InputError,
    OutputError,
    PcwladGeoError,
    RegistrationRejectedError,
    RequirementError,
)
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.job import open_job_runner, register
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.places import HOST, disk_errors, make_folders, seal
from pcwlad_geo.outputs.stages import of_dead_processes
from pcwlad_geo.products import products_found_once
from pcwlad_geo.raster.gdal import explained
from pcwlad_geo.report.finished import read_report, report_of_same_job
from pcwlad_geo.text import check_regular, csv_of, joined
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.job import Options

SUMMARY: Final = "summary.csv"
"""File name of the summary in the output folder."""
SUMMARY_STEP: Final = 100
"""Of so many lines of the summary one may be lost by a process that is killed."""

_SUMMARY_START: Final = b"line,reference,target,"
"""First bytes of the file of that name."""

Status = Literal["registered", "rejected", "unusable", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class PairOutcome:
    """The outcome of a pair."""

    pair: Pair
    status: Status
    """`unusable`: an input, an option or the output folder cannot be used; `failed`: an unexpected error."""
    reason: str | None = None
    """Reason why there is no registered raster, or the requirements that are not met."""
    done_before: bool = False
    """Whether the pair was finished by an earlier run."""
    report: Mapping[str, Any] = field(default_factory=dict)
    """Content of its report.json, if it has one."""
    error: Exception | None = None
    """The exception that was raised."""

    @property
    def passed(self) -> bool | None:
        """Whether all requirements of a registered pair are met; None without requirements."""
        passed: bool | None = self.report.get("passed") if self.status == "registered" else None
        return passed

    def row(self) -> dict[str, object]:
        """Return the line of the pair in the summary; missing values are None."""
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
    beside = path.with_name(f"{start}{os.getpid()}")
    with disk_errors(path):
        make_folders(path.parent)
        for left in of_dead_processes(path.parent, start):
            left.unlink(missing_ok=True)
        try:
            beside.write_text(text, encoding="utf-8", errors="backslashreplace", newline="")
            seal(beside)
            beside.replace(path)
        finally:
            with suppress(OSError):
                beside.unlink(missing_ok=True)


@contextmanager
def kept_summary(path: Path, outcomes: Sequence[PairOutcome]) -> Iterator[Callable[[], None]]:
    """Yield a function that writes the summary where one percent of `outcomes` is new, or one of the first.

    Writing all after each of many pairs that are unusable, and take no time, would take longer than they do.
    The rest is written at the end, however that comes.
    """
    written = 0

    def keep(*, least: int | None = None) -> None:
        nonlocal written
        new = len(outcomes) - written
        if new >= (max(1, written // SUMMARY_STEP) if least is None else least):
            write_summary(path, outcomes)
            written = len(outcomes)

    try:
        yield keep
    finally:
        keep(least=1)


def _accuracy(report: Mapping[str, Any]) -> tuple[str | None, Mapping[str, Any]]:
    """Return the accuracy at the check points, or at the fit points if there are too few check points."""
    for group in ("check", "fit"):
        found = (report.get("accuracy") or {}).get(group) or {}
        if found.get("px"):
            return group, found
    return None, {}


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """The outcomes of all pairs."""

    pairs: tuple[PairOutcome, ...]
    """Outcomes in the order of the table."""
    summary: Path
    """Path of the summary."""

    def count(self, status: str) -> int:
        """Return the number of pairs with a status."""
        return sum(outcome.status == status for outcome in self.pairs)


def batch(
    pairs: PathLike,
    *,
    out_dir: PathLike | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    **options: Unpack[Options],
) -> BatchResult:
    """Register the pairs of a table, one after another.

    A pair that is refused, cannot be used or does not meet a requirement is reported by a warning and in the
    summary, and the other pairs are processed. A pair that an earlier run has finished with the same inputs
    and options is not processed again.

    Parameters
    ----------
    pairs : path
        CSV with one line per pair, columns `reference`, `target`, and optionally `out_dir` and options of
        `register` by name. Relative paths refer to its folder.
    out_dir : path, optional
        Folder of the summary (`summary.csv`, rewritten after each pair, of hundreds of pairs after each
        percent) and of the pairs' folders that the table does not name; ``<table's stem>_registered`` in
        the working folder by default.
    overwrite : bool
        Process all pairs, and replace the results of earlier runs.
    on_event : callable
        Receives `Progress` (stage `pairs` counts the pairs) and `Warned` events; an exception that it raises
        ends the batch.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles of all pairs; None = `jobs` processes, or the workers of `scheduler`.
    **options
        Fields of `Settings`; values in the table take precedence.

    Raises
    ------
    InputError
        If the table cannot be used; nothing is written.
    OutputError
        If the summary cannot be written.
    ExecutionError
        If the executor or the worker processes cannot be used.
    """
    shared = Settings.from_options(options)
    folder = batch_folder(pairs, out_dir)
    todo = read_pairs(pairs, folder, options)
    check_summary(folder / SUMMARY)
    relay = _Relay(on_event)
    outcomes: list[PairOutcome] = []
    with (
        kept_summary(folder / SUMMARY, outcomes) as keep,
        open_job_runner(shared, executor, on_event) as runner,
    ):
        for number, pair in enumerate(todo):
            relay(Progress("pairs", number, len(todo)))
            with products_found_once():
                outcome = (None if overwrite else _done_before(pair)) or _do(pair, overwrite, relay, runner)
            outcomes.append(outcome)
            keep()
            if outcome.reason is not None:
                relay(Warned(f"{pair.name}: {outcome.status}: {outcome.reason}"))
    relay(Progress("pairs", len(todo), len(todo)))
    return BatchResult(tuple(outcomes), folder / SUMMARY)


def batch_folder(pairs: PathLike, out_dir: PathLike | None) -> Path:
    """Return the batch's folder: `out_dir`, or one named after `pairs`, for summary and unnamed outputs."""
    return Path(out_dir) if out_dir else Path(f"{Path(pairs).stem}_registered")


class _Relay:
    """Forwards events, and distinguishes exceptions of the receiver from those of a pair."""

    def __init__(self, on_event: EventCallback) -> None:
        self._on_event = on_event
        self.raised: BaseException | None = None

    def __call__(self, event: Event) -> None:
        try:
            self._on_event(event)
        except BaseException as error:
            self.raised = error
            raise

    def of(self, pair: Pair) -> EventCallback:
        """Return the receiver of a pair's events, which adds the pair's name to warnings."""
        return lambda event: self(
            Warned(f"{pair.name}: {event.message}") if isinstance(event, Warned) else event
        )


def _do(pair: Pair, overwrite: bool, relay: _Relay, runner: Runner) -> PairOutcome:
    options: dict[str, Any] = {field.name: getattr(pair.settings, field.name) for field in fields(Settings)}
    options |= pair.places
    try:
        register(
            pair.reference,
            pair.target,
            out_dir=pair.out_dir,
            overwrite=overwrite,
            on_event=relay.of(pair),
            executor=runner,
            **options,
        )
    except RequirementError:
        return _registered(pair, read_report(pair.out_dir))
    except Exception as error:  # of any kind: the other pairs are processed nevertheless
        if error is relay.raised:
            raise
        return _not_done(pair, error)
    return _registered(pair, read_report(pair.out_dir))


def _registered(pair: Pair, report: Mapping[str, Any], *, before: bool = False) -> PairOutcome:
    """Return the outcome of a registered pair, whether or not it meets its requirements."""
    missed = [each["message"] for each in report.get("requirements", ()) if not each["met"]]
    reason = "; ".join(missed) or None
    return PairOutcome(pair, "registered", reason, done_before=before, report=report)


def _not_done(pair: Pair, error: Exception) -> PairOutcome:
    if isinstance(error, RegistrationRejectedError):
        report = read_report(pair.out_dir)
        return PairOutcome(pair, "rejected", report.get("reason") or str(error), report=report, error=error)
    known = error if isinstance(error, PcwladGeoError) else explained(error)
    if known is not None:
        return PairOutcome(pair, "unusable", joined(known), error=error)
    reason = f"unexpected {type(error).__name__}: {joined(error)}"
    return PairOutcome(pair, "failed", reason, error=error)


def _done_before(pair: Pair) -> PairOutcome | None:
    """Return the outcome of the pair in an earlier run, if that was the same job, else None."""
    try:
        outcome = _earlier(pair)
        if outcome is not None:
            outcome.row()
    except (KeyError, TypeError, ValueError, AttributeError, IndexError):  # a damaged report
        return None
    return outcome


def _earlier(pair: Pair) -> PairOutcome | None:
    """Return the outcome that an earlier run of the same job has reported; raise where it is damaged."""
    report = report_of_same_job("register", (pair.reference, pair.target), pair.settings, pair.out_dir)
    status = report.get("status")
    if status == "registered":
        return _registered(pair, report, before=True)
    if status == "rejected":
        return PairOutcome(pair, status, report.get("reason"), done_before=True, report=report)
    return None
