"""Batches of pairs: their table, the registration of all of them, and the summary of outcomes."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, replace
from itertools import groupby, islice
from pathlib import Path
from traceback import clear_frames
from typing import TYPE_CHECKING, Any, Final, Literal

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import (
    ExecutionError,
    InputError,
    OutputError,
    PcwladGeoError,
    RegistrationRejectedError,
    RequirementError,
    SettingsError,
)
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.job import open_job_runner, output_folder, register
from pcwlad_geo.limits import BATCH_ROWS, check_count
from pcwlad_geo.options import NOT_IN_TABLES, OUTPUT_OPTIONS, RUNNING, SETTINGS, Settings, to_setting
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.outputs.places import HOST, disk_errors, make_folders, seal
from pcwlad_geo.outputs.stages import of_dead_processes
from pcwlad_geo.products.finding import products_found_once
from pcwlad_geo.raster.gdal import explained
from pcwlad_geo.registration import estimate_tile_count
from pcwlad_geo.report.finished import read_report, report_of_same_job
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.text import check_regular, csv_of, joined, read_text
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options

COLUMNS: Final = (
    "reference",
    "target",
    "out_dir",
    *OUTPUT_OPTIONS,
    *(name for name in SETTINGS if name not in NOT_IN_TABLES),
)
"""All columns that a table may have."""


@dataclass(frozen=True, slots=True, eq=False)
class BatchPair:
    """A line of the table: the pair to register, and its options."""

    line: int
    """Number of the line in the file, from 1."""
    reference: str
    target: str
    """Absolute path or GDAL URI, as that of the reference."""
    out_dir: Path
    settings: Settings
    places: Mapping[str, Path]
    """Paths of single outputs by column, for those given."""

    @property
    def name(self) -> str:
        """Name of the pair in messages."""
        return f"{Path(self.target).name} (line {self.line})"


def read_pairs(table: PathLike, out_dir: PathLike, options: Mapping[str, Any]) -> list[BatchPair]:
    """Read and check the whole table before any work is done.

    It is CSV with a header: `reference` and `target`, and any of the other `COLUMNS`. An empty cell means the
    field of `options`, or the default. Relative paths refer to the folder of the table; outputs must be below
    it, or `out_dir`, where pairs without a folder get ``<target stem>_registered``, with a number if that
    name is taken. Raises `InputError` if the table cannot be read, a column is unknown, a value is invalid,
    two pairs have the same `out_dir`, an output is elsewhere, or there is no pair.
    """
    path = Path(table)
    rows = list(islice(_rows(path), BATCH_ROWS + 1))
    check_count(str(path), len(rows), BATCH_ROWS, "pairs")
    if not rows:
        raise InputError(f"{path} holds no pairs: give a line for each, below the header")
    folder = Path(os.path.abspath(path)).parent  # noqa: PTH100  # resolve() would follow a symbolic link
    _check_places(path, rows, folder, Path(out_dir))
    given = _given_folders(path, rows, folder)
    taken = {_key(place) for place in given.values()}
    numbers: dict[str, int] = {}
    pairs = []
    for line, cells in rows:
        place = given.get(line) or _free(
            Path(out_dir) / output_folder(cells["target"], "registered"), taken, numbers
        )
        taken.add(_key(place))
        try:
            pairs.append(_pair(line, cells, folder, place, options))
        except SettingsError as error:
            raise InputError(f"{path}, line {line}: {error}") from error
    return pairs


def _rows(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the number and the nonempty cells of each nonempty line."""
    try:
        reader = csv.reader(io.StringIO(read_text(path, encoding="utf-8-sig")), skipinitialspace=True)
        columns = _columns(path, next(reader, []))
        for values in reader:
            values = [value.strip() for value in values]
            if not any(values):
                continue
            if len(values) > len(columns):
                raise InputError(
                    f"{path}, line {reader.line_num} has {len(values)} cells for {len(columns)} columns: "
                    "put values that hold a comma in quotes"
                )
            cells = {name: value for name, value in zip(columns, values, strict=False) if value}
            for name in ("reference", "target"):
                if name not in cells:
                    raise InputError(f"{path}, line {reader.line_num} has no {name}")
            yield reader.line_num, cells
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} is no CSV table in UTF-8: {error}") from error


def _columns(path: Path, header: list[str]) -> list[str]:
    columns = [name.strip().replace("-", "_") for name in header]
    if len(columns) == 1 and ";" in columns[0]:
        raise InputError(f"{path} is separated by semicolons: save it with commas")
    for name in columns:
        if name in NOT_IN_TABLES and name not in RUNNING:
            raise InputError(
                f"{path}: '{name}' runs code, which no table may name: register such pairs alone"
            )
        if name in RUNNING:
            raise InputError(f"{path}: '{name}' is the same for all pairs: give it to batch, not in a column")
        if name not in COLUMNS:
            raise InputError(f"{path} has unknown column '{name}'; the columns are {', '.join(COLUMNS)}")
        if columns.count(name) > 1:
            raise InputError(f"{path} has column '{name}' twice")
    for name in ("reference", "target"):
        if name not in columns:
            raise InputError(f"{path} has no column '{name}'")
    return columns


