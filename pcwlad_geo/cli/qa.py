"""``pcwlad-geo qa``: band QA and trends, with their output as text and as result event."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.options import checked_options
from pcwlad_geo.cli.running import Ending, run_guarded
from pcwlad_geo.cli.tables import columns
from pcwlad_geo.cli.watch import abandon_reports, look_at_reports
from pcwlad_geo.errors import RegistrationRejectedError, RequirementError, SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.text import visible

if TYPE_CHECKING:
    from pcwlad_geo.multi.qa.band_pairs import PairResult
    from pcwlad_geo.multi.qa.closure import Triangle
    from pcwlad_geo.multi.qa.numbers import QaResult
    from pcwlad_geo.multi.qa.requirements import Judged

BAND_PAIR_COLUMNS: Final = (
    "pair (reference – target)",
    "n",
    "mean px",
    "LE90 px",
    "CE90 px",
    "net",
    "CE90 m",
    "",
)
"""Header of the table of pairs."""


def stack_text(result: QaResult) -> str:
    """Return the text that is printed at the end of a band QA."""
    lines = columns([BAND_PAIR_COLUMNS, *(_pair(pair) for pair in result.pairs)], texts=(0, 7))
    if result.triangles:
        rows = [("triangle", "closure px", "places"), *(_triangle(triangle) for triangle in result.triangles)]
        lines += ["", *columns(rows, (0,))]
    elif result.against:
        lines += ["", "no triangles with --against: closure is not checked"]
    lines += ["", *(_verdict(verdict) for verdict in result.verdicts)] if result.verdicts else []
    from pcwlad_geo.multi.qa.requirements import ceos_ard_row  # slow to load, unless there is a result

    lines += [
        ceos_ard_row(verdict) for verdict in result.verdicts if verdict.requirement.preset == "ceos-ard"
    ]
    lines += [f"refused: {pair.name}: {pair.reason}" for pair in result.refused]
    if result.passed is not None:
        lines.append("PASSED" if result.passed else "FAILED")
    return "\n".join([*lines, f"report: {result.out_dir / 'qa.html'}"]) + "\n"


def outcome_of(result: QaResult) -> dict[str, object]:
    """Return the values of the result event."""
    from pcwlad_geo.multi.qa.run import QA_FILES  # slow to load, unless there is a result

    names = {kind: name for kind, name in QA_FILES.items() if kind != "pdf" or result.settings.pdf}
    return {
        "passed": result.passed,
        "pairs": len(result.pairs),
        "refused": [pair.name for pair in result.refused],
        "requirements": [
            {"text": verdict.requirement.rule.text, "passed": verdict.passed, "failed": list(verdict.failed)}
            for verdict in result.verdicts
        ],
        "paths": {kind: str(result.out_dir / name) for kind, name in names.items()},
    }


def _pair(pair: PairResult) -> Sequence[str]:
    px, m = pair.statistics.get("px"), pair.statistics.get("m")
    if px is None:
        return (pair.name, "", "", "", "", "", "", "refused")
    return (
        pair.name,
        str(px.n),
        f"{px.col.mean:+.3f} {px.row.mean:+.3f}",
        f"{px.col.le90:.3f} {px.row.le90:.3f}",
        f"{px.radial.ce90:.3f}",
        f"{px.net.ce90:.3f}",
        f"{m.radial.ce90:.2f}" if m else "",
        "",
    )


def _triangle(triangle: Triangle) -> Sequence[str]:
    if triangle.mean_px is None:
        return (triangle.name, "no common ground", "0")
    return (triangle.name, f"{triangle.mean_px[0]:+.3f} {triangle.mean_px[1]:+.3f}", str(triangle.cells))


def _verdict(judged: Judged) -> str:
    text = f"{judged.requirement.rule.text}: {'met' if judged.passed else 'not met'}"
    if judged.worst and not math.isnan(judged.worst[1]):
        name, value = judged.worst
        text += f" (worst {value:.3f} {judged.requirement.rule.unit}, {name})"
    return text


Rasters = Annotated[
    list[str] | None,
    o.argument(
        "RASTER…",
        "Rasters, one with several bands, or Landsat and Sentinel-2 products; FILE:2,4,5 or "
        "PRODUCT:B4,B10 takes these bands of it.",
    ),
]
Bands = Annotated[
    str | None,
    o.option(
        "--bands",
        help="Bands of the rasters that do not name theirs; of products, names.  [default: all]",
        metavar="2,4-6",
    ),
]
Against = Annotated[
    str | None,
    o.option("--against", help="Compare every band with this one only, such as B4.", metavar="NAME"),
]
Require = Annotated[
    list[str] | None,
    o.option(
        "--require",
        help="Limit that every pair must meet, such as 'CE90<=0.3px'; repeatable. Statistics: mean, median, "
        "std, RMSE, LE90, CE90, CE95, CE99.7, closure; 'net CE90': without the matching noise; units: px, "
        "native px, m.",
        metavar="LIMIT",
    ),
]
PresetOption = Annotated[
    list[str] | None,
    o.option(
        "--preset",
        help="Requirement of a mission: sentinel2, landsat-oli, landsat-tirs, or ceos-ard; repeatable.",
        metavar="NAME",
    ),
]
NativePx = Annotated[
    list[str] | None,
    o.option(
        "--native-px",
        help="Pixel size, metres, that the sensor recorded, of a resampled band; known for Landsat and "
        "Sentinel-2 files; repeatable.",
        metavar="NAME=M",
    ),
]
Mask = Annotated[
    Path | None,
    o.option(
        "--mask", help="Mask of all rasters, 0 = excluded.  [default: that of a product]", metavar="FILE"
    ),
]
TrendOption = Annotated[
    Path | None,
    o.option(
        "--trend",
        help="Instead of measuring: what `watch DIR` does with reports, plot their figures over time.",
        metavar="DIR",
    ),
]


@o.takes_settings("qa")
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
) -> None:
    """Measure how well bands lie on each other: all pairs, or each against one. Corrects nothing."""
    params = context.params
    work = _trend if trend is not None else _stack
    run_guarded(params, lambda on_event: work(params, on_event), lambda: _abandon(params))


def _stack(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    if not params["rasters"]:
        raise SettingsError("no raster: give two or more, one with several bands, or --trend DIR")
    settings = checked_options(params)
    from pcwlad_geo.multi.qa.run import qa

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
    status = 0
    if result.passed is False:
        status = RequirementError.exit_status
    elif result.refused:
        status = RegistrationRejectedError.exit_status
    return Ending(outcome_of(result), visible(stack_text(result)), status)


def _trend(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    if params["rasters"]:
        raise SettingsError("--trend reads finished reports and takes no rasters: give one or the other")
    for name in ("require", "preset", "against", "bands", "native_px", "mask"):
        if params[name]:
            raise SettingsError(
                f"--trend takes no --{name.replace('_', '-')}: it repeats what the reports say"
            )
    return look_at_reports(params["trend"], params, on_event)


def _abandon(params: Mapping[str, Any]) -> None:
    if params["trend"] is not None:
        abandon_reports(params["trend"], params)
    elif params["rasters"]:
        from pcwlad_geo.multi.qa.run import qa_folder
        from pcwlad_geo.outputs.folder import abandon

        abandon(qa_folder(params["rasters"], params["out_dir"]))
