"""Common parts of all commands: options, progress, cancellation, exit statuses, texts of outcomes."""

from __future__ import annotations

import _thread
import io
import json
import os
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, Literal

import typer

from pcwlad_geo.child import how_it_was_lost
from pcwlad_geo.cli.guard import SIGNALS, watched
from pcwlad_geo.cli.options import collect
from pcwlad_geo.cli.progress import Reporter, reporter
from pcwlad_geo.errors import (
    CancelledError,
    ExecutionError,
    PcwladGeoError,
    RegistrationRejectedError,
    RequirementError,
)
from pcwlad_geo.events import EventCallback
from pcwlad_geo.limits import check_address_space
from pcwlad_geo.options import OUTPUT_OPTIONS, Settings
from pcwlad_geo.text import check_exists, one_line, visible

if TYPE_CHECKING:
    from pcwlad_geo.correction.proof_result import Proof

UNEXPECTED = 1
"""Exit status of an unexpected error."""

PairCommand = Literal["register", "match"]


@dataclass(frozen=True, slots=True)
class Ending:
    """The result of a command that has finished."""

    figures: dict[str, object]
    """Values of the result event, but for the exit status."""
    text: str
    """The text that is printed."""
    exit_status: int = 0


def run_job(command: PairCommand, params: Mapping[str, Any]) -> None:
    """Run a job with the parameters of its command.

    Raises `typer.Exit` with the exit status, unless the job succeeded.
    """
    run_guarded(
        params,
        lambda on_event: do_pair(command, params, on_event),
        lambda: abandon_pair(_job(command), params),
    )


