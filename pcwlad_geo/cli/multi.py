"""``pcwlad-geo batch``, ``stack`` and ``watch``: many pairs, many images of one ground, these over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.job import UNEXPECTED, Ending, columns, run_guarded, show_traceback, table
from pcwlad_geo.cli.options import collect
from pcwlad_geo.errors import InputError, RegistrationRejectedError, RequirementError, SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import Settings, to_setting
from pcwlad_geo.text import visible

if TYPE_CHECKING:
    from pcwlad_geo.multi.batch.run import BatchResult
    from pcwlad_geo.multi.stack.result import Stack, StackImage
    from pcwlad_geo.multi.watch.numbers import WatchNumbers

STATUS_OF = {
    "failed": UNEXPECTED,
    "unusable": InputError.exit_status,
    "rejected": RegistrationRejectedError.exit_status,
    "not_passed": RequirementError.exit_status,
}
"""Exit status by status of a pair; the first one that any pair has applies."""

WORDS = {"not_passed": "of them against a requirement"}
"""Texts for statuses in the printed result that differ from their names."""

PairTable = Annotated[
    Path,
    o.argument(
        "PAIRS.csv", "Table, a line a pair: columns reference, target, out_dir and any option of register."
    ),
]


@o.takes_settings("batch")
def batch(context: typer.Context, pairs: PairTable, out_dir: o.OutDir = None) -> None:
    """Register the pairs of a table; pairs that an earlier run has finished are kept."""
    params = context.params
    folders: list[Path] = []  # output folders of the pairs, needed if the run is ended by force
    run_guarded(params, lambda on_event: _batch(params, folders, on_event), lambda: _abandon_pairs(folders))


def _batch(params: Mapping[str, Any], folders: list[Path], on_event: EventCallback) -> Ending:
    settings = collect(params, params["config"])
    Settings.from_options(settings)  # an invalid value is reported before the large libraries are loaded:
    from pcwlad_geo.multi.batch.run import batch, batch_folder
    from pcwlad_geo.multi.batch.table import read_pairs

    table_of_pairs, out_dir = params["pairs"], batch_folder(params["pairs"], params["out_dir"])
    folders += [pair.out_dir for pair in read_pairs(table_of_pairs, out_dir, settings)]
    result = batch(
        table_of_pairs, out_dir=out_dir, overwrite=params["overwrite"], on_event=on_event, **settings
    )
    if params["debug"]:
        for outcome in result.pairs:
            if outcome.error is not None:
                show_traceback(outcome.error)
    return _batch_ending(result)


def _abandon_pairs(folders: Sequence[Path]) -> None:
    from pcwlad_geo.outputs.folder import abandon

    for folder in folders:
        abandon(folder)


def _batch_ending(result: BatchResult) -> Ending:
    rows = [outcome.row() for outcome in result.pairs]
    counts = {status: result.count(status) for status in ("registered", "rejected", "unusable", "failed")}
    counts["not_passed"] = sum(outcome.passed is False for outcome in result.pairs)
    summary = result.summary.absolute()
    status = next((STATUS_OF[each] for each in STATUS_OF if counts[each]), 0)
    figures = {**counts, "pairs": rows, "paths": {"summary": str(summary)}}
    counted = ", ".join(f"{count} {WORDS.get(each, each)}" for each, count in counts.items() if count)
    return Ending(figures, f"{table(rows)}\n{visible(counted)}\nsummary: {visible(str(summary))}\n", status)


HEADER = ("image", "quality", "shift px", "sigma px", "sigma m", "pairs")
"""Header of the table of images."""

ImageArguments = Annotated[
    list[str],
    o.argument(
        "IMAGE…",
        "Rasters, products or STAC items; a folder of rasters; a table (CSV) with a column image. "
        "With --add: the output folder of the stack.",
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
        help="Image whose grid all get; with RPCs, what ties them to the ground.  [default: the first]",
        metavar="NAME|FILE",
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
    images: ImageArguments,
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
    params = context.params
    folder = images[0] if add else out_dir
    run_guarded(params, lambda on_event: _stack(params, on_event), lambda: _abandon_stack(folder))


def _stack(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    settings = collect(params, params["config"])
    Settings.from_options(settings)  # an invalid value is reported before the large libraries are loaded:
    if params["add"]:
        return _added(params, settings, on_event)
    from pcwlad_geo.multi.stack.run import stack

    found = stack(
        params["images"],
        out_dir=params["out_dir"],
        band=cast(int | str, to_setting("ref_band", params["band"])),
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
    from pcwlad_geo.multi.stack.adding import stack_add

    return _ending(stack_add(params["add"], params["images"][0], on_event=on_event, **settings))


def _abandon_stack(out_dir: str | Path | None) -> None:
    """Remove partly written files of a stack and of its pairs."""
    from pcwlad_geo.outputs.folder import abandon

    folder = Path(out_dir or "stack")
    pairs = folder / "pairs"
    for each in (folder, *(pairs.iterdir() if pairs.is_dir() else ())):
        abandon(each)


def _ending(found: Stack) -> Ending:
    from pcwlad_geo.multi.stack.numbers import NUMBERS, PAGE, TABLE  # slow to load, unless there is a result
    from pcwlad_geo.multi.stack.pair import PairStatus

    counts = {status: sum(pair.status == status for pair in found.pairs) for status in get_args(PairStatus)}
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
        "paths": {kind: str(path.absolute()) for kind, path in paths.items()},
    }
    lines = columns([HEADER, *(_row(image) for image in found.images)], (0, 1))
    lines += ["", f"quality: {'; '.join([found.quality.grade, *found.quality.reasons[:1]])}"]
    lines += ["pairs: " + ", ".join(f"{count} {each}" for each, count in counts.items() if count)]
    lines += [f"left out: {pair.reference} - {pair.target}: {pair.reason}" for pair in found.left_out]
    lines += [each.text for each in found.requirements]
    lines.append(f"report: {found.out_dir / PAGE}")
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


StackFolder = Annotated[Path, o.argument("STACK", "Output folder of an earlier pcwlad-geo stack.")]
AddFirst = Annotated[
    list[str] | None,
    o.option("--add", help="Add this image to the stack first; repeatable.", metavar="IMAGE"),
]
Apply = Annotated[
    bool, o.option("--apply", help="Write the images that the stack has not written, on its grid.")
]
WatchRequire = Annotated[
    list[str] | None,
    o.option(
        "--require",
        help="Limit, such as 'step<0.2px' or 'latest<1px'; exit status 4 where it is not met; repeatable. "
        "Statistics: step, drift, season, latest (how far the last image lies off its series), offset, "
        "motion; units: px, m (drift and motion: a year).",
        metavar="LIMIT",
    ),
]


@o.takes_settings("watch")
def watch(
    context: typer.Context,
    stack: StackFolder,
    out_dir: o.OutDir = None,
    add: AddFirst = None,
    apply: Apply = False,
    require: WatchRequire = None,
) -> None:
    """Find steps, drifts and moving ground in a finished stack."""
    params = context.params
    run_guarded(params, lambda on_event: _watch(params, on_event), lambda: _abandon_watch(params))


def _watch(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    settings = collect(params, params["config"])
    requirements = settings.pop("require", None) or ()
    Settings.from_options(settings)  # an invalid value is reported before the large libraries are loaded:
    from pcwlad_geo.multi.watch.page import NAMES
    from pcwlad_geo.multi.watch.run import watch, watch_folder
    from pcwlad_geo.outputs.folder import check_output_folder
    from pcwlad_geo.requirements import parse_requirements

    parse_requirements(requirements, "watch")
    status = 0
    if params["add"]:  # after what can be checked, as it takes its time and changes the stack
        from pcwlad_geo.multi.stack.adding import stack_add

        folder = watch_folder(params["stack"], params["out_dir"])
        check_output_folder(folder, params["overwrite"], NAMES["numbers"])
        added = _ending(stack_add(params["add"], params["stack"], on_event=on_event, **settings))
        status = 0 if added.exit_status == RequirementError.exit_status else added.exit_status
    return _watch_ending(
        watch(
            params["stack"],
            out_dir=params["out_dir"],
            require=requirements,
            apply=params["apply"],
            overwrite=params["overwrite"],
            on_event=on_event,
            **{name: bool(settings.get(name)) for name in ("allow_remote", "trust_vrt")},
        ),
        params,
        status,
    )


def _watch_ending(found: WatchNumbers, params: Mapping[str, Any], added: int) -> Ending:
    """Return the ending; its status is that of the image `added` where the requirements are met."""
    from pcwlad_geo.multi.watch.page import NAMES, findings
    from pcwlad_geo.multi.watch.run import watch_folder

    folder = watch_folder(params["stack"], params["out_dir"])
    status = RequirementError.exit_status if found.passed is False else added
    figures: dict[str, object] = {
        "series": len(found.series),
        "steps": sum(len(series.steps) for series in found.series),
        "moving": len(found.motion.regions) if found.motion else None,
        "corrected": found.corrected and asdict(found.corrected),
        "passed": found.passed,
        "paths": {
            kind: str((folder / name).absolute()) for kind, name in NAMES.items() if name in found.outputs
        },
    }
    rows = [
        (series.name, str(len(series.images)), f"{series.level_px[0]:+.3f} {series.level_px[1]:+.3f}",
         f"{series.level_sigma_px:.3f}", f"{series.noise_px:.3f}", str(len(series.steps)))
        for series in found.series
    ]  # fmt: skip
    lines = columns([("series", "images", "last level px", "sigma px", "noise px", "steps"), *rows], (0,))
    lines += ["", *findings(found)]
    lines += [each.message for each in found.requirements]
    if found.corrected is not None and params["apply"]:
        here, there = len(found.corrected.written), found.corrected.on_grid
        lines.append(f"on the grid of the stack: {there} of its own in {found.stack}, {here} written here")
    lines.append(f"report: {folder / NAMES['report']}")
    return Ending(figures, visible("\n".join(lines)) + "\n", status)


def _abandon_watch(params: Mapping[str, Any]) -> None:
    from pcwlad_geo.multi.watch.run import watch_folder
    from pcwlad_geo.outputs.folder import abandon

    abandon(watch_folder(params["stack"], params["out_dir"]))
    if params["add"]:
        _abandon_stack(params["stack"])
