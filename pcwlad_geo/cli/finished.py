"""``pcwlad-geo warp`` and ``edit``: what is done with a finished registration.

`warp` applies it to other bands of its target. `edit` is for programs that let a user change its tie points:
it stays open and answers requests, a JSON object a line on standard input, with events on standard output.
"""

from __future__ import annotations

import io
import json
import os
import queue
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.job import Ending, run_guarded
from pcwlad_geo.cli.progress import protocol_stream
from pcwlad_geo.errors import InputError, PcwladGeoError, SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import OutputGrid, Resampling, Settings, to_setting
from pcwlad_geo.text import parse_json, plain, visible

if TYPE_CHECKING:
    from pcwlad_geo.registration.editing import Editor

Folder = Annotated[Path, o.argument("REGISTRATION", "Output folder of an earlier pcwlad-geo register.")]
WarpRasters = Annotated[
    list[str], o.argument("FILE...", "Bands of its target, of any pixel size, and vectors drawn on it.")
]
WarpGrid = Annotated[
    OutputGrid | None, o.option("--grid", help="Output grid; the registration's by default.")
]
WarpFormat = Annotated[
    str | None,
    o.option("--of", help="Format, a GDAL driver; the registration's by default.", metavar="DRIVER"),
]
WarpResampling = Annotated[
    Resampling | None, o.option("--resampling", help="Resampling; the registration's by default.")
]
Place = Annotated[
    Path | None,
    o.option("-o", "--out-dir", help="Output folder.  [default: the working folder]", metavar="OUT_DIR"),
]
WarpedRaster = Annotated[
    Path | None,
    o.option("--output-raster", help="The warped raster, of one RASTER, here instead.", metavar="FILE"),
]
Inverse = Annotated[
    bool, o.option("--inverse", help="Move vectors from where they belong to where the target draws them.")
]
OverwriteRasters = Annotated[bool, o.option("--overwrite", help="Replace files that exist.")]


@o.takes_settings("warp")
def warp(
    context: typer.Context,
    registration: Folder,
    rasters: WarpRasters,
    out_dir: Place = None,
    grid: WarpGrid = None,
    of: WarpFormat = None,
    resampling: WarpResampling = None,
    progress: o.ProgressOption = "auto",
    watch_stdin: o.WatchStdin = False,
    inverse: Inverse = False,
    overwrite: OverwriteRasters = False,
    output_raster: WarpedRaster = None,
    debug: o.Debug = False,
) -> None:
    """Apply the correction of REGISTRATION to other bands of its target, and to vectors drawn on it."""
    given = {
        name: context.params[name] for name in ("grid", "like", "tr", "te", "t_srs", "of", "co", "resampling")
    }
    given |= {name: bool(context.params[name]) for name in ("allow_remote", "trust_vrt")}

    def work(on_event: EventCallback) -> Ending:
        from pcwlad_geo import band_warping  # slow to load

        places: dict[str, Any] = {"out_dir": out_dir, "output_raster": output_raster, "overwrite": overwrite}
        places["inverse"] = inverse
        written = band_warping.warp(registration, rasters, **places, **given, on_event=on_event)
        paths = [str(path.absolute()) for path in written]
        return Ending({"status": "warped", "paths": paths}, visible("".join(f"{path}\n" for path in written)))

    def abandon() -> None:
        from pcwlad_geo.outputs import folder

        folder.abandon(output_raster.parent if output_raster else out_dir or ".")

    run_guarded(context.params, work, abandon)


QUICK: Final = ("shift", "affine", "projective", "polynomial2", "tps")
"""Models that are fitted besides the one asked for, while no request waits."""
NOT_TAKEN: Final = ("allow_remote", "trust_vrt", "scheduler", "jobs", "tie_points", "require")
"""Settings of the registration that do not hold here: the first two are yours alone to give."""

SHOWN: Final = 300
"""Largest length of what an answer repeats of a request."""

Tell = Callable[[str, Mapping[str, object]], None]


@o.takes_settings("edit")
def edit(context: typer.Context, registration: Folder, progress: o.ProgressOption = "json") -> None:
    """Answer a program that edits the tie points of REGISTRATION (JSON lines; see the documentation)."""
    with protocol_stream() as stream:

        def tell(event: str, values: Mapping[str, object]) -> None:
            stream.write(json.dumps(plain({"event": event, **values}), allow_nan=False) + "\n")
            stream.flush()

        trust = {name: bool(context.params[name]) for name in ("allow_remote", "trust_vrt")}
        try:
            editor, model = _open(registration, trust)
        except PcwladGeoError as error:
            tell("error", {"message": str(error), "exit_status": error.exit_status})
            raise typer.Exit(error.exit_status) from error
        ready = {"points": len(editor.table), "off": editor.off, "model": model, "models": list(QUICK)}
        tell("ready", ready)
        _serve(editor, tell)


