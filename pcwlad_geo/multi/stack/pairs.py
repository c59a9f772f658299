"""The pairs of a stack: each is matched in a folder of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pcwlad_geo.errors import ExecutionError, InputError, OutputError, RegistrationRejectedError
from pcwlad_geo.estimation.solving import components
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.job import match_elsewhere, match_files, write_match
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.equations import ends_of
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.pair import PairStatus, StackPair, grade_pair
from pcwlad_geo.multi.stack.parameters import PAIR, PairParameters
from pcwlad_geo.options import SETTINGS, Settings
from pcwlad_geo.products.finding import of_one_product
from pcwlad_geo.raster import RpcGrid, middle_pixel_size_m
from pcwlad_geo.registration import Reason, estimate_tile_count
from pcwlad_geo.registration.frame_evidence import SAME_PIXELS
from pcwlad_geo.registration.positions import position_conflict
from pcwlad_geo.report.read_figures import REPORT_FILE, ReadFigures, read_figures
from pcwlad_geo.report.same_job import report_of_same_job
from pcwlad_geo.text import joined
from pcwlad_geo.tiepoints.format import PointFile
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.types import Float64

if TYPE_CHECKING:
    from pcwlad_geo.registration import Reason
from pcwlad_geo.registration import Registration

PAIRS: Final = "pairs"
"""Folder of the pairs that were measured."""
PAIR_DEFAULTS: Final[dict[str, Any]] = {
    "model": "auto", "like": None, "require": (), "keep": False,
    "of": "COG", "co": (), "resampling": "lanczos",
}  # fmt: skip
"""Options of the corrected images, which do not affect the matching of a pair."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPair:
    """What the folder of a pair holds, read once."""

    pair: StackPair
    edge: Edge | None = None
    """Its tie points on the ground; None of a pair that was refused."""
    points: PointFile | None = None
    """Those in the pixels of the files, of images with RPCs, which are adjusted there."""
    window_px: float = 0.0
    """Side of the windows in which these were matched, px of the frame."""


def edges_of(measured: Sequence[MeasuredPair]) -> list[Edge]:
    """Return the edges of the pairs that were not refused."""
    return [measurement.edge for measurement in measured if measurement.edge is not None]


def measure(
    frame: StackFrame,
    pairs: Sequence[tuple[int, int]],
    folder: Path,
    settings: Settings,
    overwrite: bool,
    on_event: EventCallback,
    runner: Runner,
    parameters: PairParameters = PAIR,
) -> Iterator[MeasuredPair]:
    """Yield the result of each pair, matched now or by an earlier run on the same files.

    Pairs of few tiles are matched in parallel, each as a whole; larger ones one after another, their tiles in
    parallel.
    """
    pairs = [frame.directed(pair) for pair in pairs]
    tasks = [_task(frame, pair, folder, settings) for pair in pairs]
    on_event(Progress("pairs", 0, len(tasks)))
    todo = [number for number, task in enumerate(tasks) if overwrite or not task.finished()]
    small = [number for number in todo if 0 < tasks[number].tile_count() <= parameters.small_tiles]
    refused = _match_whole([tasks[number] for number in small], len(tasks), len(todo), on_event, runner)
    reasons = dict(zip(small, refused, strict=True))
    for count, number in enumerate(sorted(set(todo) - set(small)), len(tasks) - len(todo) + len(small)):
        on_event(Progress("pairs", count, len(tasks)))
        reasons[number] = match_pair(*tasks[number], on_event, runner)
    for number, (pair, task) in enumerate(zip(pairs, tasks, strict=True)):
        yield measured_pair(frame, pair, task.place, reasons.get(number), on_event, parameters)
    on_event(Progress("pairs", len(tasks), len(tasks)))


