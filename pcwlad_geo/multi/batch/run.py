"""Batches: the registration of all pairs of a `table`, in this process or in workers, and a `summary`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from itertools import groupby, islice
from pathlib import Path
from traceback import clear_frames
from typing import TYPE_CHECKING, Any, Final

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import (
    ExecutionError,
    OutputError,
    PcwladGeoError,
    RegistrationRejectedError,
    RequirementError,
)
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.job import open_job_runner, register
from pcwlad_geo.multi.batch.flight import Flight, photos_of
from pcwlad_geo.multi.batch.summary import SUMMARY, PairOutcome, check_summary, figures_of, summary_writer
from pcwlad_geo.multi.batch.table import BatchPair, pairs_of_photos, read_pairs
from pcwlad_geo.multi.batch.to_place import write_to_place
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products.finding import products_found_once
from pcwlad_geo.products.unpacking import unpacked_places
from pcwlad_geo.raster.gdal import explained
from pcwlad_geo.registration import estimate_tile_count
from pcwlad_geo.report.read_figures import ReadFigures, read_figures
from pcwlad_geo.report.same_job import report_of_same_job
from pcwlad_geo.text import joined
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options


@dataclass(frozen=True, slots=True)
class BatchParameters:
    """Numbers of the running of a batch."""

    pairs_a_worker: int = 16
    """Largest number of pairs that a worker process is given before the summary is written."""
    summary_step: int = 100
    """Of so many lines of the summary one may be lost by a process that is killed."""


BATCH: Final = BatchParameters()
"""The numbers in use."""


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """The outcomes of all pairs."""

    pairs: tuple[PairOutcome, ...]
    """Outcomes in the order of the table."""
    summary: Path
    """Path of the summary."""
    to_place: Path | None = None
    """Page of the photographs of a flight that are not registered, for placing them by hand."""

    def count(self, status: str) -> int:
        """Return the number of pairs with a status."""
        return sum(outcome.status == status for outcome in self.pairs)


@checked()
def batch(
    pairs: PathLike,
    *,
    out_dir: PathLike | None = None,
    reference: PathLike | None = None,
    photos: PathLike | None = None,
    name_column: str | None = None,
    within: float = 300.0,
    photo_size: float | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    **options: Unpack[Options],
) -> BatchResult:
    """Register the pairs of a table.

    The tiles of a large pair are shared among threads; pairs of one tile among processes, of which each does
    a whole one, from its files to its folder.
    A pair that is refused, cannot be used or does not meet a requirement is reported by a warning and in the
    summary, and the other pairs are processed. A pair that an earlier run has finished with the same inputs
    and options is not processed again.

    Parameters
    ----------
    pairs : path
        CSV with one line per pair, columns `reference`, `target`, and optionally `out_dir` and options of
        `register` by name. Relative paths refer to its folder. With a
        `reference` it is a flight index: a vector file of points or footprints with a column of file names.
    out_dir : path, optional
        Folder of the summary (`summary.csv`, rewritten after each pair, of hundreds of pairs after each
        percent) and of the pairs' folders that the table does not name; ``<table's stem>_registered`` in
        the working folder by default.
    reference : path, optional
        The raster that the photographs of a flight index are registered to. Each is looked for in the part of
        it around its place; `to_place.html` lists those that are not registered.
    photos : path, optional
        Folder of the photographs; by default that of the index.
    name_column : str, optional
        Column of their file names; by default the first one with such names.
    within : float
        How far, metres, a photograph may lie from where the index says.
    photo_size : float, optional
        Length of the longer side of a photograph on the ground, metres: needed of an index of points.
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
    flight = Flight.of(reference, photos, name_column, within, photo_size)
    of_flight = [] if flight is None else photos_of(pairs, flight)
    problems = {photo.line: photo.problem for photo in of_flight if photo.problem is not None}
    every = pairs_of_photos(of_flight, folder, options) if flight else read_pairs(pairs, folder, options)
    todo = [pair for pair in every if pair.line not in problems]
    outcomes = [PairOutcome(pair, "unusable", problems[pair.line]) for pair in every if pair.line in problems]
    check_summary(folder / SUMMARY)
    events = _PairEvents(on_event)
    at_work: list[BatchPair] = []
    with (
        summary_writer(folder / SUMMARY, outcomes, BATCH.summary_step) as keep,
        _swept_if_ended(at_work),
        open_job_runner(shared, executor, on_event) as runner,
    ):
        _tell(outcomes, events)
        for part in _parts(todo, runner, BATCH.pairs_a_worker):
            events(Progress("pairs", len(outcomes), len(every)))
            at_work[:] = part
            new_outcomes = _register_part(part, overwrite, events.counted(len(outcomes), len(every)), runner)
            outcomes += new_outcomes
            keep()
            _tell(new_outcomes, events)
    events(Progress("pairs", len(every), len(every)))
    page = None if flight is None else write_to_place(folder, outcomes, of_flight, flight.reference)
    return BatchResult(tuple(outcomes), folder / SUMMARY, page)


