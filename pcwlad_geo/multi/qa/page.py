"""The page of a band QA: matrix of pairs, maps of displacements, triangles; lengths are CSS px."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.multi.pages import class_names, environment
from pcwlad_geo.multi.qa.band_pairs import SQUARES
from pcwlad_geo.multi.qa.closure import CLOSURE, closes, larger_axis_px
from pcwlad_geo.multi.qa.numbers import Summary


@dataclass(frozen=True, slots=True)
class QaLayout:
    """Sizes of the page."""

    map_side_px: float = 220.0
    """Longer side of a map, CSS px."""
    map_margin_px: float = 8.0
    """Margin around a map for the arrows at its edge, CSS px."""
    max_maps: int = 12
    """Largest number of maps."""
    ce90_classes_px: tuple[float, ...] = (0.1, 0.2, 0.3, 0.5, 1.0)
    """Class limits of CE90 for the colours of the matrix, the same on all pages so that they can be
    compared."""
    max_rows: int = 24
    """Largest number of triangles shown; lists of names are shortened to a quarter of it."""
    arrow_px: float = 15.0
    """Length of the longest arrow in the matrix: half the side of its box, less the arrow head, CSS px."""


QA_LAYOUT: Final = QaLayout()
"""The layout in use."""


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
    pairs: Sequence[Mapping[str, Any]], shapes: Mapping[str, Sequence[int]], layout: QaLayout = QA_LAYOUT
) -> list[DisplacementMap]:
    """Return the maps of the measured pairs of a summary, by decreasing CE90; `shapes` are (rows, cols)."""
    measured = [pair for pair in pairs if pair["local"]]
    worst = sorted(measured, key=lambda pair: -float(pair["displacement"]["px"]["radial"]["ce90"]))
    return [_map(pair, shapes[pair["target"]], layout) for pair in worst[: layout.max_maps]]


def _map(pair: Mapping[str, Any], shape: Sequence[int], layout: QaLayout) -> DisplacementMap:
    (rows, cols), margin_px = shape, layout.map_margin_px
    scale = layout.map_side_px / max(rows, cols)
    longest = max(math.hypot(*local["mean_px"]) for local in pair["local"])
    arrow = 0.85 * layout.map_side_px / SQUARES
    per_px = arrow / max(longest, 0.05)  # smaller ones would only show noise
    return DisplacementMap(
        name=pair["name"],
        width=round(cols * scale + 2 * margin_px, 1),
        height=round(rows * scale + 2 * margin_px, 1),
        arrows=tuple(_arrow(local, scale, per_px, margin_px) for local in pair["local"]),
        longest_px=longest,
    )


def _arrow(local: Mapping[str, Any], scale: float, per_px: float, margin_px: float) -> Arrow:
    """Return an arrow centred on its square."""
    (col, row), (d_col, d_row) = local["at_px"], local["mean_px"]
    dx, dy = d_col * per_px, d_row * per_px
    turn = round(math.degrees(math.atan2(dy, dx)))
    return Arrow(
        round(margin_px + col * scale - dx / 2, 1),
        round(margin_px + row * scale - dy / 2, 1),
        round(dx, 1),
        round(dy, 1),
        turn,
    )


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


def qa_page(summary: Summary, layout: QaLayout = QA_LAYOUT) -> str:
    """Return the text of `qa.html`.

    The `summary` is the result of `summarise`.
    """
    pairs = summary["pairs"]
    measured = [pair for pair in pairs if pair["status"] == "measured"]
    longest = max((_length(pair) for pair in measured), default=0.0)
    cells = {(pair["reference"], pair["target"]): _cell(pair, longest, layout) for pair in pairs}
    shorten = partial(few, most=layout.max_rows // 4)
    names = [band["name"] for band in summary["bands"]]
    against = summary["against"]
    return (
        environment()
        .get_template("qa.html.j2")
        .render(
            summary,
            verdict=verdict(summary),
            state={None: "open", True: "good", False: "bad"}[summary["passed"]],
            title=shorten(names),
            rows=[against] if against else names[:-1],
            columns=[name for name in names if name != against] if against else names[1:],
            cells=cells,
            where={band["name"]: _where(band) for band in summary["bands"]},
            measured=measured,
            refused=[pair for pair in pairs if pair["status"] == "refused"],
            few=shorten,
            more_gaps=max(len(summary["closure"]) - layout.max_rows, 0),
            worst_gaps=sorted(summary["closure"], key=gap, reverse=True)[: layout.max_rows],
            worst=max(measured, key=lambda pair: pair["displacement"]["px"]["radial"]["ce90"], default=None),
            farthest=max(measured, key=_length, default=None),
            farthest_px=longest,
            widest_gap=max(map(gap, summary["closure"]), default=None),
            classes=class_names(layout.ce90_classes_px),
            closes_px=CLOSURE.closes_px,
            maps=displacement_maps(pairs, {band["name"]: band["shape"] for band in summary["bands"]}, layout),
            closes=closes,
            crs_name=crs_name,
            differs=differs,
            native_differs=any(differs(pair) for pair in measured),
            warnings=_warnings(pairs),
        )
    )


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
    missed = [requirement["text"] for requirement in summary["requirements"] if not requirement["passed"]]
    if failed and refused:
        return f"Failed: {failed} of {count}, {refused} of them refused"
    if failed:
        one = f" miss {missed[0].replace('<=', '≤')}" if len(missed) == 1 else ""
        return f"Failed: {failed} of {count}{one}"
    return "Failed: triangles do not close"


def gap(triangle: Mapping[str, Any]) -> float:
    """Return the closure error of a triangle, px, of the larger axis; 0 if it is not known."""
    return larger_axis_px(triangle["mean_px"])


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


def few(names: Sequence[str], most: int) -> str:
    """Return names as text, `most` of them."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _cell(pair: Mapping[str, Any], longest: float, layout: QaLayout) -> Cell:
    if pair["status"] == "refused":
        return Cell(pair, 0, None, 0.0)
    px = pair["displacement"]["px"]
    level = sum(px["radial"]["ce90"] > limit for limit in layout.ce90_classes_px)
    col, row, length = px["col"]["mean"], px["row"]["mean"], _length(pair)
    if length < 0.15 * longest or longest == 0:
        return Cell(pair, level, None, 0.0)
    scale = layout.arrow_px / longest
    return Cell(
        pair, level, (round(col * scale, 1), round(row * scale, 1)), round(math.degrees(math.atan2(row, col)))
    )


def _length(pair: Mapping[str, Any]) -> float:
    px = pair["displacement"]["px"]
    return math.hypot(px["col"]["mean"], px["row"]["mean"])


def _where(band: Mapping[str, Any]) -> str:
    """Return file and number of a band, unless its name contains them."""
    stem = Path(band["path"]).stem
    return "" if stem.endswith(band["name"]) else f"{stem}, band {band['band']}"


def _warnings(pairs: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Return each warning once, with the pairs to which it applies."""
    pair_names: dict[str, list[str]] = {}
    for pair in pairs:
        for warning in pair["warnings"]:
            pair_names.setdefault(warning, []).append(pair["name"])
    return list(pair_names.items())