def _check_places(path: Path, rows: list[tuple[int, dict[str, str]]], folder: Path, out_dir: Path) -> None:
    """Raise if a table, which may be untrusted, names outputs outside of its own folder and OUT_DIR."""
    allowed = (folder.resolve(), out_dir.resolve())
    for line, cells in rows:
        for name in ("out_dir", *OUTPUT_OPTIONS):
            place = (folder / cells[name]).resolve() if name in cells else allowed[0]
            if not any(place.is_relative_to(own) for own in allowed):
                raise InputError(
                    f"{path}, line {line}: {name} {cells[name]} is neither below the table's folder {folder} "
                    f"nor below OUT_DIR ({out_dir}): give a folder above it by -o, or another place"
                )


def _given_folders(path: Path, rows: list[tuple[int, dict[str, str]]], folder: Path) -> dict[int, Path]:
    """Return the output folders that the table names, by line."""
    given: dict[int, Path] = {}
    lines: dict[str, int] = {}
    for line, cells in rows:
        if "out_dir" not in cells:
            continue
        given[line] = folder / cells["out_dir"]
        other = lines.setdefault(_key(given[line]), line)
        if other != line:
            raise InputError(f"{path}: lines {other} and {line} have the same out_dir {cells['out_dir']}")
    return given


def _pair(
    line: int, cells: Mapping[str, str], folder: Path, out_dir: Path, options: Mapping[str, Any]
) -> BatchPair:
    own = {name: to_setting(name, value) for name, value in cells.items() if name in SETTINGS}
    own |= {name: folder / value for name, value in own.items() if isinstance(value, Path)}
    settings = Settings.from_options({**options, **own})
    parse_requirements(settings.require, "register")
    return BatchPair(
        line,
        _located(cells["reference"], folder),
        _located(cells["target"], folder),
        out_dir,
        settings,
        {name: folder / cells[name] for name in OUTPUT_OPTIONS if name in cells},
    )


def _located(name: str, folder: Path) -> str:
    """Return a path relative to the table's folder as absolute; GDAL URIs are unchanged."""
    path = folder / name
    return name if ":" in name and not path.exists() else str(path)


def _free(folder: Path, taken: set[str], numbers: dict[str, int]) -> Path:
    """Return the folder, or the first one numbered from 2 that is not taken.

    All up to `numbers` of a folder's key are known to be taken, so that many lines of one target need no more
    than linear time; it is brought up to date.
    """
    key, free = _key(folder), folder
    number = numbers.get(key, 1)
    while number > 1 or _key(free) in taken:
        number += 1
        free = folder.with_name(f"{folder.name}_{number}")
        if _key(free) not in taken:
            break
    numbers[key] = number
    return free


def _key(folder: Path) -> str:
    """Return a key that is equal for two names of one folder, also where case is not significant."""
    return os.path.normcase(os.path.abspath(folder)).casefold()  # noqa: PTH100


SUMMARY: Final = "summary.csv"
"""File name of the summary in the output folder."""
PAIRS_A_WORKER: Final = 16
"""Largest number of pairs that a worker process is given before the summary is written."""
SUMMARY_STEP: Final = 100
"""Of so many lines of the summary one may be lost by a process that is killed."""

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
            **(self.figures or _figures_of({})),
            "passed": self.passed,
            "reason": self.reason,
        }


