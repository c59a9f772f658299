"""``pcwlad-geo watch``: a finished stack, or the reports below a folder, over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.options import checked_options
from pcwlad_geo.cli.running import Ending, run_guarded
from pcwlad_geo.cli.stack import abandon_stack, stack_ending
from pcwlad_geo.cli.tables import columns
from pcwlad_geo.errors import RequirementError, SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.text import visible

if TYPE_CHECKING:
    from pcwlad_geo.multi.watch.numbers import WatchNumbers


StackFolder = Annotated[
    Path, o.argument("STACK", "Output folder of an earlier pcwlad-geo stack, or a folder of reports.")
]
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
    """Find what moves in a finished stack, or plot reports over time."""
    params = context.params
    run_guarded(params, lambda on_event: _watch(params, on_event), lambda: _abandon_watch(params))


def look_at_reports(folder: Path, params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    """Plot the figures of the reports below a folder over time."""
    from pcwlad_geo.multi.watch.trend import trend

    result = trend(folder, out_dir=params["out_dir"], overwrite=params["overwrite"], on_event=on_event)
    figures: dict[str, object] = {
        "reports": result.reports,
        "series": len(result.series),
        "paths": {kind: str(path) for kind, path in result.paths.items()},
    }
    text = f"{result.reports} reports, {len(result.series)} series\nreport: {result.paths['report']}\n"
    return Ending(figures, visible(text))


def abandon_reports(folder: Path, params: Mapping[str, Any]) -> None:
    """Remove what an ended look at reports has left."""
    from pcwlad_geo.multi.watch.trend import trend_folder
    from pcwlad_geo.outputs.folder import abandon

    abandon(trend_folder(folder, params["out_dir"]))


def _holds_reports(folder: Path) -> bool:
    """Return whether a folder is that of reports, and of no stack."""
    names = ("report.json", "qa.json")
    return not (folder / "stack.json").exists() and any(next(folder.rglob(name), None) for name in names)


def _watch(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    settings = checked_options(params)
    requirements = settings.pop("require", None) or ()
    if _holds_reports(params["stack"]):
        for name in ("add", "apply", "require"):
            if params[name]:
                raise SettingsError(f"{params['stack']} holds reports and no stack: --{name} is for a stack")
        return look_at_reports(params["stack"], params, on_event)
    from pcwlad_geo.multi.watch.page import WATCH_FILES
    from pcwlad_geo.multi.watch.run import watch, watch_folder
    from pcwlad_geo.outputs.folder import check_output_folder
    from pcwlad_geo.requirements import parse_requirements

    parse_requirements(requirements, "watch")
    status = 0
    if params["add"]:  # after what can be checked, as it takes its time and changes the stack
        from pcwlad_geo.multi.stack.adding import stack_add

        folder = watch_folder(params["stack"], params["out_dir"])
        check_output_folder(folder, params["overwrite"], WATCH_FILES["numbers"])
        added = stack_ending(stack_add(params["add"], params["stack"], on_event=on_event, **settings))
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


def _watch_ending(numbers: WatchNumbers, params: Mapping[str, Any], added: int) -> Ending:
    """Return the ending; its status is that of the image `added` where the requirements are met."""
    from pcwlad_geo.multi.watch.page import WATCH_FILES, findings
    from pcwlad_geo.multi.watch.run import watch_folder

    folder = watch_folder(params["stack"], params["out_dir"])
    status = RequirementError.exit_status if numbers.passed is False else added
    figures: dict[str, object] = {
        "series": len(numbers.series),
        "steps": sum(len(series.steps) for series in numbers.series),
        "moving": len(numbers.motion.regions) if numbers.motion else None,
        "corrected": numbers.corrected and asdict(numbers.corrected),
        "passed": numbers.passed,
        "paths": {
            kind: str((folder / name).absolute())
            for kind, name in WATCH_FILES.items()
            if name in numbers.outputs
        },
    }
    rows = [
        (series.name, str(len(series.images)), f"{series.level_px[0]:+.3f} {series.level_px[1]:+.3f}",
         f"{series.level_sigma_px:.3f}", f"{series.noise_px:.3f}", str(len(series.steps)))
        for series in numbers.series
    ]  # fmt: skip
    lines = columns([("series", "images", "last level px", "sigma px", "noise px", "steps"), *rows], (0,))
    lines += ["", *findings(numbers)]
    lines += [requirement.message for requirement in numbers.requirements]
    if numbers.corrected is not None and params["apply"]:
        written, on_grid = len(numbers.corrected.written), numbers.corrected.on_grid
        lines.append(
            f"on the grid of the stack: {on_grid} of its own in {numbers.stack}, {written} written here"
        )
    lines.append(f"report: {folder / WATCH_FILES['report']}")
    return Ending(figures, visible("\n".join(lines)) + "\n", status)


def _abandon_watch(params: Mapping[str, Any]) -> None:
    from pcwlad_geo.multi.watch.run import watch_folder
    from pcwlad_geo.outputs.folder import abandon

    if _holds_reports(params["stack"]):
        abandon_reports(params["stack"], params)
        return
    abandon(watch_folder(params["stack"], params["out_dir"]))
    if params["add"]:
        abandon_stack(params["stack"])
