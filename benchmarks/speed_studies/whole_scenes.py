"""Whole scenes: the command line on each size and in each mode; other programs on the same scenes."""

from __future__ import annotations

import json
import math
import os
import shutil
import statistics
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from benchmarks.speed_studies import truth
from benchmarks.speed_studies.processes import Measured, measure
from benchmarks.speed_studies.scene_files import ScenePair

REPOSITORY: Final = Path(__file__).resolve().parents[2]
TIE_POINTS: Final = ("reading", "prealignment", "matching", "refining")
"""Stages of a job up to its tie points."""
AROSICS_POINTS: Final = 1000
AROSICS_WINDOW: Final = 128
AROSICS_MAX_SHIFT: Final = 3
"""Displacements reach 1.5 px an axis: the right value, with a margin; its default is 5."""


@dataclass(frozen=True, slots=True)
class Mode:
    """A command line that is measured."""

    name: str
    command: str
    options: tuple[str, ...]
    largest_px: int = 1 << 30
    """Scenes beyond this size are left out unless asked for."""


MATCH: Final = "match 1000"
REGISTER: Final = "register 1000"
GRADIENT: Final = "gradient 1000"
ALL: Final = "match all"
PCLSM: Final = "pclsm 1000"
AROSICS: Final = "AROSICS"

_THOUSAND: Final = ("--points", "1000", "--window", "129")
MODES: Final = (
    Mode(MATCH, "match", _THOUSAND),
    Mode(GRADIENT, "match", (*_THOUSAND, "--method", "gradient")),
    Mode(REGISTER, "register", _THOUSAND),
    Mode(ALL, "match", ("--points", "all", "--window", "81"), largest_px=4096),
    # the judge of how hard the scenes are: the paper's plain least squares
    Mode(PCLSM, "match", ("--method", "pclsm", "--points", "1000"), largest_px=1024),
)


@dataclass(frozen=True, slots=True)
class Run:
    """One measured run."""

    mode: str
    side_px: int
    cost: Measured
    score: truth.PointScore | None
    """None where the run gave no points."""
    inner_s: float
    """What the job itself says: its stages up to the tie points; AROSICS: its library call. NaN: failed."""
    inner_cpu_s: float = math.nan
    """AROSICS: CPU time of its library call."""


def jobs() -> int:
    """Return the number of processes of a run: two, where it may use two cores."""
    return min(2, len(os.sched_getaffinity(0)))


def run_mode(mode: Mode, pair: ScenePair, scratch: Path, home: Path | None = None) -> Run:
    """Run one command on a scene in a fresh process.

    Parameters
    ----------
    mode : Mode
    pair : ScenePair
    scratch : pathlib.Path
        Where the results go; they are removed again.
    home : pathlib.Path, optional
        Folder that stands for the user's; the usual one by default.
    """
    out = scratch / "out"
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-m", "pcwlad_geo", mode.command, str(pair.reference), str(pair.target)]
    command += ["-o", str(out), "--progress", "none", "--jobs", str(jobs()), *mode.options]
    environment = {"PYTHONPATH": str(REPOSITORY)} | ({"HOME": str(home)} if home else {})
    cost = measure(command, environment=environment, folder=scratch)
    found, inner_s = None, math.nan
    if cost.status == 0:
        found = truth.score(*truth.read_tie_points(out / "tiepoints.csv"), pair.side_px)
        seconds = json.loads((out / "report.json").read_text(encoding="utf-8"))["seconds"]
        inner_s = sum(value for stage, value in seconds.items() if stage in TIE_POINTS)
    shutil.rmtree(out, ignore_errors=True)
    return Run(mode.name, pair.side_px, cost, found, inner_s)


