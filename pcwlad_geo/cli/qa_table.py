"""The quality figures of a stack on the screen, and as the result event."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from pcwlad_geo.cli.columns import columns

if TYPE_CHECKING:
    from pcwlad_geo.stacks.closure import Triangle
    from pcwlad_geo.stacks.pairs import PairResult
    from pcwlad_geo.stacks.requirements import Judged
    from pcwlad_geo.stacks.run import QaResult
    from pcwlad_geo.stacks.trend import Trend

HEADER: Final = ("pair (reference – target)", "n", "mean px", "LE90 px", "CE90 px", "net", "CE90 m", "")
LEFT: Final = (0, 7)
"""Columns of words."""


def stack_text(result: QaResult) -> str:
    """Return what is printed at the end of a quality check."""
    lines = columns([HEADER, *(_pair(pair) for pair in result.pairs)], LEFT)
    if result.triangles:
        rows = [("triangle", "closure px", "places"), *(_triangle(each) for each in result.triangles)]
        lines += ["", *columns(rows, (0,))]
    elif result.against:
        lines += ["", "no triangles with --against: closure is not checked"]
    lines += ["", *(_verdict(verdict) for verdict in result.verdicts)] if result.verdicts else []
    lines += [f"refused: {pair.name}: {pair.reason}" for pair in result.refused]
    if result.passed is not None:
        lines.append("PASSED" if result.passed else "FAILED")
    return "\n".join([*lines, f"report: {result.out_dir / 'qa.html'}"]) + "\n"


def outcome_of(result: QaResult) -> dict[str, object]:
    """Return the values of the result event."""
    from pcwlad_geo.stacks.run import NAMES  # slow to load, but for who has a result

    names = {kind: name for kind, name in NAMES.items() if kind != "pdf" or result.settings.pdf}
    return {
        "passed": result.passed,
        "pairs": len(result.pairs),
        "refused": [pair.name for pair in result.refused],
        "requirements": [
            {"text": each.requirement.rule.text, "passed": each.passed, "failed": list(each.failed)}
            for each in result.verdicts
        ],
        "paths": {kind: str(result.out_dir / name) for kind, name in names.items()},
    }


def trend_text(found: Trend) -> str:
    """Return what is printed at the end of a trend."""
    return f"{found.reports} reports, {len(found.series)} series\nreport: {found.paths['report']}\n"


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
