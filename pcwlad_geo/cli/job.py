"""What every command does around its job: options, progress, cancellation, errors to exit statuses."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import typer

from pcwlad_geo.cli.config import collect
from pcwlad_geo.cli.interrupt import STATUS as INTERRUPTED
from pcwlad_geo.cli.interrupt import cancellable
from pcwlad_geo.cli.outcome import Outcome
from pcwlad_geo.cli.progress import Reporter, one_line, reporter
from pcwlad_geo.errors import CancelledError, PcwladGeoError, RegistrationRejectedError
from pcwlad_geo.registration.settings import Settings

UNEXPECTED = 1
PLACES = ("out_dir", "output_raster", "output_tiepoints", "output_report", "output_points")

Command = Literal["register", "match"]


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
    with reporter(params["progress"]) as report:
        status = _attempt(command, params, report)
    if status:
        raise typer.Exit(status)


def _attempt(command: Command, params: Mapping[str, Any], report: Reporter) -> int:
    """Run the job, report its end, return its exit status."""

    def end_by_force() -> None:
        report.cancelled()
        from pcwlad_geo.staging import abandon

        abandon(_paths(command, params)["numbers"].parent)

    try:
        with cancellable(end_by_force, watch_stdin=params["watch_stdin"]):
            _work(command, params, report)
            outcome = Outcome.read(_paths(command, params))
        report.result(outcome.figures(), outcome.text())
    except (KeyboardInterrupt, CancelledError):
        report.cancelled()
        return INTERRUPTED
    except PcwladGeoError as error:
        _show_traceback(params["debug"])
        report.error(str(error), {"exit_status": error.exit_status, **_rejection(error)})
        return error.exit_status
    except Exception as error:  # the last line of defence: one line instead of a traceback
        _show_traceback(params["debug"])
        message = f"unexpected {type(error).__name__}: {one_line(error)} (--debug shows where)"
        report.error(message, {"exit_status": UNEXPECTED})
        return UNEXPECTED
    return 0


def _work(command: Command, params: Mapping[str, Any], report: Reporter) -> None:
    settings = collect(params, params["config"])
    Settings.from_options(settings)  # a bad value need not wait for the heavy libraries, which load here:
    from pcwlad_geo import workflow

    function: Callable[..., object] = workflow.register if command == "register" else workflow.match
    function(
        params["reference"],
        params["target"],
        overwrite=params["overwrite"],
        on_event=report.event,
        **_places(params),
        **settings,
    )


def _paths(command: Command, params: Mapping[str, Any]) -> Mapping[str, Path]:
    """Return where the outputs go, by kind."""
    from pcwlad_geo.workflow import output_paths

    job: Literal["registered", "matched"] = "registered" if command == "register" else "matched"
    return output_paths(params["target"], job, **_places(params))


def _places(params: Mapping[str, Any]) -> dict[str, Any]:
    return {name: params[name] for name in PLACES if name in params}


def _show_traceback(wanted: bool) -> None:
    if wanted:
        traceback.print_exc()


def _rejection(error: PcwladGeoError) -> dict[str, object]:
    """Return where the report of a refusal is."""
    if not isinstance(error, RegistrationRejectedError) or not isinstance(error.out_dir, Path):
        return {}
    return {"status": "rejected", "out_dir": str(error.out_dir)}
