"""``pcwlad-geo qa``: band-to-band registration of a stack, and its trend over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.config import collect
from pcwlad_geo.cli.job import Ending, run_guarded
from pcwlad_geo.cli.visible import visible
from pcwlad_geo.errors import RegistrationRejectedError, RequirementError, SettingsError
from pcwlad_geo.registration.progress import EventCallback
from pcwlad_geo.registration.settings import Settings

if TYPE_CHECKING:
    from pcwlad_geo.stacks.run import QaResult
    from pcwlad_geo.stacks.trend import Trend

Rasters = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="RASTER…",
        help="Rasters, one with several bands, or Landsat and Sentinel-2 products; FILE:2,4,5 or "
        "PRODUCT:B4,B10 takes these bands of it.",
        show_default=False,
    ),
]
Bands = Annotated[
    str | None,
    typer.Option(
        "--bands",
        metavar="2,4-6",
        help="Bands of the rasters that do not name theirs; of products, names.  [default: all]",
    ),
]
Against = Annotated[
    str | None,
    typer.Option("--against", metavar="NAME", help="Compare every band with this one only, such as B4."),
]
Require = Annotated[
    list[str] | None,
    typer.Option(
        "--require",
        metavar="LIMIT",
        help="Limit that every pair must meet, such as 'CE90<=0.3px'; repeatable. Statistics: mean, median, "
        "std, RMSE, LE90, CE90, CE95, CE99.7, closure; 'net CE90': without the matching noise; units: px, "
        "native px, m.",
    ),
]
PresetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--preset",
        metavar="NAME",
        help="Requirement of a mission: sentinel2, landsat-oli, landsat-tirs; repeatable.",
    ),
]
NativePx = Annotated[
    list[str] | None,
    typer.Option(
        "--native-px",
        metavar="NAME=M",
        help="Pixel size, metres, that the sensor recorded, of a resampled band; known for Landsat and "
        "Sentinel-2 files; repeatable.",
    ),
]
Mask = Annotated[
    Path | None,
    typer.Option(
        "--mask", metavar="FILE", help="Mask of all rasters, 0 = excluded.  [default: that of a product]"
    ),
]
TrendOption = Annotated[
    Path | None,
    typer.Option(
        "--trend",
        metavar="DIR",
        help="Instead: a page of how the figures of all reports below DIR went over time.",
    ),
]


def qa(
    context: typer.Context,
    rasters: Rasters = None,
    out_dir: o.OutDir = None,
    bands: Bands = None,
    against: Against = None,
    require: Require = None,
    preset: PresetOption = None,
    native_px: NativePx = None,
    mask: Mask = None,
    trend: TrendOption = None,
    method: o.Method = None,
    points: o.Points = None,
    features: o.Features = None,
    keypoints: o.Keypoints = None,
    template: o.Template = None,
    window: o.Window = None,
    search_radius: o.SearchRadius = None,
    ssim_min: o.SsimMin = None,
    iterations: o.Iterations = None,
    consensus: o.Consensus = None,
    prealign: o.Prealign = None,
    pdf: o.Pdf = None,
    jobs: o.Jobs = None,
    scheduler: o.Scheduler = None,
    allow_remote: o.AllowRemote = None,
    trust_vrt: o.TrustVrt = None,
    progress: o.ProgressOption = "auto",
    watch_stdin: o.WatchStdin = False,
    config: o.Config = None,
    overwrite: o.Overwrite = False,
    debug: o.Debug = False,
) -> None:
    """Measure how well bands lie on each other: all pairs, or each against one. Corrects nothing."""
    params = context.params
    work = _trend if trend is not None else _stack
    run_guarded(params, lambda on_event: work(params, on_event), lambda: _abandon(params))


def _stack(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    if not params["rasters"]:
        raise SettingsError("no raster: give two or more, one with several bands, or --trend DIR")
    settings = collect(params, params["config"])
    Settings.from_options(settings)  # a bad value need not wait for the heavy libraries, which load here:
    from pcwlad_geo.stacks.run import qa

    result = qa(
        params["rasters"],
        out_dir=params["out_dir"],
        bands=params["bands"],
        against=params["against"],
        preset=params["preset"] or (),
        native_px=params["native_px"] or (),
        mask=params["mask"],
        overwrite=params["overwrite"],
        on_event=on_event,
        **settings,
    )
    return _ending(result)


def _ending(result: QaResult) -> Ending:
    from pcwlad_geo.cli.qa_table import outcome_of, stack_text

    status = 0
    if result.passed is False:
        status = RequirementError.exit_status
    elif result.refused:
        status = RegistrationRejectedError.exit_status
    return Ending({**outcome_of(result), "exit_status": status}, visible(stack_text(result)), status)


def _trend(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    if params["rasters"]:
        raise SettingsError("--trend reads finished reports and takes no rasters: give one or the other")
    for name in ("require", "preset", "against", "bands", "native_px", "mask"):
        if params[name]:
            raise SettingsError(
                f"--trend takes no --{name.replace('_', '-')}: it repeats what the reports say"
            )
    from pcwlad_geo.stacks.trend import trend

    return _trend_ending(
        trend(params["trend"], out_dir=params["out_dir"], overwrite=params["overwrite"], on_event=on_event)
    )


def _trend_ending(found: Trend) -> Ending:
    from pcwlad_geo.cli.qa_table import trend_text

    paths = {kind: str(path) for kind, path in found.paths.items()}
    figures: dict[str, object] = {
        "reports": found.reports,
        "series": len(found.series),
        "exit_status": 0,
        "paths": paths,
    }
    return Ending(figures, visible(trend_text(found)))


def _abandon(params: Mapping[str, Any]) -> None:
    from pcwlad_geo.staging import abandon

    if params["trend"] is not None:
        from pcwlad_geo.stacks.trend import trend_folder

        abandon(trend_folder(params["trend"], params["out_dir"]))
    elif params["rasters"]:
        from pcwlad_geo.stacks.run import qa_folder

        abandon(qa_folder(params["rasters"], params["out_dir"]))
