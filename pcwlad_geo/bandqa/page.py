"""The page of a band QA: the matrix of pairs, displacement maps and triangles, in CSS pixels."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment

from pcwlad_geo.bandqa.bands import SQUARES
from pcwlad_geo.bandqa.summary import Summary
from pcwlad_geo.report.rendering import templates_of

SIDE_PX: Final = 220.0
"""Longer side of a map, CSS px."""
MIN_SCALE_PX: Final = 0.05
"""Least displacement for the scale of the arrows, px: smaller ones would only show noise."""
MARGIN_PX: Final = 8.0
"""Margin around a map for the arrows at its edge, CSS px."""
MAX_MAPS: Final = 12
"""Largest number of maps on the page."""


@dataclass(frozen=True, slots=True)
class Arrow:
    """An arrow that starts at (x, y), CSS px."""

    x: float
    y: float
    dx: float
    dy: float
    turn_deg: int


@dataclass(frozen=True, slots=True)
class DisplacementMap:
    """The displacements of a pair as arrows, and their scale."""

    name: str
    width: float
    height: float
    arrows: tuple[Arrow, ...]
    longest_px: float
    """Displacement of the longest arrow, px of the target."""


def displacement_maps(
    pairs: Sequence[Mapping[str, Any]], shapes: Mapping[str, Sequence[int]]
) -> list[DisplacementMap]:
    """Return the maps of the measured pairs, sorted by decreasing CE90.

    Parameters
    ----------
    pairs : sequence of mapping
        Entry `pairs` of the summary.
    shapes : mapping
        Shape (rows, cols) of each band by its name.
    """
    measured = [pair for pair in pairs if pair["local"]]
    worst = sorted(measured, key=lambda pair: -float(pair["displacement"]["px"]["radial"]["ce90"]))
    return [_map(pair, shapes[pair["target"]]) for pair in worst[:MAX_MAPS]]


def _map(pair: Mapping[str, Any], shape: Sequence[int]) -> DisplacementMap:
    rows, cols = shape
    scale = SIDE_PX / max(rows, cols)
    longest = max(math.hypot(*each["mean_px"]) for each in pair["local"])
    arrow = 0.85 * SIDE_PX / SQUARES
    per_px = arrow / max(longest, MIN_SCALE_PX)
    return DisplacementMap(
        name=pair["name"],
        width=round(cols * scale + 2 * MARGIN_PX, 1),
        height=round(rows * scale + 2 * MARGIN_PX, 1),
        arrows=tuple(_arrow(each, scale, per_px) for each in pair["local"]),
        longest_px=longest,
    )


def _arrow(local: Mapping[str, Any], scale: float, per_px: float) -> Arrow:
    """Return an arrow centred on its square."""
    (col, row), (d_col, d_row) = local["at_px"], local["mean_px"]
    dx, dy = d_col * per_px, d_row * per_px
    turn = round(math.degrees(math.atan2(dy, dx)))
    return Arrow(
        round(MARGIN_PX + col * scale - dx / 2, 1),
        round(MARGIN_PX + row * scale - dy / 2, 1),
        round(dx, 1),
        round(dy, 1),
        turn,
    )


CLASSES_PX: Final = (0.1, 0.2, 0.3, 0.5, 1.0)
"""Class limits of CE90 for the colours of the matrix, constant so that pages can be compared."""
CLOSES_PX: Final = 0.05
"""Closure error above which a triangle is marked."""
MAX_ROWS: Final = 24
"""Largest number of triangles shown; lists of names are shortened to a quarter of it."""
ARROW_PX: Final = 15.0
"""Length of the longest arrow in the matrix: half the side of its box, less the arrow head."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of the matrix."""

    pair: Mapping[str, Any]
    """Entry of the pair in the summary."""
    level: int
    """Class of CE90, from 0."""
    arrow: tuple[float, float] | None
    """Position of the arrow's tip relative to the middle of its box, CSS px; None for a short one."""
    turn_deg: float
    """Direction of the arrow."""


def render(summary: Summary) -> str:
    """Return the text of `qa.html`.

    Parameters
    ----------
    summary : dict
        The result of `summarise`.
    """
    pairs = summary["pairs"]
    measured = [pair for pair in pairs if pair["status"] == "measured"]
    longest = max((_length(pair) for pair in measured), default=0.0)
    cells = {(pair["reference"], pair["target"]): _cell(pair, longest) for pair in pairs}
    names = [band["name"] for band in summary["bands"]]
    against = summary["against"]
    return (
        environment()
        .get_template("qa.html.j2")
        .render(
            summary,
            verdict=verdict(summary),
            state={None: "open", True: "good", False: "bad"}[summary["passed"]],
            title=_title(names),
            rows=[against] if against else names[:-1],
            columns=[name for name in names if name != against] if against else names[1:],
            cells=cells,
            where={band["name"]: _where(band) for band in summary["bands"]},
            measured=measured,
            refused=[pair for pair in pairs if pair["status"] == "refused"],
            few=few,
            more_gaps=max(len(summary["closure"]) - MAX_ROWS, 0),
            worst_gaps=sorted(summary["closure"], key=gap, reverse=True)[:MAX_ROWS],
            worst=max(measured, key=lambda pair: pair["displacement"]["px"]["radial"]["ce90"], default=None),
            farthest=max(measured, key=_length, default=None),
            farthest_px=longest,
            widest_gap=max(map(gap, summary["closure"]), default=None),
            classes=_classes(),
            closes_px=CLOSES_PX,
            maps=displacement_maps(pairs, {band["name"]: band["shape"] for band in summary["bands"]}),
            closes=closes,
            crs_name=crs_name,
            differs=differs,
            native_differs=any(differs(pair) for pair in measured),
            warnings=_warnings(pairs),
        )
    )


