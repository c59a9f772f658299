"""The difference test: the visible image registered to the infrared before and after its known shift.

What the two bands differ by drops out, so the difference of the two fitted shifts is known exactly; pixel
locking shows here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.pairs import landsat, rgbnir
from benchmarks.runs import PAPER, PER_POINT, Array, Job, Outcome, Runner
from benchmarks.tables import Cell, Table, at_most

LIMIT_PX = 0.02


def difference(data: Path, _scratch: Path, runner: Runner, limit_px: float = LIMIT_PX) -> Iterator[Table]:
    """Yield one table."""
    rows: list[list[Cell]] = []
    checks = []
    for pair in (landsat(data), rgbnir(data)):
        for name, settings in (("oriented + consensus", PAPER), ("oriented", PER_POINT)):
            chosen = replace(settings, model="shift")
            before, after = runner(
                [
                    Job(pair.reference, target, chosen, match_only=False)
                    for target in (pair.undisplaced, pair.target)
                ]
            )
            error = _shift(after) - _shift(before) - pair.truth
            rows.append(
                [f"{pair.name}, {name}", *(f"{v:+.3f}" for v in (*_shift(before), *_shift(after), *error))]
            )
            checks.append(
                at_most(f"{pair.name}, {name}: larger axis", float(np.abs(error).max()), limit_px, "px")
            )
    header = ("pair", "before x", "y", "after x", "y", "error x", "y")
    yield Table("Difference of two fitted shifts against the known shift, px", header, rows, checks)


def _shift(outcome: Outcome) -> Array:
    correction = outcome.result.model
    if correction is None:
        raise RuntimeError(f"refused: {outcome.reason}")
    return correction.forward(np.zeros((1, 2)))[0]
