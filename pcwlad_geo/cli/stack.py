"""``pcwlad-geo stack``: many images of one ground, adjusted together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.job import Ending, run_guarded
from pcwlad_geo.cli.options import collect
from pcwlad_geo.cli.outcome import columns
from pcwlad_geo.errors import InputError, RegistrationRejectedError, RequirementError, SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import BAND_NAME, Settings
from pcwlad_geo.text import visible

if TYPE_CHECKING:
    from pcwlad_geo.stacks.result import Stack, StackImage

HEADER = ("image", "quality", "shift px", "sigma px", "sigma m", "pairs")
"""Header of the table of images."""

Images = Annotated[
    list[str],
    typer.Argument(
        metavar="IMAGE…",
        help="Rasters, products or STAC items; a folder of rasters; a table (CSV) with a column image. "
        "With --add: the output folder of the stack.",
        show_default=False,
    ),
]
Band = Annotated[
    str, typer.Option("--band", metavar="BAND", help="Band that is matched: a number, or a product's name.")
]
ReferenceName = Annotated[
    str | None,
    typer.Option(
        "--reference",
        metavar="NAME|FILE",
        help="Image whose grid all get; of images with RPCs, what fixes them.  [default: the first]",
        show_default=False,
    ),
]
Datum = Annotated[
    Literal["reference", "mean"],
    typer.Option("--datum", help="What stays: the reference, or the mean position of all images."),
]
Add = Annotated[
    list[str] | None,
    typer.Option(
        "--add",
        metavar="IMAGE",
        help="Add this image to the finished stack named in place of images; repeatable.",
        show_default=False,
    ),
]
Pairs = Annotated[
    Path | None,
    typer.Option(
        "--pairs",
        metavar="FILE",
        help="Match the pairs of this table (CSV: reference, target) instead of choosing them.",
        show_default=False,
    ),
]
Gcps = Annotated[
    Path | None,
    typer.Option(
        "--gcps",
        metavar="FILE",
        help="Control points as the datum (CSV: image, col, row, x, y, sigma; z for images with RPCs).",
        show_default=False,
    ),
]
AllowComponents = Annotated[
    bool,
    typer.Option("--allow-components", help="Give groups of images that no pair connects a datum each."),
]
MaxPairs = Annotated[
    int | None,
    typer.Option("--max-pairs", metavar="N", min=1, help="Most pairs that are matched.", show_default=False),
]


@o.takes_settings("stack")
def stack(
    context: typer.Context,
    images: Images,
    out_dir: o.OutDir = None,
    band: Band = "1",
    reference: ReferenceName = None,
    datum: Datum = "reference",
    add: Add = None,
    pairs: Pairs = None,
    max_pairs: MaxPairs = None,
    gcps: Gcps = None,
    allow_components: AllowComponents = False,
) -> None:
    """Bring many images of one ground into one frame, all together; pairs matched before are kept."""
    params = context.params
    run_guarded(params, lambda on_event: _work(params, on_event), lambda: _abandon(params))


def _work(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    settings = collect(params, params["config"])
    Settings.from_options(settings)  # an invalid value is reported before the large libraries are loaded:
    if params["add"]:
        return _added(params, settings, on_event)
    from pcwlad_geo.stacks.run import stack

    found = stack(
        params["images"],
        out_dir=params["out_dir"],
        band=_band(params["band"]),
        on_event=on_event,
        **{name: params[name] for name in OWN},
        **settings,
    )
    return _ending(found)


OWN = ("reference", "datum", "pairs", "max_pairs", "gcps", "allow_components", "overwrite")
"""Options of the command's own that the API has under the same names."""
NOT_WITH_ADD = ("reference", "pairs", "max_pairs", "gcps", "allow_components", "overwrite", "out_dir")
"""Options that a stack has had before an image is added to it."""


def _added(params: Mapping[str, Any], settings: dict[str, Any], on_event: EventCallback) -> Ending:
    """Add images to a finished stack."""
    if len(params["images"]) != 1:
        raise SettingsError(
            f"--add takes one folder of a finished stack, and {len(params['images'])} are named: "
            "pcwlad-geo stack --add IMAGE OUT_DIR"
        )
    for name in NOT_WITH_ADD:
        if params[name]:
            option = name.replace("_", "-")
            raise SettingsError(f"--{option} is a matter of the whole stack: leave it out with --add")
    from pcwlad_geo.stacks.run import stack_add

    return _ending(stack_add(params["add"], params["images"][0], on_event=on_event, **settings))


def _band(text: str) -> int | str:
    if text.isdecimal():
        return int(text)
    if not BAND_NAME.match(text):
        raise SettingsError(f"--band {text}: give a number from 1, or the name of a product's band")
    return text


def _abandon(params: Mapping[str, Any]) -> None:
    from pcwlad_geo.outputs.folder import abandon

    folder = params["images"][0] if params["add"] else params["out_dir"] or "stack"
    abandon(folder)
    pairs = Path(folder) / "pairs"
    for folder in pairs.iterdir() if pairs.is_dir() else ():
        abandon(folder)


def _ending(found: Stack) -> Ending:
    from pcwlad_geo.stacks.result import NUMBERS, PAGE, TABLE  # slow to load, unless there is a result

    counts = {status: sum(pair.status == status for pair in found.pairs) for status in _STATUSES}
    status = InputError.exit_status if found.unreadable else 0
    if any(image.refused for image in found.images):
        status = RegistrationRejectedError.exit_status
    if found.passed is False:
        status = RequirementError.exit_status
    paths = {
        "numbers": found.out_dir / NUMBERS,
        "table": found.out_dir / TABLE,
        "report": found.out_dir / PAGE,
    }
    figures: dict[str, object] = {
        "images": len(found.images),
        "quality": asdict(found.quality),
        "refused": [image.name for image in found.images if image.refused],
        "pairs": counts,
        "unreadable": list(found.unreadable),
        "closure_px": found.closure.after_px,
        "passed": found.passed,
        "shared": found.shared,
        "exit_status": status,
        "paths": {kind: str(path.absolute()) for kind, path in paths.items()},
    }
    lines = columns([HEADER, *(_row(image) for image in found.images)], (0, 1))
    lines += ["", f"quality: {'; '.join([found.quality.grade, *found.quality.reasons[:1]])}"]
    lines += ["pairs: " + ", ".join(f"{count} {each}" for each, count in counts.items() if count)]
    lines += [f"left out: {pair.reference} - {pair.target}: {pair.reason}" for pair in found.left_out]
    lines += [each.text for each in found.requirements]
    lines.append(f"report: {found.out_dir / PAGE}")
    return Ending(figures, visible("\n".join(lines)) + "\n", status)


_STATUSES = ("used", "left out", "refused")
"""Of the pairs, as the last line counts them."""


def _row(image: StackImage) -> tuple[str, ...]:
    metres = "" if image.sigma_m is None else f"{image.sigma_m[0]:.3f} {image.sigma_m[1]:.3f}"
    return (
        image.name,
        image.quality.grade,
        f"{image.shift_px[0]:+.3f} {image.shift_px[1]:+.3f}",
        f"{image.sigma_px[0]:.3f} {image.sigma_px[1]:.3f}",
        metres,
        str(image.pairs),
    )