def do_pair(command: PairCommand, params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    """Do a job on one pair, and return its result; `params` are those of its command."""
    status, paths = _work(command, params, collect(params, params["config"]), on_event)
    outcome = Outcome.read(paths)
    return Ending(outcome.figures(), visible(outcome.text()), status)


def run_guarded(
    params: Mapping[str, Any], work: Callable[[EventCallback], Ending], abandon: Callable[[], None]
) -> None:
    """Run the work of a command: report its events and its end, and allow cancellation.

    Raises `typer.Exit` with the exit status, unless it is 0. If the work cannot remove partly written files
    itself, `abandon` does. Where there can be another process for the work, this one waits for that.
    """
    ended = watched()
    with reporter(params["progress"], debug=params["debug"]) as report:
        if ended is None:
            status = _attempt(params, report, work, abandon)
        else:
            status = ended if ended >= 0 else _lost(ended, report)
    if status:
        raise typer.Exit(status)


def _lost(ended: int, report: Reporter) -> int:
    """Report that a signal has ended the work; the next run removes what that has written in part."""
    if -ended in SIGNALS:  # before the work could heed it
        report.cancelled()
        return INTERRUPTED
    return _report_error(ExecutionError(f"the work was lost: {how_it_was_lost(ended)}"), report)


def show_traceback(error: BaseException) -> None:
    """Print the traceback of an error, for ``--debug``."""
    traceback.print_exception(error)


def _attempt(
    params: Mapping[str, Any],
    report: Reporter,
    work: Callable[[EventCallback], Ending],
    abandon: Callable[[], None],
) -> int:
    """Run the work, report its end and return its exit status."""

    def end_by_force() -> None:
        report.cancelled()
        abandon()

    try:
        try:
            with cancellable(end_by_force, watch_stdin=params["watch_stdin"]):
                check_address_space()
                ending = work(report.event)
            report.result({**ending.figures, "exit_status": ending.exit_status}, ending.text)
        except (KeyboardInterrupt, CancelledError):
            # without that module nothing was staged, and to load it takes time
            if "pcwlad_geo.outputs.folder" in sys.modules:
                with suppress(OSError, PcwladGeoError):  # files left between a step and its record
                    abandon()
            report.cancelled()
            return INTERRUPTED
    except Exception as error:  # also of the removal after an interrupt
        if params["debug"]:
            show_traceback(error)
        return _report_error(error, report)
    return ending.exit_status


def _report_error(error: Exception, report: Reporter) -> int:
    if isinstance(error, PcwladGeoError):
        details: dict[str, object] = {"exit_status": error.exit_status}
        if isinstance(error, RegistrationRejectedError) and isinstance(error.out_dir, Path):
            details |= {"status": "rejected", "out_dir": str(error.out_dir)}
        report.error(str(error), details)
        return error.exit_status
    known = _not_loaded(error)
    if known is None:
        from pcwlad_geo.raster.gdal import explained  # imported here, as it loads GDAL

        known = explained(error)
    if known is not None:
        report.error(str(known), {"exit_status": known.exit_status})
        return known.exit_status
    # any other error: one line instead of a traceback
    message = f"unexpected {type(error).__name__}: {one_line(error)} (--debug shows where)"
    report.error(message, {"exit_status": UNEXPECTED})
    return UNEXPECTED


def _not_loaded(error: Exception) -> PcwladGeoError | None:
    """Return the error to show if a library could not be loaded, mostly for lack of memory."""
    shared = any(word in str(error) for word in ("shared object", "DLL load failed"))
    if not (shared and isinstance(error, ImportError | OSError)):
        return None
    return ExecutionError(
        f"a library cannot be loaded ({one_line(error)}): give the process more memory (ulimit -v shows its "
        "limit), or install pcwlad-geo anew"
    )


def _work(
    command: PairCommand, params: Mapping[str, Any], settings: Mapping[str, Any], on_event: EventCallback
) -> tuple[int, Mapping[str, Path]]:
    """Run the job; return the exit status, and the paths of the outputs by kind."""
    inputs, places, status = (params["reference"], params["target"]), _places(params), 0
    Settings.from_options(settings)  # what is mistyped is reported before the large libraries are loaded:
    for name in inputs:
        check_exists(name)
    from pcwlad_geo import job as workflow

    function: Callable[..., object] = workflow.register if command == "register" else workflow.match_files
    with workflow.products_found_once():
        try:
            function(*inputs, overwrite=params["overwrite"], on_event=on_event, **places, **settings)
        except RequirementError as error:  # the result is there
            status = error.exit_status
        named = {name: settings[name] for name in ("tgt_band", "of") if name in settings}
        return status, workflow.output_paths(inputs[1], _job(command), **named, **places)


def abandon_pair(job: Literal["registered", "matched", "proof"], params: Mapping[str, Any]) -> None:
    """Remove partly written files of a job on one pair."""
    from pcwlad_geo.job import output_folder
    from pcwlad_geo.outputs.folder import abandon

    abandon(output_folder(params["target"], job, params["out_dir"]))


def _job(command: PairCommand) -> Literal["registered", "matched"]:
    return "registered" if command == "register" else "matched"


def _places(params: Mapping[str, Any]) -> dict[str, Any]:
    return {name: params[name] for name in ("out_dir", *OUTPUT_OPTIONS) if name in params}


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

SCALED: Final = 1.05
"""Scale of the target from which its pose is printed instead of a displacement."""
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

        The `paths` are those of all kinds of output, `numbers` (report.json) among them.
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
            "model_name": model["name"] if (model := self.summary.get("model")) else None,
            "paths": {kind: str(path.absolute()) for kind, path in self.paths.items()},
        }

    def text(self) -> str:
        """Return the summary that is printed."""
        counts, displacement = self.summary["tie_points"], self.summary["displacement_px"]
        kept = counts["total"] - counts["rejected"]
        lines = [f"{self.summary['status']}: {kept} tie points ({counts['rejected']} rejected)"]
        pose = (self.summary.get("prealignment") or {}).get("pose")
        scales = [abs(side) for side in pose["scale"]] if pose else [1.0]
        if displacement and pose and (max(scales) > SCALED or min(scales) < 1 / SCALED):
            across, down = scales  # a displacement of px of another size says nothing
            lines.append(
                f"found at scale {across:.3f} x {down:.3f}, rotation {pose['rotation_deg']:.1f} degrees"
            )
        elif displacement:
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
        size, whole = (
            _size(quality[f"{of}_ce90_px"], quality[f"{of}_ce90_m"]) for of in ("expected", "whole")
        )
        ground = "ground that was compared" if whole else "common ground"
        line = f"quality: {quality['grade']}; 90 % of the {ground} is expected to lie within {size}"
        return [f"{line}, and of all that both show within {whole}" if whole else line]

    def _requirements(self) -> list[str]:
        """Return a line for each requirement, and the verdict."""
        lines = [each["message"] for each in self.summary.get("requirements") or ()]
        if not lines:
            return []
        if self.summary["passed"]:
            doubtful = any(each.get("caveat") for each in self.summary["requirements"])
            where = f" at the tie points of a {self.summary['quality']['grade']} registration"
            return [*lines, "PASSED" + where if doubtful else "PASSED"]
        withheld = self.summary["status"] == "registered" and "raster" not in self.paths
        return [*lines, "FAILED: no corrected raster is written without --keep" if withheld else "FAILED"]

    def _table(self) -> list[str]:
        """Return the statistics before and after the correction, in columns."""
        statistics = self.summary.get("statistics") or {}
        found = [(title, statistics.get(when, {}).get(group)) for title, when, group in ROWS]
        rows = [_row(title, each) for title, each in found if each]
        return columns([HEADER, *rows], (0,)) if rows else []


def _size(px: float | None, metres: float | None) -> str:
    """Return a length as text; empty if it is not known."""
    if px is None:
        return ""
    digits = 2 if px >= 0.01 else 3  # 0.00 px would be a promise
    return f"{px:.{digits}f} px" + (f" ({metres:.{digits}f} m)" if metres is not None else "")


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


GRACE_S = 1.0
"""Time for the main thread to clean up by itself before the run is ended by another thread."""
CLEANING_S = 0.5
"""Time for the clean-up by that thread."""
WATCHER = "pcwlad-geo-interrupt"
"""Name of the threads that wait for an interrupt."""
INTERRUPTED = 130
"""Exit status of an interrupted run."""


