"""The run of a command: its work, the report of its end, and its exit status."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from pcwlad_geo.child import how_it_was_lost
from pcwlad_geo.cli.guard import SIGNALS, watched
from pcwlad_geo.cli.interrupts import INTERRUPTED, cancellable
from pcwlad_geo.cli.progress import Reporter, reporter
from pcwlad_geo.errors import (
    CancelledError,
    ExecutionError,
    PcwladGeoError,
    RegistrationRejectedError,
)
from pcwlad_geo.events import EventCallback
from pcwlad_geo.limits import check_address_space
from pcwlad_geo.text import one_line

UNEXPECTED = 1
"""Exit status of an unexpected error."""


@dataclass(frozen=True, slots=True)
class Ending:
    """The result of a command that has finished."""

    figures: dict[str, object]
    """Values of the result event, but for the exit status."""
    text: str
    """The text that is printed."""
    exit_status: int = 0


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
    expected = _not_loaded(error)
    if expected is None:
        from pcwlad_geo.raster.gdal import explained  # imported here, as it loads GDAL

        expected = explained(error)
    if expected is not None:
        report.error(str(expected), {"exit_status": expected.exit_status})
        return expected.exit_status
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
