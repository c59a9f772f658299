"""Register many pairs on two workers, once in peace and once with processes killed at random moments.

Usage::

    python fuzz/chaos.py [--pairs N] [--kills N] [--seed S]

The run in peace must not grow: memory, open files and processes are shown along the pairs. The other one is
ended again and again, by SIGKILL of a worker or of the command itself, and started again with the same
command. After each end every folder of a pair must be complete or absent; in the end all bytes must be those
of the run in peace, the seconds that reports tell aside. The exit status is 1 where that is not so.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import IO, Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from fuzz.processes import Usage, descendants, still_alive, usage
from fuzz.results import complaints, content_of
from tests.scenes import make_grid, render, write

REPOSITORY: Final = Path(__file__).resolve().parents[1]
SHAPE: Final = (110, 180)
"""Of an image: two tiles, so that there are workers."""
SCENES: Final = 6
"""Different targets; the others are copies of them."""
OPTIONS: Final = 'features = 40\nwindow = 41\ntemplate = 61\njobs = 2\nmodel = "shift"\ntile_size = 128\n'
SHARE_OF_PARENT: Final = 0.4
PATIENCE_S: Final = 600.0
GROWTH_MB: Final = 20.0
"""Memory that 100 pairs may add."""
FIRST_SHARE: Final = 0.2
"""Of the pairs, at the start: memory grows until caches are full."""


@dataclass(slots=True)
class Peace:
    """What the run in peace has shown."""

    at: list[int] = field(default_factory=list)
    """Pairs that were done."""
    held: list[Usage] = field(default_factory=list)
    seconds: float = 0.0

    def per_100_pairs(self, name: str) -> float:
        """Return how much of something 100 pairs add, by a line through the later ones."""
        later = [n for n, done in enumerate(self.at) if done >= FIRST_SHARE * max(self.at)]
        if len({self.at[n] for n in later}) < 2:
            return 0.0
        values = [float(getattr(self.held[n], name)) for n in later]
        return 100 * float(np.polyfit([self.at[n] for n in later], values, 1)[0])


@dataclass(slots=True)
class Storm:
    """What the run under attack has come to."""

    kills: Counter[str] = field(default_factory=Counter)
    starts: int = 0
    finished: int = 0
    """Runs that came to their end although processes were killed."""
    complaints: list[str] = field(default_factory=list)


class Batch:
    """The command, and the pairs that it has done, in a process of its own."""

    def __init__(self, folder: Path) -> None:
        paths = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
        command = ["batch", "pairs.csv", "-o", "results", "--config", "options.toml", "--progress", "json"]
        self._errors = (folder / "stderr").open("w")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "pcwlad_geo", *command],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": paths},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            start_new_session=True,
            text=True,
        )
        self.done: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        """Numbers of pairs that are done; None at the end."""
        self._reader = threading.Thread(target=self._read, args=(self.process.stdout,), daemon=True)
        self._reader.start()

    def _read(self, stream: IO[str]) -> None:
        for line in stream:
            event = json.loads(line) if line.startswith("{") and line.endswith("}\n") else {}
            if event.get("stage") == "pairs":
                self.done.put(event["done"])
        self.done.put(None)

    def wait(self) -> int:
        """Wait for its end and return its exit status."""
        status = self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        self._errors.close()
        return status


def make(folder: Path, pairs: int) -> None:
    """Write pairs of tiny images that take two workers, and the table of them."""
    grid = make_grid(SHAPE)
    write(folder / "reference.tif", render(grid), grid, dtype="uint8", compress="deflate")
    for number in range(min(pairs, SCENES)):
        seen = 255 - render(grid, displacement_px=(1.3 + number / 4, -0.7))
        write(folder / f"t{number:04}.tif", seen, grid, dtype="uint8", compress="deflate")
    for number in range(SCENES, pairs):
        shutil.copy(folder / f"t{number % SCENES:04}.tif", folder / f"t{number:04}.tif")
    lines = [f"reference.tif,t{number:04}.tif" for number in range(pairs)]
    (folder / "pairs.csv").write_text("\n".join(["reference,target", *lines]) + "\n")
    (folder / "options.toml").write_text(OPTIONS)


def in_peace(folder: Path) -> Peace:
    """Run the batch to its end, looking at it after each pair."""
    found, since = Peace(), time.monotonic()
    batch = Batch(folder)
    while (done := batch.done.get(timeout=PATIENCE_S)) is not None:
        held = usage(batch.process.pid)
        if held is not None and done:
            found.at.append(done)
            found.held.append(held)
    if batch.wait() != 0:
        raise RuntimeError(f"the run in peace has failed: {(folder / 'stderr').read_text()[-500:]}")
    found.seconds = time.monotonic() - since
    return found


def under_attack(folder: Path, kills: int, seed: int, mean_s: float) -> Storm:
    """Run the batch again and again, killing one of its processes after random times of a mean."""
    found, random = Storm(), Random(seed)
    while found.kills.total() < kills:
        batch = Batch(folder)
        found.starts += 1
        while batch.process.poll() is None and found.kills.total() < kills:
            try:
                batch.process.wait(random.expovariate(1 / mean_s))
                break
            except subprocess.TimeoutExpired:
                pass
            if _kill(batch.process.pid, random, found):
                break
        if found.kills.total() >= kills and batch.process.poll() is None:
            batch.process.kill()
        if batch.wait() == 0:
            found.finished += 1
            shutil.rmtree(folder / "results", ignore_errors=True)  # there is nothing left to kill
        found.complaints += [f"kill {found.kills.total()}: {each}" for each in complaints(folder / "results")]
        print(f"{found.kills.total()} kills, {len(found.complaints)} complaints", file=sys.stderr, flush=True)
    return found


def _kill(process: int, random: Random, found: Storm) -> bool:
    """Kill the command or one of its processes; return whether it was the command."""
    below = descendants(process)
    whole = random.random() < SHARE_OF_PARENT or not below
    victim = process if whole else random.choice(below)
    try:
        os.kill(victim, signal.SIGKILL)
    except ProcessLookupError:
        return False
    found.kills["the command" if whole else "a worker"] += 1
    if whole:
        left = still_alive(below, 30.0)
        found.complaints += [
            f"kill {found.kills.total()}: {len(left)} processes outlived the command"
        ] * bool(left)
        for each in left:
            os.kill(each, signal.SIGKILL)
    return whole


def main(arguments: Sequence[str] | None = None) -> int:
    """Run both, compare, print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo-chaos-") as place:
        folder = Path(place)
        make(folder, asked.pairs)
        peace = in_peace(folder)
        grown = _report_peace(asked, peace)
        wanted = content_of(folder / "results")
        shutil.rmtree(folder / "results")
        mean_s = max(0.3, min(peace.seconds / 4, 4 * peace.seconds / asked.pairs))
        storm = under_attack(folder, asked.kills, asked.seed, mean_s)
        last = Batch(folder).wait()  # the same command once more
        found = content_of(folder / "results")
        left = _hidden(folder) + _hidden(folder / "results")
    wrong = _report_storm(storm, last, _difference(wanted, found), left)
    return int(grown or wrong)


