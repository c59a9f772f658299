"""The pairs of a stack: which are worth measuring, and what the matching of each gives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import shapely

from pcwlad_geo.errors import InputError, OutputError, RegistrationRejectedError
from pcwlad_geo.events import Event, EventCallback, Progress, Warned
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.job import match_files
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.grid import Grid, jacobian, map_px
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.report.finished import report_of_same_job
from pcwlad_geo.stacks.network import Edge, components
from pcwlad_geo.text import joined
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.types import Float64

PAIRS: Final = "pairs"
"""Folder of the pairs that were measured."""
ALL_PAIRS: Final = 8
"""Of the first so many images every pair is measured."""
NEXT: Final = 3
"""Each further one is paired with so many before it."""
MIN_OVERLAP: Final = 0.1
"""Least common ground of a pair, as a share of the smaller image."""
MIN_POINTS: Final = 12
"""Least number of tie points of a pair."""

PairStatus = Literal["used", "left out", "refused"]


@dataclass(frozen=True, slots=True, eq=False)
class StackPair:
    """A pair of images, and how it agrees with all others."""

    reference: str
    target: str
    status: PairStatus
    """`left out`: its points contradict the other pairs; `refused`: it could not be matched."""
    reason: str | None
    points: int
    offset_px: tuple[float, float] | None
    """By how much its points lie off the adjustment on average (col, row), px of the frame."""
    sigma_px: float | None
    """Standard deviation of that along an axis, if the pair is right."""
    redundancy: float | None
    """Share of the offset that other pairs check; nothing tells whether a pair of 0 is wrong."""
    scatter_px: float | None
    """Robust standard deviation of its points along an axis, px of the frame."""
    folder: Path
    """Its tie points and report; in stack.json relative to that file."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """The images, and the grid in whose px all are compared."""

    names: list[str]
    infos: list[RasterInfo]
    grid: Grid
    placed: bool
    """Whether all images are georeferenced; otherwise their pixels are compared."""

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


def choose_pairs(frame: Frame, most: int | None) -> list[tuple[int, int]]:
    """Return the pairs worth measuring, at most so many.

    All of the first images; each further one with those before it, and in steps of powers of two farther
    back, which stiffen a long series. An image added at the end leaves the pairs of the others as they are.
    """
    outlines = [
        shapely.Polygon(frame.from_image(number, info.grid.boundary_px()))
        for number, info in enumerate(frame.infos)
    ]
    count = len(outlines)
    wanted = [(number - step, number) for step in range(1, count) for number in range(step, count)]
    chosen: list[tuple[int, int]] = []
    degree = np.zeros(count, int)
    for one, other in wanted:
        # images that follow each other may share no ground: others are needed then
        needed = _useful(one, other) or min(degree[one], degree[other]) < NEXT
        if needed and _overlap(outlines[one], outlines[other]) >= MIN_OVERLAP:
            chosen.append((one, other))
            degree[[one, other]] += 1
    return chosen[:most]


def _useful(one: int, other: int) -> bool:
    step = other - one
    power = step & (step - 1) == 0
    return other < ALL_PAIRS or step <= NEXT or (power and other % step == 0)


def _overlap(one: shapely.Polygon, other: shapely.Polygon) -> float:
    smaller = min(one.area, other.area)
    return float(one.intersection(other).area / smaller) if smaller > 0 else 0.0


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
    """Yield what each pair gave, matched now or by an earlier run on the same files."""
    matching = replace(settings, model="auto")
    for number, (one, other) in enumerate(chosen):
        on_event(Progress("pairs", number, len(chosen)))
        names = frame.names[one], frame.names[other]
        place = folder / PAIRS / f"{names[0]}__{names[1]}"
        inputs = frame.infos[one].uri, frame.infos[other].uri
        reason: str | None = None
        report = {} if overwrite else report_of_same_job("match", inputs, matching, place)
        if not report:
            given: dict[str, Any] = {name: getattr(matching, name) for name in asdict(matching)}

            def of_this(event: Event, name: str = " – ".join(names)) -> None:
                on_event(Warned(f"{name}: {event.message}") if isinstance(event, Warned) else event)

            try:
                match_files(
                    *inputs, out_dir=place, overwrite=True, on_event=of_this, executor=runner, **given
                )
            except RegistrationRejectedError as error:
                reason = str(error)
            except InputError as error:
                reason = joined(error)
        elif report["status"] == "rejected":
            reason = str(report["reason"])
        edge = None if reason else _edge(frame, one, other, place)
        if edge is None:
            reason = reason or f"fewer than {MIN_POINTS} tie points"
            on_event(Warned(f"{names[0]} – {names[1]}: refused: {reason}"))
        yield (
            edge,
            StackPair(
                *names, "refused" if edge is None else "used", reason, 0, None, None, None, None, place
            ),
        )
    on_event(Progress("pairs", len(chosen), len(chosen)))


def _edge(frame: Frame, one: int, other: int, place: Path) -> Edge | None:
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
    if known.sum() < MIN_POINTS:
        return None
    return Edge(one, other, first[known], second[known], covariance[known])


def check_connected(frame: Frame, edges: Sequence[Edge], folder: Path) -> None:
    """Raise `RegistrationRejectedError` if the pairs that were matched do not connect all images."""
    count, group = components(edges, len(frame.names), np.ones(len(edges), bool))
    if count == 1:
        return
    groups = [
        " + ".join(name for name, of in zip(frame.names, group, strict=True) if of == number)
        for number in range(count)
    ]
    raise RegistrationRejectedError(
        f"{count} groups of images are not connected by any pair: {'; '.join(groups)}; give images that "
        f"share ground with both, or stack each group for itself (pairs: {folder / PAIRS})"
    )
