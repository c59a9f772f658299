"""The pairs of a stack: what the matching of each gives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from pcwlad_geo.errors import InputError, OutputError, RegistrationRejectedError
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.job import match_elsewhere, match_files, write_match
from pcwlad_geo.limits import check_coordinates
from pcwlad_geo.options import Settings
from pcwlad_geo.products import of_one_product
from pcwlad_geo.raster.geodesy import middle_pixel_size_m
from pcwlad_geo.raster.grid import Grid, jacobian, linear_part, map_px
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.registration.fitting import (
    FAIR_PX,
    FEW_KEPT,
    GOOD_PX,
    GRADES,
    Grade,
    Reason,
    displaced_otherwise,
)
from pcwlad_geo.registration.inputs import estimate_tile_count
from pcwlad_geo.registration.judge import GEOREFERENCED_PX, Motion, told_of
from pcwlad_geo.report.finished import read_report, report_of_same_job
from pcwlad_geo.stacks.inputs import StackInput, number_of, read_table
from pcwlad_geo.stacks.network import Edge, basis_over, components
from pcwlad_geo.text import joined
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.types import Bool, Float64, PathLike

if TYPE_CHECKING:
    from pcwlad_geo.registration.result import Registration

PAIRS: Final = "pairs"
"""Folder of the pairs that were measured."""
SMALL_TILES: Final = 4
"""Pairs of so many tiles or fewer are matched as a whole, several at a time."""
MIN_PAIR_POINTS: Final = 12
"""Least number of tie points of a pair."""
MIN_CONTROL: Final = 4
"""Least number of control points of an image."""
LEAST_CONTROL_SIGMA_PX: Final = 1e-3
"""Least standard deviation of a control point: no position in an image is known better, px of the frame."""
CONTROL_SIGMA_PX: Final = 0.5
"""Standard deviation of a control point where the table tells none, px of the frame."""

PLACE_PX: Final = 60.0
"""Side of the squares that count as separate places of a pair, px of the frame: as the pair's own verdict."""
PRODUCT_SIGMA_M: Final = 5.0
"""Standard deviation of a band of a product beside another along an axis, metres: what Landsat 8 requires of
its bands (LE90 4.5 m, thermal ones 30 m), and Sentinel-2 (0.3 px at three sigmas), is on both sides of it."""
CONTROL_EVIDENCE: Final = 50.0
"""Evidence of control points: as of a pair with points in so many places."""

PairStatus = Literal["used", "left out", "refused"]


