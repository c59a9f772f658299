"""Other programs on the same scenes: AROSICS, and what OpenCV and scikit-image have. Time beside accuracy.

KARIOS is not on the package index and is left out.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.speed_studies import truth
from benchmarks.speed_studies import whole_scenes as w
from benchmarks.speed_studies.processes import on_cores
from benchmarks.speed_studies.scene_files import ScenePair
from benchmarks.tables import Cell, Table

POINTS: Final = (100, 1000, 10_000)
CORES: Final = (1, 2)
AROSICS_MOST_POINTS: Final = 10_000
"""Its memory grows with the square of the points: 9 GB at 17,000."""
OURS: Final = (w.MATCH, w.GRADIENT, w.REGISTER)
CALLS: Final = {
    "SIFT + MAGSAC++": "sift",
    "phase_cross_correlation": "phase_cross_correlation",
    "optical_flow_ilk": "optical_flow_ilk",
}
"""Name of a method, and that of its function in `peer_call.py`."""
DENSE: Final = "optical_flow_ilk"
"""It costs the same for any number of points."""

Works = dict[str, Callable[[], w.Run]]


def works(pair: ScenePair, scratch: Path, arosics: Path | None, points: int = w.AROSICS_POINTS) -> Works:
    """Return the runs of all other programs that are installed, by their names."""
    found: Works = {}
    if arosics and points <= AROSICS_MOST_POINTS:
        found[w.AROSICS] = partial(w.run_arosics, arosics, pair, scratch, points)
    for name, method in CALLS.items():
        if name == "SIFT + MAGSAC++" or importlib.util.find_spec("skimage"):
            found[name] = partial(_run, name, method, pair, scratch, points)
    return found


def missing(arosics: Path | None) -> Iterator[str]:
    """Yield a sentence for each program that cannot run."""
    if not arosics:
        yield "AROSICS is left out: give --arosics PYTHON or set PCWLAD_GEO_AROSICS_PYTHON"
    if not importlib.util.find_spec("skimage"):
        yield "scikit-image is left out: it is not installed"
    yield "KARIOS is left out: it is not on the package index"


def uncorrected(side_px: int) -> truth.PointScore:
    """Judge the scene as it is: no displacement, on a grid of 100 x 100 points."""
    axis = (np.arange(100) + 0.5) * side_px / 100
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return truth.score(grid, np.zeros_like(grid), side_px)


def growth_with_points(
    pair: ScenePair, scratch: Path, arosics: Path | None, counts: Sequence[int]
) -> list[w.Run]:
    """Run match and the other programs for each number of points; it is in the names of the runs."""
    mode = next(mode for mode in w.MODES if mode.name == w.MATCH)
    runs = []
    for count in counts:
        ours = replace(mode, name="match", options=("--points", str(count), "--window", "129"))
        others = works(pair, scratch, arosics, count)
        others.pop(DENSE, None)
        named: Works = {"match": partial(w.run_mode, ours, pair, scratch)} | others
        runs += [replace(run, mode=f"points: {count}, {run.mode}") for run in w.repeated(named, 1)]
    return runs


def growth_with_cores(pair: ScenePair, scratch: Path, arosics: Path | None) -> list[w.Run]:
    """Run our commands and AROSICS on one core and on two, where there are two."""
    runs = []
    for count in CORES:
        with on_cores(count):
            if w.jobs() < count:
                continue
            named: Works = {m.name: partial(w.run_mode, m, pair, scratch) for m in w.MODES if m.name in OURS}
            if arosics:
                named[w.AROSICS] = partial(w.run_arosics, arosics, pair, scratch)
            found = list(w.repeated(named, 1))
        runs += [replace(run, mode=f"cores: {count}, {run.mode}") for run in found]
    return runs


def table(title: str, runs: Sequence[w.Run]) -> Table:
    """Return one line for each run."""
    rows: list[list[Cell]] = []
    for run in runs:
        row: list[Cell] = [run.mode, f"{run.cost.wall_s:.2f}", f"{run.cost.cpu_s:.2f}"]
        found = run.score
        row += [found.points, found.correct, found.rmse_px] if found else ["-", "-", "failed"]
        rows.append([*row, f"{run.cost.peak_mb:.0f}"])
    return Table(title, ("", "wall s", "CPU s", "points", "correct", "RMSE px", "MB"), rows)


def _run(name: str, method: str, pair: ScenePair, scratch: Path, points: int) -> w.Run:
    out = scratch / "peer.csv"
    script = Path(__file__).with_name("peer_call.py")
    files = [str(pair.reference), str(pair.target)]
    command = [sys.executable, str(script), method, *files, str(points), str(out)]
    return w.run_peer(name, command, pair, scratch, lambda: truth.read_tie_points(out))
