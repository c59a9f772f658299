"""The tool's own error a point: the moved minus the unmoved result, minus the known move, at common points.

What the two bands differ by, and how far they lay apart before, drops out: what is left is locking, noise of
the interpolation and of the iteration. The same in both results, structure that lies elsewhere in the other
band, cannot be seen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.pairs import landsat, rgbnir
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.tables import Cell, Table
from pcwlad_geo.options import Settings

WINDOWS = (None, 81, 129, 181)
"""None: the default call."""
GROSS_PX = 0.5
"""Points beyond this are counted, and left out of bias and scatter."""


def pointwise(data: Path, _scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield one table."""
    rows: list[list[Cell]] = []
    for pair in (landsat(data), rgbnir(data)):
        for window in WINDOWS:
            settings = replace(Settings(), window=window) if window else Settings()
            before, after = runner(
                [Job(pair.reference, target, settings) for target in (pair.undisplaced, pair.target)]
            )
            error = moved_minus_unmoved(before, after) - pair.truth
            gross = np.hypot(*error.T) > GROSS_PX
            good = error[~gross]
            deviation = 1.4826 * np.median(np.abs(good - np.median(good, axis=0)), axis=0)
            figures = (*good.mean(axis=0), *good.std(axis=0), *deviation)
            name = f"window {window}" if window else "default"
            cpu_s = f"{before.cpu_s + after.cpu_s:.1f}"
            rows.append(
                [f"{pair.name}, {name}", len(error), int(gross.sum()), *(f"{v:+.4f}" for v in figures), cpu_s]
            )
    header = ("pair", "points", "gross", "bias x", "y", "scatter x", "y", "MAD x", "y", "CPU s")
    yield Table("Moved minus unmoved result, minus the known move, at the same points, px", header, rows)


def moved_minus_unmoved(before: Outcome, after: Outcome) -> Array:
    """Return the displacements after the move minus those before, of the points that both have."""
    places = {tuple(place): row for row, place in enumerate(before.points.reference_px)}
    both = [
        (places[key], row) for row, p in enumerate(after.points.reference_px) if (key := tuple(p)) in places
    ]
    first, second = np.array(both).T
    return after.points.target_px[second] - before.points.target_px[first]
