"""Register many pairs, one after another, on the same workers; what is done stays done."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcwlad_geo.batches.pairs import Pair, read_pairs
from pcwlad_geo.batches.summary import (
    SUMMARY,
    PairOutcome,
    check_summary,
    read_report,
    write_summary,
)
from pcwlad_geo.errors import InputError, PcwladGeoError, RegistrationRejectedError, RequirementError
from pcwlad_geo.raster.identity import FileIdentity, same
from pcwlad_geo.raster.trust import trusting
from pcwlad_geo.registration.inputs import Inputs, identify_inputs, resolve
from pcwlad_geo.registration.option_values import RUNNING
from pcwlad_geo.registration.progress import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.registration.runners import open_runner
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.registration.tasks import Runner
from pcwlad_geo.report.summary import plain
from pcwlad_geo.workflow import register

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.workflow import Options

PathLike = str | os.PathLike[str]


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """What became of all pairs."""

    pairs: tuple[PairOutcome, ...]
    """In the order of the table."""
    summary: Path
    """The table that was written."""

    def count(self, status: str) -> int:
        """Return how many pairs have ended so."""
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

    A pair that is refused, cannot be used or does not meet a requirement is told in a warning and in the
    summary, and the rest is done.
    A pair that an earlier run has finished, with the same inputs and options, is not done again.

    Parameters
    ----------
    pairs : path
        CSV: a line a pair, columns `reference`, `target`, and where wanted `out_dir` and options of
        `register` by name. Relative paths start from its folder.
    out_dir : path, optional
        Folder of the summary (`summary.csv`, rewritten after each pair) and of the pairs' folders that the
        table does not name; ``<table's stem>_registered`` in the working folder by default.
    overwrite : bool
        Do all pairs, and replace what earlier runs have left.
    on_event : callable
        Receives `Progress` (its stage `pairs` counts them) and `Warned` events; an exception that it raises
        ends the batch.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles of all pairs; None = `jobs` processes, or the workers of `scheduler`.
    **options
        The fields of `Settings`; the table's own values go before them.

    Raises
    ------
    InputError
        If the table cannot be used; nothing is written.
    OutputError
        If the summary cannot be written.
    ExecutionError
        If what the batch runs on cannot be used.
    """
    shared = Settings.from_options(options)
    folder = batch_folder(pairs, out_dir)
    todo = read_pairs(pairs, folder, options)
    check_summary(folder / SUMMARY)
    relay = _Relay(on_event)
    outcomes: list[PairOutcome] = []
    with open_runner(shared, executor, on_event) as runner:
        for number, pair in enumerate(todo):
            relay(Progress("pairs", number, len(todo)))
            outcome = (None if overwrite else _done_before(pair)) or _do(pair, overwrite, relay, runner)
            outcomes.append(outcome)
            write_summary(folder / SUMMARY, outcomes)
            if outcome.reason is not None:
                relay(Warned(f"{pair.name}: {outcome.status}: {outcome.reason}"))
    relay(Progress("pairs", len(todo), len(todo)))
    return BatchResult(tuple(outcomes), folder / SUMMARY)


def batch_folder(pairs: PathLike, out_dir: PathLike | None) -> Path:
    """Return the folder of the summary and of the pairs' folders that the table does not name."""
    return Path(out_dir) if out_dir else Path(f"{Path(pairs).stem}_registered")


class _Relay:
    """Hands events on, and tells an exception of the receiver from one of a pair."""

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
        """Return the receiver of a pair's events: its warnings say whose they are."""
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
    except Exception as error:  # of any kind: the other pairs are done all the same
        if error is relay.raised:
            raise
        return _not_done(pair, error)
    return _registered(pair, read_report(pair.out_dir))


def _registered(pair: Pair, report: Mapping[str, Any], *, before: bool = False) -> PairOutcome:
    """Return the outcome of a pair that was registered, whether or not it meets its requirements."""
    missed = [each["message"] for each in report.get("requirements", ()) if not each["met"]]
    reason = "; ".join(missed) or None
    return PairOutcome(pair, "registered", reason, done_before=before, report=report)


def _not_done(pair: Pair, error: Exception) -> PairOutcome:
    if isinstance(error, RegistrationRejectedError):
        report = read_report(pair.out_dir)
        return PairOutcome(pair, "rejected", report.get("reason") or str(error), report=report, error=error)
    if isinstance(error, PcwladGeoError):
        return PairOutcome(pair, "unusable", _one_line(error), error=error)
    reason = f"unexpected {type(error).__name__}: {_one_line(error)}"
    return PairOutcome(pair, "failed", reason, error=error)


def _done_before(pair: Pair) -> PairOutcome | None:
    """Return what an earlier run has made of the pair, if that was the same job."""
    report = read_report(pair.out_dir)
    status = report.get("status")
    if status not in ("registered", "rejected"):
        return None
    try:
        with trusting(pair.settings.trust):
            inputs = resolve(pair.reference, pair.target, pair.settings, all_bands=True)
            if not _same_inputs(inputs, report):
                return None
    except InputError:  # the job itself tells
        return None
    settings = {name: value for name, value in asdict(inputs.settings).items() if name not in RUNNING}
    before = {name: value for name, value in report["settings"].items() if name not in RUNNING}
    if before != plain(settings):
        return None
    if status == "registered":
        return _registered(pair, report, before=True)
    return PairOutcome(pair, status, report.get("reason"), done_before=True, report=report)


def _same_inputs(inputs: Inputs, report: Mapping[str, Any]) -> bool:
    """Whether the report is of these files, and none has been replaced since."""
    names = [inputs.reference, inputs.target]
    if [report[which]["path"] for which in ("reference", "target")] != names:
        return False
    try:
        before = [FileIdentity.from_json(each) for each in report["inputs"]]
    except (KeyError, TypeError):  # of an earlier version
        return False
    return same(before, [file.identity for file in identify_inputs(inputs)])


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
