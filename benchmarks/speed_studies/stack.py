"""A stack of scenes: its time beside that of its pairs alone, memory, one more image, and being killed."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.speed_studies.processes import Measured, measure
from benchmarks.tables import Cell, Check, Table, at_most
from tests.scenes import make_grid, render, write

REPOSITORY: Final = Path(__file__).resolve().parents[2]
SIDE_PX: Final = 1024
SEED: Final = 181
DEAREST, MOST_MB = 1.2, 1500.0
KILLS: Final = 2
PAIRS_ALONE: Final = """
import csv, sys
from pathlib import Path
from pcwlad_geo.job import open_job_runner
from pcwlad_geo.multi.stack.pairs import match_pair
from pcwlad_geo.options import Settings
if __name__ == "__main__":
    settings = Settings(jobs=int(sys.argv[3]))
    pairs = enumerate(csv.reader(open(sys.argv[1])))
    calls = [(tuple(pair), settings, Path(sys.argv[2]) / str(number)) for number, pair in pairs]
    with open_job_runner(settings, None, lambda event: None) as runner:
        runner.run(match_pair, calls, "pairs")
"""
"""Matches the pairs of a table on the same processes as a stack, and does nothing else."""


def stack_of_scenes(scratch: Path, scenes: int, jobs: int) -> Iterator[Table]:
    """Yield what a stack of so many scenes costs, and what being killed does to it."""
    folder = scratch / "scenes of a stack"
    images = _make(folder, scenes + 1)
    last = folder.with_name("the last") / images[-1].name
    last.parent.mkdir()
    images[-1].rename(last)
    options = ("--jobs", str(jobs), "--progress", "none")
    whole = _command("stack", str(folder), "-o", str(scratch / "whole"), *options)
    names = [place.name for place in sorted((scratch / "whole/pairs").glob("[!.]*"))]
    pairs = [[str(folder / f"{name}.tif") for name in each.split("__")] for each in names]
    alone = _alone(scratch, pairs, jobs)
    killed = [_killed(folder, scratch, options, number, whole.wall_s) for number in range(KILLS)]
    stamps = _stamps(scratch / "whole")
    added = _command("stack", "--add", str(last), str(scratch / "whole"), *options)
    places = {place.name for place in (scratch / "whole/pairs").glob("[!.]*")} - set(names)
    of_last = [
        [str(last if name == last.stem else folder / f"{name}.tif") for name in each.split("__")]
        for each in sorted(places)
    ]
    alone_of_last = _alone(scratch, of_last, jobs)
    rows: list[list[Cell]] = [
        [f"stack of {scenes} scenes", len(names), whole.wall_s, whole.cpu_s, whole.peak_mb],
        ["its pairs alone", len(names), alone.wall_s, alone.cpu_s, alone.peak_mb],
        ["one image added", len(places), added.wall_s, added.cpu_s, added.peak_mb],
        ["its pairs alone", len(places), alone_of_last.wall_s, alone_of_last.cpu_s, alone_of_last.peak_mb],
    ]
    checks = [
        at_most("time / that of its pairs alone", whole.wall_s / alone.wall_s, DEAREST, "", 2),
        at_most("CPU time / that of its pairs alone", whole.cpu_s / alone.cpu_s, DEAREST, "", 2),
        at_most("peak memory", whole.peak_mb, MOST_MB, "MB", 0),
        at_most("one image added: earlier pairs measured again", _again(stamps), 0, digits=0),
        at_most("one image added: pairs that are not its own", _foreign(places, last.stem), 0, digits=0),
        *(check for checks in killed for check in checks),
    ]
    header = ("", "pairs", "wall s", "CPU s", "MB")
    yield Table(f"A stack of {scenes} scenes of {SIDE_PX}²", header, rows, checks)


def _make(folder: Path, count: int) -> list[Path]:
    folder.mkdir(parents=True)
    rng, grid = np.random.default_rng(SEED), make_grid((SIDE_PX, SIDE_PX))
    made = []
    for number in range(count):
        shift = rng.uniform(-5.0, 5.0, 2) if number else np.zeros(2)
        values = render(grid, "red", displacement_px=shift, noise=0.0)
        values += rng.normal(0.0, 2.0 + number % 5, values.shape)
        made.append(write(folder / f"scene{number:03}.tif", values, grid))
    return made


def _command(*arguments: str) -> Measured:
    command = [sys.executable, "-m", "pcwlad_geo", *arguments]
    found = measure(command, environment={"PYTHONPATH": str(REPOSITORY)})
    if found.status:
        raise RuntimeError(f"{arguments[0]}: {found.reason}")
    return found


def _alone(scratch: Path, pairs: list[list[str]], jobs: int) -> Measured:
    table, script, out = scratch / "pairs.csv", scratch / "pairs_alone.py", scratch / "alone"
    shutil.rmtree(out, ignore_errors=True)
    table.write_text("".join(f"{one},{other}\n" for one, other in pairs))
    script.write_text(PAIRS_ALONE)
    command = [sys.executable, str(script), str(table), str(out), str(jobs)]
    found = measure(command, environment={"PYTHONPATH": str(REPOSITORY)})
    if found.status:
        raise RuntimeError(f"the pairs alone: {found.reason}")
    return found


def _killed(folder: Path, scratch: Path, options: tuple[str, ...], number: int, wall_s: float) -> list[Check]:
    """Kill a stack at a random moment and start it again; compare it with one that was not."""
    out = scratch / f"killed{number}"
    moment_s = random.Random(SEED + number).uniform(0.1, 0.9) * wall_s
    command = [sys.executable, "-m", "pcwlad_geo", "stack", str(folder), "-o", str(out), *options]
    process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(REPOSITORY)})
    time.sleep(moment_s)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = _stamps(out)
    _command("stack", str(folder), "-o", str(out), *options)
    again = _again(done)
    differing = _differing(out, scratch / "whole")
    when = f"killed after {moment_s:.0f} s with {len(done)} pairs"
    return [
        at_most(f"{when}: pairs measured twice", again, 0, digits=0),
        at_most(f"{when}: files that differ from those of an undisturbed run", differing, 0, digits=0),
    ]


def _stamps(out: Path) -> dict[Path, int]:
    """Return when each pair of a stack was measured."""
    return {path: path.stat().st_mtime_ns for path in out.glob("pairs/[!.]*/report.json")}


def _again(done: dict[Path, int]) -> int:
    return sum(path.stat().st_mtime_ns != before for path, before in done.items())


def _foreign(places: set[str], name: str) -> int:
    return sum(name not in place.split("__") for place in places)


def _differing(one: Path, other: Path) -> int:
    names = {path.name for folder in (one, other) for path in folder.iterdir() if path.is_file()}
    return sum(
        not ((one / name).is_file() and (other / name).is_file())
        or (one / name).read_bytes() != (other / name).read_bytes()
        for name in names
    )