@dataclass(frozen=True, slots=True, eq=False)
class StackPair:
    """A pair of images, and how it agrees with all others."""

    reference: str
    target: str
    status: PairStatus
    """`left out`: its points contradict the other pairs; `refused`: it could not be matched."""
    reason: str | None
    folder: Path
    """Its tie points and report; in stack.json relative to that file."""
    points: int = 0
    offset_px: tuple[float, float] | None = None
    """By how much its points lie off the adjustment on average (col, row), px of the frame."""
    sigma_px: float | None = None
    """Standard deviation of that along an axis, if the pair is right."""
    redundancy: float | None = None
    """Share of the offset that other pairs check; nothing tells whether a pair of 0 is wrong."""
    scatter_px: float | None = None
    """Robust standard deviation of its points along an axis, px of the frame."""
    quality: Grade | None = None
    """Of the pair by itself: how far its matches agree with one smooth displacement; null where refused."""
    quality_reasons: tuple[str, ...] = ()
    """Why it is not good."""
    motions: tuple[Motion, ...] = ()
    """What parts of its matches agree on, where that is more than one displacement: that used comes first."""
    ce90_px: float | None = None
    """Distance from the adjustment within which 90 % of its points lie, five neighbours averaged, px of the
    frame."""
    empty_share: float | None = None
    """Of the squares of its reference in which both images have data, the part without a tie point."""
    jitter_px: float = 0.0
    """By how much rows and columns move within a window that matched it, RMS, target px; 0 where not seen."""

    @property
    def off_px(self) -> float:
        """Length of its offset, px of the frame; 0 of one that was refused."""
        return math.hypot(*self.offset_px or (0.0, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """The images, and the grid in whose px all are compared."""

    names: list[str]
    infos: list[RasterInfo]
    grid: Grid
    placed: bool
    """Whether all images are georeferenced; otherwise their pixels are compared."""
    inputs: tuple[StackInput, ...] = ()
    """The images as they were named; none: the files of `infos`."""
    reference: int = 0
    """Number of the image whose grid it is."""

    def given(self, image: int) -> StackInput:
        """Return an image as it was named."""
        info = self.infos[image]
        return self.inputs[image] if self.inputs else StackInput(info.uri, info.band, self.names[image])

    def from_image(self, image: int, px: Float64) -> Float64:
        """Map the (n, 2) `px` of an image to px of the frame by its georeferencing."""
        return map_px(px, self.infos[image].grid, self.grid) if self.placed else px

    def to_image(self, image: int, px: Float64) -> Float64:
        """Map the (n, 2) `px` of the frame to px of an image."""
        return map_px(px, self.grid, self.infos[image].grid) if self.placed else px

    def scale(self, image: int, px: Float64) -> Float64:
        """Return the (n, 2, 2) derivatives of the frame's px by an image's, at its (n, 2) `px`."""
        if not self.placed:
            return np.broadcast_to(np.eye(2), (len(px), 2, 2))
        return jacobian(px, self.infos[image].grid, self.grid)


Measured = tuple[Edge | None, StackPair]


def measure(
    frame: Frame,
    chosen: Sequence[tuple[int, int]],
    folder: Path,
    settings: Settings,
    overwrite: bool,
    on_event: EventCallback,
    runner: Runner,
) -> Iterator[Measured]:
    """Yield what each pair gave, matched now or by an earlier run on the same files.

    Pairs of few tiles are matched each as a whole, several at a time; of larger ones, one after another, the
    tiles are.
    """
    tasks = [_task(frame, pair, folder, settings) for pair in chosen]
    on_event(Progress("pairs", 0, len(tasks)))
    todo = [number for number, task in enumerate(tasks) if overwrite or not task.finished()]
    small = [number for number in todo if tasks[number].small]
    refused = _match_whole([tasks[number] for number in small], len(tasks), len(todo), on_event, runner)
    reasons = dict(zip(small, refused, strict=True))
    for done, number in enumerate(sorted(set(todo) - set(small)), len(tasks) - len(todo) + len(small)):
        on_event(Progress("pairs", done, len(tasks)))
        reasons[number] = match_pair(*tasks[number].arguments, on_event, runner)
    for number, (pair, task) in enumerate(zip(chosen, tasks, strict=True)):
        yield measured_pair(frame, pair, task.place, reasons.get(number), on_event)
    on_event(Progress("pairs", len(tasks), len(tasks)))


def measured_pair(
    frame: Frame, pair: tuple[int, int], place: Path, reason: str | None, on_event: EventCallback
) -> Measured:
    """Return what a matched pair gave, from its folder unless there is a reason that it gave nothing."""
    names = frame.names[pair[0]], frame.names[pair[1]]
    edge, report = None, {}
    if reason is None:
        report = read_report(place)  # also its warnings: a run that was killed and goes on tells the same
        for warning in report.get("warnings", ()):
            on_event(Warned(f"{names[0]} – {names[1]}: {warning}"))
        reason = str(report.get("reason")) if report.get("status") == "rejected" else None
        edge = edge_of(frame, *pair, place) if reason is None else None
    if edge is None:
        reason = reason or f"fewer than {MIN_PAIR_POINTS} tie points"
        on_event(Warned(f"{names[0]} – {names[1]}: refused: {reason}"))
    status: PairStatus = "refused" if edge is None else "used"
    found = StackPair(*names, status, reason, place, motions=_motions_of(report, place))
    return edge, found if edge is None else graded(found, edge, report)


def _motions_of(report: Mapping[str, Any], place: Path) -> tuple[Motion, ...]:
    """Return the motions in the report of a pair; raises `OutputError` if they are damaged."""
    try:
        motions = tuple(Motion(**each) for each in report.get("motions", ()))
        told_of(motions, taken=True)  # fails where a value is of a wrong type
    except (TypeError, ValueError) as error:
        raise OutputError(
            f"{place} has a damaged report ({error}): remove the folder, and run again"
        ) from error
    return motions


def graded(pair: StackPair, edge: Edge, report: Mapping[str, Any]) -> StackPair:
    """Return a pair with the grade that its points and its report give it."""
    left = _off_smooth(edge.first_xy, edge.second_xy, np.ones(len(edge), bool))
    off_px, counts = float(np.percentile(np.hypot(*left.T), 90)), report.get("tie_points", {})
    jitter_px = float(report.get("jitter_px", 0.0))
    kept = 1 - counts.get("rejected", 0) / max(counts.get("total", 0), 1)
    reasons: list[tuple[Grade, str]] = [("fair", told_of(pair.motions, taken=True))] if pair.motions else []
    if off_px > GOOD_PX:
        text = f"a tenth of its points lie more than {off_px:.2f} px off a smooth displacement"
        reasons.append(("fair" if off_px <= FAIR_PX else "poor", text))
    if kept < FEW_KEPT:
        reasons.append(("poor", f"only {100 * kept:.0f} % of the matches agree with their neighbours"))
    reasons += [(each.grade, each.text) for each in _displaced_otherwise(pair.folder)]
    grade: Grade = min((grade for grade, _ in reasons), key=GRADES.index, default="good")
    texts = tuple(text for _, text in reasons)
    return replace(pair, quality=grade, quality_reasons=texts, jitter_px=jitter_px)


def _displaced_otherwise(place: Path) -> Iterator[Reason]:
    """Yield a reason where many of the matches that a pair rejected agree on one other displacement."""
    points = read_point_file(place / "tiepoints.csv")
    off_px = _off_smooth(points.reference, points.target, points.enabled)
    return displaced_otherwise(off_px[~points.enabled], len(points.enabled))


def _off_smooth(first_xy: Float64, second_xy: Float64, kept: Bool) -> Float64:
    """Return how far (n, 2) displacements lie off a polynomial of those that are `kept`, an (n,) mask."""
    moved, values = second_xy - first_xy, basis_over([first_xy[kept]], "polynomial2").values(first_xy)
    return moved - values @ least_squares(values[kept], moved[kept])


@dataclass(frozen=True, slots=True)
class _Task:
    """A pair to be matched."""

    inputs: tuple[str, str]
    settings: Settings
    place: Path

    @property
    def arguments(self) -> tuple[tuple[str, str], Settings, Path]:
        """What `match_pair` and `match_elsewhere` are called with."""
        return self.inputs, self.settings, self.place

    @property
    def small(self) -> bool:
        """Whether it has few tiles, so that its processes would wait for each other."""
        return 0 < estimate_tile_count(*self.inputs, self.settings) <= SMALL_TILES

    def finished(self) -> bool:
        """Return whether an earlier run has matched it."""
        return bool(report_of_same_job("match", self.inputs, self.settings, self.place))


def _task(frame: Frame, pair: tuple[int, int], folder: Path, settings: Settings) -> _Task:
    first, second = (frame.given(image) for image in pair)
    own = {"ref_band": first.band, "tgt_band": second.band, "ref_mask": first.mask, "tgt_mask": second.mask}
    place = folder / PAIRS / f"{frame.names[pair[0]]}__{frame.names[pair[1]]}"
    matching = replace(settings, **PAIR_DEFAULTS, **own)  # type: ignore[arg-type]  # by name
    return _Task((first.path, second.path), matching, place)


def _match_whole(
    tasks: Sequence[_Task], count: int, left: int, on_event: EventCallback, runner: Runner
) -> list[str | None]:
    """Match pairs, several at a time; return why each was refused, None where the folder tells.

    `count` is the number of all pairs, of which `left` are not finished.
    """

    def of_all(event: Event) -> None:
        if isinstance(event, Progress):
            event = Progress("pairs", event.done + count - left, count)
        on_event(event)

    calls = [task.arguments for task in tasks]
    if not tasks:
        return []
    if runner.shares_kernels:  # on this machine: each is written where it is matched
        return runner.run(match_pair, calls, "pairs", of_all).results
    found = runner.run(match_elsewhere, calls, "pairs", of_all).results
    return [
        each if isinstance(each, str) else _kept(partial(write_match, each, *task.inputs), task)
        for task, each in zip(tasks, found, strict=True)
    ]


def match_pair(
    inputs: tuple[str, str],
    settings: Settings,
    place: Path,
    on_event: EventCallback = ignore,
    runner: Runner | None = None,
) -> str | None:
    """Match a pair of files into the folder `place`; return why it could not be, None where the folder tells.

    The runner, this process by default, runs the tiles. Warnings are told later, from the folder.
    """

    def of_this(event: Event) -> None:
        if not isinstance(event, Warned):
            on_event(event)

    task = _Task(inputs, settings, place)
    return _kept(partial(match_files, *inputs, on_event=of_this, executor=runner or InThisProcess()), task)


def _kept(job: Callable[..., Registration], task: _Task) -> str | None:
    """Call a job that writes the folder of a pair; return why it could not be matched."""
    given: dict[str, Any] = {name: getattr(task.settings, name) for name in asdict(task.settings)}
    try:
        job(out_dir=task.place, overwrite=True, **given)
    except RegistrationRejectedError:
        return None
    except InputError as error:
        return joined(error)
    return None


PAIR_DEFAULTS: Final[dict[str, Any]] = {
    "model": "auto", "like": None, "require": (), "keep": False,
    "of": "COG", "co": (), "resampling": "lanczos",
}  # fmt: skip
"""Options of the corrected images, which say nothing of a pair."""


def edge_of(frame: Frame, one: int, other: int, place: Path) -> Edge | None:
    """Read the tie points of a pair, as all runs find them; None if they are too few."""
    points = read_point_file(place / "tiepoints.csv")
    sigma_px = points.sigma_px
    if sigma_px is None:
        raise OutputError(f"{place} has tie points without sigma: remove the folder, and run again")
    good = points.enabled & np.isfinite(sigma_px).all(axis=1) & (sigma_px > 0).all(axis=1)
    reference_px, target_px, sigma_px = points.reference[good], points.target[good], sigma_px[good]
    scale = frame.scale(other, target_px)
    covariance = np.einsum("nab,nb,ncb->nac", scale, sigma_px**2, scale)
    first, second = frame.from_image(one, reference_px), frame.from_image(other, target_px)
    known = np.isfinite(np.column_stack([first, second])).all(axis=1)
    if known.sum() < MIN_PAIR_POINTS:
        return None
    first, second = first[known], second[known]
    places = len(np.unique(np.floor(first / PLACE_PX), axis=0))
    far = float(np.hypot(*np.median(second - first, axis=0))) / GEOREFERENCED_PX if frame.placed else 0.0
    return Edge(one, other, first, second, covariance[known], evidence=places / (1 + far**2))


def sigma_known(frame: Frame, datum: int | None, count: int) -> Float64 | None:
    """Return the (count,) sigmas, px of the frame, by which images lie as the datum does: of its product."""
    sizes_m = middle_pixel_size_m(frame.grid)
    if datum is None or datum >= len(frame.infos) or sizes_m is None or not frame.placed:
        return None
    found = np.full(count, np.inf)
    same_product = [of_one_product(frame.infos[datum].uri, info.uri) for info in frame.infos[:count]]
    found[: len(same_product)][same_product] = PRODUCT_SIGMA_M / max(sizes_m)
    return found if any(same_product) else None


@dataclass(frozen=True, slots=True)
class ControlPoint:
    """A place of an image whose ground is known."""

    image: str
    """Name of the image."""
    col: float
    """Position in the file, px, corner-based."""
    row: float
    x: float
    """Position on the ground, CRS of the reference."""
    y: float
    sigma: float | None = None
    """Standard deviation along an axis, units of x and y; null: half a pixel of the reference."""


def control_points(table: PathLike) -> tuple[ControlPoint, ...]:
    """Read control points from a table with the columns image, col, row, x, y and, if known, sigma.

    Raises `InputError` if it cannot be used.
    """
    found = []
    for row in read_table(Path(table), ("image", "col", "row", "x", "y")):
        col_px, row_px, x, y = (number_of(row, column) for column in ("col", "row", "x", "y"))
        sigma = number_of(row, "sigma") if row.get("sigma") else None
        found.append(ControlPoint(row["image"], col_px, row_px, x, y, sigma))
        check_control(found[-1], str(table))
    return tuple(found)


def check_control(point: ControlPoint, origin: str) -> None:
    """Raise `InputError` if a control point of the file `origin` holds no usable numbers."""
    values = (point.col, point.row, point.x, point.y, 1.0 if point.sigma is None else point.sigma)
    if not all(math.isfinite(each) for each in values) or values[4] <= 0:
        raise InputError(
            f"{origin}: the control points of {point.image} need finite numbers and sigmas above 0"
        )
    check_coordinates(origin, values)


def control_edges(points: Sequence[ControlPoint], frame: Frame, ground: int | None = None) -> list[Edge]:
    """Return control points, image by image, as pairs with the ground itself.

    The number of the `ground` among the images is that after the last image by default. Raises `InputError`
    if they name no image of the frame or are too few, or the images are not georeferenced.
    """
    if points and not frame.placed:
        raise InputError("images without georeferencing have no place for control points")
    unit = abs(float(np.linalg.det(linear_part(frame.grid.transform)))) ** 0.5
    found = []
    for name in dict.fromkeys(point.image for point in points):
        if name not in frame.names:
            raise InputError(
                f"control points are of {name}, which is none of the images {', '.join(frame.names)}"
            )
        own = [point for point in points if point.image == name]
        if len(own) < MIN_CONTROL:
            raise InputError(f"there are {len(own)} control points of {name}: give {MIN_CONTROL}")
        at_px = np.array([(point.col, point.row) for point in own])
        on_ground = frame.grid.to_px(np.array([(point.x, point.y) for point in own]))
        sigma = np.array([point.sigma / unit if point.sigma else CONTROL_SIGMA_PX for point in own])
        sigma = np.maximum(sigma, LEAST_CONTROL_SIGMA_PX)
        image = frame.names.index(name)
        off_px = np.hypot(*np.median(on_ground - frame.from_image(image, at_px), axis=0))
        if not off_px <= sum(frame.grid.shape) + sum(frame.infos[image].grid.shape):
            raise InputError(
                f"the control points of {name} lie {off_px:.3g} px of the frame from where its "
                "georeferencing places them: check the order of x and y, and their CRS, which is that of "
                "the reference"
            )
        covariance = sigma[:, None, None] ** 2 * np.eye(2)
        number = len(frame.names) if ground is None else ground
        found.append(
            Edge(number, image, on_ground, frame.from_image(image, at_px), covariance, None, CONTROL_EVIDENCE)
        )
    return found


def check_connected(frame: Frame, edges: Sequence[Edge], reference: int, folder: Path, split: bool) -> str:
    """Return a warning where the pairs that were matched do not connect all images; empty where they do.

    Raises `RegistrationRejectedError` unless it may be `split` into groups, or where no pair could be
    matched.
    """
    _, group = components(edges, len(frame.names) + 1, np.ones(len(edges), bool))
    groups = [
        " + ".join(name for name, of in zip(frame.names, group, strict=False) if of == number)
        for number in dict.fromkeys(group[: len(frame.names)].tolist())
    ]
    if len(groups) == 1 and edges:
        return ""
    alone = (
        f"; {frame.names[reference]}, the reference, has no pair at all: give another with --reference"
        if (group == group[reference]).sum() == 1
        else ""
    )
    message = f"{len(groups)} groups of images are not connected by any pair: {'; '.join(groups)}{alone}"
    if split and edges:
        return f"{message}: each group has a datum of its own, the first of its images"
    raise RegistrationRejectedError(
        f"{message}; give images that share ground with both, stack each group for itself, or give "
        f"--allow-components (pairs: {folder / PAIRS})"
    )
