"""``pcwlad-geo stack``: many images of one ground, adjusted together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.options import checked_options
from pcwlad_geo.cli.running import Ending, run_guarded
from pcwlad_geo.cli.tables import columns
from pcwlad_geo.errors import InputError, RegistrationRejectedError, RequirementError, SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.option_text import to_setting
from pcwlad_geo.text import visible

if TYPE_CHECKING:
    from pcwlad_geo.multi.stack.result import Stack, StackImage


IMAGE_COLUMNS = ("image", "quality", "shift px", "sigma px", "sigma m", "pairs")
"""Header of the table of images."""
ImageArguments = Annotated[
    list[str] | None,
    o.argument(
        "IMAGE…",
        "Rasters, products or STAC items; a folder of rasters; a table (CSV) with a column image; a web map "
        "(with --allow-remote). "
        "With --add: the output folder of the stack.",
    ),
]
Stac = Annotated[
    str | None,
    o.option(
        "--stac",
        help="More images: a file of STAC items, or API/search?collections=…&bbox=…&datetime=… (with "
        "--allow-remote; needs pip install 'pcwlad-geo[stac]').",
        metavar="SEARCH|FILE",
    ),
]
BandOption = Annotated[
    str,
    o.option(
        "--band",
        help="Band to match: a number, or its name in a product.",
        show_default=True,
        metavar="BAND",
    ),
]
ReferenceName = Annotated[
    str | None,
    o.option(
        "--reference",
        help="Image whose grid all get, or a web map; with RPCs, what ties them to the ground.  [default: "
        "the web map, or the first]",
        metavar="NAME|FILE|MAP",
    ),
]
Datum = Annotated[
    Literal["reference", "mean"],
    o.option(
        "--datum", help="What stays: the reference, or the mean position of all images.", show_default=True
    ),
]
Add = Annotated[
    list[str] | None,
    o.option(
        "--add",
        help="Add this image to the finished stack named in place of images; repeatable.",
        metavar="IMAGE",
    ),
]
PairsOption = Annotated[
    Path | None,
    o.option(
        "--pairs",
        help="Match the pairs of this table (CSV: reference, target) instead of choosing them.",
        metavar="FILE",
    ),
]
Gcps = Annotated[
    Path | None,
    o.option(
        "--gcps",
        help="Control points as the datum (CSV: image, col, row, x, y, sigma; z for images with RPCs).",
        metavar="FILE",
    ),
]
AllowComponents = Annotated[
    bool, o.option("--allow-components", help="Give each group of unconnected images its own datum.")
]
MaxPairs = Annotated[int | None, o.option("--max-pairs", help="Pairs to match at most.", metavar="N", min=1)]


@o.takes_settings("stack")
def stack(
    context: typer.Context,
    images: ImageArguments = None,
    stac: Stac = None,
    out_dir: o.OutDir = None,
    band: BandOption = "1",
    reference: ReferenceName = None,
    datum: Datum = "reference",
    add: Add = None,
    pairs: PairsOption = None,
    max_pairs: MaxPairs = None,
    gcps: Gcps = None,
    allow_components: AllowComponents = False,
) -> None:
    """Adjust many images of one ground together, into one frame; pairs matched before are kept."""
    if not images and stac is None:
        raise typer.BadParameter("give images, or --stac", param_hint="IMAGE…")
    params = {**context.params, "images": images or []}
    folder = images[0] if add and images else out_dir
    run_guarded(params, lambda on_event: _stack(params, on_event), lambda: abandon_stack(folder))


def _stack(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    settings = checked_options(params)
    if params["add"]:
        return _added(params, settings, on_event)
    from pcwlad_geo.multi.stack.run import stack

    result = stack(
        params["images"],
        out_dir=params["out_dir"],
        band=cast(int | str, to_setting("ref_band", params["band"])),
        on_event=on_event,
        **{name: params[name] for name in OWN},
        **settings,
    )
    return stack_ending(result)


OWN = ("stac", "reference", "datum", "pairs", "max_pairs", "gcps", "allow_components", "overwrite")
"""Options of the command's own that the API has under the same names."""
NOT_WITH_ADD = ("stac", "reference", "pairs", "max_pairs", "gcps", "allow_components", "overwrite", "out_dir")
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
    from pcwlad_geo.multi.stack.adding import stack_add

    return stack_ending(stack_add(params["add"], params["images"][0], on_event=on_event, **settings))


def abandon_stack(out_dir: str | Path | None) -> None:
    """Remove partly written files of a stack and of its pairs."""
    from pcwlad_geo.outputs.folder import abandon

    folder = Path(out_dir or "stack")
    pairs = folder / "pairs"
    for place in (folder, *(pairs.iterdir() if pairs.is_dir() else ())):
        abandon(place)


def stack_ending(stack: Stack) -> Ending:
    """Return the end of a run that has adjusted a stack."""
    from pcwlad_geo.multi.stack.numbers import (  # slow to load, unless there is a result
        STACK_FILE,
        STACK_PAGE,
        TABLE,
    )
    from pcwlad_geo.multi.stack.pair import PairStatus

    counts = {status: sum(pair.status == status for pair in stack.pairs) for status in get_args(PairStatus)}
    status = InputError.exit_status if stack.unreadable else 0
    if any(image.refused for image in stack.images):
        status = RegistrationRejectedError.exit_status
    if stack.passed is False:
        status = RequirementError.exit_status
    paths = {
        "numbers": stack.out_dir / STACK_FILE,
        "table": stack.out_dir / TABLE,
        "report": stack.out_dir / STACK_PAGE,
    }
    figures: dict[str, object] = {
        "images": len(stack.images),
        "quality": asdict(stack.quality),
        "refused": [image.name for image in stack.images if image.refused],
        "pairs": counts,
        "unreadable": list(stack.unreadable),
        "closure_px": stack.closure.after_px,
        "passed": stack.passed,
        "shared": stack.shared,
        "paths": {kind: str(path.absolute()) for kind, path in paths.items()},
    }
    lines = columns([IMAGE_COLUMNS, *(_row(image) for image in stack.images)], (0, 1))
    lines += ["", f"quality: {'; '.join([stack.quality.grade, *stack.quality.reasons[:1]])}"]
    lines += [
        "pairs: " + ", ".join(f"{count} {status_name}" for status_name, count in counts.items() if count)
    ]
    lines += [f"left out: {pair.reference} - {pair.target}: {pair.reason}" for pair in stack.left_out]
    lines += [requirement.text for requirement in stack.requirements]
    lines.append(f"report: {stack.out_dir / STACK_PAGE}")
    return Ending(figures, visible("\n".join(lines)) + "\n", status)


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