def _hidden(folder: Path) -> list[str]:
    """Return the names of hidden files in a folder: stages, locks."""
    return sorted(path.name for path in folder.iterdir() if path.name.startswith("."))


def _difference(wanted: dict[str, bytes], found: dict[str, bytes]) -> list[str]:
    """Return the names of files that are not the same in both."""
    return sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))


def _report_peace(asked: argparse.Namespace, peace: Peace) -> bool:
    """Print what the run in peace has held; return whether it has grown."""
    growth = {name: peace.per_100_pairs(name) for name in ("memory_mb", "files", "processes")}
    start, end = peace.held[int(FIRST_SHARE * len(peace.held))], peace.held[-1]
    print(f"{asked.pairs} pairs on two workers, seed {asked.seed}: {peace.seconds:.0f} s")
    for name, slope in growth.items():
        print(f"  {name:10} {getattr(start, name):8.1f} after a fifth, {getattr(end, name):8.1f} at the end, "
              f"{slope:+7.2f} per 100 pairs", flush=True)  # fmt: skip
    enough = asked.pairs >= 100  # the slope of a few pairs is that of filling caches
    return enough and (growth["memory_mb"] > GROWTH_MB or growth["files"] > 1 or growth["processes"] > 1)


def _report_storm(storm: Storm, last: int, differing: list[str], left: list[str]) -> bool:
    """Print what the run under attack has come to; return whether something was wrong."""
    counts = ", ".join(f"{count} of {what}" for what, count in sorted(storm.kills.items()))
    ended = f"in {storm.starts} runs, {storm.finished} ended by themselves"
    print(f"  {storm.kills.total()} kills ({counts}) {ended}")
    print(f"  {len(storm.complaints)} broken folders or processes left after a kill")
    print(
        f"  the same command again: exit {last}, {len(differing)} files differ, {len(left)} hidden files left"
    )
    for line in (
        *storm.complaints,
        *(f"differs: {name}" for name in differing),
        *(f"left: {name}" for name in left),
    ):
        print(f"    {line}")
    return bool(storm.complaints or differing or left or last)


if __name__ == "__main__":
    sys.exit(main())
