"""Small pairs: what one costs by the default call, how soon its pixels are read, many in one batch."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from os import environ
from pathlib import Path
from typing import Final

import numpy as np
from rasterio.windows import Window

from benchmarks.speed_studies import whole_scenes as w
from benchmarks.speed_studies.parts import crop
from benchmarks.speed_studies.processes import Measured, measure, on_cores, resident_mb
from benchmarks.speed_studies.scene_files import make_pair
from benchmarks.tables import Cell, Table, at_most
from benchmarks.timing import Cost, cheapest
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import fit_pair, match_pair, prepare_pair

SIDE_PX: Final = 512
BATCH_SIDE_PX: Final = 256
BATCH_PAIRS: Final = 100
SCENE_SIDES: Final = (1024, 2048, 4096, 8192)
_PROGRAM: Final = (sys.executable, "-m", "pcwlad_geo")
# an installed package has its bytecode: without it, 130 modules are compiled at every start
_ENVIRONMENT: Final = {"PYTHONPATH": str(w.REPOSITORY), "PYTHONDONTWRITEBYTECODE": ""}


def small_pairs(scratch: Path, arosics: Path | None, pairs: int, repeats: int) -> Iterator[Table]:
    """Yield what a pair costs, good and hopeless, beside AROSICS; then what a batch of so many costs."""
    yield one_pair(scratch, arosics, repeats)
    yield many_pairs(scratch, pairs)


GROWTH_PARTS: Final = 4
"""Parts of the time of a batch whose memory is compared."""


def growth(scratch: Path, count: int) -> Table:
    """Register small pairs in one process, over and over; print the memory it holds by part of the work.

    The same pairs serve again, each time into other folders: what a pair leaves in memory adds up.
    """
    table, out = scratch / "pairs.csv", scratch / "batch"
    shutil.rmtree(out, ignore_errors=True)
    pairs = list(cut(scratch, min(count, BATCH_PAIRS)))
    table.write_text(
        "reference,target\n" + "".join("{},{}\n".format(*pairs[n % len(pairs)]) for n in range(count))
    )
    command = [*_PROGRAM, "batch", str(table), "-o", str(out), "--no-report", "--jobs", "1", "--overwrite"]
    held_mb: list[float] = []
    with subprocess.Popen(
        [*command, "--progress", "json"], stdout=subprocess.PIPE, text=True, env=environ | _ENVIRONMENT
    ) as process:
        for line in process.stdout or ():
            event = json.loads(line)
            if event.get("stage") == "pairs":
                held_mb.append(resident_mb(process.pid))
    parts = np.array_split(np.array(held_mb), GROWTH_PARTS)
    medians = [float(np.median(part)) for part in parts]
    rows: list[list[Cell]] = [[f"{n + 1} of {GROWTH_PARTS}", f"{mb:.0f}"] for n, mb in enumerate(medians)]
    check = at_most("batch: memory in the last quarter / in the second", medians[-1] / medians[1], 1.05)
    title = f"memory of one process over {count} pairs of {BATCH_SIDE_PX}²"
    return Table(title, ("part", "MB"), rows, [check])


def one_pair(scratch: Path, arosics: Path | None, repeats: int) -> Table:
    """Measure whole processes in turn, warm; of each the least of several."""
    pair = make_pair(scratch / "scenes", SIDE_PX)
    good = ["match", str(pair.reference), str(pair.target)]
    hopeless, proved = ["match", *strangers(scratch)], ["prove", *good[1:]]
    costs: dict[str, list[Measured]] = {"match": [], "match, refused": [], "prove, quick": [], w.AROSICS: []}
    pixels_s = []
    for number in range(repeats + 1):
        found = {
            name: measured(command, scratch / "small")
            for name, command in zip(costs, (good, hopeless, proved), strict=False)
        }
        read_s = until_read(good, scratch / "small")
        if arosics:
            found[w.AROSICS] = w.run_arosics(arosics, pair, scratch).cost
        if number:  # the first round compiles what is not in the cache
            pixels_s.append(read_s)
            for name, cost in found.items():
                costs[name].append(cost)
    wall = {name: min(cost.wall_s for cost in runs) for name, runs in costs.items() if runs}
    cpu = {name: min(cost.cpu_s for cost in runs) for name, runs in costs.items() if runs}
    rows: list[list[Cell]] = [[name, wall[name], cpu[name]] for name in wall]
    rows.append(["match, until its pixels are read", min(pixels_s), "-"])
    fitted = fit_cost(scratch, repeats)
    rows.append([f"fit of {BATCH_SIDE_PX}² alone", fitted.wall_s, fitted.cpu_s])
    refused = cpu["match, refused"] / cpu["match"]
    checks = [
        at_most(f"match, {SIDE_PX}²: wall time", wall["match"], 2.5, "s"),
        at_most(f"match, {SIDE_PX}²: CPU time", cpu["match"], 4.0, "s"),
        at_most(f"match, {SIDE_PX}²: wall time until the pixels are read", min(pixels_s), 0.8, "s"),
        at_most(f"match of a hopeless pair, {SIDE_PX}²: CPU time", cpu["match, refused"], 4.0, "s"),
        at_most("match of a hopeless pair: CPU time / a good one's", refused, 0.5),
        at_most(f"prove quick, {SIDE_PX}²: wall time / match", wall["prove, quick"] / wall["match"], 3.0),
    ]
    if arosics:
        ratio = wall["match"] / wall[w.AROSICS]
        checks.append(at_most(f"match, {SIDE_PX}²: wall time / AROSICS' process", ratio, 0.3))
        ratio = cpu["match"] / cpu[w.AROSICS]
        checks.append(at_most(f"match, {SIDE_PX}²: CPU time / AROSICS' process", ratio, 0.3))
    return Table(f"{SIDE_PX}², default call, whole processes", ("", "wall s", "CPU s"), rows, checks)


def many_pairs(scratch: Path, count: int) -> Table:
    """Register pairs of BATCH_SIDE_PX in one `batch`, on one core and on two: there each pair has one.

    On one core also without pages. The matching is summed over the pairs, as their reports tell it.
    """
    table, out = scratch / "pairs.csv", scratch / "batch"
    table.write_text("reference,target\n" + "".join(f"{one},{other}\n" for one, other in cut(scratch, count)))
    command = [*_PROGRAM, "batch", str(table), "-o", str(out), "--progress", "none", "--overwrite"]
    rows: list[list[Cell]] = []
    checks = []
    for cores, page, limit_s in ((1, True, 1.5), (1, False, 0.8), (2, True, None)):
        shutil.rmtree(out, ignore_errors=True)  # the reports of an earlier run would count
        with on_cores(cores):
            cost = measure(command if page else [*command, "--no-report"], environment=_ENVIRONMENT)
        reports = [json.loads(path.read_text(encoding="utf-8")) for path in out.glob("*/report.json")]
        if len(reports) < count:
            raise RuntimeError(f"{count - len(reports)} of {count} pairs have no report: {cost.reason}")
        spent = (sum(report["seconds"].get(stage, 0.0) for stage in w.TIE_POINTS) for report in reports)
        matching_s = sum(spent)
        registered = sum(report["status"] == "registered" for report in reports)
        ratio = cost.wall_s / matching_s
        label = f"{cores}, with report" if page else f"{cores}, without"
        a_pair_s = cost.cpu_s / count
        rows.append([label, cost.wall_s, cost.cpu_s, a_pair_s, matching_s, ratio, f"{cost.peak_mb:.0f}"])
        if limit_s is not None:
            what = f"batch of {count} pairs, {'with' if page else 'without'} report: CPU time a pair"
            checks.append(at_most(what, a_pair_s, limit_s, "s"))
    checks.append(at_most(f"batch of {count} pairs on two cores: wall time / its matching", ratio, 1.1))
    title = f"batch of {count} pairs of {BATCH_SIDE_PX}², {registered} of them registered"
    columns = ("cores", "wall s", "CPU s", "CPU s a pair", "matching s", "wall / matching", "MB")
    return Table(title, columns, rows, checks)


def fit_cost(scratch: Path, repeats: int) -> Cost:
    """Measure the fit of a matched pair of BATCH_SIDE_PX, in this process, warm; the least of several."""
    pair = prepare_pair(*next(cut(scratch, 1)), Settings())
    return cheapest([partial(fit_pair, match_pair(pair, InThisProcess()))], repeats)[0]


def strangers(scratch: Path) -> list[str]:
    """Return two parts of a scene that show other ground, without georeferencing."""
    scene = make_pair(scratch / "scenes", 2 * SIDE_PX)
    folder, found = scratch / "strangers", []
    for path, begin in ((scene.reference, 0), (scene.target, SIDE_PX)):
        window = Window(begin, begin, SIDE_PX, SIDE_PX)
        found.append(str(crop(path, folder / path.name, window, placed=False)))
    return found


def measured(command: list[str], out: Path) -> Measured:
    """Run a command of the program; pairs of `strangers` must be refused, all others must not."""
    cost = measure(
        [*_PROGRAM, *command, "-o", str(out), "--progress", "none", "--overwrite"], environment=_ENVIRONMENT
    )
    if cost.status != (3 if "strangers" in command[1] else 0):
        raise RuntimeError(f"{' '.join(command)}: exit status {cost.status}: {cost.reason}")
    return cost


def until_read(command: list[str], out: Path) -> float:
    """Return the wall time from the start of a command to the event that tells that the pixels are read."""
    options = ["-o", str(out), "--progress", "json", "--overwrite"]
    begun = time.perf_counter()
    with subprocess.Popen(
        [*_PROGRAM, *command, *options], stdout=subprocess.PIPE, text=True, env=environ | _ENVIRONMENT
    ) as process:
        for line in process.stdout or ():
            event = json.loads(line)
            if event.get("stage") == "reading" and event["done"] == event["total"]:
                read_s = time.perf_counter() - begun
                process.stdout.read()
                return read_s
    raise RuntimeError(f"{' '.join(command)}: no pixels were read")


def cut(scratch: Path, count: int) -> Iterator[tuple[Path, Path]]:
    """Cut pairs of BATCH_SIDE_PX, side by side, from a scene that is large enough."""
    side = next(size for size in SCENE_SIDES if (size // BATCH_SIDE_PX) ** 2 >= count)
    scene, folder = make_pair(scratch / "scenes", side), scratch / f"pairs of {BATCH_SIDE_PX}"
    for number in range(count):
        row, col = divmod(number, side // BATCH_SIDE_PX)
        window = Window(col * BATCH_SIDE_PX, row * BATCH_SIDE_PX, BATCH_SIDE_PX, BATCH_SIDE_PX)
        yield (
            crop(scene.reference, folder / f"red_{number}.tif", window),
            crop(scene.target, folder / f"thermal_{number}.tif", window),
        )
