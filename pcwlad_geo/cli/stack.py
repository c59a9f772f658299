"""``pcwlad-geo stack``: many images of one ground, adjusted together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.job import Ending, run_guarded
from pcwlad_geo.cli.options import collect
from pcwlad_geo.cli.outcome import columns
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import BAND_NAME, Settings
from pcwlad_geo.text import visible

if TYPE_CHECKING:
    from pcwlad_geo.stacks.result import Stack, StackImage

HEADER = ("image", "shift px", "sigma px", "sigma m", "pairs")
"""Header of the table of images."""

Images = Annotated[
    list[str],
    typer.Argument(
        metavar="IMAGE…",
        help="Rasters or products; a folder of rasters; a table (CSV) with a column image.",
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
        metavar="NAME",
        help="Image whose grid all get.  [default: the first]",
        show_default=False,
    ),
]
Datum = Annotated[
    Literal["reference", "mean"],
    typer.Option("--datum", help="What stays: the reference, or the mean position of all images."),
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
    max_pairs: MaxPairs = None,
    progress: o.ProgressOption = "auto",
    watch_stdin: o.WatchStdin = False,
    config: o.Config = None,
    overwrite: o.Overwrite = False,
    debug: o.Debug = False,
) -> None:
    """Bring many images of one ground into one frame, all together; pairs matched before are kept."""
    params = context.params
    run_guarded(params, lambda on_event: _work(params, on_event), lambda: _abandon(params))


def _work(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    settings = collect(params, params["config"])
    Settings.from_options(settings)  # an invalid value is reported before the large libraries are loaded:
    from pcwlad_geo.stacks.run import stack

    found = stack(
        params["images"],
        out_dir=params["out_dir"],
        band=_band(params["band"]),
        reference=params["reference"],
        datum=params["datum"],
        max_pairs=params["max_pairs"],
        overwrite=params["overwrite"],
        on_event=on_event,
        **settings,
    )
    return _ending(found)


def _band(text: str) -> int | str:
    if text.isdecimal():
        return int(text)
    if not BAND_NAME.match(text):
        raise SettingsError(f"--band {text}: give a number from 1, or the name of a product's band")
    return text


def _abandon(params: Mapping[str, Any]) -> None:
    from pcwlad_geo.outputs.folder import abandon

    pairs = Path(params["out_dir"] or "stack") / "pairs"
    for folder in pairs.iterdir() if pairs.is_dir() else ():
        abandon(folder)


def _ending(found: Stack) -> Ending:
    from pcwlad_geo.stacks.result import NUMBERS, PAGE, TABLE  # slow to load, unless there is a result

    counts = {status: sum(pair.status == status for pair in found.pairs) for status in _STATUSES}
    status = InputError.exit_status if found.unreadable else 0
    paths = {
        "numbers": found.out_dir / NUMBERS,
        "table": found.out_dir / TABLE,
        "report": found.out_dir / PAGE,
    }
    figures: dict[str, object] = {
        "images": len(found.images),
        "pairs": counts,
        "unreadable": list(found.unreadable),
        "shared": found.shared,
        "exit_status": status,
        "paths": {kind: str(path.absolute()) for kind, path in paths.items()},
    }
    lines = columns([HEADER, *(_row(image) for image in found.images)], (0,))
    lines += ["", "pairs: " + ", ".join(f"{count} {each}" for each, count in counts.items() if count)]
    lines += [f"left out: {pair.reference} - {pair.target}: {pair.reason}" for pair in found.left_out]
    lines.append(f"report: {found.out_dir / PAGE}")
    return Ending(figures, visible("\n".join(lines)) + "\n", status)


_STATUSES = ("used", "left out", "refused")
"""Of the pairs, as the last line counts them."""


def _row(image: StackImage) -> tuple[str, ...]:
    metres = "" if image.sigma_m is None else f"{image.sigma_m[0]:.3f} {image.sigma_m[1]:.3f}"
    return (
        image.name,
        f"{image.shift_px[0]:+.3f} {image.shift_px[1]:+.3f}",
        f"{image.sigma_px[0]:.3f} {image.sigma_px[1]:.3f}",
        metres,
        str(image.pairs),
    )
