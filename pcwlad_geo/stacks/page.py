"""The page of a stack: its images, the net of pairs, and the pairs that do not fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from pcwlad_geo.report.rendering import templates_of
from pcwlad_geo.stacks.cycles import root_mean_square
from pcwlad_geo.stacks.pairs import StackPair
from pcwlad_geo.stacks.result import Stack

SIDE_PX: Final = 460.0
"""Side of the drawing of the net, CSS px."""
MARGIN_PX: Final = 60.0
"""Margin around the ring of images for their names, CSS px."""
BESIDE_PX: Final = 100.0
"""Width on either side for longer names, CSS px."""
NAME_LENGTH: Final = 24
"""Largest number of characters of a name in the drawing."""
CLASSES_PX: Final = (0.02, 0.05, 0.1, 0.3)
"""Class limits of the offset of a pair for its colour, constant so that pages can be compared."""
SERIES_PX: Final = (760.0, 170.0)
"""Width and height of a time series, CSS px."""
RANKED: Final = 5
"""Number of images named by their displacement."""
MODEL_NAMES: Final = {
    "shift": "a shift",
    "affine": "an affine",
    "polynomial": "a polynomial",
    "polynomial2": "a polynomial of order 2",
    "polynomial3": "a polynomial of order 3",
    "tps": "a smooth spline",
}
"""What the correction of an image is, in words."""
MAX_NAMED: Final = 40
"""Largest number of images whose names stand in the drawing."""


@dataclass(frozen=True, slots=True)
class Node:
    """An image on the ring, CSS px."""

    name: str
    short: str
    """The name, shortened to `NAME_LENGTH`."""
    x: float
    y: float
    label_x: float
    label_y: float
    anchor: str


@dataclass(frozen=True, slots=True)
class Link:
    """A pair as a line between two images, CSS px."""

    x1: float
    y1: float
    x2: float
    y2: float
    kind: str
    """Class of its style."""
    title: str


@dataclass(frozen=True, slots=True)
class Bar:
    """The shift of an image along an axis in a time series, CSS px, with one sigma on either side."""

    name: str
    x: float
    y: float
    top: float
    bottom: float


@dataclass(frozen=True, slots=True)
class Series:
    """The shifts of the images along an axis, in the order of their dates."""

    axis: str
    bars: tuple[Bar, ...]
    ticks: tuple[tuple[float, str], ...]
    """Height, CSS px, and value."""
    dates: tuple[tuple[float, str], ...]
    """Place, CSS px, and date."""


def page(found: Stack) -> str:
    """Return the page, which holds everything that it shows."""
    nodes = _ring([image.name for image in found.images])
    at = {node.name: node for node in nodes}
    order = {"left out": 0, "refused": 1, "used": 2}
    pairs = sorted(found.pairs, key=lambda pair: (order[pair.status], -_offset_px(pair)))
    used = [_offset_px(pair) for pair in found.pairs if pair.status == "used"]
    sigma = [max(image.sigma_px) for image in found.images]
    template = templates_of("pcwlad_geo.stacks").get_template("stack.html.j2")
    return template.render(
        images=sorted(found.images, key=lambda image: -image.suspicion),
        farthest=sorted(found.images, key=lambda image: -math.hypot(*image.shift_px))[:RANKED],
        closure=found.closure,
        series=_series(found),
        wide=SERIES_PX,
        requirements=found.requirements,
        groups=max(image.group for image in found.images) + 1,
        pairs=[(pair, _offset_px(pair)) for pair in pairs],
        nodes=nodes,
        links=[_link(pair, at) for pair in reversed(pairs)],
        side=SIDE_PX,
        beside=BESIDE_PX,
        named=len(nodes) <= MAX_NAMED,
        classes=_class_names(),
        counts={status: sum(pair.status == status for pair in found.pairs) for status in order},
        typical_px=root_mean_square(used) or 0.0,
        worst_sigma_px=max(sigma),
        datum=found.datum,
        model=MODEL_NAMES.get(found.images[-1].correction.name, found.images[-1].correction.name),
        added=[name for names in found.added for name in names],
        shared=found.shared,
        unreadable=found.unreadable,
        block=found.block,
        unchecked=[
            pair for pair in found.pairs if pair.redundancy is not None and pair.redundancy < UNCHECKED
        ],
    )


UNCHECKED: Final = 0.01
"""A pair of less redundancy is checked by no other."""


def _series(found: Stack) -> list[Series]:
    """Return the time series of the shifts, along columns and rows; none of fewer than three dates."""
    dated = sorted(
        (image for image in found.images if image.given.day is not None),
        key=lambda image: (str(image.date), image.name),
    )
    days = [image.given.day.toordinal() for image in dated if image.given.day is not None]
    if len(set(days)) < DATES:
        return []
    width, height = SERIES_PX
    across = [MARGIN_PX + (day - days[0]) / (days[-1] - days[0]) * (width - 2 * MARGIN_PX) for day in days]
    made = []
    for axis, name in enumerate(("columns", "rows")):
        ends = [image.shift_px[axis] + sign * image.sigma_px[axis] for image in dated for sign in (-1.0, 1.0)]
        low, high = min(ends), max(max(ends), min(ends) + 1e-3)

        def down(value: float, low: float = low, high: float = high) -> float:
            return round(height - 25 - (value - low) / (high - low) * (height - 40), 1)

        bars = [
            Bar(
                f"{image.name}, {str(image.date)[:10]}: {image.shift_px[axis]:+.3f} px",
                round(x, 1),
                down(image.shift_px[axis]),
                down(image.shift_px[axis] + image.sigma_px[axis]),
                down(image.shift_px[axis] - image.sigma_px[axis]),
            )
            for image, x in zip(dated, across, strict=True)
        ]
        ticks = tuple((down(value), f"{value:+.2f}") for value in (low, (low + high) / 2, high))
        dates = ((across[0], str(dated[0].date)[:10]), (across[-1], str(dated[-1].date)[:10]))
        made.append(Series(name, tuple(bars), ticks, dates))
    return made


DATES: Final = 3
"""Least number of dates of a time series."""


def _ring(names: Sequence[str]) -> list[Node]:
    middle, radius = SIDE_PX / 2, SIDE_PX / 2 - MARGIN_PX
    nodes = []
    for number, name in enumerate(names):
        angle = 2 * math.pi * number / len(names) - math.pi / 2
        across, down = math.cos(angle), math.sin(angle)
        anchor = "middle" if abs(across) < 0.2 else "start" if across > 0 else "end"
        place = [
            round(middle + distance * side, 1)
            for distance in (radius, radius + 12)
            for side in (across, down)
        ]
        short = name if len(name) <= NAME_LENGTH else f"{name[: NAME_LENGTH - 1]}…"
        nodes.append(Node(name, short, place[0], place[1], place[2], place[3] + 4, anchor))
    return nodes


def _link(pair: StackPair, at: dict[str, Node]) -> Link:
    one, other = at[pair.reference], at[pair.target]
    title = f"{pair.reference} – {pair.target}: {pair.status}"
    if pair.offset_px is not None:
        title += f", {_offset_px(pair):.3f} px off, {pair.points} points"
    kind = (
        f"c{sum(_offset_px(pair) > limit for limit in CLASSES_PX)}" if pair.status == "used" else pair.status
    )
    return Link(one.x, one.y, other.x, other.y, kind.replace(" ", "-"), title)


def _class_names() -> list[str]:
    limits = [f"{limit:g}" for limit in CLASSES_PX]
    between = [f"{low} to {high} px" for low, high in pairwise(limits)]
    return [f"up to {limits[0]} px", *between, f"over {limits[-1]} px"]


def _offset_px(pair: StackPair) -> float:
    return 0.0 if pair.offset_px is None else math.hypot(*pair.offset_px)