def _tell(outcomes: Sequence[PairOutcome], events: _PairEvents) -> None:
    """Warn of what is not registered, or does not meet a requirement."""
    for outcome in outcomes:
        if outcome.reason is not None:
            events(Warned(f"{outcome.pair.name}: {outcome.status}: {outcome.reason}"))


def batch_folder(pairs: PathLike, out_dir: PathLike | None) -> Path:
    """Return the batch's folder: `out_dir`, or one named after `pairs`, for summary and unnamed outputs."""
    return Path(out_dir) if out_dir else Path(f"{Path(pairs).stem}_registered")


class _PairEvents:
    """Forwards events, and distinguishes exceptions of the receiver from those of a pair."""

    def __init__(self, on_event: EventCallback) -> None:
        self._on_event = on_event
        self.error: BaseException | None = None

    def __call__(self, event: Event) -> None:
        try:
            self._on_event(event)
        except BaseException as error:
            self.error = error
            raise

    def counted(self, finished: int, total: int) -> _PairEvents:
        """Return the same for a part of the batch's pairs, whose progress is that of all."""

        def tell(event: Event) -> None:
            if isinstance(event, Progress) and event.stage == "pairs":
                event = replace(event, done=finished + event.done, total=total)
            self(event)

        return _PairEvents(tell)

    def of(self, pair: BatchPair) -> EventCallback:
        """Return the receiver of a pair's events, which adds the pair's name to warnings."""
        return lambda event: self(
            Warned(f"{pair.name}: {event.message}") if isinstance(event, Warned) else event
        )


def _parts(todo: Sequence[BatchPair], runner: Runner, pairs_a_worker: int) -> Iterator[list[BatchPair]]:
    """Yield the pairs in their order: alone, or those of one tile together, for workers that do one each.

    The first one is alone: what goes wrong with every pair is told before the workers begin.
    """
    most = pairs_a_worker * runner.threads if runner.shares_jobs else 1

    def is_small(numbered: tuple[int, BatchPair]) -> bool:
        number, pair = numbered
        tiles = estimate_tile_count(pair.reference, pair.target, pair.settings) if number and most > 1 else 0
        return tiles == 1

    for small, group in groupby(enumerate(todo), is_small):
        pairs = (pair for _, pair in group)
        while part := list(islice(pairs, most if small else 1)):
            yield part


def _register_part(
    part: Sequence[BatchPair], overwrite: bool, events: _PairEvents, runner: Runner
) -> list[PairOutcome]:
    """Register one pair, or several at once in worker processes, but for those that were done before."""
    with products_found_once():
        before = [None if overwrite else _done_before(pair) for pair in part]
        unfinished = [pair for pair, outcome in zip(part, before, strict=True) if outcome is None]
        if len(unfinished) <= 1:
            outcomes = iter([_register_pair(pair, overwrite, events, runner) for pair in unfinished])
        else:
            results = runner.run_jobs(
                _register_whole, [(pair, overwrite) for pair in unfinished], "pairs", events
            )
            outcomes = iter(
                [_reported(result, pair, events) for result, pair in zip(results, unfinished, strict=True)]
            )
    return [outcome or next(outcomes) for outcome in before]