def measured_pair(
    frame: StackFrame,
    pair: tuple[int, int],
    place: Path,
    reason: str | None,
    on_event: EventCallback,
    parameters: PairParameters = PAIR,
) -> MeasuredPair:
    """Return the result of a matched pair, from its folder unless there is a `reason` for its refusal."""
    names = frame.names[pair[0]], frame.names[pair[1]]
    edge, points, report = None, None, ReadFigures()
    if reason is None:
        figures = read_figures(place)  # also its warnings, so that a resumed run repeats them
        if figures is None and (place / REPORT_FILE).exists():
            raise OutputError(
                f"{place} has a damaged report (report.json is none of this program): "
                "remove the folder, and run again"
            )
        report = figures or report
        for warning in report.warnings:
            on_event(Warned(f"{names[0]} – {names[1]}: {warning}"))
        reason = str(report.reason) if report.status == "rejected" else None
        points = read_point_file(place / "tiepoints.csv") if reason is None else None
        edge = None if points is None else edge_of(frame, *pair, points, place, parameters)
    if edge is None:
        reason = reason or f"fewer than {parameters.min_points} tie points"
        on_event(Warned(f"{names[0]} – {names[1]}: refused: {reason}"))
    status: PairStatus = "refused" if edge is None else "used"
    result = StackPair(*names, status, reason, place, motions=report.motions)
    if edge is None or points is None:
        return MeasuredPair(result)
    infos = frame.infos[pair[0]], frame.infos[pair[1]]
    conflict = None if frame.georeferenced else position_conflict(*infos, edge.first_xy, edge.second_xy)
    texts = [text for text in report.warnings if text.startswith(SAME_PIXELS)]
    texts += [] if conflict is None else [conflict.text]
    result = grade_pair(result, edge, points, report, [Reason("poor", text) for text in texts])
    if not any(isinstance(info.grid, RpcGrid) for info in infos):
        return MeasuredPair(result, edge)
    return MeasuredPair(result, edge, points, float(report.window_px or 0))


class _PairTask(NamedTuple):
    """A pair to be matched: the arguments of `match_pair` and `match_elsewhere`."""

    inputs: tuple[str, str]
    settings: Settings
    place: Path

    def tile_count(self) -> int:
        """Return how many tiles it has, about; 0 where that is not known."""
        return estimate_tile_count(*self.inputs, self.settings)

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


def edge_of(
    frame: StackFrame,
    one: int,
    other: int,
    points: PointFile,
    place: Path,
    parameters: PairParameters = PAIR,
) -> Edge | None:
    """Return the tie points of a pair on the ground, from its folder `place`; None if they are too few."""
    sigma_px = points.sigma_px
    if sigma_px is None:
        raise OutputError(f"{place} has tie points without sigma: remove the folder, and run again")
    good = points.enabled & np.isfinite(sigma_px).all(axis=1) & (sigma_px > 0).all(axis=1)
    reference_px, target_px, sigma_px = points.reference[good], points.target[good], sigma_px[good]
    scale = frame.scale(other, target_px)
    covariance = np.einsum("nab,nb,ncb->nac", scale, sigma_px**2, scale)
    first, second = frame.from_image(one, reference_px), frame.from_image(other, target_px)
    finite = np.isfinite(np.column_stack([first, second])).all(axis=1)
    if finite.sum() < parameters.min_points:
        return None
    first, second = first[finite], second[finite]
    places = len(np.unique(np.floor(first / parameters.square_px), axis=0))
    median_px = float(np.hypot(*np.median(second - first, axis=0)))
    offset = median_px / parameters.motions.georeferenced_px if frame.georeferenced else 0.0
    return Edge(one, other, first, second, covariance[finite], evidence=places / (1 + offset**2))


def sigma_known(
    frame: StackFrame, datum: int | None, count: int, parameters: PairParameters = PAIR
) -> Float64 | None:
    """Return the (count,) prior sigmas (see `adjust`) of images, px of the frame; None if there are none.

    The displacements of bands of the product that the datum belongs to are known beforehand.
    """
    sizes_m = middle_pixel_size_m(frame.grid)
    if datum is None or datum >= len(frame.infos) or sizes_m is None or not frame.georeferenced:
        return None
    sigma = np.full(count, np.inf)
    same_product = [of_one_product(frame.infos[datum].uri, info.uri) for info in frame.infos[:count]]
    sigma[: len(same_product)][same_product] = parameters.product_sigma_m / max(sizes_m)
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
