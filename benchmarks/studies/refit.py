"""Told and true CE90 where tie points are fitted again: of the sample pair, and of others of its kind.

The truth is the formula of `sample_data/make_sample_data.py`, on all the ground that both rasters show. The
other pairs are of the same formula: other landscapes, with other noise. All goes by the command line, and
the editor's files are those that *Align with these* of QGIS writes.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio

from benchmarks.runs import Array, Runner
from benchmarks.tables import Cell, Check, Table, within
from pcwlad_geo.correction.reading import from_dict

REPOSITORY: Final = Path(__file__).resolve().parents[2]
SEEDS: Final = (6, 1, 2, 3, 4)
"""Of the landscapes; 6 is the sample pair."""
WITHIN: Final = 0.2
"""Largest difference of the CE90 that is told from the true one, as a share of that."""
EVERY: Final = 3
"""Of the points that are thinned one in so many stays."""
WORST: Final = 0.2
"""Share of the points that are switched off for their residuals."""
STEP_PX: Final = 5
UNKNOWN: Final = ".points, in a folder of its own"
"""A way by which nothing is known of the points but their positions."""


@dataclass(frozen=True, slots=True)
class Figures:
    """What a run tells of its error, and what is true."""

    way: str
    grade: str
    told_px: float
    true_px: float


def refit(_data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield a table of all ways by which the points of each pair get into a fit."""
    with ThreadPoolExecutor(runner.processes) as pool:
        found = list(pool.map(partial(_pair, scratch), SEEDS))
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for seed, ways in zip(SEEDS, found, strict=True):
        for each in ways:
            name, ratio = f"landscape {seed}, {each.way}", each.told_px / each.true_px
            rows.append([name, each.told_px, each.true_px, ratio, each.grade])
            if each.way == UNKNOWN:
                checks.append(Check(name, each.grade, "not good", each.grade != "good"))
            else:
                checks.append(within(f"{name}: told by true", ratio, 1 - WITHIN, 1 + WITHIN, digits=2))
    header = ("pair and way", "told CE90, px", "true", "told by true", "grade")
    yield Table("Tie points that are fitted again", header, rows, checks)


def _pair(scratch: Path, seed: int) -> list[Figures]:
    """Render a pair, register it, and fit its points again by each way."""
    folder = scratch / str(seed)
    _python("sample_data/make_sample_data.py", folder, "--seed", seed)
    done = folder / "done"
    truth = _truth(folder)
    ways = [_registered("first run", folder, done, truth)]
    for way, (path, options) in _files(done).items():
        out = folder / re.sub(r"\W+", "_", way)
        ways.append(_registered(way, folder, out, truth, "--tie-points", path, *options))
    return ways


def _files(done: Path) -> dict[str, tuple[Path, Sequence[str]]]:
    """Write the points as a user has them, and return the file and options of each way."""
    ready, edited = _edited(done, "edited.csv", 0.0)
    model = ("--model", ready["model"].rstrip("0123456789"))
    lines = (done / "tiepoints.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    thinned, alone = done / "thinned.csv", done.parent / "alone.points"
    thinned.write_text("".join([lines[0], *lines[1::EVERY]]), encoding="utf-8")
    points = done / "landsat_b10.tif.points"
    alone.write_bytes(points.read_bytes())
    return {
        "Align with these, unedited": (edited, model),
        ".points, unedited": (points, ()),
        "tiepoints.csv, unedited": (done / "tiepoints.csv", ()),
        f"every {EVERY}rd point of tiepoints.csv": (thinned, ()),
        f"the worst {WORST:.0%} switched off": (_edited(done, "chosen.csv", WORST)[1], model),
        UNKNOWN: (alone, ()),
    }


def _edited(done: Path, name: str, worst: float) -> tuple[dict[str, Any], Path]:
    """Save the points, those of the longest residuals off; return how the editor began, and the file."""
    command = [sys.executable, "-m", "pcwlad_geo", "edit", str(done)]
    place = done / name
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as editor:
        if editor.stdin is None or editor.stdout is None:
            raise RuntimeError("the editor has no pipes")
        ready = json.loads(editor.stdout.readline())

        def ask(event: str, **request: object) -> dict[str, Any]:
            print(json.dumps(request), file=editor.stdin, flush=True)
            answers = map(json.loads, editor.stdout or ())
            return next(answer for answer in answers if answer["event"] in (event, "failed"))

        fitted = ask("fit", do="fit", model=ready["model"], off=ready["off"], number=1)
        length = np.hypot(*np.array(fitted["residual_px"]).T)
        length[ready["off"]] = 0.0
        on = len(length) - len(ready["off"])
        chosen = np.argsort(-length)[: round(worst * on)].tolist()
        ask("saved", do="save", path=str(place), off=[*ready["off"], *chosen])
        editor.stdin.close()
    return ready, place


def _registered(way: str, folder: Path, out: Path, truth: tuple[Array, Array], *options: object) -> Figures:
    pair = [folder / f"landsat_{band}.tif" for band in ("b4", "b10")]
    _python("-m", "pcwlad_geo", "register", *pair, "--out-dir", out, "--jobs", 1, *options)
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    places, displacement = truth
    error = from_dict(report["model"]).forward(places) - places - displacement
    quality = report["quality"]
    true = float(np.percentile(np.hypot(*error.T), 90))
    return Figures(way, quality["grade"], quality["expected_ce90_px"], true)


def _truth(folder: Path) -> tuple[Array, Array]:
    """Return where the ground that both rasters show is predicted in the target, and its displacement, px."""
    sys.path.insert(0, str(REPOSITORY / "sample_data"))
    from make_sample_data import true_displacement_px

    with rasterio.open(folder / "landsat_b4.tif") as ref, rasterio.open(folder / "landsat_b10.tif") as tgt:
        seen, shown = ref.read(1) > 0, tgt.read(1) > 0
        offset = ~tgt.transform * (ref.transform * (0, 0))
    rows, cols = np.nonzero(seen[::STEP_PX, ::STEP_PX])
    places = np.column_stack([cols, rows]) * STEP_PX + 0.5 + np.array(offset)
    displacement = true_displacement_px(places)
    col, row = np.floor(places + displacement).astype(np.intp).T
    inside = (col >= 0) & (row >= 0) & (col < shown.shape[1]) & (row < shown.shape[0])
    inside[inside] = shown[row[inside], col[inside]]
    return places[inside], displacement[inside]


def _python(*words: object) -> None:
    """Run Python, in the root of the repository."""
    subprocess.run([sys.executable, *map(str, words)], cwd=REPOSITORY, check=True, capture_output=True)