def run_arosics(python: Path, pair: ScenePair, scratch: Path, points: int = AROSICS_POINTS) -> Run:
    """Run AROSICS' COREG_LOCAL on a scene in a fresh process of its own environment."""
    table = scratch / "arosics.csv"
    grid_res = round(pair.side_px / math.sqrt(points))
    script = Path(__file__).with_name("arosics_call.py")
    numbers = [str(number) for number in (grid_res, AROSICS_WINDOW, AROSICS_MAX_SHIFT)]
    command = [str(python), str(script), str(pair.reference), str(pair.target), *numbers, str(table)]
    return run_peer(AROSICS, command, pair, scratch, lambda: truth.read_arosics(table))


def run_peer(
    name: str,
    command: Sequence[str],
    pair: ScenePair,
    scratch: Path,
    read: Callable[[], tuple[truth.Float64, truth.Float64]],
) -> Run:
    """Run another program, which prints the cost of its call as JSON, and judge the points that it wrote."""
    cost = measure(command, environment={"PYTHONPATH": ""}, folder=scratch)
    if cost.status != 0:
        return Run(name, pair.side_px, cost, None, math.nan)
    figures = json.loads(cost.output.strip().splitlines()[-1])
    found = truth.score(*read(), pair.side_px)
    return Run(name, pair.side_px, cost, found, figures["wall_s"], figures["cpu_s"])


def repeated(works: Mapping[str, Callable[[], Run]], repeats: int) -> Iterator[Run]:
    """Do all named runs in turn, several times. One that fails is not done again."""
    failed: set[str] = set()
    for _ in range(repeats):
        for name, work in works.items():
            if name not in failed:
                run = work()
                failed |= {name} if run.score is None else set()
                yield run


def read_runs(path: Path) -> list[Run]:
    """Return the runs that `write_runs` has kept."""
    rows = json.loads(path.read_text(encoding="utf-8"))
    for row in rows:
        row["cost"] = Measured(**row["cost"])
        row["score"] = row["score"] and truth.PointScore(**row["score"])
    return [Run(**row) for row in rows]


def write_runs(path: Path, runs: Sequence[Run]) -> None:
    """Keep runs for a later call of the benchmark on the same machine."""
    path.write_text(json.dumps([asdict(run) for run in runs]), encoding="utf-8")


class Results:
    """All runs; figures are medians over the runs of one mode on one size."""

    def __init__(self, runs: Sequence[Run]) -> None:
        self.runs = list(runs)

    def of(self, mode: str, side_px: int) -> list[Run]:
        """Return the runs that gave points."""
        return [r for r in self.runs if (r.mode, r.side_px) == (mode, side_px) and r.score is not None]

    def wall_s(self, mode: str, side_px: int) -> float:
        """Wall time of the process."""
        return _median([run.cost.wall_s for run in self.of(mode, side_px)])

    def inner_s(self, mode: str, side_px: int) -> float:
        """Wall time of the job inside the process."""
        return _median([run.inner_s for run in self.of(mode, side_px)])

    def inner_cpu_s(self, mode: str, side_px: int) -> float:
        """CPU time of the call of another program."""
        return _median([run.inner_cpu_s for run in self.of(mode, side_px)])

    def cpu_s(self, mode: str, side_px: int) -> float:
        """CPU time of all processes."""
        return _median([run.cost.cpu_s for run in self.of(mode, side_px)])

    def peak_mb(self, mode: str, side_px: int) -> float:
        """Largest peak of memory."""
        return max((run.cost.peak_mb for run in self.of(mode, side_px)), default=math.nan)

    def rmse_px(self, mode: str, side_px: int) -> float:
        """RMSE of the correct points."""
        return _median([run.score.rmse_px for run in self.of(mode, side_px) if run.score])

    def count(self, what: str, mode: str, side_px: int) -> float:
        """`points`, `correct` or `cells`."""
        return _median([getattr(run.score, what) for run in self.of(mode, side_px)])

    def sizes(self, mode: str) -> list[int]:
        """Sizes on which a mode gave points."""
        return sorted({run.side_px for run in self.runs if run.mode == mode and run.score is not None})


def _median(values: Sequence[float]) -> float:
    return float(statistics.median(values)) if values else math.nan
