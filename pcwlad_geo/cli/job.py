"""What every command does around its job: options, progress, cancellation, errors to exit statuses."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import typer

from pcwlad_geo.cli.config import collect
from pcwlad_geo.cli.interrupt import STATUS as INTERRUPTED
from pcwlad_geo.cli.interrupt import cancellable
from pcwlad_geo.cli.outcome import Outcome
from pcwlad_geo.cli.progress import Reporter, reporter
from pcwlad_geo.cli.visible import one_line, visible
from pcwlad_geo.errors import (
    CancelledError,
    ExecutionError,
    PcwladGeoError,
    RegistrationRejectedError,
    RequirementError,
)
from pcwlad_geo.limits import check_address_space
from pcwlad_geo.registration.progress import EventCallback
from pcwlad_geo.registration.settings import Settings

UNEXPECTED = 1
PLACES = ("out_dir", "output_raster", "output_tiepoints", "output_report", "output_points")

Command = Literal["register", "match"]


@dataclass(frozen=True, slots=True)
class Ending:
    """The end of a command that did its work."""

    figures: dict[str, object]
    """Values of the result event."""
    text: str
    """The same for people."""
    exit_status: int = 0


def run_job(command: Command, params: Mapping[str, Any]) -> None:
    """Run a job as the parameters of its command say.

    Parameters
    ----------
    command : {"register", "match"}
        The workflow function of that name is run.
    params : mapping
        The parameters of the command, by name.

    Raises
    ------
    typer.Exit
        With the exit status, unless the job succeeded.
    """

    def work(on_event: EventCallback) -> Ending:
        settings = collect(params, params["config"])
        status = 0
        try:
            _work(command, params, settings, on_event)
        except RequirementError as error:  # the result is there
            status = error.exit_status
        outcome = Outcome.read(_paths(command, params, settings))
        return Ending({**outcome.figures(), "exit_status": status}, visible(outcome.text()), status)

    run_guarded(params, work, lambda: _abandon(command, params))


def run_guarded(
    params: Mapping[str, Any], work: Callable[[EventCallback], Ending], abandon: Callable[[], None]
) -> None:
    """Do the work of a command: report its events and its end, let it be cancelled.

    Parameters
    ----------
    params : mapping
        The parameters of the command; progress, watch_stdin and debug are used.
    work : callable
        Receives the callback for events.
    abandon : callable
        Removes what the work has half-written, where it cannot do so itself.

    Raises
    ------
    typer.Exit
        With the exit status, unless it is 0.
    """
    with reporter(params["progress"], debug=params["debug"]) as report:
        status = _attempt(params, report, work, abandon)
    if status:
        raise typer.Exit(status)


def show_traceback(error: BaseException) -> None:
    """Show where an error arose, for ``--debug``."""
    traceback.print_exception(error)


def _attempt(
    params: Mapping[str, Any],
    report: Reporter,
    work: Callable[[EventCallback], Ending],
    abandon: Callable[[], None],
) -> int:
    """Do the work, report its end, return its exit status."""

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
    """Remove what an interrupt left that came between a step and the note that it was done."""
    if "pcwlad_geo.staging" in sys.modules:  # else nothing was staged, and loading it takes a while
        with suppress(OSError, PcwladGeoError):
            abandon()


def _report_error(error: Exception, report: Reporter) -> int:
    if isinstance(error, PcwladGeoError):
        report.error(str(error), {"exit_status": error.exit_status, **_rejection(error)})
        return error.exit_status
    known = _not_loaded(error)
    if known is None:
        from pcwlad_geo.raster.boundary import explained  # only now: it loads GDAL

        known = explained(error)
    if known is not None:
        report.error(str(known), {"exit_status": known.exit_status})
        return known.exit_status
    # the last line of defence: one line instead of a traceback
    message = f"unexpected {type(error).__name__}: {one_line(error)} (--debug shows where)"
    report.error(message, {"exit_status": UNEXPECTED})
    return UNEXPECTED


def _not_loaded(error: Exception) -> PcwladGeoError | None:
    """Return the error that people see where a library could not be loaded: mostly for want of memory."""
    shared = any(word in str(error) for word in ("shared object", "DLL load failed"))
    if not (shared and isinstance(error, ImportError | OSError)):
        return None
    return ExecutionError(
        f"a library cannot be loaded ({one_line(error)}): give the process more memory (ulimit -v shows its "
        "limit), or install pcwlad-geo anew"
    )


def _work(
    command: Command, params: Mapping[str, Any], settings: Mapping[str, Any], on_event: EventCallback
) -> None:
    Settings.from_options(settings)  # a bad value need not wait for the heavy libraries, which load here:
    from pcwlad_geo import workflow

    function: Callable[..., object] = workflow.register if command == "register" else workflow.match
    function(
        params["reference"],
        params["target"],
        overwrite=params["overwrite"],
        on_event=on_event,
        **_places(params),
        **settings,
    )


def _abandon(command: Command, params: Mapping[str, Any]) -> None:
    from pcwlad_geo.staging import abandon
    from pcwlad_geo.workflow import output_folder

    abandon(params["out_dir"] or output_folder(params["target"], _job(command)))


def _paths(command: Command, params: Mapping[str, Any], settings: Mapping[str, Any]) -> Mapping[str, Path]:
    """Return where the outputs go, by kind."""
    from pcwlad_geo.workflow import output_paths

    named = {name: settings[name] for name in ("tgt_band", "of") if name in settings}
    return output_paths(params["target"], _job(command), **named, **_places(params))


def _job(command: Command) -> Literal["registered", "matched"]:
    return "registered" if command == "register" else "matched"


def _places(params: Mapping[str, Any]) -> dict[str, Any]:
    return {name: params[name] for name in PLACES if name in params}


def _rejection(error: PcwladGeoError) -> dict[str, object]:
    """Return where the report of a refusal is."""
    if not isinstance(error, RegistrationRejectedError) or not isinstance(error.out_dir, Path):
        return {}
    return {"status": "rejected", "out_dir": str(error.out_dir)}
