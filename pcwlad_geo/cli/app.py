"""The ``pcwlad-geo`` command: its subcommands, and every end of it as an exit status."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import typer

import pcwlad_geo
from pcwlad_geo.cli.batch import batch
from pcwlad_geo.cli.match import match
from pcwlad_geo.cli.progress import show_error
from pcwlad_geo.cli.qa import qa
from pcwlad_geo.cli.register import register
from pcwlad_geo.cli.warp import warp
from pcwlad_geo.errors import InputError

app = typer.Typer(
    name="pcwlad-geo",
    add_completion=False,
    rich_markup_mode=None,  # plain help, plain errors
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(register)
app.command()(match)
app.command()(warp)
app.command()(qa)
app.command()(batch)


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
        status = app(list(arguments) or ["--help"], standalone_mode=False)
    except typer.TyperException as error:
        show_error(error.format_message())
        return error.exit_code
    except typer.Abort:
        return 130
    except MemoryError:  # before the work, or in telling its end
        show_error("there is not enough memory: end other programs, or raise the limit (ulimit -v)")
        return InputError.exit_status
    return status if isinstance(status, int) else 0
