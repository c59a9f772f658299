"""The pairs of a stack: each is matched in a folder of its own, and graded."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from pcwlad_geo.correction.error_statistics import Proof
from pcwlad_geo.errors import ExecutionError, InputError, OutputError, RegistrationRejectedError
from pcwlad_geo.estimation.solving import components, least_squares
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.job import match_elsewhere, match_files, write_match
from pcwlad_geo.multi.network import Edge, basis_over, ends_of
from pcwlad_geo.multi.stack_frame import StackFrame
from pcwlad_geo.options import SETTINGS, Settings
from pcwlad_geo.products.finding import of_one_product
from pcwlad_geo.raster.grid import middle_pixel_size_m
from pcwlad_geo.registration import (
    FAIR_PX,
    GOOD_PX,
    GRADES,
    Grade,
    Motion,
    QualityParameters,
    estimate_tile_count,
)
from pcwlad_geo.registration.frame_evidence import SAME_PIXELS
from pcwlad_geo.registration.motions import MotionParameters, describe_motions
from pcwlad_geo.registration.positions import position_conflict
from pcwlad_geo.registration.quality import displaced_otherwise
from pcwlad_geo.report.finished import NUMBERS, read_report, report_of_same_job
from pcwlad_geo.text import joined
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.types import Bool, Float64

if TYPE_CHECKING:
    from pcwlad_geo.registration import Registration

PAIRS: Final = "pairs"
"""Folder of the pairs that were measured."""
SMALL_TILES: Final = 4
"""Largest number of tiles of a pair that is matched as a whole, in one of several processes."""
MIN_PAIR_POINTS: Final = 12
"""Least number of tie points of a pair."""
PLACE_PX: Final = 60.0
"""Side of the squares by whose number the evidence of a pair is measured, px of the frame."""
PRODUCT_SIGMA_M: Final = 5.0
"""Standard deviation of the misregistration of two bands of a product along an axis, metres. The requirements
of Landsat 8 (LE90 4.5 m, thermal bands 30 m) and Sentinel-2 (0.3 px at three sigmas) lie on both sides."""
PAIR_DEFAULTS: Final[dict[str, Any]] = {
    "model": "auto", "like": None, "require": (), "keep": False,
    "of": "COG", "co": (), "resampling": "lanczos",
}  # fmt: skip
"""Options of the corrected images, which do not affect the matching of a pair."""

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


Measured = tuple[Edge | None, StackPair]


T = TypeVar("T")


def measure(
    frame: StackFrame,
    pairs: Sequence[tuple[int, int]],
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
    tasks = [_task(frame, pair, folder, settings) for pair in pairs]
    on_event(Progress("pairs", 0, len(tasks)))
    todo = [number for number, task in enumerate(tasks) if overwrite or not task.finished()]
    small = [number for number in todo if tasks[number].small]
    refused = _match_whole([tasks[number] for number in small], len(tasks), len(todo), on_event, runner)
    reasons = dict(zip(small, refused, strict=True))
    for count, number in enumerate(sorted(set(todo) - set(small)), len(tasks) - len(todo) + len(small)):
        on_event(Progress("pairs", count, len(tasks)))
        reasons[number] = match_pair(*tasks[number], on_event, runner)
    for number, (pair, task) in enumerate(zip(pairs, tasks, strict=True)):
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
        if not report and (place / NUMBERS).exists():
            raise OutputError(
                f"{place} has a damaged report (report.json is none of this program): "
                "remove the folder, and run again"
            )
        for warning in report.get("warnings", ()):
            on_event(Warned(f"{names[0]} – {names[1]}: {warning}"))
        reason = str(report.get("reason")) if report.get("status") == "rejected" else None
        edge = edge_of(frame, *pair, place) if reason is None else None
    if edge is None:
        reason = reason or f"fewer than {MIN_PAIR_POINTS} tie points"
        on_event(Warned(f"{names[0]} – {names[1]}: refused: {reason}"))
    status: PairStatus = "refused" if edge is None else "used"
    motions = _validated(tuple[Motion, ...], report.get("motions", ()), place)
    result = StackPair(*names, status, reason, place, motions=motions)
    if edge is None:
        return edge, result
    infos = frame.infos[pair[0]], frame.infos[pair[1]]
    conflict = None if frame.placed else position_conflict(*infos, edge.first_xy, edge.second_xy)
    texts = [text for text in report.get("warnings", ()) if text.startswith(SAME_PIXELS)]
    texts += [] if conflict is None else [conflict.text]
    return edge, graded(result, edge, report, [("poor", text) for text in texts])


def _validated(kind: type[T], value: object, place: Path) -> T:
    """Return a part of the report of a pair as a `kind`; raises `OutputError` if it is damaged."""
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValidationError as error:
        message = f"{place} has a damaged report ({joined(error)}): remove the folder, and run again"
        raise OutputError(message) from error


def graded(
    pair: StackPair, edge: Edge, report: Mapping[str, Any], doubts: Sequence[tuple[Grade, str]] = ()
) -> StackPair:
    """Return a pair with the grade that its points, its report and other `doubts` give it."""
    residual_px = _smooth_residuals(edge.first_xy, edge.second_xy, np.ones(len(edge), bool))
    off_px, counts = float(np.percentile(np.hypot(*residual_px.T), 90)), report.get("tie_points", {})
    jitter_px = float(report.get("jitter_px", 0.0))
    agreeing = 1 - counts.get("rejected", 0) / max(counts.get("total", 0), 1)
    reasons: list[tuple[Grade, str]] = [*doubts]
    if pair.motions:
        reasons.append(("fair", describe_motions(pair.motions, accepted=True)))
    if off_px > GOOD_PX:
        text = f"a tenth of its points lie more than {off_px:.2f} px off a smooth displacement"
        reasons.append(("fair" if off_px <= FAIR_PX else "poor", text))
    if agreeing < QualityParameters().poor_kept_share:
        reasons.append(("poor", f"only {100 * agreeing:.0f} % of the matches agree with their neighbours"))
    points = read_point_file(pair.folder / "tiepoints.csv")
    rejected_px = _smooth_residuals(points.reference, points.target, points.enabled)[~points.enabled]
    otherwise = displaced_otherwise(rejected_px, len(points.enabled))
    reasons += [(reason.grade, reason.text) for reason in otherwise]
    grade: Grade = min((grade for grade, _ in reasons), key=GRADES.index, default="good")
    texts = tuple(text for _, text in reasons)
    values = report.get("proof")
    values = {**values, "map": ()} if isinstance(values, dict) else values
    proof = _validated(Proof, values, pair.folder) if values else None
    return replace(pair, quality=grade, quality_reasons=texts, jitter_px=jitter_px, proof=proof)


def _smooth_residuals(first_xy: Float64, second_xy: Float64, fitted: Bool) -> Float64:
    """Return the (n, 2) residuals of displacements from a polynomial fitted to the `fitted`, an (n,) mask."""
    displacement, values = (
        second_xy - first_xy,
        basis_over([first_xy[fitted]], "polynomial2").values(first_xy),
    )
    return displacement - values @ least_squares(values[fitted], displacement[fitted])


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
    image_options = {
        "ref_band": first.band,
        "tgt_band": second.band,
        "ref_mask": first.mask,
        "tgt_mask": second.mask,
    }
    place = folder / PAIRS / f"{frame.names[pair[0]]}__{frame.names[pair[1]]}"
    matching = replace(settings, **PAIR_DEFAULTS, **image_options)  # type: ignore[arg-type]  # by name
    return _PairTask((first.path, second.path), matching, place)


def _match_whole(
    tasks: Sequence[_PairTask], count: int, unfinished: int, on_event: EventCallback, runner: Runner
) -> list[str | None]:
    """Match pairs in parallel; return the reasons of `match_pair`.

    `count` is the number of all pairs, of which `unfinished` are not finished.
    """

    def of_all(event: Event) -> None:
        if isinstance(event, Progress):
            event = Progress("pairs", event.done + count - unfinished, count)
        on_event(event)

    if not tasks:
        return []
    calls = [tuple(task) for task in tasks]  # workers elsewhere need not load this module
    if runner.is_local:  # each is written where it is matched
        return [_reason(outcome) for outcome in runner.run_jobs(match_pair, calls, "pairs", of_all)]
    results = runner.run(match_elsewhere, calls, "pairs", of_all)
    return [
        outcome if isinstance(outcome, str) else _refusal(partial(write_match, outcome, *task.inputs), task)
        for task, outcome in zip(tasks, results, strict=True)
    ]


def _reason(result: str | ExecutionError | None) -> str | None:
    """Return why a pair cannot be matched, also where its process was lost."""
    return joined(result) if isinstance(result, ExecutionError) else result


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
    options: dict[str, Any] = {name: getattr(task.settings, name) for name in SETTINGS}
    try:
        with suppress(RegistrationRejectedError):
            job(out_dir=task.place, overwrite=True, **options)
    except InputError as error:
        return joined(error)
    return None


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
    finite = np.isfinite(np.column_stack([first, second])).all(axis=1)
    if finite.sum() < MIN_PAIR_POINTS:
        return None
    first, second = first[finite], second[finite]
    places = len(np.unique(np.floor(first / PLACE_PX), axis=0))
    offset_px = float(np.hypot(*np.median(second - first, axis=0)))
    offset = offset_px / MotionParameters().georeferenced_px if frame.placed else 0.0
    return Edge(one, other, first, second, covariance[finite], evidence=places / (1 + offset**2))


def sigma_known(frame: StackFrame, datum: int | None, count: int) -> Float64 | None:
    """Return the (count,) prior sigmas (see `adjust`) of images, px of the frame; None if there are none.

    The displacements of bands of the product that the datum belongs to are known beforehand.
    """
    sizes_m = middle_pixel_size_m(frame.grid)
    if datum is None or datum >= len(frame.infos) or sizes_m is None or not frame.placed:
        return None
    sigma = np.full(count, np.inf)
    same_product = [of_one_product(frame.infos[datum].uri, info.uri) for info in frame.infos[:count]]
    sigma[: len(same_product)][same_product] = PRODUCT_SIGMA_M / max(sizes_m)
    return sigma if any(same_product) else None


def check_connected(
    frame: StackFrame, edges: Sequence[Edge], reference: int, folder: Path, split: bool
) -> str:
    """Return a warning if the pairs that were matched do not connect all images, an empty text if they do.

    Raises `RegistrationRejectedError` if they may not be `split` into groups, or no pair could be matched.
    """
    group = components(ends_of(edges), len(frame.names) + 1)
    groups = [
        " + ".join(name for name, member in zip(frame.names, group, strict=False) if member == number)
        for number in dict.fromkeys(group[: len(frame.names)].tolist())
    ]
    if len(groups) == 1 and edges:
        return ""
    lone_reference = (
        f"; {frame.names[reference]}, the reference, has no pair at all: give another with --reference"
        if (group == group[reference]).sum() == 1
        else ""
    )
    message = (
        f"{len(groups)} groups of images are not connected by any pair: {'; '.join(groups)}{lone_reference}"
    )
    if split and edges:
        return f"{message}: each group has a datum of its own, the first of its images"
    raise RegistrationRejectedError(
        f"{message}; give images that share ground with both, stack each group for itself, or give "
        f"--allow-components (pairs: {folder / PAIRS})"
    )
