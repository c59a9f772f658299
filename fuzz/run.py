"""Run the command line on damaged inputs and report what it does that it must not do.

Usage::

    python fuzz/run.py [--count N | --minutes N] [--seed S] [--jobs J] [--recipe REGEX] [--save FOLDER]
    python fuzz/run.py --replay FOLDER…

The kept inputs of `fuzz/corpus/hostile` are run first, as they are, then N mutants. The same seed gives the
same mutants, whatever the jobs. The exit status is 1 if there are failures: see docs/development/fuzzing.md.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from itertools import count
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzz.cases import Case, case, whole
from fuzz.fork_server import ForkServer
from fuzz.judge import Failure
from fuzz.kept import HOSTILE, reproducers
from fuzz.orders import Limits, Outcome
from fuzz.saved import read_saved, save
from fuzz.table import Tally, summary

DEFAULT_COUNT = 1000
SAVED_OF_A_CLASS = 2
ROOM_BYTES = 4 << 30
"""What a folder in memory must have free."""
Work = Callable[[ForkServer], tuple[str, Case, Outcome, list[Failure]]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the arguments ask for; return the exit status."""
    asked = _arguments(arguments)
    limits = Limits(asked.hang, asked.memory)
    mutants = f"mutants of seed {asked.seed}"
    status = 0
    with ExitStack() as stack:
        made = tempfile.TemporaryDirectory(prefix="pcwlad-geo-fuzz-", dir=_quick_folder())
        place = Path(stack.enter_context(made))
        servers = _start(stack, place, asked.jobs)
        if asked.replay:
            kept = [read_saved(folder) for folder in asked.replay]
            return _run(f"saved inputs ({len(kept)})", map(_as_it_is(limits), kept), servers, asked.save)
        if (
            asked.first == 0
            and asked.recipe is None
            and not asked.no_kept
            and (kept := [whole(each) for each in reproducers(asked.hostile)])
        ):
            status |= _run("kept inputs", map(_as_it_is(limits), kept), servers, asked.save)
        until = time.monotonic() + 60 * asked.minutes if asked.minutes else float("inf")
        numbers = count(asked.first) if asked.minutes else range(asked.first, asked.first + asked.count)
        todo = (_mutant(asked.seed, number, limits, asked.recipe) for number in _before(until, numbers))
        status |= _run(mutants, todo, servers, asked.save)
    return status


def _arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=DEFAULT_COUNT, help="mutants (1000)")
    parser.add_argument("--minutes", type=float, help="instead: as many as fit into this time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--first", type=int, default=0, metavar="NUMBER", help="number of the first mutant (0)"
    )
    parser.add_argument("--jobs", type=int, default=2, help="fork servers (2)")
    parser.add_argument(
        "--hang", type=float, default=Limits().seconds, metavar="SECONDS", help="limit of time (60)"
    )
    parser.add_argument(
        "--memory", type=int, default=Limits().memory_mb, metavar="MB", help="limit of memory (3072)"
    )
    parser.add_argument("--recipe", metavar="REGEX", help="mutants of the recipes with this in their name")
    parser.add_argument("--save", type=Path, metavar="FOLDER", help="where inputs that fail are kept")
    parser.add_argument("--replay", type=Path, nargs="+", metavar="FOLDER", help="run saved inputs again")
    parser.add_argument("--no-kept", action="store_true", help="leave out the kept inputs")
    parser.add_argument("--hostile", type=Path, default=HOSTILE, metavar="FOLDER", help="the kept inputs")
    return parser.parse_args(arguments)


def _quick_folder() -> str | None:
    """Return a folder in memory where there is room: files are synchronised with a disk in every run."""
    memory = Path("/dev/shm")
    usable = memory.is_dir() and os.access(memory, os.W_OK)
    return str(memory) if usable and shutil.disk_usage(memory).free > ROOM_BYTES else None


def _start(stack: ExitStack, place: Path, jobs: int) -> list[ForkServer]:
    started = []
    for number in range(jobs):
        folder = place / str(number)
        folder.mkdir()
        started.append(ForkServer(folder))
    return [stack.enter_context(server) for server in started]  # they warm up side by side


def _before(until: float, numbers: Iterator[int] | range) -> Iterator[int]:
    for number in numbers:
        if time.monotonic() > until:
            return
        yield number


def _as_it_is(limits: Limits) -> Callable[[Case], Work]:
    def of(made: Case) -> Work:
        def work(server: ForkServer) -> tuple[str, Case, Outcome, list[Failure]]:
            return made.name, made, *server.run(made, limits)

        return work

    return of


def _mutant(seed: int, number: int, limits: Limits, recipe: str | None) -> Work:
    def work(server: ForkServer) -> tuple[str, Case, Outcome, list[Failure]]:
        made = case(seed, number, recipe_part=recipe)
        outcome, failures = server.run(made, limits)
        if failures and len(made.edits) > 1:
            made = _smallest(seed, number, made, failures, server, limits, recipe)
        return f"{seed}/{number}", made, outcome, failures

    return work


def _smallest(
    seed: int,
    number: int,
    made: Case,
    failures: list[Failure],
    server: ForkServer,
    limits: Limits,
    recipe: str | None,
) -> Case:
    """Return the input with one of its edits alone, where that fails in the same way."""
    for index in range(len(made.edits)):
        alone = case(seed, number, only=(index,), recipe_part=recipe)
        if set(server.run(alone, limits)[1]) == set(failures):
            return alone
    return made


def _run(title: str, todo: Iterator[Work], servers: Sequence[ForkServer], folder: Path | None) -> int:
    """Run all, as many at a time as there are servers; print the table."""
    tally, lock, since = Tally(), threading.Lock(), time.monotonic()
    broken = threading.Event()

    def serve(server: ForkServer) -> None:
        try:
            serve_all(server)
        except BaseException:
            broken.set()  # the others end with their present input, so that it is told at once
            raise

    def serve_all(server: ForkServer) -> None:
        while not broken.is_set():
            with lock:
                work = next(todo, None)
            if work is None:
                return
            name, made, outcome, failures = work(server)
            with lock:
                new = tally.add(name, outcome, failures)
                for label in new:
                    print(f"{name}: {label}: {'; '.join(made.edits)[:160]}", file=sys.stderr, flush=True)
                few = any(tally.classes[failure.label] <= SAVED_OF_A_CLASS for failure in failures)
                if folder is not None and few:
                    save(folder, made, outcome, failures)

    with ThreadPoolExecutor(len(servers)) as pool:
        for done in [pool.submit(serve, server) for server in servers]:
            done.result()
    print(summary(tally, title, time.monotonic() - since), flush=True)
    return int(tally.failed > 0)


if __name__ == "__main__":
    sys.exit(main())
