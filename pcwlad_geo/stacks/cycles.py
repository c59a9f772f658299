"""Cycles of pairs: by how much they fail to close, and which pair is to blame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

from pcwlad_geo.stacks.pairs import StackPair

MAX_CYCLES: Final = 20_000
"""Largest number of cycles that are looked at."""
OPEN: Final = 5.0
"""A cycle that fails to close by more sigmas is listed."""
LISTED: Final = 30
"""Largest number of cycles that are listed."""


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


def closure_of(pairs: Sequence[StackPair]) -> Closure:
    """Return how the cycles of measured pairs close.

    In a cycle the displacements of the adjustment add up to nothing; what is left is by how much each pair
    lies off it.
    """
    measured = {(pair.reference, pair.target): pair for pair in pairs if pair.offset_px is not None}
    every, good, found = [], [], []
    for images in _cycles(measured):
        steps = [_step(measured, *ends) for ends in zip(images, (*images[1:], images[0]), strict=True)]
        col, row = (sum(sign * _offset(pair)[axis] for pair, sign in steps) for axis in (0, 1))
        length = math.hypot(col, row)
        every.append(length)
        if all(pair.status == "used" for pair, _ in steps):
            good.append(length)
        sigma = math.sqrt(sum((pair.sigma_px or 0.0) ** 2 for pair, _ in steps))
        if length > OPEN * max(sigma, 1e-9):
            worst = max(
                (pair for pair, _ in steps), key=lambda pair: (pair.status != "used", suspicion(pair))
            )
            found.append(Cycle(images, (col, row), sigma, (worst.reference, worst.target)))
    found.sort(key=lambda each: -math.hypot(*each.closure_px))
    return Closure(len(every), root_mean_square(every), root_mean_square(good), tuple(found[:LISTED]))


def suspicion(pair: StackPair) -> float:
    """Return by how many sigmas a pair disagrees with all others; 0 for one that was refused."""
    if pair.offset_px is None or not pair.sigma_px:
        return 0.0
    return math.hypot(*pair.offset_px) / pair.sigma_px


def root_mean_square(values: Sequence[float]) -> float | None:
    """Return the root mean square of values; None of none."""
    return math.sqrt(sum(value**2 for value in values) / len(values)) if values else None


def _offset(pair: StackPair) -> tuple[float, float]:
    return pair.offset_px or (0.0, 0.0)


def _step(measured: dict[tuple[str, str], StackPair], one: str, other: str) -> tuple[StackPair, float]:
    """Return the pair of two images, and whether it is gone forwards (1) or backwards (-1)."""
    found = measured.get((one, other))
    return (found, 1.0) if found is not None else (measured[other, one], -1.0)


def _cycles(measured: dict[tuple[str, str], StackPair]) -> list[tuple[str, ...]]:
    """Return the cycles of three images, or of four where there are none of three."""
    near: dict[str, set[str]] = {}
    for one, other in measured:
        near.setdefault(one, set()).add(other)
        near.setdefault(other, set()).add(one)
    order = {name: number for number, name in enumerate(near)}
    found: list[tuple[str, ...]] = []
    for one, other in measured:
        later = max(order[one], order[other])
        thirds = sorted(
            (each for each in near[one] & near[other] if order[each] > later), key=order.__getitem__
        )
        found += [(one, other, third) for third in thirds]
        if len(found) > MAX_CYCLES:
            return found[:MAX_CYCLES]
    return found or _of_four(near, order)


def _of_four(near: dict[str, set[str]], order: dict[str, int]) -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = []
    for one, across in combinations(order, 2):
        between = sorted((near[one] & near[across]) - {one, across}, key=order.__getitem__)
        found += [
            (one, two, across, four)
            for two, four in combinations(between, 2)
            if order[one] < min(order[two], order[four])
        ]
        if len(found) > MAX_CYCLES:
            break
    return found[:MAX_CYCLES]
