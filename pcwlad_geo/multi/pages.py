"""The pages of a band QA (matrix, maps, triangles) and of a stack (net of pairs, time series), CSS px."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from jinja2 import Environment

from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.models import AffineCorrection, affine_between
from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.adjustment import MIN_REDUNDANCY
from pcwlad_geo.multi.bands import CLOSES_PX, SQUARES, closes, larger_axis_px
from pcwlad_geo.multi.cycles import GRADES_OF_IMAGES, root_mean_square
from pcwlad_geo.multi.qa_result import Summary
from pcwlad_geo.multi.stack_frame import StackFrame
from pcwlad_geo.multi.stack_pairs import StackPair
from pcwlad_geo.multi.stack_result import Stack, StackImage
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.write import NAMES
from pcwlad_geo.raster.file_tree import file_name
from pcwlad_geo.registration import Prealignment, Registration
from pcwlad_geo.report import figures
from pcwlad_geo.report.page import Answer, Headline, State, page_environment, templates_of
from pcwlad_geo.report.views import pair_views, read_backdrop
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import TiePointTable, predict_px

MAP_SIDE_PX: Final = 220.0
"""Longer side of a map, CSS px."""
MAP_MARGIN_PX: Final = 8.0
"""Margin around a map for the arrows at its edge, CSS px."""


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
    """Return the maps of the measured pairs of a summary, by decreasing CE90; `shapes` are (rows, cols)."""
    measured = [pair for pair in pairs if pair["local"]]
    worst = sorted(measured, key=lambda pair: -float(pair["displacement"]["px"]["radial"]["ce90"]))
    return [_map(pair, shapes[pair["target"]]) for pair in worst[:12]]


def _map(pair: Mapping[str, Any], shape: Sequence[int]) -> DisplacementMap:
    rows, cols = shape
    scale = MAP_SIDE_PX / max(rows, cols)
    longest = max(math.hypot(*each["mean_px"]) for each in pair["local"])
    arrow = 0.85 * MAP_SIDE_PX / SQUARES
    per_px = arrow / max(longest, 0.05)  # smaller ones would only show noise
    return DisplacementMap(
        name=pair["name"],
        width=round(cols * scale + 2 * MAP_MARGIN_PX, 1),
        height=round(rows * scale + 2 * MAP_MARGIN_PX, 1),
        arrows=tuple(_arrow(each, scale, per_px) for each in pair["local"]),
        longest_px=longest,
    )


def _arrow(local: Mapping[str, Any], scale: float, per_px: float) -> Arrow:
    """Return an arrow centred on its square."""
    (col, row), (d_col, d_row) = local["at_px"], local["mean_px"]
    dx, dy = d_col * per_px, d_row * per_px
    turn = round(math.degrees(math.atan2(dy, dx)))
    return Arrow(
        round(MAP_MARGIN_PX + col * scale - dx / 2, 1),
        round(MAP_MARGIN_PX + row * scale - dy / 2, 1),
        round(dx, 1),
        round(dy, 1),
        turn,
    )


CE90_CLASSES_PX: Final = (0.1, 0.2, 0.3, 0.5, 1.0)
"""Class limits of CE90 for the colours of the matrix, constant so that pages can be compared."""
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


def qa_page(summary: Summary) -> str:
    """Return the text of `qa.html`.

    The `summary` is the result of `summarise`.
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
            title=few(names),
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
            classes=_class_names(CE90_CLASSES_PX),
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
    environment = templates_of("pcwlad_geo.multi")
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
    level = sum(px["radial"]["ce90"] > limit for limit in CE90_CLASSES_PX)
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


def _class_names(limits: Sequence[float], between: str = "–", unit: str = "") -> list[str]:
    """Return the labels of a legend, lowest class first."""
    texts = [f"{limit:g}" for limit in limits]
    names = [f"up to {texts[0]}", *map(between.join, pairwise(texts)), f"over {texts[-1]}"]
    return [name + unit for name in names]


def _where(band: Mapping[str, Any]) -> str:
    """Return file and number of a band, unless its name contains them."""
    stem = Path(band["path"]).stem
    return "" if stem.endswith(band["name"]) else f"{stem}, band {band['band']}"


