"""The page of a stack: the net of its pairs, its worst image, and its shifts over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.correction.error_statistics import FitAccuracy
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.pages import class_names, signed
from pcwlad_geo.multi.stack.closure import root_mean_square
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.pair import StackPair
from pcwlad_geo.multi.stack.parameters import GRADING
from pcwlad_geo.multi.stack.quality import GRADES_OF_IMAGES
from pcwlad_geo.multi.stack.result import Stack, StackImage
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.files import OUTPUT_NAMES
from pcwlad_geo.raster import RasterInfo, file_name
from pcwlad_geo.registration import Decision, Prealignment, Registration
from pcwlad_geo.report.answers import Answer, Headline, State
from pcwlad_geo.report.maps import displacement_figure
from pcwlad_geo.report.page_templates import page_environment
from pcwlad_geo.report.time_lines import TimeLine, time_line_figure
from pcwlad_geo.report.views import VIEWS, pair_views, read_backdrop
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import TiePointTable, predict_px
from pcwlad_geo.types import Float64

QUALIFIERS: Final = {"good": "", "fair": ", with care", "poor": ", poorly"}
"""What the headline adds by the grade of the stack."""
STATES: Final[dict[str, State]] = {"good": "good", "fair": "caution", "poor": "bad", "refused": "bad"}
"""Colours of the grades of images."""


@dataclass(frozen=True, slots=True)
class StackLayout:
    """Sizes of the page."""

    net_side_px: float = 460.0
    """Side of the drawing of the net, CSS px."""
    net_margin_px: float = 60.0
    """Margin around the ring of images for their names, CSS px."""
    name_length: int = 24
    """Largest number of characters of a name in the drawing."""
    offset_classes_px: tuple[float, ...] = (0.02, 0.05, 0.1, 0.3)
    """Class limits of the offset of a pair for its colour, the same on all pages so that they can be
    compared."""
    named_doubts: int = 5
    """Number of images that the verdict names with what speaks against them."""


STACK_LAYOUT: Final = StackLayout()
"""The layout in use."""


@dataclass(frozen=True, slots=True)
class Node:
    """An image on the ring, CSS px."""

    name: str
    short: str
    """The name, shortened."""
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


def _report_of(pair: StackPair) -> str:
    """Return the name of a pair's report page, or of its numbers where it was matched without a page."""
    page, numbers = (OUTPUT_NAMES[kind] for kind in ("report", "numbers"))
    without_page = (pair.folder / numbers).exists() and not (pair.folder / page).exists()
    return numbers if without_page else page


def stack_page(result: Stack, frame: StackFrame | None = None, layout: StackLayout = STACK_LAYOUT) -> str:
    """Return the page, which holds everything that it shows; pictures only with the images of a frame."""
    nodes = _ring([image.name for image in result.images], layout)
    at = {node.name: node for node in nodes}
    order = {"left out": 0, "refused": 1, "used": 2}
    pairs = sorted(result.pairs, key=lambda pair: (order[pair.status], -pair.off_px))
    images = sorted(
        result.images,
        key=lambda image: (
            GRADES_OF_IMAGES.index(image.quality.grade),
            -image.misfit_sigmas,
            -image.quality.expected_ce90_px,
        ),
    )
    worst_pair = None if frame is None else _worst_registration(result, frame, images)
    environment = page_environment("pcwlad_geo.multi")
    environment.filters["signed"] = signed
    return environment.get_template("stack.html.j2").render(
        result=result,
        block=result.block,
        images=images,
        headline=_headline(result),
        answers=[
            _accuracy_answer(result),
            _doubts_answer(images, layout.named_doubts),
            _agreement_answer(result),
        ],
        states=STATES,
        worst_pair=worst_pair and (file_name(worst_pair.target.uri), file_name(worst_pair.reference.uri)),
        views=[] if worst_pair is None else pair_views(worst_pair, replace(VIEWS, places=2)),
        whole=None,
        field=worst_pair
        and displacement_figure(
            worst_pair.tie_points, worst_pair.reference.grid.shape, read_backdrop(worst_pair.reference)
        ),
        paper=False,
        in_time=_shifts_in_time(result),
        groups=max(image.group for image in result.images) + 1,
        pairs=[(pair, pair.off_px, _report_of(pair)) for pair in pairs],
        nodes=nodes,
        links=[_link(pair, at, layout) for pair in reversed(pairs)],
        side=layout.net_side_px,
        name_width=100.0,
        named=len(nodes) <= 40,
        classes=class_names(layout.offset_classes_px, " to ", " px"),
        model=MODELS[result.images[-1].correction.name].words,
        added=[name for names in result.added for name in names],
    )


