"""``pcwlad-geo edit``: for programs that let a user change the tie points of a finished registration.

It stays open and answers requests, a JSON object a line on standard input, with events on standard output.
"""

from __future__ import annotations

import io
import json
import queue
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.progress import protocol_stream
from pcwlad_geo.cli.warp import Folder
from pcwlad_geo.errors import InputError, PcwladGeoError, SettingsError
from pcwlad_geo.option_text import to_setting
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Trust, trusting
from pcwlad_geo.text import joined, parse_json, plain, typed

if TYPE_CHECKING:
    from pcwlad_geo.registration.editing import Editor


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

        remote, vrt = (bool(context.params[name]) for name in ("allow_remote", "trust_vrt"))
        with trusting(Trust(remote=remote, vrt=vrt)):
            try:
                editor, model = _open(registration, allow_remote=remote, trust_vrt=vrt)
            except PcwladGeoError as error:
                tell("error", {"message": str(error), "exit_status": error.exit_status})
                raise typer.Exit(error.exit_status) from error
            ready = {"points": len(editor.table), "off": editor.off, "model": model, "models": list(QUICK)}
            tell("ready", ready)
            _serve(editor, tell)


def _open(folder: Path, *, allow_remote: bool = False, trust_vrt: bool = False) -> tuple[Editor, str]:
    from pcwlad_geo.raster import Bands
    from pcwlad_geo.registration import prepare_pair
    from pcwlad_geo.registration.editing import Editor
    from pcwlad_geo.report.finished import ReadReport
    from pcwlad_geo.report.read_figures import read_report

    content = read_report(folder)
    if content.get("status") != "registered":
        raise InputError(f"{folder} holds no finished registration: give the output folder of register")
    try:
        report = typed(content, ReadReport)
        options = {
            name: to_setting(name, value)
            for name, value in report.settings.items()
            if name not in NOT_TAKEN and value is not None
        }
        for name in ("ref_band", "tgt_band"):  # a product's bands are its files here
            options[name] = options[name] if Bands.of_file("", str(options[name])) else 1
        settings = Settings.from_options(options | {"allow_remote": allow_remote, "trust_vrt": trust_vrt})
        model = str((report.model or {})["name"])
    except (KeyError, ValueError, SettingsError) as error:
        message = f"{type(error).__name__}: {joined(error)}"
        raise InputError(
            f"{folder} has a damaged report.json ({message}): register the pair again"
        ) from error
    reference, target = report.reference.path, report.target.path
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
            expected = isinstance(error, PcwladGeoError | ValueError | OSError)
            message = (
                str(error) if expected else f"the request cannot be used ({type(error).__name__}: {error})"
            )
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
    what, number = request.get("do"), request.get("number")
    off, deleted = ({int(index) for index in request.get(name, ())} for name in ("off", "gone"))
    numbered = off | deleted
    if numbered and not 0 <= min(numbered) <= max(numbered) < len(editor.table):
        raise ValueError(f"points are numbered from 0 to {len(editor.table) - 1}: name no others")
    if what == "fit":
        trial = editor.try_model(str(request["model"]), numbered)
        figures = {
            "model": trial.model,
            "rmse_px": trial.rmse_px,
            "points": trial.points,
            "checked": trial.checked,
        }
        tell("fit", {"number": number, **figures, "residual_px": trial.residual_px.round(6).tolist()})
        for model in (name for name in QUICK if name != trial.model):
            if not waiting.empty():
                return
            _tell_model(editor, model, numbered, number, tell)
    elif what == "add":
        names = ("reference_xy", "target_px" if "target_px" in request else "target_xy")
        reference_xy, in_target = (tuple(request[name]) for name in names)
        most_px = editor.parameters.radius_px
        radius_px = min(float(request.get("radius_px", most_px)), most_px)
        by_px = {"target_px": in_target} if names[1] == "target_px" else {}
        refined = editor.add(reference_xy, None if by_px else in_target, radius_px, deleted, **by_px)
        tell("added", {"number": number, "refined": refined, "point": _last(editor)})
    elif what == "improve":
        _improve(editor, request, off, deleted, tell)
    elif what == "save":
        _save(editor, Path(request["path"]), off, deleted)
        tell("saved", {"number": number, "path": request["path"]})
    else:
        raise ValueError(f"unknown request {str(what)[:SHOWN]!r}: give fit, add, improve or save")


def _improve(editor: Editor, request: dict[str, Any], off: set[int], deleted: set[int], tell: Tell) -> None:
    """Refine all points that are on, one after the other, and tell which the others contradict."""
    most_px, replaced = editor.parameters.radius_px, set(deleted)
    radius_px = min(float(request.get("radius_px", most_px)), most_px)
    for row in sorted(set(range(len(editor.table))) - off - deleted):
        refined = editor.improve(row, radius_px, replaced)
        replaced |= {row} if refined else set()
        tell("improved", {"row": row, "point": _last(editor) if refined else None})
    tell("contradicting", {"rows": editor.contradicting(off | replaced)})


def _last(editor: Editor) -> dict[str, object]:
    """Return the point that was added last, as a row of tiepoints.csv."""
    from pcwlad_geo.tiepoints.table import columns_of

    return {name: values[-1].item() for name, values in columns_of(editor.table).items()}


def _save(editor: Editor, place: Path, off: set[int], deleted: set[int]) -> None:
    """Write the points, whole or not at all, and never over what was read."""
    from pcwlad_geo.outputs.folder import place_file, stage_inside
    from pcwlad_geo.outputs.places import check_outputs

    check_outputs([place], editor.files)
    with stage_inside(place.parent) as stage:
        editor.save(stage / place.name, off, deleted)
        place_file(stage / place.name, place, overwrite=True)


def _tell_model(editor: Editor, model: str, off: set[int], number: object, tell: Tell) -> None:
    """Tell how well another model fits; nothing where the points do not determine it."""
    try:
        trial = editor.compare(model, off)
    except InputError as error:
        tell("model", {"number": number, "model": model, "rmse_px": None, "message": str(error)})
        return
    tell("model", {"number": number, "model": model, "rmse_px": trial.rmse_px})
