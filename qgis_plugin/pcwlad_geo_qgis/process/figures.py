"""The figures of a result event of register or match, as numbers and in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..help import GRADES, VERDICTS
from ..text import tr


def summary(outcome: Mapping[str, Any]) -> str:
    """Return the main figures of a result event in a sentence or two."""
    found = figures(outcome)
    lines = [tr("Tie points: {:.0f}").format(found["POINTS"])]
    if "SHIFT" in found:
        text = tr("Median displacement of the target: {:+.3f} px to the right, {:+.3f} px down")
        lines.append(text.format(found["SHIFT_COL"], found["SHIFT_ROW"]))
    if "RMSE" in found:
        lines.append(tr("What is left: RMSE {RMSE:.3f} px, CE90 {CE90:.3f} px").format(**found))
    if "RMSE_M" in found:
        lines[-1] += tr(" (RMSE {RMSE_M:.2f} m, CE90 {CE90_M:.2f} m)").format(**found)
    if outcome.get("quality"):
        lines.append(quality_line(outcome["quality"]))
    return "\n".join(lines)


def quality_line(quality: Mapping[str, Any]) -> str:
    """Return the grade, and what to expect of the registered raster; the warnings have told the reasons."""
    text = tr("Quality: {}; 90 % of the common ground is expected to lie within {:.2f} px")
    line = text.format(tr(GRADES[quality["grade"]]), quality["expected_ce90_px"])
    metres = quality["expected_ce90_m"]
    return line if metres is None else line + f" ({metres:.2f} m)"


def figures(outcome: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers of a result event: those of the check points, of the fit points without them."""
    counts = outcome["tie_points"]
    found: dict[str, float] = {"POINTS": counts["total"] - counts["rejected"]}
    if outcome["displacement_px"]:
        col, row = outcome["displacement_px"]["median"]
        found.update(SHIFT=math.hypot(col, row), SHIFT_COL=col, SHIFT_ROW=row)
    for group in ("check", "fit"):
        accuracy = outcome["accuracy"][group]
        if accuracy["px"]:
            for unit, suffix in (("px", ""), ("m", "_M")):
                if accuracy[unit]:
                    found[f"RMSE{suffix}"] = accuracy[unit]["rmse"]
                    found[f"CE90{suffix}"] = accuracy[unit]["ce90"]
            break
    return found


def verdict(outcome: Mapping[str, Any]) -> str:
    """Return what a user wants to know of a finished registration, in one sentence."""
    found, quality = figures(outcome), outcome.get("quality")
    if not quality:
        return tr("{:.0f} tie points were found.").format(found["POINTS"])
    judged = tr(VERDICTS[quality["grade"]])
    metres = quality["expected_ce90_m"]
    return judged.format(quality["expected_ce90_px"], "" if metres is None else f" ({metres:.2f} m)")