def _headline(result: Stack) -> Headline:
    placed_count, total = len(result.written.images), len(result.images)
    if not any(image.name != result.datum for image in result.written.images):
        return Headline("No image could be placed reliably", "bad")
    qualifier = (
        QUALIFIERS[result.quality.grade] if placed_count == total else f", {total - placed_count} refused"
    )
    qualifier = ", but a requirement is not met" if result.passed is False else qualifier
    count = f"{placed_count} of {total}" if placed_count < total else f"{total}"
    state = "bad" if result.passed is False else STATES[result.quality.grade]
    return Headline(f"{count} images in one frame{qualifier}", state)


def _accuracy_answer(result: Stack) -> Answer:
    images = result.written.images or result.images
    expected = max(images, key=lambda image: image.quality.expected_ce90_px)
    sigma = max(max(image.sigma_px) for image in images)
    datum = "the mean of all" if result.datum == "mean" else f"{result.datum}, which stays"
    text = (
        f"90 % of every image is expected to lie within {expected.quality.expected_ce90_px:.3f} px "
        f"(worst: {expected.name}). Positions have a sigma of {sigma:.3f} px or better, relative to {datum}."
    )
    return Answer(
        "How well?", text, STATES[min((image.quality.grade for image in images), key=GRADES_OF_IMAGES.index)]
    )


def _doubts_answer(images: Sequence[StackImage], most: int) -> Answer:
    """Name the images, the worst first, that are not good, `most` of them."""
    doubts = [image for image in images if image.quality.grade != "good"]
    reasons = [f"{image.name} is {image.quality.grade}: {image.quality.reasons[0]}" for image in doubts]
    more = [f"and {len(reasons) - most} more"] if len(reasons) > most else []
    text = "; ".join([*reasons[:most], *more]) or "All images are good"
    return Answer("Which images not?", f"{text}.", STATES[images[0].quality.grade])


def _agreement_answer(result: Stack) -> Answer:
    """Tell how far the pairs of the images that are not refused agree."""
    names = {image.name for image in result.written.images}
    pairs = [pair for pair in result.pairs if pair.offset_px and {pair.reference, pair.target} <= names]
    in_use = [pair for pair in pairs if pair.status == "used"]
    checked = [pair.off_px for pair in in_use if (pair.redundancy or 0.0) >= GRADING.min_redundancy]
    away, unchecked_count, closure = len(pairs) - len(in_use), len(in_use) - len(checked), result.closure
    against = f"; {away} {'pair contradicts' if away == 1 else 'pairs contradict'} the others" if away else ""
    if not checked:
        several = f"{len(in_use)} pairs that form no cycle cannot check each other"
        text = "one pair cannot be checked by others" if len(in_use) == 1 else several
        return Answer("Do the pairs agree?", f"Nothing tells: {text}{against}.", "caution")
    unchecked = f", {unchecked_count} of them checked by no other" if unchecked_count else ""
    text = (
        f"{len(in_use)} of {len(pairs)} pairs agree to {root_mean_square(checked) or 0.0:.3f} px (RMS)"
        f"{unchecked}{against}"
    )
    if closure.before_px is None:
        return Answer("Do the pairs agree?", f"{text}. No three or four of them form a cycle.", "caution")
    text += f". Cycles of pairs ({closure.cycles}) close to {closure.before_px:.3f} px"
    if closure.after_px not in (None, closure.before_px):
        text += f", without those left out to {closure.after_px:.3f} px"
    return Answer("Do the pairs agree?", f"{text}.", "caution" if away else "good")


