"""The pairs of a stack: which are matched, and the result of each."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeVar

import numpy as np
import shapely
from pydantic import TypeAdapter, ValidationError
from rasterio.enums import Resampling
from scipy import ndimage

from pcwlad_geo.correction.error_statistics import Proof
from pcwlad_geo.errors import InputError, OutputError, RegistrationRejectedError
from pcwlad_geo.estimation.solving import components, least_squares, pseudo_inverse
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.job import match_elsewhere, match_files, write_match
from pcwlad_geo.limits import check_coordinates
from pcwlad_geo.multi.network import Edge, basis_over, ends_of
from pcwlad_geo.multi.stack_inputs import StackInput, number_of, read_table
from pcwlad_geo.options import SETTINGS, Settings
from pcwlad_geo.products import of_one_product
from pcwlad_geo.raster.grid import Grid, jacobian, linear_part, map_px, middle_pixel_size_m
from pcwlad_geo.raster.source import RasterInfo, has_quick_overview, open_raster
from pcwlad_geo.registration.fitting import (
    FAIR_PX,
    GOOD_PX,
    GRADES,
    POOR_KEPT_SHARE,
    Grade,
    displaced_otherwise,
)
from pcwlad_geo.registration.inputs import estimate_tile_count
from pcwlad_geo.registration.judge import GEOREFERENCED_PX, Motion, describe_motions
from pcwlad_geo.report.finished import read_report, report_of_same_job
from pcwlad_geo.text import joined
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.types import Bool, Float64, PathLike

if TYPE_CHECKING:
    from pcwlad_geo.registration.result import Registration

PAIRS: Final = "pairs"
"""Folder of the pairs that were measured."""
SMALL_TILES: Final = 4
"""Largest number of tiles of a pair that is matched as a whole, in one of several processes."""
MIN_PAIR_POINTS: Final = 12
"""Least number of tie points of a pair."""
MIN_CONTROL: Final = 4
"""Least number of control points of an image."""
LEAST_CONTROL_SIGMA_PX: Final = 1e-3
"""Least standard deviation of a control point, px of the frame: no position in an image is known better."""
CONTROL_COLUMNS: Final = ("image", "col", "row", "x", "y")
"""Columns that a table of control points must have."""
CONTROL_SIGMA_PX: Final = 0.5
"""Standard deviation of a control point for which the table has none, px of the frame."""

PLACE_PX: Final = 60.0
"""Side of the squares by whose number the evidence of a pair is measured, px of the frame."""
PRODUCT_SIGMA_M: Final = 5.0
"""Standard deviation of the misregistration of two bands of a product along an axis, metres. The requirements
of Landsat 8 (LE90 4.5 m, thermal bands 30 m) and Sentinel-2 (0.3 px at three sigmas) lie on both sides."""
CONTROL_EVIDENCE: Final = 50.0
"""Evidence of the control points of an image: that of a pair with points in this number of squares."""

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
    """Mean residual of its points from the adjustment (col, row), px of the frame."""
    sigma_px: float | None = None
    """Standard deviation of that along an axis, if the pair is right."""
    redundancy: float | None = None
    """Share of the offset that other pairs check; an error of a pair of 0 cannot be found."""
    scatter_px: float | None = None
    """Robust standard deviation of its points along an axis, px of the frame."""
    quality: Grade | None = None
    """Of the pair by itself: how far its matches agree with one smooth displacement; null where refused."""
    quality_reasons: tuple[str, ...] = ()
    """Why it is not good."""
    motions: tuple[Motion, ...] = ()
    """Displacements that parts of its matches agree on, if there are several; the one used comes first."""
    ce90_px: float | None = None
    """90th percentile of the distance of its points from the adjustment, means of five neighbours, px of the
    frame."""
    empty_share: float | None = None
    """Share without a tie point of the squares of its reference in which both images have data."""
    jitter_px: float = 0.0
    """RMS displacement of rows and columns within a matching window, target px; 0 where none was found."""
    proof: Proof | None = None
    """The tool's own error on the pair, target px, without its map; null where no proof was asked for."""

    @property
    def off_px(self) -> float:
        """Length of its offset, px of the frame; 0 of one that was refused."""
        return math.hypot(*self.offset_px or (0.0, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class StackFrame:
    """The images, and the grid in whose pixels all are compared."""

    names: list[str]
    infos: list[RasterInfo]
    grid: Grid
    placed: bool
    """Whether all images are georeferenced; otherwise their pixels are compared."""
    inputs: tuple[StackInput, ...] = ()
    """The images as the user gave them; empty: the files of `infos`."""
    reference: int = 0
    """Number of the image whose grid it is."""

    def given(self, image: int) -> StackInput:
        """Return an image as the user gave it."""
        info = self.infos[image]
        return self.inputs[image] if self.inputs else StackInput(info.uri, info.band, self.names[image])

    def from_image(self, image: int, px: Float64) -> Float64:
        """Map the (n, 2) `px` of an image to px of the frame by its georeferencing."""
        return map_px(px, self.infos[image].grid, self.grid) if self.placed else px

    def to_image(self, image: int, px: Float64) -> Float64:
        """Map the (n, 2) `px` of the frame to px of an image."""
        return map_px(px, self.grid, self.infos[image].grid) if self.placed else px

    def scale(self, image: int, px: Float64) -> Float64:
        """Return the (n, 2, 2) Jacobian of `from_image` at the (n, 2) `px` of an image."""
        if not self.placed:
            return np.broadcast_to(np.eye(2), (len(px), 2, 2))
        return jacobian(px, self.infos[image].grid, self.grid)

    def pixel(self, image: int) -> float:
        """Return the side of a pixel in the middle of an image, px of the frame."""
        return math.sqrt(abs(np.linalg.det(self.scale(image, self.infos[image].grid.middle_px)[0])))


Measured = tuple[Edge | None, StackPair]
T = TypeVar("T")


def measure(
    frame: StackFrame,
    chosen: Sequence[tuple[int, int]],
    folder: Path,
    settings: Settings,
    overwrite: bool,
    on_event: EventCallback,
    runner: Runner,
) -> Iterator[Measured]:
    """Yield the result of each pair, matched now or by an earlier run on the same files.

    Pairs of few tiles are matched in parallel, each as a whole; larger ones one after another, their tiles in
    parallel.
    """
    tasks = [_task(frame, pair, folder, settings) for pair in chosen]
    on_event(Progress("pairs", 0, len(tasks)))
    todo = [number for number, task in enumerate(tasks) if overwrite or not task.finished()]
    small = [number for number in todo if tasks[number].small]
    refused = _match_whole([tasks[number] for number in small], len(tasks), len(todo), on_event, runner)
    reasons = dict(zip(small, refused, strict=True))
    for done, number in enumerate(sorted(set(todo) - set(small)), len(tasks) - len(todo) + len(small)):
        on_event(Progress("pairs", done, len(tasks)))
        reasons[number] = match_pair(*tasks[number], on_event, runner)
    for number, (pair, task) in enumerate(zip(chosen, tasks, strict=True)):
        yield measured_pair(frame, pair, task.place, reasons.get(number), on_event)
    on_event(Progress("pairs", len(tasks), len(tasks)))


def measured_pair(
    frame: StackFrame, pair: tuple[int, int], place: Path, reason: str | None, on_event: EventCallback
) -> Measured:
    """Return the result of a matched pair, from its folder unless there is a `reason` for its refusal."""
    names = frame.names[pair[0]], frame.names[pair[1]]
    edge, report = None, {}
    if reason is None:
        report = read_report(place)  # also its warnings, so that a resumed run repeats them
        for warning in report.get("warnings", ()):
            on_event(Warned(f"{names[0]} – {names[1]}: {warning}"))
        reason = str(report.get("reason")) if report.get("status") == "rejected" else None
        edge = edge_of(frame, *pair, place) if reason is None else None
    if edge is None:
        reason = reason or f"fewer than {MIN_PAIR_POINTS} tie points"
        on_event(Warned(f"{names[0]} – {names[1]}: refused: {reason}"))
    status: PairStatus = "refused" if edge is None else "used"
    motions = _validated(tuple[Motion, ...], report.get("motions", ()), place)
    found = StackPair(*names, status, reason, place, motions=motions)
    return edge, found if edge is None else graded(found, edge, report)


def _validated(kind: type[T], found: object, place: Path) -> T:
    """Return a part of the report of a pair as a `kind`; raises `OutputError` if it is damaged."""
    try:
        return TypeAdapter(kind).validate_python(found)
    except ValidationError as error:
        message = f"{place} has a damaged report ({joined(error)}): remove the folder, and run again"
        raise OutputError(message) from error


def graded(pair: StackPair, edge: Edge, report: Mapping[str, Any]) -> StackPair:
    """Return a pair with the grade that its points and its report give it."""
    residual_px = _smooth_residuals(edge.first_xy, edge.second_xy, np.ones(len(edge), bool))
    off_px, counts = float(np.percentile(np.hypot(*residual_px.T), 90)), report.get("tie_points", {})
    jitter_px = float(report.get("jitter_px", 0.0))
    kept = 1 - counts.get("rejected", 0) / max(counts.get("total", 0), 1)
    reasons: list[tuple[Grade, str]] = (
        [("fair", describe_motions(pair.motions, taken=True))] if pair.motions else []
    )
    if off_px > GOOD_PX:
        text = f"a tenth of its points lie more than {off_px:.2f} px off a smooth displacement"
        reasons.append(("fair" if off_px <= FAIR_PX else "poor", text))
    if kept < POOR_KEPT_SHARE:
        reasons.append(("poor", f"only {100 * kept:.0f} % of the matches agree with their neighbours"))
    points = read_point_file(pair.folder / "tiepoints.csv")
    rejected_px = _smooth_residuals(points.reference, points.target, points.enabled)[~points.enabled]
    otherwise = displaced_otherwise(rejected_px, len(points.enabled))
    reasons += [(each.grade, each.text) for each in otherwise]
    grade: Grade = min((grade for grade, _ in reasons), key=GRADES.index, default="good")
    texts = tuple(text for _, text in reasons)
    values = report.get("proof")
    values = {**values, "map": ()} if isinstance(values, dict) else values
    proof = _validated(Proof, values, pair.folder) if values else None
    return replace(pair, quality=grade, quality_reasons=texts, jitter_px=jitter_px, proof=proof)


def _smooth_residuals(first_xy: Float64, second_xy: Float64, kept: Bool) -> Float64:
    """Return the (n, 2) residuals of displacements from a polynomial fitted to the `kept`, an (n,) mask."""
    moved, values = second_xy - first_xy, basis_over([first_xy[kept]], "polynomial2").values(first_xy)
    return moved - values @ least_squares(values[kept], moved[kept])


class _PairTask(NamedTuple):
    """A pair to be matched: the arguments of `match_pair` and `match_elsewhere`."""

    inputs: tuple[str, str]
    settings: Settings
    place: Path

    @property
    def small(self) -> bool:
        """Whether it has so few tiles that processes would idle if they were matched in parallel."""
        return 0 < estimate_tile_count(*self.inputs, self.settings) <= SMALL_TILES

    def finished(self) -> bool:
        """Return whether an earlier run has matched it."""
        return bool(report_of_same_job("match", self.inputs, self.settings, self.place))


def _task(frame: StackFrame, pair: tuple[int, int], folder: Path, settings: Settings) -> _PairTask:
    first, second = (frame.given(image) for image in pair)
    own = {"ref_band": first.band, "tgt_band": second.band, "ref_mask": first.mask, "tgt_mask": second.mask}
    place = folder / PAIRS / f"{frame.names[pair[0]]}__{frame.names[pair[1]]}"
    matching = replace(settings, **PAIR_DEFAULTS, **own)  # type: ignore[arg-type]  # by name
    return _PairTask((first.path, second.path), matching, place)


def _match_whole(
    tasks: Sequence[_PairTask], count: int, left: int, on_event: EventCallback, runner: Runner
) -> list[str | None]:
    """Match pairs in parallel; return the reasons of `match_pair`.

    `count` is the number of all pairs, of which `left` are not finished.
    """

    def of_all(event: Event) -> None:
        if isinstance(event, Progress):
            event = Progress("pairs", event.done + count - left, count)
        on_event(event)

    if not tasks:
        return []
    calls = [tuple(task) for task in tasks]  # workers elsewhere need not load this module
    if runner.is_local:  # each is written where it is matched
        return runner.run(match_pair, calls, "pairs", of_all).results
    found = runner.run(match_elsewhere, calls, "pairs", of_all).results
    return [
        each if isinstance(each, str) else _refusal(partial(write_match, each, *task.inputs), task)
        for task, each in zip(tasks, found, strict=True)
    ]


def match_pair(
    inputs: tuple[str, str],
    settings: Settings,
    place: Path,
    on_event: EventCallback = ignore,
    runner: Runner | None = None,
) -> str | None:
    """Match a pair of files into the folder `place`; return why it cannot be matched.

    None if the folder has the result, which may be a rejection. The runner, this process by default, runs the
    tiles. Warnings are sent later, from the folder.
    """

    def of_this(event: Event) -> None:
        if not isinstance(event, Warned):
            on_event(event)

    job = partial(match_files, *inputs, on_event=of_this, executor=runner or InThisProcess())
    return _refusal(job, _PairTask(inputs, settings, place))


def _refusal(job: Callable[..., Registration], task: _PairTask) -> str | None:
    """Call a job that writes the folder of a pair; return the reason of `match_pair`."""
    given: dict[str, Any] = {name: getattr(task.settings, name) for name in SETTINGS}
    try:
        with suppress(RegistrationRejectedError):
            job(out_dir=task.place, overwrite=True, **given)
    except InputError as error:
        return joined(error)
    return None


PAIR_DEFAULTS: Final[dict[str, Any]] = {
    "model": "auto", "like": None, "require": (), "keep": False,
    "of": "COG", "co": (), "resampling": "lanczos",
}  # fmt: skip
"""Options of the corrected images, which do not affect the matching of a pair."""


def edge_of(frame: StackFrame, one: int, other: int, place: Path) -> Edge | None:
    """Read the tie points of a pair from its folder; None if they are too few."""
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


def sigma_known(frame: StackFrame, datum: int | None, count: int) -> Float64 | None:
    """Return the (count,) prior sigmas (see `adjust`) of images, px of the frame; None if there are none.

    The displacements of bands of the product that the datum belongs to are known beforehand.
    """
    sizes_m = middle_pixel_size_m(frame.grid)
    if datum is None or datum >= len(frame.infos) or sizes_m is None or not frame.placed:
        return None
    found = np.full(count, np.inf)
    same_product = [of_one_product(frame.infos[datum].uri, info.uri) for info in frame.infos[:count]]
    found[: len(same_product)][same_product] = PRODUCT_SIGMA_M / max(sizes_m)
    return found if any(same_product) else None


@dataclass(frozen=True, slots=True)
class ControlPoint:
    """A position in an image whose ground position is known."""

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
    rows = read_table(Path(table), CONTROL_COLUMNS)
    return tuple(control_point(row, str(table)) for row in rows)


def control_point(row: Mapping[str, str], origin: str) -> ControlPoint:
    """Return the control point of a line of the table `origin`; raises `InputError` if it cannot be used."""
    col_px, row_px, x, y = (number_of(row, column) for column in CONTROL_COLUMNS[1:])
    sigma = number_of(row, "sigma") if row.get("sigma") else None
    point = ControlPoint(row["image"], col_px, row_px, x, y, sigma)
    check_control(point, origin)
    return point


def check_control(point: ControlPoint, origin: str) -> None:
    """Raise `InputError` if a control point of the file `origin` holds no usable numbers."""
    values = (point.col, point.row, point.x, point.y, 1.0 if point.sigma is None else point.sigma)
    if not all(math.isfinite(each) for each in values) or values[4] <= 0:
        raise InputError(
            f"{origin}: the control points of {point.image} need finite numbers and sigmas above 0"
        )
    check_coordinates(origin, values)


def control_edges(points: Sequence[ControlPoint], frame: StackFrame, ground: int | None = None) -> list[Edge]:
    """Return the control points of each image as a pair of the ground itself and the image.

    The number of the `ground` is that after the last image by default. Raises `InputError` if they name no
    image of the frame or are too few, or the images are not georeferenced.
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
        image = frame.names.index(name)
        at_px = frame.from_image(image, np.array([(point.col, point.row) for point in own]))
        on_ground = frame.grid.to_px(np.array([(point.x, point.y) for point in own]))
        check_place(name, at_px, on_ground, sum(frame.grid.shape) + sum(frame.infos[image].grid.shape))
        sigma = np.array([point.sigma / unit if point.sigma else CONTROL_SIGMA_PX for point in own])
        covariance = np.maximum(sigma, LEAST_CONTROL_SIGMA_PX)[:, None, None] ** 2 * np.eye(2)
        number = len(frame.names) if ground is None else ground
        found.append(Edge(number, image, on_ground, at_px, covariance, evidence=CONTROL_EVIDENCE))
    return found


def check_place(name: str, at_px: Float64, placed_px: Float64, size_px: int) -> None:
    """Raise `InputError` if the control points of the image `name` do not lie on it.

    Their (n, 2) positions in it are `at_px`, and the (n, 2) `placed_px` are those of their ground positions
    by its georeferencing; `size_px` is the largest median difference.
    """
    check = "check the order of x and y, their CRS, which is that of the reference, and heights"
    for col, row in at_px[~np.isfinite(placed_px).all(axis=1)][:1]:
        raise InputError(
            f"the ground of the control point at ({col:.1f}, {row:.1f}) px (col, row) of {name} is nowhere "
            f"in it by its georeferencing: {check}"
        )
    off_px = float(np.hypot(*np.median(placed_px - at_px, axis=0)))
    if not off_px <= size_px:
        raise InputError(
            f"the control points of {name} lie {off_px:.3g} px of the frame from where its georeferencing "
            f"places them: {check}"
        )


def check_connected(
    frame: StackFrame, edges: Sequence[Edge], reference: int, folder: Path, split: bool
) -> str:
    """Return a warning if the pairs that were matched do not connect all images, an empty text if they do.

    Raises `RegistrationRejectedError` if they may not be `split` into groups, or no pair could be matched.
    """
    group = components(ends_of(edges), len(frame.names) + 1)
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


ALL_PAIRS: Final = 8
"""Largest number of images all of whose pairs are measured."""
MIN_OVERLAP: Final = 0.1
"""Least common ground of a pair, as a share of the smaller image."""
OVERVIEW_PX: Final = 128
"""Longer side of an overview, px."""
OVERLAP_CELLS: Final = 64
"""Number of positions along each axis at which the overviews of all images are compared."""
UNCERTAIN_VARIANCE: Final = 0.75
"""Variance of the position of an image, in those of a median pair, above which it gets another pair."""
LEAST_COST: Final = 0.2
"""The variance of a pair is taken as the square of the sum of this and its cost."""
UNCERTAIN_SIGMA: Final = 1.5
"""Ratio of the sigma of an image to the median of all above which it gets further pairs."""
DIRECT_IMAGES: Final = 300
"""Largest number of images whose variances are computed, which takes dense matrices."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A pair with common ground, and its cost: low for images that are likely to match well."""

    pair: tuple[int, int]
    cost: float


def read_overview(info: RasterInfo) -> Float64 | None:
    """Return the (rows, cols) gradient magnitude of an overview of an image; NaN where it has no data.

    It has at most `OVERVIEW_PX` px a side; None for a large image without stored overviews. Raises
    `InputError` if the pixels cannot be read.
    """
    if not has_quick_overview(info):
        return None
    rows, cols = info.grid.shape
    shape = tuple(max(2, min(side, round(side * OVERVIEW_PX / max(rows, cols)))) for side in (rows, cols))
    with open_raster(info.uri) as dataset:
        read = dataset.read(info.band, out_shape=shape, masked=True, resampling=Resampling.average)
    valid = ~np.ma.getmaskarray(read) & np.isfinite(read.data)
    if not valid.any():
        return np.full(shape, np.nan)
    values = np.where(valid, read.data, np.median(read.data[valid])).astype(np.float64)
    edges = ndimage.gaussian_gradient_magnitude(values, 1.0)
    return np.where(ndimage.binary_erosion(valid, border_value=1), edges, np.nan)


def candidates(
    frame: StackFrame, inputs: Sequence[StackInput], overviews: Sequence[Float64 | None]
) -> list[Candidate]:
    """Return all pairs with common ground, those of the lowest cost first.

    The `overviews` of the images are those of `read_overview`, each (rows, cols) or None. The cost depends on
    the correlation of the overviews first (bands of one kind, one season, without clouds), then on season,
    sun, years between the images and clouds by the metadata, common ground and the ratio of pixel sizes.
    """
    outlines = [
        shapely.Polygon(frame.from_image(number, info.grid.boundary_px()))
        for number, info in enumerate(frame.infos)
    ]
    alike = _correlations(frame, overviews, shapely.total_bounds(outlines))
    pixel = [frame.pixel(number) for number in range(len(frame.infos))]
    found = []
    for one, other in combinations(range(len(outlines)), 2):
        overlap = _overlap(outlines[one], outlines[other])
        if overlap >= MIN_OVERLAP:
            cost = 1.5 - alike[one, other] - 0.5 * overlap + _metadata_cost(inputs[one], inputs[other])
            cost += 0.2 * abs(float(np.log2(pixel[one] / pixel[other])))
            found.append(Candidate((one, other), round(cost + 1e-6 * (other - one), 9)))
    return sorted(found, key=lambda each: (each.cost, each.pair))


def _overlap(one: shapely.Polygon, other: shapely.Polygon) -> float:
    smaller = min(one.area, other.area)
    return float(one.intersection(other).area / smaller) if smaller > 0 else 0.0


def _metadata_cost(one: StackInput, other: StackInput) -> float:
    """Return the part of the cost of a pair that depends on dates, sun and clouds in the metadata."""
    cost = 0.25 * ((one.cloud or 0.0) + (other.cloud or 0.0))
    if one.day is not None and other.day is not None:
        days = abs((one.day - other.day).days)
        season = min(days % 365.25, 365.25 - days % 365.25) / 182.6
        cost += 0.3 * season + 0.1 * min(1.0, days / 3650)
    if one.sun_elevation is not None and other.sun_elevation is not None:
        cost += 0.3 * min(1.0, abs(one.sun_elevation - other.sun_elevation) / 60)
    return cost


def _correlations(frame: StackFrame, overviews: Sequence[Float64 | None], bounds: Float64) -> Float64:
    """Return the (images, images) correlations of the overviews on common ground; 0.5 where unknown.

    They are compared within the (4,) `bounds`, px of the frame.
    """
    low, high = bounds.reshape(2, 2)
    step = (np.arange(OVERLAP_CELLS) + 0.5) / OVERLAP_CELLS
    at = low + np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2) * (high - low)
    samples = np.stack([_sampled(frame, number, overview, at) for number, overview in enumerate(overviews)])
    valid = np.isfinite(samples)
    values = np.where(valid, samples, 0.0)
    weight = valid.astype(np.float64)
    count = weight @ weight.T
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (values @ weight.T) / count  # of the first over what both show
        square = ((values**2) @ weight.T) / count - mean**2
        found = ((values @ values.T) / count - mean * mean.T) / np.sqrt(square * square.T)
    known = (count >= 64) & np.isfinite(found)
    return np.where(known, np.clip(found, 0.0, 1.0), 0.5)


def _sampled(frame: StackFrame, image: int, overview: Float64 | None, at: Float64) -> Float64:
    """Return the overview of an image at (n, 2) positions of the frame, scaled; NaN outside."""
    found = np.full(len(at), np.nan)
    if overview is None or not np.isfinite(overview).any():
        return found
    rows, cols = frame.infos[image].grid.shape
    per_px = np.array([overview.shape[1] / cols, overview.shape[0] / rows])
    with np.errstate(invalid="ignore"):
        index = np.floor(frame.to_image(image, at) * per_px)
    inside = ((index >= 0) & (index < overview.shape[::-1])).all(axis=1)
    col, row = index[inside].astype(int).T
    found[inside] = overview[row, col] / np.nanstd(overview) if np.nanstd(overview) > 0 else np.nan
    return found


def choose_pairs(
    found: Sequence[Candidate], images: int, most: int | None = None, before: Sequence[tuple[int, int]] = ()
) -> list[tuple[int, int]]:
    """Return the pairs to measure, the most important first, not more than `most`.

    The candidates `found` are in the order of their cost; `images` is the number of images. Pairs measured
    `before`, by an earlier run, are kept, and only images that have none get others.
    """
    known = {image for pair in before for image in pair}
    chosen = dict.fromkeys(before)
    for _ in range(3):  # two spanning trees without common pairs would close a cycle with every pair
        chosen |= dict.fromkeys(_spanning_tree(found, images, known, chosen))
    if images <= ALL_PAIRS:
        chosen |= dict.fromkeys(each.pair for each in found if not known.issuperset(each.pair))
    elif images <= DIRECT_IMAGES and not before:
        chosen |= dict.fromkeys(_strengthening(found, images, list(chosen)))
    return list(chosen)[:most]


def _spanning_tree(
    found: Sequence[Candidate], images: int, known: set[int], taken: Mapping[tuple[int, int], None]
) -> Iterator[tuple[int, int]]:
    """Yield the pairs not taken of a minimum spanning tree (Kruskal); the images `known` are connected."""
    roots = [min(known) if image in known else image for image in range(images)]
    for each in found:
        one, other = (roots[image] for image in each.pair)
        if one != other and each.pair not in taken:
            roots = [one if root == other else root for root in roots]
            yield each.pair


def _strengthening(
    found: Sequence[Candidate], images: int, chosen: list[tuple[int, int]]
) -> Iterator[tuple[int, int]]:
    """Yield further pairs for the images that are least well connected to the first."""
    taken = set(chosen)
    weight = {each.pair: (LEAST_COST + each.cost) ** -2 for each in found}
    usual = float(np.median([weight[pair] for pair in chosen]))
    laplace = np.zeros((images, images))
    for pair in chosen:
        _connect(laplace, pair, weight[pair] / usual)
    while len(taken) < 4 * images:
        variance = np.insert(np.diag(pseudo_inverse(laplace[1:, 1:], hermitian=True)), 0, 0.0)
        another = _another(found, taken, variance)
        if another is None:
            return
        taken.add(another)
        _connect(laplace, another, weight[another] / usual)
        yield another


def _another(
    found: Sequence[Candidate], taken: set[tuple[int, int]], variance: Float64
) -> tuple[int, int] | None:
    """Return a pair for the image of the largest variance that can get one; None if no image needs one."""
    for worst in np.argsort(-variance, kind="stable").tolist():
        if variance[worst] <= UNCERTAIN_VARIANCE:
            return None
        for each in found:
            other = sum(each.pair) - worst
            if worst in each.pair and each.pair not in taken and variance[other] < variance[worst] / 2:
                return each.pair
    return None


def _connect(laplace: Float64, pair: tuple[int, int], weight: float) -> None:
    """Add a pair to the weighted Laplacian matrix of the graph of pairs."""
    one, other = pair
    laplace[[one, other], [one, other]] += weight
    laplace[[one, other], [other, one]] -= weight


def asked_by_sigma(
    found: Sequence[Candidate],
    chosen: Sequence[tuple[int, int]],
    sigma: Float64,
    kinds: Sequence[object],
) -> list[tuple[int, int]]:
    """Return further pairs, at most two each, for images of an unusually large sigma.

    All pairs of two kinds of images may have an error in common, which only pairs with a third kind average:
    kinds with which an image has the fewest pairs come first. The candidates `found` are in the order of
    their cost, and those `chosen` were measured. The (images,) array `sigma` has the standard deviation of
    the position of each image, and `kinds` its kind.
    """
    limit = UNCERTAIN_SIGMA * float(np.median(sigma[sigma > 0])) if (sigma > 0).any() else np.inf
    taken = dict.fromkeys(chosen)
    count = len(taken)
    for image in np.flatnonzero(sigma > limit).tolist():
        for _ in range(2):
            with_kind = Counter(kinds[sum(pair) - image] for pair in taken if image in pair)
            free = [
                each.pair
                for each in found
                if image in each.pair and each.pair not in taken and sigma[sum(each.pair) - image] <= limit
            ]
            if free:
                taken[min(free, key=lambda pair: with_kind[kinds[sum(pair) - image]])] = None
    return list(taken)[count:]


def listed_pairs(table: PathLike, frame: StackFrame, inputs: Sequence[StackInput]) -> list[tuple[int, int]]:
    """Return the pairs of a CSV table with columns reference and target, names or paths of images.

    Raises `InputError` if it cannot be read or names an image that the stack does not have.
    """
    number = {name: index for index, name in enumerate(frame.names)}
    for index, given in enumerate(inputs):
        with suppress(OSError):
            number.setdefault(str(Path(given.path).resolve()), index)
    chosen: dict[tuple[int, int], None] = {}
    for row in read_table(Path(table), ("reference", "target")):
        ends = []
        for column in ("reference", "target"):
            text = row[column]
            end = number.get(text, number.get(str((Path(table).parent / text).resolve())))
            if end is None:
                names = ", ".join(frame.names)
                raise InputError(f"{table} names {text}, which is none of the images {names}")
            ends.append(end)
        if ends[0] == ends[1]:
            raise InputError(f"{table} has a pair of {row['reference']} with itself")
        chosen[min(ends), max(ends)] = None
    return list(chosen)