def environment() -> Environment:
    """Return the templates of this package, everything escaped, with the filters for figures."""
    environment = templates_of("pcwlad_geo.bandqa")
    environment.filters["figure"] = figure
    environment.filters["signed"] = signed
    environment.filters["file_name"] = lambda path: Path(path).name
    return environment


def verdict(summary: Summary) -> str:
    """Return the headline of the page, with the verdict."""
    pairs = summary["pairs"]
    refused = sum(pair["status"] == "refused" for pair in pairs)
    count = "1 pair" if len(pairs) == 1 else f"{len(pairs)} pairs"
    if summary["passed"] is None:
        if refused:
            return f"{refused} of {count} could not be measured"
        return f"{count} measured"
    if summary["passed"]:
        who = {1: "the pair meets", 2: "both pairs meet"}.get(len(pairs), f"all {count} meet")
        return f"Passed: {who} the requirement{'s' if len(summary['requirements']) > 1 else ''}"
    failed = sum(pair["passed"] is False for pair in pairs)
    missed = [each["text"] for each in summary["requirements"] if not each["passed"]]
    if failed and refused:
        return f"Failed: {failed} of {count}, {refused} of them refused"
    if failed:
        one = f" miss {missed[0].replace('<=', '≤')}" if len(missed) == 1 else ""
        return f"Failed: {failed} of {count}{one}"
    return "Failed: triangles do not close"


def gap(triangle: Mapping[str, Any]) -> float:
    """Return the closure error of a triangle, px, of the larger axis; 0 if it is not known."""
    return float(max(map(abs, triangle["mean_px"] or (0.0, 0.0))))


def closes(triangle: Mapping[str, Any]) -> bool:
    """Whether a triangle closes within the limit, or within three standard errors."""
    if triangle["mean_px"] is None:
        return False
    errors = triangle["error_px"] or (0.0, 0.0)
    return all(
        abs(mean) <= max(CLOSES_PX, 3 * error)
        for mean, error in zip(triangle["mean_px"], errors, strict=True)
    )


def crs_name(crs: str | None) -> str:
    """Return the short name of a CRS: its code, or the beginning of its text."""
    if crs is None:
        return "none"
    name = re.match(r'\w+\["([^"]+)"', crs)
    return name[1] if name else crs


def differs(pair: Mapping[str, Any]) -> bool:
    """Whether the native pixel size of a measured pair is known and differs from the target's."""
    in_px, in_native_px = (pair["displacement"][unit] for unit in ("px", "native_px"))
    return bool(in_native_px is not None and in_native_px["radial"] != in_px["radial"])


def figure(value: float | None, digits: int = 2) -> str:
    """Return `value` with `digits` decimals and a typographic minus sign; a dash for None."""
    if value is None:
        return "–"
    text = f"{value:.{digits}f}"
    return text.replace("-", "−") if float(text) else f"{0:.{digits}f}"


def signed(value: float | None, digits: int = 2) -> str:
    """Return `value` with `digits` decimals and its sign; a dash for None."""
    text = figure(value, digits)
    return f"+{text}" if value is not None and float(text.replace("−", "-")) > 0 else text


def few(names: Sequence[str]) -> str:
    """Return names as text, shortened if there are many."""
    most = MAX_ROWS // 4
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _cell(pair: Mapping[str, Any], longest: float) -> Cell:
    if pair["status"] == "refused":
        return Cell(pair, 0, None, 0.0)
    px = pair["displacement"]["px"]
    level = sum(px["radial"]["ce90"] > limit for limit in CLASSES_PX)
    col, row, length = px["col"]["mean"], px["row"]["mean"], _length(pair)
    if length < 0.15 * longest or longest == 0:
        return Cell(pair, level, None, 0.0)
    scale = ARROW_PX / longest
    return Cell(
        pair, level, (round(col * scale, 1), round(row * scale, 1)), round(math.degrees(math.atan2(row, col)))
    )


def _length(pair: Mapping[str, Any]) -> float:
    px = pair["displacement"]["px"]
    return math.hypot(px["col"]["mean"], px["row"]["mean"])


def _classes() -> list[str]:
    """Return the labels of the legend, lowest class first."""
    limits = [f"{limit:g}" for limit in CLASSES_PX]
    between = [f"{low}–{high}" for low, high in pairwise(limits)]
    return [f"up to {limits[0]}", *between, f"over {limits[-1]}"]


def _where(band: Mapping[str, Any]) -> str:
    """Return file and number of a band, unless its name contains them."""
    stem = Path(band["path"]).stem
    return "" if stem.endswith(band["name"]) else f"{stem}, band {band['band']}"


def _title(names: Sequence[str]) -> str:
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def _warnings(pairs: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Return each warning once, with the pairs to which it applies."""
    found: dict[str, list[str]] = {}
    for pair in pairs:
        for warning in pair["warnings"]:
            found.setdefault(warning, []).append(pair["name"])
    return list(found.items())
