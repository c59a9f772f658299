"""Small maps of where a pair is displaced: arrows over the scene, in CSS pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from pcwlad_geo.stacks.local import SQUARES

SIDE_PX: Final = 220.0
"""Longer side of a map."""
LEAST_SCALE_PX: Final = 0.05
"""Displacements below this are not drawn larger: they would show noise."""
MARGIN_PX: Final = 8.0
"""Around a map, for the arrows at its edge."""
MOST_MAPS: Final = 12


@dataclass(frozen=True, slots=True)
class Arrow:
    """An arrow from (x, y), CSS px."""

    x: float
    y: float
    dx: float
    dy: float
    turn_deg: int


@dataclass(frozen=True, slots=True)
class DisplacementMap:
    """The arrows of a pair, and their scale."""

    name: str
    width: float
    height: float
    arrows: tuple[Arrow, ...]
    longest_px: float
    """Displacement of the longest arrow, px of the target."""


def displacement_maps(
    pairs: Sequence[Mapping[str, Any]], shapes: Mapping[str, Sequence[int]]
) -> list[DisplacementMap]:
    """Return the maps of the measured pairs, those of the largest CE90 first.

    Parameters
    ----------
    pairs : sequence of mapping
        As in the summary.
    shapes : mapping
        (rows, cols) of each band by its name.
    """
    measured = [pair for pair in pairs if pair["local"]]
    worst = sorted(measured, key=lambda pair: -float(pair["displacement"]["px"]["radial"]["ce90"]))
    return [_map(pair, shapes[pair["target"]]) for pair in worst[:MOST_MAPS]]


def _map(pair: Mapping[str, Any], shape: Sequence[int]) -> DisplacementMap:
    rows, cols = shape
    scale = SIDE_PX / max(rows, cols)
    longest = max(math.hypot(*each["mean_px"]) for each in pair["local"])
    arrow = 0.85 * SIDE_PX / SQUARES
    per_px = arrow / max(longest, LEAST_SCALE_PX)
    return DisplacementMap(
        name=pair["name"],
        width=round(cols * scale + 2 * MARGIN_PX, 1),
        height=round(rows * scale + 2 * MARGIN_PX, 1),
        arrows=tuple(_arrow(each, scale, per_px) for each in pair["local"]),
        longest_px=longest,
    )


def _arrow(local: Mapping[str, Any], scale: float, per_px: float) -> Arrow:
    """Return an arrow whose middle is the middle of its square."""
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