def _warnings(pairs: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Return each warning once, with the pairs to which it applies."""
    found: dict[str, list[str]] = {}
    for pair in pairs:
        for warning in pair["warnings"]:
            found.setdefault(warning, []).append(pair["name"])
    return list(found.items())


NET_SIDE_PX: Final = 460.0
"""Side of the drawing of the net, CSS px."""
NET_MARGIN_PX: Final = 60.0
"""Margin around the ring of images for their names, CSS px."""
NAME_LENGTH: Final = 24
"""Largest number of characters of a name in the drawing."""
OFFSET_CLASSES_PX: Final = (0.02, 0.05, 0.1, 0.3)
"""Class limits of the offset of a pair for its colour, constant so that pages can be compared."""
QUALIFIERS: Final = {"good": "", "fair": ", with care", "poor": ", poorly"}
"""What the headline adds by the grade of the stack."""
STATES: Final[dict[str, State]] = {"good": "good", "fair": "caution", "poor": "bad", "refused": "bad"}
"""Colours of the grades of images."""
NAMED_DOUBTS: Final = 5
"""Number of images that the verdict names with what speaks against them."""


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


def _report_of(pair: StackPair) -> str:
    """Return the name of a pair's report page, or of its numbers where it was matched without a page."""
    page, numbers = (NAMES[kind] for kind in ("report", "numbers"))
    without_page = (pair.folder / numbers).exists() and not (pair.folder / page).exists()
    return numbers if without_page else page


def stack_page(found: Stack, frame: StackFrame | None = None) -> str:
    """Return the page, which holds everything that it shows; pictures only with the images of a frame."""
    nodes = _ring([image.name for image in found.images])
    at = {node.name: node for node in nodes}
    order = {"left out": 0, "refused": 1, "used": 2}
    pairs = sorted(found.pairs, key=lambda pair: (order[pair.status], -pair.off_px))
    images = sorted(
        found.images,
        key=lambda image: (
            GRADES_OF_IMAGES.index(image.quality.grade),
            -image.misfit_sigmas,
            -image.quality.expected_ce90_px,
        ),
    )
    worst_pair = None if frame is None else _worst_registration(found, frame, images)
    environment = page_environment("pcwlad_geo.multi")
    environment.filters["signed"] = signed
    return environment.get_template("stack.html.j2").render(
        found=found,
        block=found.block,
        images=images,
        headline=_headline(found),
        answers=[_accuracy_answer(found), _doubts_answer(images), _agreement_answer(found)],
        states=STATES,
        worst_pair=worst_pair and (file_name(worst_pair.target.uri), file_name(worst_pair.reference.uri)),
        views=[] if worst_pair is None else pair_views(worst_pair),
        field=worst_pair
        and figures.displacement_figure(
            worst_pair.tie_points, worst_pair.reference.grid.shape, read_backdrop(worst_pair.reference)
        ),
        paper=False,
        in_time=_shifts_in_time(found),
        groups=max(image.group for image in found.images) + 1,
        pairs=[(pair, pair.off_px, _report_of(pair)) for pair in pairs],
        nodes=nodes,
        links=[_link(pair, at) for pair in reversed(pairs)],
        side=NET_SIDE_PX,
        name_width=100.0,
        named=len(nodes) <= 40,
        classes=_class_names(OFFSET_CLASSES_PX, " to ", " px"),
        model=MODELS[found.images[-1].correction.name].words,
        added=[name for names in found.added for name in names],
    )


def _headline(found: Stack) -> Headline:
    placed, given = len(found.written.images), len(found.images)
    if not any(image.name != found.datum for image in found.written.images):
        return Headline("No image could be placed reliably", "bad")
    qualifier = QUALIFIERS[found.quality.grade] if placed == given else f", {given - placed} refused"
    qualifier = ", but a requirement is not met" if found.passed is False else qualifier
    count = f"{placed} of {given}" if placed < given else f"{given}"
    state = "bad" if found.passed is False else STATES[found.quality.grade]
    return Headline(f"{count} images in one frame{qualifier}", state)


def _accuracy_answer(found: Stack) -> Answer:
    images = found.written.images or found.images
    expected = max(images, key=lambda image: image.quality.expected_ce90_px)
    sigma = max(max(image.sigma_px) for image in images)
    datum = "the mean of all" if found.datum == "mean" else f"{found.datum}, which stays"
    text = (
        f"90 % of every image is expected to lie within {expected.quality.expected_ce90_px:.3f} px "
        f"(worst: {expected.name}). Positions have a sigma of {sigma:.3f} px or better, relative to {datum}."
    )
    return Answer(
        "How well?", text, STATES[min((each.quality.grade for each in images), key=GRADES_OF_IMAGES.index)]
    )


def _doubts_answer(images: Sequence[StackImage]) -> Answer:
    """Name the images, the worst first, that are not good."""
    doubts = [image for image in images if image.quality.grade != "good"]
    reasons = [f"{each.name} is {each.quality.grade}: {each.quality.reasons[0]}" for each in doubts]
    more = [f"and {len(reasons) - NAMED_DOUBTS} more"] if len(reasons) > NAMED_DOUBTS else []
    text = "; ".join([*reasons[:NAMED_DOUBTS], *more]) or "All images are good"
    return Answer("Which images not?", f"{text}.", STATES[images[0].quality.grade])


def _agreement_answer(found: Stack) -> Answer:
    """Tell how far the pairs of the images that are not refused agree."""
    placed = {image.name for image in found.written.images}
    pairs = [each for each in found.pairs if each.offset_px and {each.reference, each.target} <= placed]
    used = [pair for pair in pairs if pair.status == "used"]
    checked = [pair.off_px for pair in used if (pair.redundancy or 0.0) >= MIN_REDUNDANCY]
    away, alone, closure = len(pairs) - len(used), len(used) - len(checked), found.closure
    against = f"; {away} {'pair contradicts' if away == 1 else 'pairs contradict'} the others" if away else ""
    if not checked:
        several = f"{len(used)} pairs that form no cycle cannot check each other"
        text = "one pair cannot be checked by others" if len(used) == 1 else several
        return Answer("Do the pairs agree?", f"Nothing tells: {text}{against}.", "caution")
    unchecked = f", {alone} of them checked by no other" if alone else ""
    text = (
        f"{len(used)} of {len(pairs)} pairs agree to {root_mean_square(checked) or 0.0:.3f} px (RMS)"
        f"{unchecked}{against}"
    )
    if closure.before_px is None:
        return Answer("Do the pairs agree?", f"{text}. No three or four of them form a cycle.", "caution")
    text += f". Cycles of pairs ({closure.cycles}) close to {closure.before_px:.3f} px"
    if closure.after_px not in (None, closure.before_px):
        text += f", without those left out to {closure.after_px:.3f} px"
    return Answer("Do the pairs agree?", f"{text}.", "caution" if away else "good")


def _worst_registration(found: Stack, frame: StackFrame, images: Sequence[StackImage]) -> Registration | None:
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
        moved = correction.forward(predict_px(partner.correction.inverse(at_px), reference, target))
        correction = AffineCorrection("affine", affine_between(predicted, moved))
    count = len(at_px)
    table = TiePointTable(
        reference_px=at_px,
        target_px=observed_px,
        predicted_px=predicted,
        xy=at_px,
        displacement_m=np.full((count, 2), np.nan),
        covariance_px2=np.tile(np.eye(2), (count, 1, 1)),
        score=-np.hypot(*(at_px - at_px.mean(axis=0)).T),  # the middle is shown
        residual_px=observed_px - correction.forward(predicted),
        status=np.full(count, "matched"),
        crs=reference.grid.crs,
    )
    return Registration(
        status="registered",
        reason=None,
        warnings=(),
        reference=reference,
        target=target,
        matching_grid=frame.grid,
        px_m=None,
        prealignment=Prealignment("georeferencing", (0.0, 0.0), 0),
        tie_points=table,
        correction=correction,
        accuracy={},
        counts={},
        seconds={},
        settings=Settings(),
    )


def _shifts_in_time(found: Stack) -> tuple[str, str] | None:
    """Return a picture of the shifts by date, and what it shows; None of fewer than three dates."""
    dated = [image for image in found.images if image.given.day is not None]
    dated.sort(key=lambda image: (str(image.date), image.name))
    days = np.array([image.given.day for image in dated], "datetime64[D]")
    if len(np.unique(days)) < 3:
        return None
    moved_px, sigma_px = (
        np.array([getattr(each, name) for each in dated]) for name in ("shift_px", "sigma_px")
    )
    no_model, none = np.full(moved_px.shape, np.nan), np.zeros(len(dated), bool)
    span = days[0], days[-1]
    line = figures.TimeLine(days, moved_px, np.hypot(*sigma_px.T) / 2**0.5, no_model, none, (), span)
    return figures.time_line_figure(line), f"{len(dated)} images from {span[0]} to {span[1]}"


def _ring(names: Sequence[str]) -> list[Node]:
    middle, radius = NET_SIDE_PX / 2, NET_SIDE_PX / 2 - NET_MARGIN_PX
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
    kind = (
        f"c{sum(pair.off_px > limit for limit in OFFSET_CLASSES_PX)}"
        if pair.status == "used"
        else pair.status
    )
    return Link(one.x, one.y, other.x, other.y, kind.replace(" ", "-"), title)
