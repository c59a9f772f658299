"""The ``pcwlad-geo`` command: ``register`` and ``match`` for one pair, the other commands, exit statuses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import pcwlad_geo
from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.batch import batch
from pcwlad_geo.cli.edit import edit
from pcwlad_geo.cli.job import run_job
from pcwlad_geo.cli.progress import show_error
from pcwlad_geo.cli.qa import qa
from pcwlad_geo.cli.rig import rig
from pcwlad_geo.cli.stack import stack
from pcwlad_geo.cli.warp import warp
from pcwlad_geo.errors import InputError, PcwladGeoError

app = typer.Typer(
    name="pcwlad-geo",
    add_completion=False,
    rich_markup_mode=None,  # plain help, plain errors
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
@o.takes_settings("register")
def register(
    context: typer.Context,
    reference: o.Reference,
    target: o.Target,
    out_dir: o.OutDir = None,
    progress: o.ProgressOption = "auto",
    watch_stdin: o.WatchStdin = False,
    config: o.Config = None,
    overwrite: o.Overwrite = False,
    output_raster: o.OutputRaster = None,
    output_tiepoints: o.OutputTiepoints = None,
    output_report: o.OutputReport = None,
    output_points: o.OutputPoints = None,
    debug: o.Debug = False,
) -> None:
    """Register TARGET to REFERENCE: tie points, correction, registered raster, report."""
    run_job("register", context.params)


@app.command()
@o.takes_settings("match")
def match(
    context: typer.Context,
    reference: o.Reference,
    target: o.Target,
    out_dir: o.OutDir = None,
    progress: o.ProgressOption = "auto",
    watch_stdin: o.WatchStdin = False,
    config: o.Config = None,
    overwrite: o.Overwrite = False,
    output_tiepoints: o.OutputTiepoints = None,
    output_report: o.OutputReport = None,
    output_points: o.OutputPoints = None,
    debug: o.Debug = False,
) -> None:
    """Match TARGET to REFERENCE: tie points and report, no correction."""
    run_job("match", context.params)


app.command()(warp)
app.command()(qa)
app.command()(batch)
app.command()(stack)
app.add_typer(rig, name="rig")
app.command(hidden=True)(edit)  # a conversation between programs


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pcwlad-geo {pcwlad_geo.__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit."),
    ] = False,
) -> None:
    """Sub-pixel registration of multimodal rasters."""


def run(arguments: Sequence[str]) -> int:
    """Run the command line and return its exit status; usage errors are one line on standard error."""
    try:
        Path.cwd()
    except OSError as error:
        show_error(f"the working folder cannot be used ({error.strerror}): change to another one")
        return InputError.exit_status
    try:
        status = app(list(arguments) or ["--help"], standalone_mode=False)
    except typer.TyperException as error:
        show_error(error.format_message())
        return error.exit_code
    except PcwladGeoError as error:  # before a run could report it
        show_error(error)
        return error.exit_status
    except typer.Abort:
        return 130
    except MemoryError:  # before the work, or while reporting its end
        show_error("there is not enough memory: end other programs, or raise the limit (ulimit -v)")
        return InputError.exit_status
    return status if isinstance(status, int) else 0