def _figures_of(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a report that the summary has; all are None without one."""
    counts = report.get("tie_points") or {}
    displacement = (report.get("displacement_px") or {}).get("median") or (None, None)
    group, accuracy = _accuracy(report)
    px, m = accuracy.get("px") or {}, accuracy.get("m") or {}
    return {
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
        "passed": report.get("passed"),
        "warnings": len(report["warnings"]) if report else None,
        "seconds": round(sum(report["seconds"].values()), 1) if report else None,
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
        for left in of_dead_processes(path.parent, start):
            left.unlink(missing_ok=True)
        try:
            staged.write_text(text, encoding="utf-8", errors="backslashreplace", newline="")
            seal(staged)
            staged.replace(path)
        finally:
            with suppress(OSError):
                staged.unlink(missing_ok=True)


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


@checked()
def batch(
    pairs: PathLike,
    *,
    out_dir: PathLike | None = None,
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
    events = _PairEvents(on_event)
    outcomes: list[PairOutcome] = []
    at_work: list[BatchPair] = []
    with (
        kept_summary(folder / SUMMARY, outcomes) as keep,
        _swept_if_ended(at_work),
        open_job_runner(shared, executor, on_event) as runner,
    ):
        for part in _parts(todo, runner):
            events(Progress("pairs", len(outcomes), len(todo)))
            at_work[:] = part
            found = _do_part(part, overwrite, events.counted(len(outcomes), len(todo)), runner)
            outcomes += found
            keep()
            for outcome in found:
                if outcome.reason is not None:
                    events(Warned(f"{outcome.pair.name}: {outcome.status}: {outcome.reason}"))
    events(Progress("pairs", len(todo), len(todo)))
    return BatchResult(tuple(outcomes), folder / SUMMARY)


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

    def counted(self, done: int, total: int) -> _PairEvents:
        """Return the same for a part of the batch's pairs, whose progress is that of all."""

        def tell(event: Event) -> None:
            if isinstance(event, Progress) and event.stage == "pairs":
                event = replace(event, done=done + event.done, total=total)
            self(event)

        return _PairEvents(tell)

    def of(self, pair: BatchPair) -> EventCallback:
        """Return the receiver of a pair's events, which adds the pair's name to warnings."""
        return lambda event: self(
            Warned(f"{pair.name}: {event.message}") if isinstance(event, Warned) else event
        )


def _parts(todo: Sequence[BatchPair], runner: Runner) -> Iterator[list[BatchPair]]:
    """Yield the pairs in their order: alone, or those of one tile together, for workers that do one each.

    The first one is alone: what goes wrong with every pair is told before the workers begin.
    """
    most = PAIRS_A_WORKER * runner.threads if runner.shares_jobs else 1

    def is_small(numbered: tuple[int, BatchPair]) -> bool:
        number, pair = numbered
        tiles = estimate_tile_count(pair.reference, pair.target, pair.settings) if number and most > 1 else 0
        return tiles == 1

    for small, group in groupby(enumerate(todo), is_small):
        pairs = (pair for _, pair in group)
        while part := list(islice(pairs, most if small else 1)):
            yield part


def _do_part(
    part: Sequence[BatchPair], overwrite: bool, events: _PairEvents, runner: Runner
) -> list[PairOutcome]:
    """Register one pair, or several at once in worker processes, but for those that were done before."""
    with products_found_once():
        before = [None if overwrite else _done_before(pair) for pair in part]
        left = [pair for pair, outcome in zip(part, before, strict=True) if outcome is None]
        if len(left) <= 1:
            done = iter([_do(pair, overwrite, events, runner) for pair in left])
        else:
            found = runner.run_jobs(_do_whole, [(pair, overwrite) for pair in left], "pairs", events)
            done = iter([_told(result, pair, events) for result, pair in zip(found, left, strict=True)])
    return [outcome or next(done) for outcome in before]


def _told(
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


def _do_whole(pair: BatchPair, overwrite: bool) -> tuple[PairOutcome, list[Warned]]:
    """Register a pair in a worker process; return its outcome and what it was warned of."""
    events: list[Event] = []
    outcome = _do(pair, overwrite, _PairEvents(events.append), InThisProcess())
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


def _do(pair: BatchPair, overwrite: bool, events: _PairEvents, runner: Runner) -> PairOutcome:
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
        return _registered(pair, read_report(pair.out_dir))
    except Exception as error:  # of any kind: the other pairs are processed nevertheless
        if error is events.error:
            raise
        return _not_done(pair, error)
    return _registered(pair, read_report(pair.out_dir))


def _registered(pair: BatchPair, report: Mapping[str, Any], *, before: bool = False) -> PairOutcome:
    """Return the outcome of a registered pair, whether or not it meets its requirements."""
    missed = [each["message"] for each in report.get("requirements", ()) if not each["met"]]
    reason = "; ".join(missed) or None
    return PairOutcome(pair, "registered", reason, done_before=before, figures=_figures_of(report))


def _not_done(pair: BatchPair, error: Exception) -> PairOutcome:
    _release(error)
    if isinstance(error, RegistrationRejectedError):
        report = read_report(pair.out_dir)
        reason = report.get("reason") or str(error)
        return PairOutcome(pair, "rejected", reason, figures=_figures_of(report), error=error)
    known = error if isinstance(error, PcwladGeoError) else explained(error)
    if known is not None:
        return PairOutcome(pair, "unusable", joined(known), error=error)
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
    report = report_of_same_job("register", (pair.reference, pair.target), pair.settings, pair.out_dir)
    status = report.get("status")
    if status == "registered":
        return _registered(pair, report, before=True)
    if status == "rejected":
        return PairOutcome(pair, status, report.get("reason"), done_before=True, figures=_figures_of(report))
    return None