@contextmanager
def cancellable(forced_end: Callable[[], None], *, watch_stdin: bool = False) -> Iterator[None]:
    """Convert the first interrupt to KeyboardInterrupt in the main thread; end a stuck run by force.

    Python runs signal handlers between two byte codes of the main thread, which a long call of a C library
    delays. The wakeup descriptor is written at once, so a thread that reads it can wait `GRACE_S` and then
    clean up by `forced_end` and end the process itself, with status 130. With `watch_stdin`, the end of
    standard input interrupts the run too. Handlers can be set in the main thread alone: in any other one the
    caller's own are left as they are.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    finished = threading.Event()
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    previous = {number: signal.signal(number, _interrupt) for number in SIGNALS}
    wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    watched = (reader, finished, forced_end)
    watcher = threading.Thread(target=_watch_signals, args=watched, name=WATCHER, daemon=True)
    watcher.start()
    if watch_stdin:
        threading.Thread(target=_watch_stdin, args=(finished,), name=WATCHER, daemon=True).start()
    try:
        yield
    finally:
        finished.set()
        signal.set_wakeup_fd(wakeup)
        for number, handler in previous.items():
            signal.signal(number, handler)
        writer.close()  # ends the watcher
        watcher.join()


def _interrupt(number: int, frame: FrameType | None) -> None:
    for each in SIGNALS:  # once: a second signal must not interrupt the clean-up
        signal.signal(each, signal.SIG_IGN)
    raise KeyboardInterrupt


def _watch_signals(reader: socket.socket, finished: threading.Event, forced_end: Callable[[], None]) -> None:
    with reader:
        while received := reader.recv(1):
            if received[0] in SIGNALS:
                if not finished.wait(GRACE_S):
                    _end_process(forced_end)
                return


def _end_process(forced_end: Callable[[], None]) -> None:
    # In a separate thread: the stuck main thread may hold a lock that the clean-up needs.
    cleaning = threading.Thread(target=forced_end, daemon=True)
    cleaning.start()
    cleaning.join(CLEANING_S)
    os._exit(INTERRUPTED)  # worker processes end with this one


def _watch_stdin(finished: threading.Event) -> None:
    # os.read: a thread that waits in sys.stdin would block the end of the interpreter.
    while os.read(0, 4096):
        pass
    if finished.is_set():
        return
    if hasattr(signal, "pthread_kill"):  # wakes a main thread that waits for a lock
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()


def proof_text(proof: Proof) -> str:
    """Return what is printed of a proof, without the place of its files."""
    bias, scatter, locking = (
        [f"{value:+.4f}" if name == "bias" else f"{value:.4f}" for value in values]
        for name, values in (
            ("bias", proof.bias_px),
            ("scatter", proof.scatter_px),
            ("locking", proof.locking_px),
        )
    )
    rows = [
        ("", "column", "row"),
        ("bias", *bias),
        ("scatter", *scatter),
        ("pixel locking, amplitude", *locking),
    ]
    lines = [
        f"the tool's own error, target px: {proof.points} tie points matched again after {len(proof.moves)} "
        "known moves of the target",
        *columns(rows, (0,)),
        f"points: RMSE {proof.rmse_px:.4f} px, CE90 {proof.ce90_px:.4f} px",
    ]
    if proof.correction is not None:
        each = proof.correction
        lines.append(f"correction ({each.model}): RMSE {each.rmse_px:.4f} px, CE90 {each.ce90_px:.4f} px")
    lines += [
        f"within sigma {100 * proof.sigma.within_68:.0f} % (68 is right), within 1.96 sigma "
        f"{100 * proof.sigma.within_95:.0f} % (95); the sigmas hold times {proof.sigma.factor:.2f}",
        f"wrong matches that passed every test: {proof.false_matches} of "
        f"{proof.matches + proof.false_matches}; lost: {proof.lost}",
    ]
    if proof.sensitivity is not None:
        from pcwlad_geo.report.page import tolerated_text

        lines.append("tolerates " + "; ".join(map(tolerated_text, proof.sensitivity.limits)))
        if (back := proof.sensitivity.reversal) is not None:
            col, row = back.bias_px
            lines.append(f"both directions: RMS {back.rms_px:.4f} px, bias {col:+.4f}, {row:+.4f} px")
    return "\n".join(lines) + "\n"


def prove_pair(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    """Prove a pair with the parameters of the command."""
    settings = collect(params, params["config"])
    Settings.from_options(settings)  # what is mistyped is reported before the large libraries are loaded:
    for name in (params["reference"], params["target"]):
        check_exists(name)
    from pcwlad_geo.job import PROOF_NAMES, output_folder, prove

    proof = prove(
        params["reference"],
        params["target"],
        effort=params["effort"],
        out_dir=params["out_dir"],
        overwrite=params["overwrite"],
        on_event=on_event,
        **settings,
    )
    folder = output_folder(params["target"], "proof", params["out_dir"])
    figures: dict[str, object] = {
        **{
            name: getattr(proof, name)
            for name in ("bias_px", "scatter_px", "rmse_px", "ce90_px", "false_matches")
        },
        "paths": {kind: str((folder / name).absolute()) for kind, name in PROOF_NAMES.items()},
    }
    text = f"{proof_text(proof)}report: {folder / PROOF_NAMES['report']}\n"
    return Ending(figures, visible(text))