def _worst_registration(
    result: Stack, frame: StackFrame, images: Sequence[StackImage]
) -> Registration | None:
    """Return the worst image as the stack registers it to another, the reference if they were matched.

    None where its files cannot be read, or no pair of it could be matched.
    """
    worst = next((image for image in images if image.name != result.datum), images[0])
    measured = [pair for pair in result.pairs if pair.offset_px is not None]
    about = [pair for pair in measured if worst.name in (pair.reference, pair.target)]
    if not about:
        return None
    pair = max(
        about,
        key=lambda candidate: (result.reference in (candidate.reference, candidate.target), candidate.points),
    )
    backwards = pair.reference == worst.name
    other = pair.target if backwards else pair.reference
    partner = next(image for image in images if image.name == other)
    reference, target = (frame.infos[frame.names.index(name)] for name in (other, worst.name))
    try:
        points = read_point_file(pair.folder / "tiepoints.csv")
    except InputError:
        return None
    good = points.enabled
    at_px, observed_px = (points.reference[good], points.target[good])[:: -1 if backwards else 1]
    predicted = predict_px(at_px, reference, target)
    correction = worst.correction
    if not np.allclose(partner.correction.forward(at_px), at_px):
        displaced_px = correction.forward(predict_px(partner.correction.inverse(at_px), reference, target))
        correction = AffineCorrection.fit(predicted, displaced_px)
    table = _table(reference, at_px, observed_px, predicted, correction)
    return Registration(
        decision=Decision(),
        warnings=(),
        reference=reference,
        target=target,
        matching_grid=frame.grid,
        px_m=None,
        prealignment=Prealignment("georeferencing", (0.0, 0.0), 0),
        tie_points=table,
        model=correction,
        accuracy=FitAccuracy(),
        counts={},
        seconds={},
        settings=Settings(),
    )


def _table(
    reference: RasterInfo,
    at_px: Float64,
    observed_px: Float64,
    predicted_px: Float64,
    correction: Correction,
) -> TiePointTable:
    """Return tie points with their residuals; the one nearest to the middle has the highest score."""
    count = len(at_px)
    return TiePointTable(
        reference_px=at_px,
        target_px=observed_px,
        predicted_px=predicted_px,
        xy=at_px,
        displacement_m=np.full((count, 2), np.nan),
        covariance_px2=np.tile(np.eye(2), (count, 1, 1)),
        score=-np.hypot(*(at_px - at_px.mean(axis=0)).T),  # the middle is shown
        residual_px=observed_px - correction.forward(predicted_px),
        status=np.full(count, "matched"),
        crs=reference.grid.crs,
    )


def _shifts_in_time(result: Stack) -> tuple[str, str] | None:
    """Return a picture of the shifts by date, and what it shows; None of fewer than three dates."""
    dated = [image for image in result.images if image.given.day is not None]
    dated.sort(key=lambda image: (str(image.date), image.name))
    days = np.array([image.given.day for image in dated], "datetime64[D]")
    if len(np.unique(days)) < 3:
        return None
    moved_px, sigma_px = (
        np.array([getattr(image, name) for image in dated]) for name in ("shift_px", "sigma_px")
    )
    no_model, none = np.full(moved_px.shape, np.nan), np.zeros(len(dated), bool)
    span = days[0], days[-1]
    line = TimeLine(days, moved_px, np.hypot(*sigma_px.T) / 2**0.5, no_model, none, (), span)
    return time_line_figure(line), f"{len(dated)} images from {span[0]} to {span[1]}"


def _ring(names: Sequence[str], layout: StackLayout) -> list[Node]:
    middle, longest = layout.net_side_px / 2, layout.name_length
    radius = middle - layout.net_margin_px
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
        short = name if len(name) <= longest else f"{name[: longest - 1]}…"
        nodes.append(Node(name, short, place[0], place[1], place[2], place[3] + 4, anchor))
    return nodes


def _link(pair: StackPair, at: dict[str, Node], layout: StackLayout) -> Link:
    one, other = at[pair.reference], at[pair.target]
    title = f"{pair.reference} – {pair.target}: {pair.status}"
    if pair.offset_px is not None:
        title += f", {pair.off_px:.3f} px off, {pair.points} points"
    kind = (
        f"c{sum(pair.off_px > limit for limit in layout.offset_classes_px)}"
        if pair.status == "used"
        else pair.status
    )
    return Link(one.x, one.y, other.x, other.y, kind.replace(" ", "-"), title)