def _reported(
    result: tuple[PairOutcome, list[Warned]] | ExecutionError, pair: BatchPair, events: _PairEvents
) -> PairOutcome:
    """Send what a pair was warned of; return its outcome, also where its process was lost."""
    if isinstance(result, ExecutionError):
        with suppress(OutputError), OutputFolder(pair.out_dir, overwrite=True):
            pass  # entering it sweeps
        return _not_done(pair, result)
    outcome, warnings = result
    for warning in warnings:
        events(warning)
    return outcome


def _register_whole(pair: BatchPair, overwrite: bool) -> tuple[PairOutcome, list[Warned]]:
    """Register a pair in a worker process; return its outcome and what it was warned of."""
    events: list[Event] = []
    outcome = _register_pair(pair, overwrite, _PairEvents(events.append), InThisProcess())
    return outcome, [event for event in events if isinstance(event, Warned)]


@contextmanager
def _swept_if_ended(at_work: Sequence[BatchPair]) -> Iterator[None]:
    """Remove what workers leave of the pairs they are at, where the batch ends before they do."""
    try:
        yield
    except BaseException:
        for pair in at_work:
            with suppress(OutputError), OutputFolder(pair.out_dir, overwrite=True):
                pass  # entering it sweeps
        raise


def _register_pair(pair: BatchPair, overwrite: bool, events: _PairEvents, runner: Runner) -> PairOutcome:
    options: dict[str, Any] = {field.name: getattr(pair.settings, field.name) for field in fields(Settings)}
    options |= pair.places
    try:
        register(
            pair.reference,
            pair.target,
            out_dir=pair.out_dir,
            overwrite=overwrite,
            on_event=events.of(pair),
            executor=runner,
            **options,
        )
    except RequirementError:
        return _registered(pair, read_figures(pair.out_dir))
    except Exception as error:  # of any kind: the other pairs are processed nevertheless
        if error is events.error:
            raise
        return _not_done(pair, error)
    return _registered(pair, read_figures(pair.out_dir))


def _registered(pair: BatchPair, report: ReadFigures | None, *, before: bool = False) -> PairOutcome:
    """Return the outcome of a registered pair, whether or not it meets its requirements."""
    requirements = report.requirements if report else ()
    missed = [requirement.message for requirement in requirements if not requirement.met]
    reason = "; ".join(missed) or None
    return PairOutcome(pair, "registered", reason, done_before=before, figures=figures_of(report))


def _not_done(pair: BatchPair, error: Exception) -> PairOutcome:
    _release(error)
    if isinstance(error, RegistrationRejectedError):
        report = read_figures(pair.out_dir)
        reason = (report and report.reason) or str(error)
        return PairOutcome(pair, "rejected", reason, figures=figures_of(report), error=error)
    reported = error if isinstance(error, PcwladGeoError) else explained(error)
    if reported is not None:
        return PairOutcome(pair, "unusable", joined(reported), error=error)
    reason = f"unexpected {type(error).__name__}: {joined(error)}"
    return PairOutcome(pair, "failed", reason, error=error)


def _release(error: BaseException) -> None:
    """Free what an error and those before it hold of a pair: variables of their frames, the registration."""
    chain: list[BaseException] = []
    current: BaseException | None = error
    while current is not None and current not in chain:
        chain.append(current)
        clear_frames(current.__traceback__)
        if isinstance(current, RegistrationRejectedError):
            current.registration = None
        current = current.__cause__ or current.__context__


def _done_before(pair: BatchPair) -> PairOutcome | None:
    """Return the outcome of the pair in an earlier run, if that was the same job, else None."""
    try:
        outcome = _earlier(pair)
        if outcome is not None:
            outcome.row()
    except (KeyError, TypeError, ValueError, AttributeError, IndexError):  # a damaged report
        return None
    return outcome


def _earlier(pair: BatchPair) -> PairOutcome | None:
    """Return the outcome that an earlier run of the same job has reported; raise where it is damaged."""
    names = [pair.reference, pair.target]
    for number, place in unpacked_places(names, pair.out_dir).items():
        names[number] = str(place)
    report = report_of_same_job("register", (names[0], names[1]), pair.settings, pair.out_dir)
    if report is None:
        return None
    if report.status == "registered":
        return _registered(pair, report, before=True)
    return PairOutcome(pair, "rejected", report.reason, done_before=True, figures=figures_of(report))
