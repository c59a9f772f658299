"""Cycles of pairs of a stack, and by how much they fail to close."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from pcwlad_geo.multi.stack.pair import StackPair
from pcwlad_geo.multi.stack.parameters import GRADING, GradeParameters


@dataclass(frozen=True, slots=True)
class Cycle:
    """A cycle that does not close."""

    images: tuple[str, ...]
    """Names of its images, in order."""
    closure_px: tuple[float, float]
    """What the displacements of its pairs add up to (col, row), px of the frame."""
    sigma_px: float
    """Standard deviation of that along an axis, if all its pairs are right."""
    blame: tuple[str, str]
    """The pair of it that disagrees most with all others, in sigmas."""


@dataclass(frozen=True, slots=True)
class Closure:
    """How the cycles of three pairs, or of four where there are none of three, close."""

    cycles: int
    """Number of cycles of measured pairs."""
    before_px: float | None
    """Root mean square length of what all of them fail to close by, px of the frame; null without a cycle."""
    after_px: float | None
    """The same of those without a pair that was left out."""
    open: tuple[Cycle, ...]
    """Those that do not close, the worst first."""


def closure_of(pairs: Sequence[StackPair], parameters: GradeParameters = GRADING) -> Closure:
    """Return how the cycles of measured pairs close.

    In a cycle the displacements of the adjustment add up to nothing; what is left is by how much each pair
    lies off it.
    """
    measured = {(pair.reference, pair.target): pair for pair in pairs if pair.offset_px is not None}
    every, good, open_cycles = [], [], []
    for images in _cycles(measured, parameters.max_cycles):
        steps = [_step(measured, *ends) for ends in zip(images, (*images[1:], images[0]), strict=True)]
        col, row = (
            sum(sign * (pair.offset_px or (0.0, 0.0))[axis] for pair, sign in steps) for axis in (0, 1)
        )
        length = math.hypot(col, row)
        every.append(length)
        if all(pair.status == "used" for pair, _ in steps):
            good.append(length)
        sigma = math.sqrt(sum((pair.sigma_px or 0.0) ** 2 for pair, _ in steps))
        if length > parameters.open_sigmas * max(sigma, 1e-9):
            worst = max(
                (pair for pair, _ in steps), key=lambda pair: (pair.status != "used", misfit_sigmas(pair))
            )
            open_cycles.append(Cycle(images, (col, row), sigma, (worst.reference, worst.target)))
    open_cycles.sort(key=lambda cycle: -math.hypot(*cycle.closure_px))
    listed = tuple(open_cycles[: parameters.max_open_cycles])
    return Closure(len(every), root_mean_square(every), root_mean_square(good), listed)


def misfit_sigmas(pair: StackPair) -> float:
    """Return by how many sigmas a pair disagrees with all others; 0 for one that was refused."""
    return pair.off_px / pair.sigma_px if pair.sigma_px else 0.0


def root_mean_square(values: Sequence[float]) -> float | None:
    """Return the root mean square of values; None of none."""
    return math.sqrt(sum(value**2 for value in values) / len(values)) if values else None


def _step(measured: dict[tuple[str, str], StackPair], one: str, other: str) -> tuple[StackPair, float]:
    """Return the pair of two images, and whether it is gone forwards (1) or backwards (-1)."""
    forward = measured.get((one, other))
    return (forward, 1.0) if forward is not None else (measured[other, one], -1.0)


def _cycles(measured: dict[tuple[str, str], StackPair], most: int) -> list[tuple[str, ...]]:
    """Return `most` cycles of three images, or of four where there are none of three."""
    neighbours: dict[str, set[str]] = {}
    for one, other in measured:
        neighbours.setdefault(one, set()).add(other)
        neighbours.setdefault(other, set()).add(one)
    order = {name: number for number, name in enumerate(neighbours)}
    cycles: list[tuple[str, ...]] = []
    for one, other in measured:
        later = max(order[one], order[other])
        thirds = sorted(
            (third_name for third_name in neighbours[one] & neighbours[other] if order[third_name] > later),
            key=order.__getitem__,
        )
        cycles += [(one, other, third) for third in thirds]
        if len(cycles) > most:
            return cycles[:most]
    return cycles or _of_four(neighbours, order, most)


def _of_four(neighbours: dict[str, set[str]], order: dict[str, int], most: int) -> list[tuple[str, ...]]:
    cycles: list[tuple[str, ...]] = []
    for one, across in combinations(order, 2):
        between = sorted((neighbours[one] & neighbours[across]) - {one, across}, key=order.__getitem__)
        cycles += [
            (one, two, across, four)
            for two, four in combinations(between, 2)
            if order[one] < min(order[two], order[four])
        ]
        if len(cycles) > most:
            break
    return cycles[:most]
