"""``pcwlad-geo edit``: for programs that let a user change the tie points of a finished registration.

It stays open and answers requests, a JSON object a line on standard input, with events on standard output.
"""

from __future__ import annotations

import io
import json
import math
import queue
import sys
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.progress import protocol_stream
from pcwlad_geo.cli.warp import Folder
from pcwlad_geo.errors import InputError, PcwladGeoError
from pcwlad_geo.options import NOT_IN_TABLES, Settings
from pcwlad_geo.raster import Trust, trusting
from pcwlad_geo.text import joined, parse_json, plain, typed

if TYPE_CHECKING:
    from pcwlad_geo.registration.editing import Editor


QUICK: Final = ("shift", "affine", "projective", "polynomial2", "tps")
"""Models that are fitted besides the one asked for, while no request waits."""
NOT_TAKEN: Final = (*NOT_IN_TABLES, "tie_points", "require")
"""Settings of the registration that do not hold here: what may be opened is yours alone to say."""
SHOWN: Final = 300
"""Largest length of what an answer repeats of a request."""
Place = tuple[float, float]
Tell = Callable[[str, Mapping[str, object]], None]


@dataclass(frozen=True, slots=True)
class Numbered:
    """The number of a request, which its answers repeat."""

    number: int | float | str | None = None

    def __post_init__(self) -> None:
        if len(str(self.number)) > SHOWN:
            raise ValueError("the number of a request is short")


@dataclass(frozen=True, slots=True)
class Request(Numbered):
    """A request. Which of its fields count depends on what it asks for."""

    do: str = ""
    off: frozenset[int] = frozenset()
    """Points that are switched off."""
    gone: frozenset[int] = frozenset()
    """Points that are deleted."""
    model: str = ""
    reference_xy: Place | None = None
    target_xy: Place | None = None
    target_px: Place | None = None
    radius_px: float = math.inf
    path: str = ""


@dataclass(frozen=True, slots=True)
class Unusable(Numbered):
    """A line that is no request."""

    reason: str = ""


Requests = queue.Queue[Request | Unusable | None]
"""Those that wait, and None when no more come."""


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
    from pcwlad_geo.report.finished import ReadReport, read_saved

    place, report = read_saved(folder)
    if not isinstance(report, ReadReport):
        raise InputError(f"{place} is a saved correction: give the output folder of register")
    options: Any = {name: getattr(Settings(), name) for name in NOT_TAKEN}
    for name in ("ref_band", "tgt_band"):  # a product's bands are its files here
        band = getattr(report.settings, name)
        options[name] = band if Bands.of_file("", str(band)) else 1
    options |= {"allow_remote": allow_remote, "trust_vrt": trust_vrt}
    pair = prepare_pair(report.reference.path, report.target.path, replace(report.settings, **options))
    return Editor(pair, place.parent / "tiepoints.csv"), report.model.name


def _serve(editor: Editor, tell: Tell) -> None:
    """Answer requests until standard input ends; the newest fit counts, others that wait are left out."""
    waiting: Requests = queue.Queue()
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
        if _is_fit(request) and _asks_to_fit(waiting):
            continue
        try:
            _answer(editor, request, tell, waiting)
        except Exception as error:  # of any kind: the program that asks is told, and may go on asking
            expected = isinstance(error, PcwladGeoError | ValueError | OSError)
            message = (
                str(error) if expected else f"the request cannot be used ({type(error).__name__}: {error})"
            )
            tell("failed", {"number": request.number, "message": message})


def _is_fit(request: Request | Unusable | None) -> bool:
    return isinstance(request, Request) and request.do == "fit"


def _asks_to_fit(waiting: Requests) -> bool:
    """Return whether the next request that waits is a fit, which makes one before it pointless."""
    with waiting.mutex:
        return bool(waiting.queue) and _is_fit(waiting.queue[0])


def _parsed(line: str) -> Request | Unusable:
    number = None
    try:
        content = parse_json(line)
        number = typed(content, Numbered, written=Numbered).number
        return typed(content, Request, written=Request)
    except ValueError as error:
        return Unusable(number, f"the request cannot be used ({joined(error)[:SHOWN]})")


def _answer(editor: Editor, request: Request | Unusable, tell: Tell, waiting: Requests) -> None:
    if isinstance(request, Unusable):
        raise ValueError(request.reason)
    number, numbered = request.number, request.off | request.gone
    if numbered and not 0 <= min(numbered) <= max(numbered) < len(editor.table):
        raise ValueError(f"points are numbered from 0 to {len(editor.table) - 1}: name no others")
    if request.do == "fit":
        trial = editor.try_model(request.model, numbered)
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
    elif request.do == "add":
        in_target = request.target_px or request.target_xy
        if request.reference_xy is None or in_target is None:
            raise ValueError("a point is added by reference_xy, and by target_px or target_xy: give both")
        refined = editor.add(
            request.reference_xy,
            None if request.target_px else request.target_xy,
            min(request.radius_px, editor.parameters.radius_px),
            request.gone,
            request.target_px,
        )
        tell("added", {"number": number, "refined": refined, "point": _last(editor)})
    elif request.do == "improve":
        _improve(editor, request, tell)
    elif request.do == "save":
        _save(editor, request)
        tell("saved", {"number": number, "path": request.path})
    else:
        raise ValueError(f"unknown request {request.do[:SHOWN]!r}: give fit, add, improve or save")


def _improve(editor: Editor, request: Request, tell: Tell) -> None:
    """Refine all points that are on, one after the other, and tell which the others contradict."""
    off, replaced = request.off, set(request.gone)
    radius_px = min(request.radius_px, editor.parameters.radius_px)
    for row in sorted(set(range(len(editor.table))) - off - request.gone):
        refined = editor.improve(row, radius_px, replaced)
        replaced |= {row} if refined else set()
        tell("improved", {"row": row, "point": _last(editor) if refined else None})
    tell("contradicting", {"rows": editor.contradicting(off | replaced)})


def _last(editor: Editor) -> dict[str, object]:
    """Return the point that was added last, as a row of tiepoints.csv."""
    from pcwlad_geo.tiepoints.table import columns_of

    return {name: values[-1].item() for name, values in columns_of(editor.table).items()}


def _save(editor: Editor, request: Request) -> None:
    """Write the points, whole or not at all, and never over what was read."""
    from pcwlad_geo.outputs.folder import place_file, stage_inside
    from pcwlad_geo.outputs.places import check_outputs

    if not request.path:
        raise ValueError("points are saved to a path: give one")
    place = Path(request.path)
    check_outputs([place], editor.files)
    with stage_inside(place.parent) as stage:
        editor.save(stage / place.name, request.off, request.gone)
        place_file(stage / place.name, place, overwrite=True)


def _tell_model(editor: Editor, model: str, off: Collection[int], number: object, tell: Tell) -> None:
    """Tell how well another model fits; nothing where the points do not determine it."""
    try:
        trial = editor.compare(model, off)
    except InputError as error:
        tell("model", {"number": number, "model": model, "rmse_px": None, "message": str(error)})
        return
    tell("model", {"number": number, "model": model, "rmse_px": trial.rmse_px})
