"""Mutation testing: small defects are planted into modules that must not fail, and tests must notice each.

Usage::

    python mutants/run.py [--module NAME]... [--sample N] [--seed S] [--jobs J] [--list]

Prints, per module, how many mutants there are, how many the tests named in `targets.py` kill, and the ones
that survive. Mutants that behave as the module itself are listed, with the reason, in `equivalent.toml`; they
are not run. The exit status is 1 where a module does not reach the share that must be killed. Linux only.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

# Here, before numpy loads: forked processes must not inherit the threads of a pool.
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

# What takes long to import is loaded once; nothing of the package itself, which is exchanged.
import numpy  # noqa: F401
import rasterio.shutil  # noqa: F401
import scipy.spatial  # noqa: F401

from mutants import trial
from mutants.operators import Mutant, mutants
from mutants.targets import EQUIVALENT, TARGETS, equivalent, key
from mutants.trial import REPOSITORY, Bench, Limits

MUST_KILL: Final = 0.9
"""Share of the mutants of each module."""
SLOWER: Final = 10.0
"""A mutant whose tests take so many times as long as those of the module itself, hangs."""
PATIENCE_S: Final = 60.0
"""Besides, for a machine that is busy."""
MORE_WORK_S: Final = 10.0
"""A process hangs, too, that needs so much more processor time than the tests of the module itself in all."""
WORDS: Final = {trial.SURVIVED: "survived", trial.KILLED: "killed", trial.HUNG: "killed (hangs)"}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a mutant."""

    mutant: Mutant
    status: int


def main() -> int:
    """Run the mutants of all modules that are asked for, and print what survives."""
    arguments = _parse()
    chosen = [name for name in TARGETS if not arguments.module or Path(name).stem in arguments.module]
    reached = [_study(module, arguments) for module in chosen]
    return 0 if all(reached) else 1


def _study(module: str, arguments: argparse.Namespace) -> bool:
    source = (REPOSITORY / module).read_text(encoding="utf-8")
    every = mutants(source)
    excused = equivalent(module)
    stale = excused.keys() - {key(mutant) for mutant in every}
    for where, before, after in sorted(stale):
        print(f"{EQUIVALENT.name}: {module} has no mutant of {where}: {before} -> {after}", file=sys.stderr)
    wanted = [mutant for mutant in every if key(mutant) not in excused]
    if arguments.sample and arguments.sample < len(wanted):
        wanted = random.Random(arguments.seed).sample(wanted, arguments.sample)
    if arguments.list:
        print(*(_told(mutant) for mutant in wanted), sep="\n")
        return not stale
    begun = time.monotonic()
    survived = []
    for outcome in _outcomes(module, source, wanted, arguments.jobs):
        if arguments.verbose:
            print(f"{WORDS[outcome.status]}: {_told(outcome.mutant)}", flush=True)
        if outcome.status == trial.SURVIVED:
            survived.append(outcome.mutant)
    killed = len(wanted) - len(survived)
    print(
        f"{module}: {len(wanted)} mutants, {killed} killed, {len(survived)} survived: "
        f"{100 * killed / max(1, len(wanted)):.1f} % killed (must reach {100 * MUST_KILL:.0f} %); "
        f"{len(every)} made, {len(excused)} of them equivalent; {time.monotonic() - begun:.0f} s"
    )
    for mutant in sorted(survived, key=lambda each: each.line):
        print(f"    {_told(mutant)}", flush=True)
    return not stale and killed >= MUST_KILL * len(wanted)


def _outcomes(module: str, source: str, wanted: list[Mutant], jobs: int) -> Iterator[Outcome]:
    tests = TARGETS[module]
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo mutants ") as folder:
        benches = [Bench.make(Path(folder) / str(number), module) for number in range(jobs)]
        begun = time.monotonic()
        for bench in benches:
            # unchanged, the tests must pass: and then their own compiled files are there
            process, status, used = os.wait4(bench.start(source, tests, Limits(600.0, 600.0)), 0)
            if _status((process, status)) != trial.SURVIVED:
                log = (bench.folder / "log.txt").read_text(errors="replace")
                raise SystemExit(f"{', '.join(tests)} fail on {module} as it is:\n{log[-3000:]}")
        limits = Limits(
            PATIENCE_S + SLOWER * (time.monotonic() - begun) / len(benches),
            MORE_WORK_S + used.ru_utime + used.ru_stime,
        )
        running: dict[int, tuple[Mutant, Bench]] = {}
        free, waiting = list(benches), list(wanted)
        while waiting or running:
            while waiting and free:
                bench, mutant = free.pop(), waiting.pop(0)
                running[bench.start(mutant.source, tests, limits)] = (mutant, bench)
            process, status = os.wait()
            mutant, bench = running.pop(process)
            free.append(bench)
            yield Outcome(mutant, _status((process, status)))


def _status(waited: tuple[int, int]) -> int:
    return os.waitstatus_to_exitcode(waited[1])


def _told(mutant: Mutant) -> str:
    return f"line {mutant.line}, {mutant.where or 'module'}: {mutant.before}  ->  {mutant.after}"


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    stems = [Path(name).stem for name in TARGETS]
    parser.add_argument("--module", action="append", choices=stems, help="only this one; repeatable")
    parser.add_argument("--sample", type=int, metavar="N", help="N mutants of a module, drawn at random")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--list", action="store_true", help="print the mutants and run none")
    parser.add_argument("--verbose", action="store_true", help="print the outcome of each")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
