"""``pcwlad-geo rig``: learn a camera with several lenses, and bring its captures into one frame each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.batch import STATUS_OF
from pcwlad_geo.cli.options import collect
from pcwlad_geo.cli.running import Ending, run_guarded
from pcwlad_geo.cli.sections import Command
from pcwlad_geo.cli.tables import columns
from pcwlad_geo.errors import OutputError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import Settings
from pcwlad_geo.text import visible

if TYPE_CHECKING:
    from pcwlad_geo.rigs.applying_run import RigApplied
    from pcwlad_geo.rigs.rig import Rig

rig = typer.Typer(
    help="Bring the lenses of a camera onto each other: learn the rig, apply it to captures.",
    no_args_is_help=True,
    epilog=o.examples("rig learn captures/ -o RIG.json", "rig apply RIG.json captures/ -o aligned"),
)

Captures = Annotated[list[str], o.argument("CAPTURES…", "Raw frames of the camera, or folders of them.")]
RigFile = Annotated[Path, o.argument("RIG.json", "What rig learn has written.")]
Out = Annotated[
    Path | None, o.option("-o", "--out", help="File to write.  [default: RIG.json]", metavar="RIG.json")
]
Pattern = Annotated[
    str | None,
    o.option(
        "--pattern",
        help="What file names without ending look like, with (?P<capture>…) and (?P<lens>…), where neither "
        "XMP nor usual names tell what belongs together.",
        metavar="REGEX",
    ),
]
Fisheye = Annotated[
    bool, o.option("--fisheye", help="Lenses without a calibration in their frames are fisheyes.")
]
Split = Annotated[
    bool,
    o.option(
        "--split",
        help="Write one file per lens, with the name, EXIF and XMP of the raw frame and a calibration "
        "without distortion, instead of one raster per capture.",
    ),
]
For = Annotated[
    Literal["odm", "metashape", "pix4d"] | None,
    o.option(
        "--for", help="Lay these files out for a program, and print how it takes them.  [implies --split]"
    ),
]
LENS_COLUMNS = ("lens", "focal px", "moved px", "sigma px", "calibration off px")
"""Header of the table of lenses."""


@rig.command(
    "learn",
    cls=Command,
    short_help="Learn the lenses from a few captures in flight.",
    epilog=o.examples("rig learn captures/ -o RIG.json"),
)
@o.takes_settings("rig")
def learn(
    context: typer.Context,
    captures: Captures,
    out: Out = None,
    pattern: Pattern = None,
    fisheye: Fisheye = False,
) -> None:
    """Learn distortion, orientation and parallax of all lenses from a few CAPTURES in flight."""
    run_guarded(context.params, lambda on_event: _learn(context.params, on_event), lambda: None)


@rig.command(
    "apply",
    cls=Command,
    short_help="Make one raster of each capture, its bands on each other.",
    epilog=o.examples("rig apply RIG.json captures/ -o aligned"),
)
@o.takes_settings("rig")
def apply(
    context: typer.Context,
    rig_file: RigFile,
    captures: Captures,
    out_dir: o.OutDir = None,
    pattern: Pattern = None,
    split: Split = False,
    program: For = None,
) -> None:
    """Write one raster per capture, its bands on each other; bad CAPTURES are named."""
    run_guarded(context.params, lambda on_event: _apply(context.params, on_event), lambda: None)


def _running(params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options about where the work runs, and what may be opened."""
    settings = Settings.from_options(collect(params, params["config"]))
    return {name: getattr(settings, name) for name in ("jobs", "scheduler", "allow_remote", "trust_vrt")}


def _learn(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    running = _running(params)
    from pcwlad_geo.rigs.learning_run import rig_learn

    out = params["out"] or Path("RIG.json")
    if out.is_dir():
        raise OutputError(f"{out} is a folder: name the file to write, such as {out / 'RIG.json'}")
    rig = rig_learn(
        params["captures"],
        out=out,
        pattern=params["pattern"],
        fisheye=params["fisheye"],
        overwrite=params["overwrite"],
        on_event=on_event,
        **running,
    )
    return _learned(rig, out)


def _learned(rig: Rig, out: Path) -> Ending:
    rows, lenses = [LENS_COLUMNS], []
    for lens in rig.lenses:
        off = lens.off_by_px()
        offset_px = rig.offset_px(lens)
        rows.append(
            (
                lens.name,
                f"{lens.lens.focal_px:.1f}",
                f"{offset_px[0]:+.1f} {offset_px[1]:+.1f}",
                f"{lens.mapping_sigma_px[0]:.3f}",
                "none" if off is None else f"{off[0]:.2f} (at most {off[1]:.2f})",
            )
        )
        lenses.append({"name": lens.name, "calibration_difference_px": None if off is None else list(off)})
    lines = columns(rows, (0,))
    lines += [
        "",
        f"{rig.captures} captures, {rig.points} tie points, residual {rig.residual_px:.3f} px",
        f"quality: {rig.quality}, 90 % of the frame within {rig.expected_ce90_px or math.nan:.2f} px",
        f"rig: {out}",
    ]
    names = ("captures", "points", "residual_px", "quality", "expected_ce90_px")
    figures: dict[str, object] = {
        **{name: getattr(rig, name) for name in names},
        "lenses": lenses,
        "paths": {"rig": str(out.absolute())},
    }
    return Ending(figures, visible("\n".join(lines)) + "\n")


def _apply(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    running = _running(params)
    from pcwlad_geo.rigs.applying_run import rig_apply

    applied = rig_apply(
        params["rig_file"],
        params["captures"],
        out_dir=params["out_dir"] or "rig_applied",
        pattern=params["pattern"],
        split=params["split"],
        program=params["program"],
        overwrite=params["overwrite"],
        on_event=on_event,
        **running,
    )
    return _applied(applied)


def _applied(applied: RigApplied) -> Ending:
    from pcwlad_geo.registration import GRADES

    counts = {status: applied.count(status) for status in ("corrected", "rejected", "unusable", "failed")}
    status = next((STATUS_OF[name] for name in STATUS_OF if counts.get(name)), 0)
    grades = {grade: applied.count(grade) for grade in reversed(GRADES)}
    bad = [capture for capture in applied.captures if capture.status != "corrected"]
    lines = [", ".join(f"{count} {name}" for name, count in (counts | grades).items() if count)]
    lines.append(f"summary: {applied.summary.absolute()}")
    if applied.next_step is not None:
        lines.append(f"next: {applied.next_step}")
    figures: dict[str, object] = {
        **counts,
        "quality": grades,
        "bad": [
            {"capture": capture.name, "status": capture.status, "reason": capture.reason} for capture in bad
        ],
        "next_step": applied.next_step,
        "paths": {"summary": str(applied.summary.absolute())},
    }
    return Ending(figures, visible("\n".join(lines)) + "\n", status)