def _open(folder: Path, trust: Mapping[str, bool]) -> tuple[Editor, str]:
    from pcwlad_geo.raster.bands import Bands
    from pcwlad_geo.registration import prepare_pair
    from pcwlad_geo.registration.editing import Editor
    from pcwlad_geo.report.finished import read_report

    report = read_report(folder)
    if report.get("status") != "registered":
        raise InputError(f"{folder} holds no finished registration: give the output folder of register")
    try:
        given = {
            name: to_setting(name, value)
            for name, value in report["settings"].items()
            if name not in NOT_TAKEN and value is not None
        }
        for name in ("ref_band", "tgt_band"):  # a product's bands are its files here
            given[name] = given[name] if Bands.of_file("", str(given[name])) else 1
        settings = Settings.from_options({**given, **trust})
        reference, target = (os.fspath(report[which]["path"]) for which in ("reference", "target"))
        model = str(report["model"]["name"])
    except (KeyError, TypeError, ValueError, AttributeError, SettingsError) as error:
        raise InputError(
            f"{folder} has a damaged report.json ({type(error).__name__}: {error}): register the pair again"
        ) from error
    return Editor(prepare_pair(reference, target, settings), folder / "tiepoints.csv"), model


def _serve(editor: Editor, tell: Tell) -> None:
    """Answer requests until standard input ends; the newest fit counts, others that wait are left out."""
    waiting: queue.Queue[dict[str, Any] | None] = queue.Queue()
    if isinstance(sys.stdin, io.TextIOWrapper):  # a line that is no UTF-8 is a wrong request like any other
        sys.stdin.reconfigure(encoding="utf-8", errors="replace")

    def read() -> None:
        try:
            for line in sys.stdin:
                waiting.put(_parsed(line))
        finally:
            waiting.put(None)

    threading.Thread(target=read, daemon=True).start()
    while (request := waiting.get()) is not None:
        if request.get("do") == "fit" and _asks_to_fit(waiting):
            continue
        try:
            _answer(editor, request, tell, waiting)
        except Exception as error:  # of any kind: the program that asks is told, and may go on asking
            known = isinstance(error, PcwladGeoError | ValueError | OSError)
            message = str(error) if known else f"the request cannot be used ({type(error).__name__}: {error})"
            tell("failed", {"number": request.get("number"), "message": message})


def _asks_to_fit(waiting: queue.Queue[dict[str, Any] | None]) -> bool:
    """Return whether the next request that waits is a fit, which makes one before it pointless."""
    with waiting.mutex:
        following = waiting.queue[0] if waiting.queue else None
    return following is not None and following.get("do") == "fit"


def _parsed(line: str) -> dict[str, Any]:
    try:
        request = parse_json(line)
    except ValueError:
        request = None
    if not isinstance(request, dict):
        return {"do": line.strip()[:SHOWN]}
    # what an answer repeats of a request is short and of one value
    plain = isinstance(request.get("number"), int | float | str) and len(str(request["number"])) <= SHOWN
    return request if plain else {**request, "number": None}


def _answer(
    editor: Editor, request: dict[str, Any], tell: Tell, waiting: queue.Queue[dict[str, Any] | None]
) -> None:
    from pcwlad_geo.tiepoints.table import columns_of

    what, number = request.get("do"), request.get("number")
    off, gone = ({int(index) for index in request.get(name, ())} for name in ("off", "gone"))
    named = off | gone
    if named and not 0 <= min(named) <= max(named) < len(editor.table):
        raise ValueError(f"points are numbered from 0 to {len(editor.table) - 1}: name no others")
    if what == "fit":
        trial = editor.try_model(str(request["model"]), named)
        found = {
            "model": trial.model,
            "rmse_px": trial.rmse_px,
            "points": trial.points,
            "checked": trial.checked,
        }
        tell("fit", {"number": number, **found, "residual_px": trial.residual_px.round(6).tolist()})
        for model in (each for each in QUICK if each != trial.model):
            if not waiting.empty():
                return
            _tell_model(editor, model, named, number, tell)
    elif what == "add":
        places = tuple(request["reference_xy"]), tuple(request["target_xy"])
        most_px = editor.parameters.radius_px
        radius_px = min(float(request.get("radius_px", most_px)), most_px)
        refined = editor.add(*places, radius_px, gone)
        point = {name: values[-1].item() for name, values in columns_of(editor.table).items()}
        tell("added", {"number": number, "refined": refined, "point": point})
    elif what == "save":
        _save(editor, Path(request["path"]), off, gone)
        tell("saved", {"number": number, "path": request["path"]})
    else:
        raise ValueError(f"unknown request {str(what)[:SHOWN]!r}: give fit, add or save")


def _save(editor: Editor, place: Path, off: set[int], gone: set[int]) -> None:
    """Write the points, whole or not at all, and never over what was read."""
    from pcwlad_geo.outputs.folder import place_file, stage_inside
    from pcwlad_geo.outputs.places import check_outputs

    check_outputs([place], editor.files)
    with stage_inside(place.parent) as stage:
        editor.save(stage / place.name, off, gone)
        place_file(stage / place.name, place, overwrite=True)


def _tell_model(editor: Editor, model: str, off: set[int], number: object, tell: Tell) -> None:
    """Tell how well another model fits; nothing where the points do not determine it."""
    try:
        trial = editor.compare(model, off)
    except InputError as error:
        tell("model", {"number": number, "model": model, "rmse_px": None, "message": str(error)})
        return
    tell("model", {"number": number, "model": model, "rmse_px": trial.rmse_px})
