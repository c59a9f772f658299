"""The page of a stack: its grade, its worst image, all images, the net of pairs, those that do not fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from pcwlad_geo.correction.models import AffineCorrection, affine_between
from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.source import file_name
from pcwlad_geo.registration.prealign import Prealignment
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.report.figures import displacement_figure
from pcwlad_geo.report.page import Answer, Headline, State, page_environment
from pcwlad_geo.report.views import pair_views, read_backdrop
from pcwlad_geo.stacks.cycles import ORDER, root_mean_square
from pcwlad_geo.stacks.pairs import Frame, StackPair
from pcwlad_geo.stacks.result import Stack, StackImage
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import TiePointTable, predict_px

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
CARE: Final = {"good": "", "fair": ", with care", "poor": ", poorly"}
"""What the headline adds by the grade of the stack."""
STATES: Final[dict[str, State]] = {"good": "good", "fair": "caution", "poor": "bad", "refused": "bad"}
"""Colours of the grades of images."""
NAMED_DOUBTS: Final = 5
"""Number of images that the verdict names with what speaks against them."""
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


def page(found: Stack, frame: Frame | None = None) -> str:
    """Return the page, which holds everything that it shows; pictures only with the images of a frame."""
    nodes = _ring([image.name for image in found.images])
    at = {node.name: node for node in nodes}
    order = {"left out": 0, "refused": 1, "used": 2}
    pairs = sorted(found.pairs, key=lambda pair: (order[pair.status], -pair.off_px))
    images = sorted(found.images, key=lambda image: (ORDER.index(image.quality.grade), -image.suspicion))
    seen = None if frame is None else _worst_seen(found, frame, images)
    environment = page_environment("pcwlad_geo.stacks")
    return environment.get_template("stack.html.j2").render(
        found=found,
        block=found.block,
        images=images,
        headline=_headline(found),
        answers=[_how_well(found), _which_not(images), _trust(found)],
        states=STATES,
        seen=seen and (file_name(seen.target.uri), file_name(seen.reference.uri)),
        views=[] if seen is None else pair_views(seen),
        field=seen
        and displacement_figure(seen.tie_points, seen.reference.grid.shape, read_backdrop(seen.reference)),
        paper=False,
        series=_series(found),
        wide=SERIES_PX,
        groups=max(image.group for image in found.images) + 1,
        pairs=[(pair, pair.off_px) for pair in pairs],
        nodes=nodes,
        links=[_link(pair, at) for pair in reversed(pairs)],
        side=SIDE_PX,
        beside=BESIDE_PX,
        named=len(nodes) <= MAX_NAMED,
        classes=_class_names(),
        model=MODEL_NAMES.get(found.images[-1].correction.name, found.images[-1].correction.name),
        added=[name for names in found.added for name in names],
    )


def _headline(found: Stack) -> Headline:
    placed, given = len(found.written.images), len(found.images)
    if not any(image.name != found.datum for image in found.written.images):
        return Headline("No image could be placed reliably", "bad")
    told = CARE[found.quality.grade] if placed == given else f", {given - placed} refused"
    told = ", but a requirement is not met" if found.passed is False else told
    count = f"{placed} of {given}" if placed < given else f"{given}"
    state = "bad" if found.passed is False else STATES[found.quality.grade]
    return Headline(f"{count} images in one frame{told}", state)


def _how_well(found: Stack) -> Answer:
    images = found.written.images or found.images
    expected = max(images, key=lambda image: image.quality.expected_ce90_px)
    sigma = max(max(image.sigma_px) for image in images)
    datum = "the mean of all" if found.datum == "mean" else f"{found.datum}, which stays"
    text = (
        f"90 % of every image is expected to lie within {expected.quality.expected_ce90_px:.2f} px "
        f"(worst: {expected.name}). Positions have a sigma of {sigma:.3f} px or better, relative to {datum}."
    )
    return Answer("How well?", text, STATES[min((each.quality.grade for each in images), key=ORDER.index)])


def _which_not(images: Sequence[StackImage]) -> Answer:
    """Name the images, the worst first, that are not good."""
    doubts = [image for image in images if image.quality.grade != "good"]
    told = [f"{each.name} is {each.quality.grade}: {each.quality.reasons[0]}" for each in doubts]
    more = [f"and {len(told) - NAMED_DOUBTS} more"] if len(told) > NAMED_DOUBTS else []
    text = "; ".join([*told[:NAMED_DOUBTS], *more]) or "All images are good"
    return Answer("Which images not?", f"{text}.", STATES[images[0].quality.grade])


def _trust(found: Stack) -> Answer:
    """Tell how far the pairs of the images that are not refused agree."""
    placed = {image.name for image in found.written.images}
    pairs = [each for each in found.pairs if each.offset_px and {each.reference, each.target} <= placed]
    used = [pair.off_px for pair in pairs if pair.status == "used"]
    away, closure = len(pairs) - len(used), found.closure
    text = f"{len(used)} of {len(pairs)} pairs agree to {root_mean_square(used) or 0.0:.3f} px (RMS)"
    if away:
        text += f"; {away} {'pair contradicts' if away == 1 else 'pairs contradict'} the others"
    if closure.before_px is None:
        return Answer("Do the pairs agree?", f"{text}. No cycle of pairs checks them.", "caution")
    text += f". Cycles of pairs ({closure.cycles}) close to {closure.before_px:.3f} px"
    if closure.after_px not in (None, closure.before_px):
        text += f", without those left out to {closure.after_px:.3f} px"
    return Answer("Do the pairs agree?", f"{text}.", "caution" if away else "good")


def _worst_seen(found: Stack, frame: Frame, images: Sequence[StackImage]) -> Registration | None:
    """Return the worst image as the stack registers it to another, the reference if they were matched.

    None where its files cannot be read, or no pair of it could be matched.
    """
    worst = next((image for image in images if image.name != found.datum), images[0])
    measured = [pair for pair in found.pairs if pair.offset_px is not None]
    about = [pair for pair in measured if worst.name in (pair.reference, pair.target)]
    if not about:
        return None
    pair = max(about, key=lambda each: (found.reference in (each.reference, each.target), each.points))
    backwards = pair.reference == worst.name
    other = pair.target if backwards else pair.reference
    beside = next(image for image in images if image.name == other)
    reference, target = (frame.infos[frame.names.index(name)] for name in (other, worst.name))
    try:
        points = read_point_file(pair.folder / "tiepoints.csv")
    except InputError:
        return None
    good = points.enabled
    at_px, seen_px = (points.reference[good], points.target[good])[:: -1 if backwards else 1]
    predicted = predict_px(at_px, reference, target)
    correction = worst.correction
    if not np.allclose(beside.correction.forward(at_px), at_px):
        moved = correction.forward(predict_px(beside.correction.inverse(at_px), reference, target))
        correction = AffineCorrection("affine", affine_between(predicted, moved))
    count = len(at_px)
    table = TiePointTable(
        reference_px=at_px,
        target_px=seen_px,
        predicted_px=predicted,
        xy=at_px,
        displacement_m=np.full((count, 2), np.nan),
        covariance_px2=np.tile(np.eye(2), (count, 1, 1)),
        score=-np.hypot(*(at_px - at_px.mean(axis=0)).T),  # the middle is shown
        residual_px=seen_px - correction.forward(predicted),
        status=np.full(count, "matched"),
        crs=reference.grid.crs,
    )
    start = Prealignment("georeferencing", (0.0, 0.0), 0)
    return Registration(
        *("registered", None, (), reference, target, frame.grid, None),
        *(start, table, correction, {}, {}, {}, Settings()),
    )


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
        title += f", {pair.off_px:.3f} px off, {pair.points} points"
    kind = f"c{sum(pair.off_px > limit for limit in CLASSES_PX)}" if pair.status == "used" else pair.status
    return Link(one.x, one.y, other.x, other.y, kind.replace(" ", "-"), title)


def _class_names() -> list[str]:
    limits = [f"{limit:g}" for limit in CLASSES_PX]
    between = [f"{low} to {high} px" for low, high in pairwise(limits)]
    return [f"up to {limits[0]} px", *between, f"over {limits[-1]} px"]
