"""Common parts of all commands: options, progress, cancellation, and exit statuses of errors."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import typer

from pcwlad_geo.cli.interrupt import STATUS as INTERRUPTED
from pcwlad_geo.cli.interrupt import cancellable
from pcwlad_geo.cli.options import collect
from pcwlad_geo.cli.outcome import Outcome
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

UNEXPECTED = 1
"""Exit status of an unexpected error."""

Command = Literal["register", "match"]


@dataclass(frozen=True, slots=True)
class Ending:
    """The result of a command that has finished."""

    figures: dict[str, object]
    """Values of the result event."""
    text: str
    """The text that is printed."""
    exit_status: int = 0


def run_job(command: Command, params: Mapping[str, Any]) -> None:
    """Run a job with the parameters of its command.

    Raises `typer.Exit` with the exit status, unless the job succeeded.
    """

    def work(on_event: EventCallback) -> Ending:
        status, paths = _work(command, params, collect(params, params["config"]), on_event)
        outcome = Outcome.read(paths)
        return Ending({**outcome.figures(), "exit_status": status}, visible(outcome.text()), status)

    run_guarded(params, work, lambda: _abandon(command, params))


def run_guarded(
    params: Mapping[str, Any], work: Callable[[EventCallback], Ending], abandon: Callable[[], None]
) -> None:
    """Run the work of a command: report its events and its end, and allow cancellation.

    Raises `typer.Exit` with the exit status, unless it is 0. If the work cannot remove partly written files
    itself, `abandon` does.
    """
    with reporter(params["progress"], debug=params["debug"]) as report:
        status = _attempt(params, report, work, abandon)
    if status:
        raise typer.Exit(status)


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
        with cancellable(end_by_force, watch_stdin=params["watch_stdin"]):
            check_address_space()
            ending = work(report.event)
        report.result(ending.figures, ending.text)
    except (KeyboardInterrupt, CancelledError):
        _clean_up(abandon)
        report.cancelled()
        return INTERRUPTED
    except Exception as error:
        if params["debug"]:
            show_traceback(error)
        return _report_error(error, report)
    return ending.exit_status


def _clean_up(abandon: Callable[[], None]) -> None:
    """Remove files left by an interrupt between a step and its record."""
    if "pcwlad_geo.outputs.folder" in sys.modules:  # otherwise nothing was staged, and loading it takes time
        with suppress(OSError, PcwladGeoError):
            abandon()


def _report_error(error: Exception, report: Reporter) -> int:
    if isinstance(error, PcwladGeoError):
        report.error(str(error), {"exit_status": error.exit_status, **_rejection(error)})
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
    command: Command, params: Mapping[str, Any], settings: Mapping[str, Any], on_event: EventCallback
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


def _abandon(command: Command, params: Mapping[str, Any]) -> None:
    from pcwlad_geo.job import output_folder
    from pcwlad_geo.outputs.folder import abandon

    abandon(params["out_dir"] or output_folder(params["target"], _job(command)))


def _job(command: Command) -> Literal["registered", "matched"]:
    return "registered" if command == "register" else "matched"


def _places(params: Mapping[str, Any]) -> dict[str, Any]:
    return {name: params[name] for name in ("out_dir", *OUTPUT_OPTIONS) if name in params}


def _rejection(error: PcwladGeoError) -> dict[str, object]:
    """Return the paths of the report of a rejected registration."""
    if not isinstance(error, RegistrationRejectedError) or not isinstance(error.out_dir, Path):
        return {}
    return {"status": "rejected", "out_dir": str(error.out_dir)}
