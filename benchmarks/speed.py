"""Print what registering costs: wall time, CPU time, memory and accuracy by scene size, beside AROSICS.

Usage::

    python benchmarks/speed.py --stack [SCENES] [--jobs N]
    python benchmarks/speed.py [--quick] [--scratch FOLDER] [--arosics PYTHON]

Every run of the command line is a process of its own; CPU time and memory are summed over all its processes.
Lines below the last table hold the figures against what must be reached.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2

from benchmarks.kernels import phase_congruency_cost
from benchmarks.speed_studies import limits, parts
from benchmarks.speed_studies import whole_scenes as w
from benchmarks.speed_studies.processes import measure
from benchmarks.speed_studies.scene_files import ScenePair, make_pair
from benchmarks.speed_studies.stack import stack_of_scenes
from benchmarks.tables import Cell, Check, Table, as_text, at_most

SIZES = (1024, 2048, 4096, 16384)
QUICK_SIZES = (1024, 2048, 4096)
AROSICS_SIDE_PX = 4096
TILE_PX = 2048
STACK_SCENES = 100


def main() -> int:
    """Make the scenes, measure, print."""
    arguments = _parse()
    folder = tempfile.TemporaryDirectory(prefix="pcwlad-geo-bench-")
    with nullcontext(arguments.scratch) if arguments.scratch else folder as scratch:
        scratch = Path(scratch)
        if arguments.stack:
            for table in stack_of_scenes(scratch, arguments.stack, arguments.jobs):
                print(as_text(table), flush=True)
            return 0
        pairs = [_make(scratch, size) for size in arguments.sizes]
        checks = [*_parts(pairs, arguments.repeats)]
        checks += _starts(pairs[0], scratch)
        checks += _scenes(pairs, scratch, arguments)
    rows = [(check.what, check.value, check.limit, "ok" if check.holds else "MISSES") for check in checks]
    print("\n" + as_text(Table("What must be reached", ("", "value", "limit", ""), rows)))
    missed = [check for check in checks if not check.holds]
    print(f"\n{len(checks) - len(missed)} of {len(checks)} figures reached")
    return 0


def _make(scratch: Path, side_px: int) -> ScenePair:
    begun = time.perf_counter()
    pair = make_pair(scratch / "scenes", side_px)
    print(f"[scene {side_px}²: {time.perf_counter() - begun:.0f} s]", flush=True)
    return pair


def _parts(pairs: Sequence[ScenePair], repeats: int) -> Iterator[Check]:
    """Measure filter bank, refinement and a small pair in this process."""
    cv2.setNumThreads(1)
    maps = phase_congruency_cost(TILE_PX, repeats)
    at_81, at_129 = parts.refinement_ms(pairs[0], (81, 129), 300, repeats)
    small = parts.small_pair(pairs[0], 512, 1000, repeats)
    rows: list[list[Cell]] = [
        [f"24 inverse FFTs of {TILE_PX}², s", maps.transforms],
        [f"phase congruency of {TILE_PX}², s", maps.oriented + maps.moment],
        ["refinement, window 81, ms a point", at_81],
        ["refinement, window 129, ms a point", at_129],
        ["512² pair, 1000 features, register, s", small.cpu_s],
    ]
    print("\n" + as_text(Table("CPU time of the parts, in one process, warm", ("", "CPU"), rows)), flush=True)
    yield at_most(f"phase congruency of {TILE_PX}² / its inverse FFTs", maps.ratio, 2.5)
    yield at_most("refinement a point, window 129", at_129, 2.5, "ms")
    yield at_most("refinement a point, window 81", at_81, 1.0, "ms")
    yield at_most("512² pair, 1000 features", small.cpu_s, 4.0, "s")


def _starts(pair: ScenePair, scratch: Path) -> Iterator[Check]:
    """Start with nothing compiled, again from that cache, and only for the help."""
    rows: list[list[Cell]] = []
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo-bench-") as cache:
        for name in ("cold", "warm"):
            run = w.run_mode(w.MODES[0], pair, scratch, Path(cache))
            rows.append([f"{run.mode}, {pair.side_px}², {name} cache", run.cost.wall_s, run.cost.cpu_s])
    command = [sys.executable, "-m", "pcwlad_geo", "--help"]
    helps = [measure(command, environment={"PYTHONPATH": str(w.REPOSITORY)}) for _ in range(5)]
    help_s = min(run.wall_s for run in helps)
    rows.append(["--help", help_s, min(run.cpu_s for run in helps)])
    print("\n" + as_text(Table("Start-up", ("", "wall s", "CPU s"), rows)), flush=True)
    yield at_most("--help", help_s, 0.5, "s")


def _scenes(pairs: Sequence[ScenePair], scratch: Path, arguments: argparse.Namespace) -> Iterator[Check]:
    """Measure all modes on all sizes."""
    for mode in w.MODES:  # compiles whatever is not in the cache yet
        w.run_mode(mode, pairs[0], scratch)
    runs: list[w.Run] = []
    bank_wall_s = float("nan")
    for pair in pairs:
        modes = [mode for mode in w.MODES if arguments.full or pair.side_px <= mode.largest_px]
        beside = arguments.arosics if pair.side_px == AROSICS_SIDE_PX else None
        repeats = arguments.repeats if pair.side_px <= AROSICS_SIDE_PX else 1
        runs += w.repeated(modes, pair, scratch, repeats, beside)
        results = w.Results(runs)
        bank = parts.bare_scene_bank(pair)
        if pair.side_px == limits.SIDE_PX:
            bank_wall_s = bank.wall_s
        print("\n" + as_text(_table(results, pair.side_px, [mode.name for mode in modes], bank)))
        for run in {
            run.mode: run for run in runs if run.side_px == pair.side_px and run.score is None
        }.values():
            print(f"left out: {run.mode}: {run.cost.reason}")
        sys.stdout.flush()
    if not arguments.arosics:
        print("\nno comparison with AROSICS: give --arosics PYTHON or set PCWLAD_GEO_AROSICS_PYTHON")
    yield from limits.checks_of_scenes(w.Results(runs), bank_wall_s)


def _table(results: w.Results, side_px: int, modes: Sequence[str], bank: parts.Cost) -> Table:
    header = ("", "wall s", "in job s", "CPU s", "points", "correct", "cells", "ms/point", "MB", "RMSE px")
    rows: list[list[Cell]] = []
    for mode in [*modes, w.AROSICS]:
        if side_px not in results.sizes(mode):
            continue
        correct = int(results.count("correct", mode, side_px))
        cpu_s = results.cpu_s(mode, side_px)
        row: list[Cell] = [
            mode,
            *_seconds(results.wall_s(mode, side_px), results.inner_s(mode, side_px), cpu_s),
        ]
        row += [
            int(results.count("points", mode, side_px)),
            correct,
            int(results.count("cells", mode, side_px)),
        ]
        row += [f"{1000 * cpu_s / correct:.1f}" if correct else "-"]
        row += [f"{results.peak_mb(mode, side_px):.0f}", results.rmse_px(mode, side_px)]
        rows.append(row)
    rows.append(["bare filter bank", *_seconds(bank.wall_s, bank.wall_s, bank.cpu_s), *["-"] * 6])
    return Table(f"{side_px} x {side_px} px, {w.JOBS} jobs", header, rows)


def _seconds(*values: float) -> list[Cell]:
    return [f"{value:.2f}" for value in values]


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="sizes up to 4096, each mode once")
    parser.add_argument("--sizes", type=int, nargs="+", help=f"sides of the scenes, px (default: {SIZES})")
    parser.add_argument("--full", action="store_true", help="all modes on all sizes: hours for the largest")
    parser.add_argument("--repeats", type=int, help="runs of each mode (default: 3; --quick: 1)")
    parser.add_argument("--scratch", type=Path, help="keep the scenes there, and use those that are there")
    default = os.environ.get("PCWLAD_GEO_AROSICS_PYTHON")
    parser.add_argument(
        "--arosics", type=Path, default=default and Path(default), help="Python of AROSICS' environment"
    )
    parser.add_argument(
        "--stack",
        type=int,
        nargs="?",
        const=STACK_SCENES,
        metavar="SCENES",
        help=f"measure a stack of so many scenes instead (default: {STACK_SCENES})",
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes of a stack (default: 2)")
    arguments = parser.parse_args()
    arguments.sizes = sorted(arguments.sizes or (QUICK_SIZES if arguments.quick else SIZES))
    arguments.repeats = arguments.repeats or (1 if arguments.quick else 3)
    if arguments.scratch:
        arguments.scratch.mkdir(parents=True, exist_ok=True)
    if arguments.arosics and not arguments.arosics.exists():
        parser.error(f"there is no {arguments.arosics}: give the Python of an environment with arosics")
    if not sys.platform.startswith("linux"):
        parser.error("this benchmark reads /proc: run it on Linux")
    return arguments


if __name__ == "__main__":
    sys.exit(main())
