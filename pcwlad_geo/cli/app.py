"""The ``pcwlad-geo`` command: those for one pair, the other commands, their groups, exit statuses."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final

import typer

import pcwlad_geo
from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.batch import batch
from pcwlad_geo.cli.edit import edit
from pcwlad_geo.cli.interrupts import INTERRUPTED
from pcwlad_geo.cli.pair import abandon_pair, do_pair, run_pair
from pcwlad_geo.cli.progress import show_error
from pcwlad_geo.cli.prove import prove_pair
from pcwlad_geo.cli.qa import qa
from pcwlad_geo.cli.rig import rig
from pcwlad_geo.cli.running import Ending, run_guarded
from pcwlad_geo.cli.sections import AFTER, MANY, ONE_PAIR, Command, Commands
from pcwlad_geo.cli.shift import shift
from pcwlad_geo.cli.stack import stack
from pcwlad_geo.cli.warp import warp
from pcwlad_geo.cli.watch import watch
from pcwlad_geo.correction import Effort
from pcwlad_geo.errors import InputError, PcwladGeoError
from pcwlad_geo.events import EventCallback

HELP_EXAMPLES: Final = o.examples(
    "demo",
    "register red.tif thermal.tif -o registered",
    'register red.tif thermal.tif --require "CE90<=0.5px"',
    "warp registered thermal_b11.tif",
    "stack 2021.tif 2022.tif 2023.tif -o series",
    "register --help",
)
"""End of the help."""
SAMPLE: Final = ("landsat_b4.tif", "landsat_b10.tif")
"""Reference and target of the demonstration: parts of the synthetic pair of the repository."""
NEXT: Final = """
The pair is synthetic. The thermal band lies +1.18, -0.71 px (mean; column, row) from where its georeferencing
says; the red band is right. Next, open that report, and register a pair of your own:
  pcwlad-geo register REFERENCE TARGET
"""
"""What `demo` prints after the result."""
PROTOCOL: Final = 1
"""Number of the conversation with programs, JSON lines and ``edit``: programs of another cannot follow it."""


app = typer.Typer(
    name="pcwlad-geo",
    cls=Commands,
    rich_markup_mode=None,  # plain help, plain errors
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command(
    cls=Command,
    rich_help_panel=ONE_PAIR,
    epilog=o.examples(
        "register red.tif thermal.tif",
        "register red.tif thermal.tif -o registered --overwrite",
        'register red.tif thermal.tif --require "CE90<=0.5px"',
        "register red.tif far_off.tif --prealign search",
        "register red.tif thermal.tif --ref-mask clouds.tif --model affine",
    ),
)
@o.takes_settings("register")
def register(
    context: typer.Context,
    reference: o.Reference,
    target: o.Target,
    out_dir: o.OutDir = None,
    output_raster: o.OutputRaster = None,
    output_tiepoints: o.OutputTiepoints = None,
    output_report: o.OutputReport = None,
    output_points: o.OutputPoints = None,
) -> None:
    """Register TARGET to REFERENCE: tie points, correction, registered raster, report."""
    run_pair("register", context.params)


@app.command(
    cls=Command,
    rich_help_panel=ONE_PAIR,
    epilog=o.examples("match red.tif thermal.tif -o matched", "match red.tif thermal.tif --points all"),
)
@o.takes_settings("match")
def match(
    context: typer.Context,
    reference: o.Reference,
    target: o.Target,
    out_dir: o.OutDir = None,
    output_tiepoints: o.OutputTiepoints = None,
    output_report: o.OutputReport = None,
    output_points: o.OutputPoints = None,
) -> None:
    """Find the tie points of a pair: a report, no correction."""
    run_pair("match", context.params)


EffortOption = Annotated[
    Effort,
    o.option(
        "--effort",
        help="quick: a sample of points; full: more, and what the pair tolerates.",
        show_default=True,
    ),
]


@app.command(
    cls=Command,
    rich_help_panel=ONE_PAIR,
    epilog=o.examples("prove red.tif thermal.tif", "prove red.tif thermal.tif --effort full -o proof"),
)
@o.takes_settings("prove")
def prove(
    context: typer.Context,
    reference: o.Reference,
    target: o.Target,
    out_dir: o.OutDir = None,
    effort: EffortOption = "quick",
) -> None:
    """Measure the tool's own error on a pair: move TARGET by known amounts, and match it again."""
    params = context.params
    run_guarded(params, lambda on_event: prove_pair(params, on_event), lambda: abandon_pair("proof", params))


DemoFolder = Annotated[Path, o.argument("FOLDER", "Folder to write into.  [default: pcwlad-geo-demo]")]


@app.command(cls=Command, rich_help_panel=ONE_PAIR, epilog=o.examples("demo", "demo sample --overwrite"))
@o.takes_settings("demo")
def demo(context: typer.Context, folder: DemoFolder = Path("pcwlad-geo-demo")) -> None:
    """Write a small synthetic pair into FOLDER, and register it: no data of your own are needed."""
    reference, target = (str(folder / name) for name in SAMPLE)
    params = {"reference": reference, "target": target, "out_dir": folder / "registered", **context.params}

    def work(on_event: EventCallback) -> Ending:
        _write_sample(params)
        ending = do_pair("register", params, on_event)
        return replace(ending, text=ending.text + NEXT)

    run_guarded(params, work, lambda: abandon_pair("registered", params))


def _write_sample(params: Mapping[str, Any]) -> None:
    """Copy the sample pair to its places, after all that may refuse the run."""
    from pcwlad_geo.outputs.folder import check_output_folder, place_file, stage_inside
    from pcwlad_geo.outputs.places import check_outputs

    places, overwrite = [params["folder"] / name for name in SAMPLE], params["overwrite"]
    check_output_folder(params["out_dir"], overwrite)
    check_outputs(places, overwrite=overwrite)
    with stage_inside(params["folder"]) as stage:
        for place in places:
            shutil.copyfile(Path(__file__).parent / "sample" / place.name, stage / place.name)
            place_file(stage / place.name, place, overwrite=overwrite)


for command, panel, lines in (
    (batch, MANY, ("batch pairs.csv -o registered", "batch pairs.csv -o registered --jobs 8")),
    (stack, MANY, ("stack 2021.tif 2022.tif 2023.tif -o series", "stack --add 2024.tif series")),
    (watch, MANY, ("watch series", "watch series -o watched")),
    (qa, MANY, ("qa b2.tif b3.tif b4.tif -o quality", 'qa stacked.tif --require "CE90<=0.3px"')),
    (
        warp,
        AFTER,
        (
            "warp registered thermal_b11.tif",
            "warp registered thermal_b11.tif -o warped --resampling bilinear",
        ),
    ),
    (shift, AFTER, ("shift ortho.tif plots.gpkg --by 1.2,-0.8 -o shifted",)),
):
    app.command(cls=Command, rich_help_panel=panel, epilog=o.examples(*lines))(command)
app.add_typer(rig, name="rig", rich_help_panel=MANY)
app.command(hidden=True)(edit)  # a conversation between programs


def _show_version(is_wanted: bool) -> None:
    if is_wanted:
        typer.echo(f"pcwlad-geo {pcwlad_geo.__version__} (protocol {PROTOCOL})")
        raise typer.Exit


@app.callback(epilog=HELP_EXAMPLES)
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
        return INTERRUPTED
    except MemoryError:  # before the work, or while reporting its end
        show_error("there is not enough memory: end other programs, or raise the limit (ulimit -v)")
        return InputError.exit_status
    return status if isinstance(status, int) else 0
