"""The page of a band QA: matrix of pairs, maps of displacements, triangles; lengths are CSS px."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Final

from pcwlad_geo.multi.pages import class_names, environment
from pcwlad_geo.multi.qa.band_pairs import SQUARES, LocalMean
from pcwlad_geo.multi.qa.closure import CLOSURE, closes, larger_axis_px
from pcwlad_geo.multi.qa.numbers import BandEntry, BandPairEntry, QaNumbers, TriangleEntry
from pcwlad_geo.text import plain


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
    pairs: Sequence[BandPairEntry], shapes: Mapping[str, tuple[int, int]], layout: QaLayout = QA_LAYOUT
) -> list[DisplacementMap]:
    """Return the maps of the measured pairs, by decreasing CE90; `shapes` are (rows, cols)."""
    worst = sorted((pair for pair in pairs if pair.local), key=_ce90_px, reverse=True)
    return [_map(pair, shapes[pair.target], layout) for pair in worst[: layout.max_maps]]


def _map(pair: BandPairEntry, shape: tuple[int, int], layout: QaLayout) -> DisplacementMap:
    (rows, cols), margin_px = shape, layout.map_margin_px
    scale = layout.map_side_px / max(rows, cols)
    longest = max(math.hypot(*local.mean_px) for local in pair.local)
    arrow = 0.85 * layout.map_side_px / SQUARES
    per_px = arrow / max(longest, 0.05)  # smaller ones would only show noise
    return DisplacementMap(
        name=pair.name,
        width=round(cols * scale + 2 * margin_px, 1),
        height=round(rows * scale + 2 * margin_px, 1),
        arrows=tuple(_arrow(local, scale, per_px, margin_px) for local in pair.local),
        longest_px=longest,
    )


def _arrow(local: LocalMean, scale: float, per_px: float, margin_px: float) -> Arrow:
    """Return an arrow centred on its square."""
    (col, row), (d_col, d_row) = local.at_px, local.mean_px
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

    pair: BandPairEntry
    """The pair, as qa.json has it."""
    level: int
    """Class of CE90, from 0."""
    arrow: tuple[float, float] | None
    """Position of the arrow's tip relative to the middle of its box, CSS px; None for a short one."""
    turn_deg: float
    """Direction of the arrow."""


def qa_page(numbers: QaNumbers, layout: QaLayout = QA_LAYOUT) -> str:
    """Return the text of `qa.html`."""
    pairs, bands, against = numbers.pairs, numbers.bands, numbers.against
    measured = [pair for pair in pairs if pair.status == "measured"]
    longest = max(map(_length_px, measured), default=0.0)
    shorten = partial(few, most=layout.max_rows // 4)
    names = [band.name for band in bands]
    return (
        environment()
        .get_template("qa.html.j2")
        .render(
            {field.name: getattr(numbers, field.name) for field in fields(numbers)},
            settings=plain(numbers.settings),
            verdict=verdict(numbers),
            state={None: "open", True: "good", False: "bad"}[numbers.passed],
            title=shorten(names),
            rows=[against] if against else names[:-1],
            columns=[name for name in names if name != against] if against else names[1:],
            cells={(pair.reference, pair.target): _cell(pair, longest, layout) for pair in pairs},
            where={band.name: _where(band) for band in bands},
            measured=measured,
            refused=[pair for pair in pairs if pair.status == "refused"],
            few=shorten,
            more_gaps=max(len(numbers.closure) - layout.max_rows, 0),
            worst_gaps=sorted(numbers.closure, key=gap, reverse=True)[: layout.max_rows],
            worst=max(measured, key=_ce90_px, default=None),
            farthest=max(measured, key=_length_px, default=None),
            farthest_px=longest,
            widest_gap=max(map(gap, numbers.closure), default=None),
            classes=class_names(layout.ce90_classes_px),
            closes_px=CLOSURE.closes_px,
            maps=displacement_maps(pairs, {band.name: band.shape for band in bands}, layout),
            closes=closes,
            crs_name=crs_name,
            differs=differs,
            native_differs=any(map(differs, measured)),
            warnings=_warnings(pairs),
        )
    )


def verdict(numbers: QaNumbers) -> str:
    """Return the headline of the page, with the verdict."""
    pairs, requirements = numbers.pairs, numbers.requirements
    refused = sum(pair.status == "refused" for pair in pairs)
    count = "1 pair" if len(pairs) == 1 else f"{len(pairs)} pairs"
    if numbers.passed is None:
        return f"{refused} of {count} could not be measured" if refused else f"{count} measured"
    if numbers.passed:
        who = {1: "the pair meets", 2: "both pairs meet"}.get(len(pairs), f"all {count} meet")
        return f"Passed: {who} the requirement{'s' if len(requirements) > 1 else ''}"
    failed = sum(pair.passed is False for pair in pairs)
    missed = [requirement.text for requirement in requirements if not requirement.passed]
    if failed and refused:
        return f"Failed: {failed} of {count}, {refused} of them refused"
    if failed:
        one = f" miss {missed[0].replace('<=', '≤')}" if len(missed) == 1 else ""
        return f"Failed: {failed} of {count}{one}"
    return "Failed: triangles do not close"


def gap(triangle: TriangleEntry) -> float:
    """Return the closure error of a triangle, px, of the larger axis; 0 if it is not known."""
    return larger_axis_px(triangle.mean_px)


def crs_name(crs: str | None) -> str:
    """Return the short name of a CRS: its code, or the beginning of its text."""
    if crs is None:
        return "none"
    name = re.match(r'\w+\["([^"]+)"', crs)
    return name[1] if name else crs


def differs(pair: BandPairEntry) -> bool:
    """Whether the native pixel size of a measured pair is known and differs from the target's."""
    in_px, in_native_px = pair.displacement["px"], pair.displacement["native_px"]
    return in_px is not None and in_native_px is not None and in_native_px.radial != in_px.radial


def few(names: Sequence[str], most: int) -> str:
    """Return names as text, `most` of them."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _cell(pair: BandPairEntry, longest_px: float, layout: QaLayout) -> Cell:
    level = sum(_ce90_px(pair) > limit for limit in layout.ce90_classes_px)
    length_px = _length_px(pair)
    if length_px < 0.15 * longest_px or longest_px == 0:
        return Cell(pair, level, None, 0.0)
    (col, row), scale = _mean_px(pair), layout.arrow_px / longest_px
    tip = round(col * scale, 1), round(row * scale, 1)
    return Cell(pair, level, tip, round(math.degrees(math.atan2(row, col))))


def _mean_px(pair: BandPairEntry) -> tuple[float, float]:
    """Return the mean displacement (col, row); 0 of a pair that is not measured."""
    px = pair.displacement["px"]
    return (px.col.mean, px.row.mean) if px else (0.0, 0.0)


def _length_px(pair: BandPairEntry) -> float:
    return math.hypot(*_mean_px(pair))


def _ce90_px(pair: BandPairEntry) -> float:
    px = pair.displacement["px"]
    return px.radial.ce90 if px else 0.0


def _where(band: BandEntry) -> str:
    """Return file and number of a band, unless its name contains them."""
    stem = Path(band.path).stem
    return "" if stem.endswith(band.name) else f"{stem}, band {band.band}"


def _warnings(pairs: Sequence[BandPairEntry]) -> list[tuple[str, list[str]]]:
    """Return each warning once, with the pairs to which it applies."""
    pair_names: dict[str, list[str]] = {}
    for pair in pairs:
        for warning in pair.warnings:
            pair_names.setdefault(warning, []).append(pair.name)
    return list(pair_names.items())
