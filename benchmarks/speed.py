"""Print what registering costs: time, memory and accuracy by scene size, beside AROSICS and other programs.

Usage::

    python benchmarks/speed.py --stack [SCENES] [--jobs N]
    python benchmarks/speed.py --small [PAIRS] [--arosics PYTHON]
    python benchmarks/speed.py --chips [PAIRS]
    python benchmarks/speed.py --peers [--sizes PX ...] [--counts POINTS ...] [--plot FILE] [--arosics PYTHON]
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
from dataclasses import replace
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2

from benchmarks.kernels import phase_congruency_cost
from benchmarks.speed_studies import gdal_warp, limits, parts, peers, peers_plot
from benchmarks.speed_studies import whole_scenes as w
from benchmarks.speed_studies.processes import measure
from benchmarks.speed_studies.scene_files import ScenePair, make_pair
from benchmarks.speed_studies.small_pairs import BATCH_PAIRS, growth, many_pairs, small_pairs
from benchmarks.speed_studies.stack import stack_of_scenes
from benchmarks.tables import Cell, Check, Table, as_text, at_most

SIZES = (1024, 2048, 4096, 16384)
QUICK_SIZES = (1024, 2048, 4096)
PEERS_SIZES = (512, 1024, 2048, 4096)
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
        if arguments.chips:
            for make in (many_pairs, growth):
                print("\n" + as_text(make(scratch, arguments.chips)), flush=True)
            return 0
        checks: list[Check] = []
        if not arguments.small:
            pairs = [_make(scratch, size) for size in arguments.sizes]
        if not (arguments.small or arguments.peers):
            checks += [*_parts(pairs, arguments.repeats), *_starts(pairs[0], scratch)]
        if not arguments.peers:
            count = arguments.small or BATCH_PAIRS
            for table in small_pairs(scratch, arguments.arosics, count, arguments.repeats):
                print("\n" + as_text(replace(table, checks=())), flush=True)
                checks += table.checks
        if not arguments.small:
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
    """Measure filter bank and refinement in this process."""
    cv2.setNumThreads(1)
    maps = phase_congruency_cost(TILE_PX, repeats)
    at_81, at_129 = parts.refinement_ms(pairs[0], (81, 129), 300, repeats)
    rows: list[list[Cell]] = [
        [f"24 inverse FFTs of {TILE_PX}², s", maps.transforms],
        [f"phase congruency of {TILE_PX}², s", maps.oriented + maps.moment],
        ["refinement, window 81, ms a point", at_81],
        ["refinement, window 129, ms a point", at_129],
    ]
    print("\n" + as_text(Table("CPU time of the parts, in one process, warm", ("", "CPU"), rows)), flush=True)
    yield at_most(f"phase congruency of {TILE_PX}² / its inverse FFTs", maps.ratio, 2.5)
    yield at_most("refinement a point, window 129", at_129, 2.5, "ms")
    yield at_most("refinement a point, window 81", at_81, 1.0, "ms")


def _starts(pair: ScenePair, scratch: Path) -> Iterator[Check]:
    """Start with an empty HOME, again with what that left there, and only for the help."""
    rows: list[list[Cell]] = []
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo-bench-") as home:
        for name in ("empty HOME", "same HOME"):
            run = w.run_mode(w.MODES[0], pair, scratch, Path(home))
            rows.append([f"{run.mode}, {pair.side_px}², {name}", run.cost.wall_s, run.cost.cpu_s])
    command = [sys.executable, "-m", "pcwlad_geo", "--help"]
    helps = [measure(command, environment={"PYTHONPATH": str(w.REPOSITORY)}) for _ in range(5)]
    help_s = min(run.wall_s for run in helps)
    rows.append(["--help", help_s, min(run.cpu_s for run in helps)])
    print("\n" + as_text(Table("Start-up", ("", "wall s", "CPU s"), rows)), flush=True)
    yield at_most("--help", help_s, 0.5, "s")


def _scenes(pairs: Sequence[ScenePair], scratch: Path, arguments: argparse.Namespace) -> Iterator[Check]:
    """Measure all modes on all sizes, and with `--peers` the other programs beside them."""
    chosen = [mode for mode in w.MODES if not arguments.peers or mode.name in peers.OURS]
    for mode in chosen:  # once for what they leave in caches
        w.run_mode(mode, pairs[0], scratch)
    if arguments.peers:
        for work in peers.works(pairs[0], scratch, arguments.arosics, 100).values():
            work()
    runs: list[w.Run] = w.read_runs(arguments.runs) if arguments.runs and arguments.runs.exists() else []
    bank_wall_s, warp_s = float("nan"), float("nan")
    for pair in pairs:
        modes = [mode for mode in chosen if arguments.full or pair.side_px <= mode.largest_px]
        works: peers.Works = {mode.name: partial(w.run_mode, mode, pair, scratch) for mode in modes}
        if arguments.peers:
            works |= peers.works(pair, scratch, arguments.arosics)
        elif arguments.arosics and pair.side_px == AROSICS_SIDE_PX:
            works[w.AROSICS] = partial(w.run_arosics, arguments.arosics, pair, scratch)
        repeats = arguments.repeats if pair.side_px <= AROSICS_SIDE_PX else 1
        runs += w.repeated(works, repeats)
        if arguments.runs:
            w.write_runs(arguments.runs, runs)
        results = w.Results(runs)
        bank = parts.bare_scene_bank(pair)
        if pair.side_px == limits.SIDE_PX:
            bank_wall_s = bank.wall_s
        if pair.side_px == limits.LARGE_PX:
            warp_s = gdal_warp.warp_s(pair, scratch)
            print(f"\ngdalwarp and COG of {pair.side_px}²: {warp_s:.1f} s")
        print("\n" + as_text(_table(results, pair.side_px, list(works), bank)))
        for run in {
            run.mode: run for run in runs if run.side_px == pair.side_px and run.score is None
        }.values():
            print(f"left out: {run.mode}: {run.cost.reason}")
        sys.stdout.flush()
    if arguments.peers:
        _growth_of_peers(pairs[-1], scratch, arguments)
    elif not arguments.arosics:
        print("\nno comparison with AROSICS: give --arosics PYTHON or set PCWLAD_GEO_AROSICS_PYTHON")
    if arguments.plot:
        peers_plot.draw(arguments.plot, w.Results(runs), pairs[-1].side_px)
    yield from limits.checks_of_scenes(w.Results(runs), bank_wall_s, warp_s)


def _growth_of_peers(pair: ScenePair, scratch: Path, arguments: argparse.Namespace) -> None:
    """Print how the time grows with points and cores on the largest scene, and what is left out."""
    where = f" on {pair.side_px}²"
    if arguments.counts:
        found = peers.growth_with_points(pair, scratch, arguments.arosics, arguments.counts)
        print("\n" + as_text(peers.table("Growth with points" + where, found)), flush=True)
    if w.jobs() > 1:
        found = peers.growth_with_cores(pair, scratch, arguments.arosics)
        print("\n" + as_text(peers.table("Growth with cores" + where, found)), flush=True)
    print("\n" + "\n".join(peers.missing(arguments.arosics)))


def _table(results: w.Results, side_px: int, modes: Sequence[str], bank: parts.Cost) -> Table:
    header = ("", "wall s", "in job s", "CPU s", "points", "correct", "cells", "ms/point", "MB", "RMSE px")
    rows: list[list[Cell]] = []
    for mode in modes:
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
    rows.append(["uncorrected", *["-"] * 8, peers.uncorrected(side_px).rmse_px])
    return Table(f"{side_px} x {side_px} px, {w.jobs()} jobs", header, rows)


def _seconds(*values: float) -> list[Cell]:
    return [f"{value:.2f}" for value in values]


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="sizes up to 4096, each mode once")
    parser.add_argument("--sizes", type=int, nargs="+", help=f"sides of the scenes, px (default: {SIZES})")
    parser.add_argument("--full", action="store_true", help="all modes on all sizes: hours for the largest")
    parser.add_argument("--repeats", type=int, help="runs of each mode (default: 3; --quick, --peers: 1)")
    parser.add_argument("--scratch", type=Path, help="keep the scenes there, and use those that are there")
    default = os.environ.get("PCWLAD_GEO_AROSICS_PYTHON")
    parser.add_argument(
        "--arosics", type=Path, default=default and Path(default), help="Python of AROSICS' environment"
    )
    for name, count, what in (
        ("--stack", STACK_SCENES, "a stack of so many scenes"),
        ("--small", BATCH_PAIRS, "a small pair, and so many in a batch,"),
        ("--chips", BATCH_PAIRS, "a batch of so many small pairs alone, and how its memory grows,"),
    ):
        parser.add_argument(
            name, type=int, nargs="?", const=count, help=f"measure {what} instead (default: {count})"
        )
    parser.add_argument("--peers", action="store_true", help="run OpenCV and scikit-image on the scenes, too")
    parser.add_argument(
        "--counts", type=int, nargs="*", default=peers.POINTS, help="points of the growth with points"
    )
    parser.add_argument("--plot", type=Path, help="picture of time and accuracy, SVG or PNG")
    parser.add_argument("--runs", type=Path, help="JSON file of runs: its runs count, new ones are added")
    parser.add_argument("--jobs", type=int, default=2, help="processes of a stack (default: 2)")
    arguments = parser.parse_args()
    default_sizes = PEERS_SIZES if arguments.peers else QUICK_SIZES if arguments.quick else SIZES
    arguments.sizes = sorted(arguments.sizes or default_sizes)
    arguments.repeats = arguments.repeats or (1 if arguments.quick or arguments.peers else 3)
    if arguments.scratch:
        arguments.scratch.mkdir(parents=True, exist_ok=True)
    if arguments.arosics and not arguments.arosics.exists():
        parser.error(f"there is no {arguments.arosics}: give the Python of an environment with arosics")
    if not sys.platform.startswith("linux"):
        parser.error("this benchmark reads /proc: run it on Linux")
    return arguments


if __name__ == "__main__":
    sys.exit(main())
