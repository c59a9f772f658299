"""The figures of a result event of register or match, as numbers and in sentences."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..help import GRADES, LABELS, QUALITY_LINES, VERDICTS
from ..text import tr
from .engine import EngineError

RASTERS = ("_registered.tif", "_corrected.vrt", "_registered.vrt")
"""How the names of corrected rasters end, the one that is shown first."""


def summary(outcome: Mapping[str, Any]) -> str:
    """Return the main figures, and the grade with what to expect; the warnings have told the reasons."""
    quality = outcome.get("quality")
    if not quality:
        return facts(outcome)
    sizes = _sizes(quality)
    grade = tr(QUALITY_LINES[len(sizes) - 1]).format(tr(GRADES[quality["grade"]]), *sizes)
    return f"{facts(outcome)}\n{grade}"


def facts(outcome: Mapping[str, Any]) -> str:
    """Return the main figures of a result event, a line each."""
    found = figures(outcome)
    lines = [tr("Tie points: {:.0f}").format(found["POINTS"])]
    if outcome.get("model_name"):
        lines.append(tr("Model: {}").format(tr(LABELS[outcome["model_name"].rstrip("0123456789")])))
    # from a frame of its own, a displacement tells nothing but where that begins
    if "SHIFT" in found and outcome.get("target", {}).get("georeferenced", True):
        text = tr("Median displacement of the target: {:+.3f} px to the right, {:+.3f} px down")
        lines.append(text.format(found["SHIFT_COL"], found["SHIFT_ROW"]))
    if "RMSE" in found:
        lines.append(tr("What is left: RMSE {RMSE:.3f} px, CE90 {CE90:.3f} px").format(**found))
    if "RMSE_M" in found:
        lines[-1] += tr(" (RMSE {RMSE_M:.2f} m, CE90 {CE90_M:.2f} m)").format(**found)
    if basemap := outcome.get("basemap") or (outcome.get("reference") or {}).get("basemap"):
        facts_of = (
            basemap["attribution"],
            f"{float(format(basemap['pixel_m'] or 0, '.3g')):g} m",
            basemap["date"],
        )
        name = f"{basemap['name']} ({', '.join(filter(None, facts_of))})"
        lines.append(tr("All this is relative to the basemap {}.").format(name))
    return "\n".join(lines)


def _sizes(quality: Mapping[str, Any]) -> list[str]:
    """Return the expected error of what was compared, and of all the ground where that is more."""
    found = [(quality[f"{of}_ce90_px"], quality[f"{of}_ce90_m"]) for of in ("expected", "whole")]
    return [f"{px:.2f} px" + ("" if m is None else f" ({m:.2f} m)") for px, m in found if px is not None]


def figures(outcome: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers of a result event: those of the check points, of the fit points without them."""
    counts = outcome["tie_points"]
    found: dict[str, float] = {"POINTS": counts["total"] - counts["rejected"]}
    if outcome["displacement_px"]:
        col, row = outcome["displacement_px"]["median"]
        found.update(SHIFT=math.hypot(col, row), SHIFT_COL=col, SHIFT_ROW=row)
    groups = (outcome["accuracy"][name] for name in ("check", "fit"))
    accuracy = next((each for each in groups if each["px"]), {})
    for unit, suffix in (("px", ""), ("m", "_M")):
        for name in ("rmse", "ce90") if accuracy.get(unit) else ():
            found[name.upper() + suffix] = accuracy[unit][name]
    return found


def told(outcome: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a user is told of a finished job: sentences, the grade, and where its files are."""
    graded = {"QUALITY": outcome["quality"]["grade"]} if outcome.get("quality") else {}
    return {"VERDICT": verdict(outcome), "FACTS": facts(outcome), "PATHS": outcome["paths"], **graded}


def earlier(folder: Path) -> dict[str, Any]:
    """Return the result event of a finished registration from its folder, with the paths of its inputs.

    Raises
    ------
    EngineError
        If it is none, or was refused.
    """
    try:
        outcome = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        raster = next(name for end in RASTERS for name in outcome["outputs"] if name.endswith(end))
        inputs = {each["role"]: each["path"] for each in outcome["inputs"]}
        paths = {"reference": inputs["reference"], "target": inputs["target"], "raster": str(folder / raster)}
        paths.update(report=str(folder / "report.html"), geopackage=str(folder / "tiepoints.gpkg"))
        if "tiepoints.gpkg" not in outcome["outputs"]:
            raise EngineError(tr("{}: no tiepoints.gpkg. Register again without --no-report.").format(folder))
        return {**outcome, "model_name": outcome["model"]["name"], "paths": paths}
    except (OSError, ValueError, KeyError, TypeError, StopIteration) as error:
        raise EngineError(tr("{} is no folder of a finished registration.").format(folder)) from error


def verdict(outcome: Mapping[str, Any]) -> str:
    """Return what a user wants to know of a finished registration, in one sentence."""
    found, quality = figures(outcome), outcome.get("quality")
    if not quality:
        return tr("{:.0f} tie points were found.").format(found["POINTS"])
    sizes = _sizes(quality)
    return tr(VERDICTS[quality["grade"]][len(sizes) - 1]).format(*sizes)
