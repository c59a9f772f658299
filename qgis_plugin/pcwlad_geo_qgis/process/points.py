"""Tie points as a user edits them: which are on, their residuals, and what can be undone."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple


@dataclass
class Point:
    """A tie point: its row of tiepoints.csv, as numbers."""

    number: int
    x: float
    y: float
    """In the reference's CRS."""
    target_px: tuple[float, float]
    sigma_px: float
    status: str
    residual_px: tuple[float, float] = (math.nan, math.nan)
    """Predicted minus observed (col, row), as the Georeferencer has it; the engine has the other sign."""

    @property
    def length_px(self) -> float:
        """Length of the residual."""
        return math.hypot(*self.residual_px)


def point_of(row: dict[str, Any]) -> Point:
    """Return a point from a row of tiepoints.csv, or from the engine's answer."""

    def number(name: str) -> float:
        value = row.get(name)
        return math.nan if value in (None, "") else float(value)

    residual = (-number("residual_col"), -number("residual_row"))
    where = (number("tgt_col"), number("tgt_row"))
    sigma = math.hypot(number("sigma_col"), number("sigma_row"))
    return Point(int(number("id")), number("x"), number("y"), where, sigma, row["status"], residual)


class Affine(NamedTuple):
    """x = a u + b v + c, y = d u + e v + f."""

    a: float
    b: float
    c: float
    d: float
    e: float
    f: float

    def __call__(self, u: float, v: float) -> tuple[float, float]:
        """Return (x, y)."""
        return self.a * u + self.b * v + self.c, self.d * u + self.e * v + self.f

    @property
    def determinant(self) -> float:
        """How much larger an area becomes; negative where it is mirrored."""
        return self.a * self.e - self.b * self.d

    def inverse(self) -> Affine:
        """Return the function from (x, y) to (u, v)."""
        a, b, d, e = (value / self.determinant for value in (self.e, -self.b, -self.d, self.a))
        return Affine(a, b, -a * self.c - b * self.f, d, e, -d * self.c - e * self.f)


def affine_of(rows: Sequence[Sequence[float]]) -> Affine | None:
    """Return the affine function that fits rows (u, v, x, y); None where they do not determine it."""
    if len(rows) < 3:
        return None
    means = [math.fsum(column) / len(rows) for column in zip(*rows)]  # Python 3.9 has no strict
    centred = [[value - mean for value, mean in zip(row, means)] for row in rows]

    def moment(one: int, other: int) -> float:
        return math.fsum(row[one] * row[other] for row in centred)

    uu, uv, vv = moment(0, 0), moment(0, 1), moment(1, 1)
    determinant = uu * vv - uv * uv
    if determinant <= 1e-9 * uu * vv:
        return None
    parts: list[float] = []
    for axis in (2, 3):
        u, v = moment(0, axis), moment(1, axis)
        first, second = (u * vv - v * uv) / determinant, (v * uu - u * uv) / determinant
        parts += [first, second, means[axis] - first * means[0] - second * means[1]]
    return Affine(*parts)


@dataclass
class Points:
    """All points of a job, and the changes to them."""

    points: list[Point]
    off: set[int] = field(default_factory=set)
    """Indices of those that are switched off."""
    gone: set[int] = field(default_factory=set)
    """Indices of those that are deleted or moved: another one stands for what was moved."""
    rmse_px: dict[str, float | None] = field(default_factory=dict)
    """Of each model, for the points that are on; None where they do not determine it."""
    _before: list[tuple[set[int], set[int], int]] = field(default_factory=list)
    """What was off and gone, and how many points there were."""
    _after: list[tuple[set[int], set[int]]] = field(default_factory=list)
    """What was taken back: what is off and gone with it."""

    @classmethod
    def read(cls, folder: Path) -> Points:
        """Read those of a finished job."""
        with (folder / "tiepoints.csv").open(encoding="utf-8", newline="") as file:
            points = [point_of(row) for row in csv.DictReader(file)]
        return cls(points, {index for index, each in enumerate(points) if each.status == "rejected"})

    def switch(self, indices: Iterable[int], on: bool) -> bool:
        """Switch points on or off, and return whether any was not so already."""
        wanted = self.off - set(indices) if on else self.off | set(indices)
        return self._change(wanted, self.gone)

    def delete(self, indices: Iterable[int]) -> bool:
        """Delete points, and return whether there were any."""
        return self._change(self.off, self.gone | set(indices))

    def _change(self, off: set[int], gone: set[int]) -> bool:
        if (off, gone) == (self.off, self.gone):
            return False
        self._keep()
        self.off, self.gone = off, gone
        return True

    def _keep(self) -> None:
        self._before.append((self.off, self.gone, len(self.points)))
        self._after = []

    def undo(self) -> bool:
        """Take back the last change, and return whether there was one."""
        if not self._before:
            return False
        self._after.append((self.off, self.gone))
        self.off, gone, count = self._before.pop()
        self.gone = gone | set(range(count, len(self.points)))
        return True

    def redo(self) -> bool:
        """Make the change again that was taken back last, and return whether there was one."""
        if not self._after:
            return False
        after = self._after[:-1]
        self._change(*self._after[-1])
        self._after = after
        return True

    @property
    def can_redo(self) -> bool:
        """Whether there is a change to make again."""
        return bool(self._after)

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to take back."""
        return bool(self._before)

    def add(self, row: dict[str, Any], instead_of: int | None = None) -> None:
        """Append a point that the engine has placed, perhaps instead of one; it is one change."""
        self._keep()
        self.points.append(point_of(row))
        self.gone = self.gone | ({instead_of} - {None})

    def take(self, residual_px: Sequence[Sequence[float]]) -> None:
        """Take the engine's residuals (observed minus model) of all points."""
        for point, (col, row) in zip(self.points, residual_px):
            point.residual_px = (-col, -row)

    def above(self, length_px: float) -> list[int]:
        """Return the points that are on and have longer residuals than so many pixels."""
        shown = set(range(len(self.points))) - self.off - self.gone
        return sorted(index for index in shown if self.points[index].length_px > length_px)

    def placement(self) -> Affine | None:
        """Return the affine function from target pixels to the map of the points that are on.

        None where they do not span an area.
        """
        used = [each for row, each in enumerate(self.points) if row not in self.off | self.gone]
        return affine_of([(*each.target_px, each.x, each.y) for each in used])

    def fitted(self) -> Affine | None:
        """Return the affine function from target pixels to the map that is nearest to the last fit."""
        rows = []
        for row, each in enumerate(self.points):
            predicted = [a + b for a, b in zip(each.target_px, each.residual_px)]
            if row not in self.gone and all(map(math.isfinite, predicted)):
                rows.append((*predicted, each.x, each.y))
        return affine_of(rows)

    def status(self, index: int) -> str:
        """Return what a point counts as now."""
        return "gone" if index in self.gone else "rejected" if index in self.off else "fit"
