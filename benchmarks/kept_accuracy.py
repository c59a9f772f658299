"""Compare the accuracy of the plain call on small pairs with kept figures.

Usage::

    python benchmarks/kept_accuracy.py [--keep] [--data FOLDER]

One pair of each kind, with the settings of a plain call: a synthetic pair of exact truth; a pair of the
paper with a known shift, matched before and after it (the tool's own error a point, as in the study
`pointwise`); and a pair of two viewpoints, by its epipolar lines. The exit status is 1 where an error is more
than a tenth above the one in `kept_accuracy.json`, or the number of points more than a twentieth below;
`--keep` writes the figures measured now there. The real pairs are left out, with a line that says so, where
their folder is not given by `--data` or PCWLAD_GEO_TEST_DATA. Half a minute of CPU.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.pairs import landsat, uav
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.scores import epipolar_errors, score, translation_errors
from benchmarks.speed_studies.scene_files import displacement_px, make_pair
from benchmarks.studies.pointwise import GROSS_PX, moved_minus_unmoved
from benchmarks.tables import Check, Table, as_text, at_least, at_most
from pcwlad_geo.options import Settings

KEPT: Final = Path(__file__).with_suffix(".json")
LARGER_ERROR: Final = 1.1
"""Most that an error may be of the one kept."""
FEWER_POINTS: Final = 0.95
"""Least that the number of points may be of the one kept."""
ROUNDING_PX: Final = 0.001
"""By how much other versions of libraries and compilers may move a figure besides."""
SIDE_PX: Final = 384

Figures = dict[str, float]


def main() -> int:
    """Measure, print, compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--keep", action="store_true", help="keep the figures measured now")
    parser.add_argument("--data", type=Path, help="folder of the real image pairs")
    arguments = parser.parse_args()
    data = arguments.data or Path(os.environ.get("PCWLAD_GEO_TEST_DATA", ""))
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo-bench-") as scratch:
        measured = dict(_measured(Path(scratch), data))
    known: dict[str, Figures] = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    if arguments.keep:
        known |= {pair: {name: round(v, 4) for name, v in each.items()} for pair, each in measured.items()}
        KEPT.write_text(json.dumps(known, indent=1) + "\n")
    checks = [check for pair, each in measured.items() for check in compared(pair, each, known[pair])]
    title, pairs = "Accuracy of the plain call beside kept figures", [[pair] for pair in measured]
    print(as_text(Table(title, ("pair",), pairs, checks)))
    return 0 if all(check.holds for check in checks) else 1


def _measured(scratch: Path, data: Path) -> Iterator[tuple[str, Figures]]:
    """Yield the figures of each pair that is here."""
    runner = Runner(1)
    yield "synthetic, exact truth", _synthetic(scratch, runner)
    moving, views = landsat(data), uav(data)
    if not moving.reference.exists():
        print(f"the pairs of the paper are left out: no {moving.reference.resolve()} (give --data)\n")
        return
    jobs = [Job(moving.reference, target, Settings()) for target in (moving.undisplaced, moving.target)]
    before, after = runner(jobs)
    yield "landsat_sub1, pointwise", _pointwise(before, after, moving.truth)
    yield "landsat_sub1", _scored(translation_errors(after.positions, moving.truth))
    (outcome,) = runner([Job(views.reference, views.target, Settings())])
    yield "uav_1, distance to epipolar lines", _scored(epipolar_errors(outcome.positions))


def _synthetic(scratch: Path, runner: Runner) -> Figures:
    pair = make_pair(scratch, SIDE_PX)
    (outcome,) = runner([Job(pair.reference, pair.target, Settings())])
    points = outcome.points
    error_px = points.displacement_px - displacement_px(points.predicted_px)
    return _scored(error_px) | {"bias_px": float(np.abs(error_px.mean(axis=0)).max())}


def _scored(error_px: Array) -> Figures:
    result = score(error_px)
    return {"points": result.correct, "rmse_px": result.rmse_px, "scatter_px": result.scatter_px}


def _pointwise(before: Outcome, after: Outcome, truth_xy_px: tuple[float, float]) -> Figures:
    error_px = moved_minus_unmoved(before, after) - truth_xy_px
    good = error_px[np.hypot(*error_px.T) <= GROSS_PX]
    bias, scatter = np.abs(good.mean(axis=0)).max(), good.std(axis=0).max()
    return {"points": len(good), "bias_px": float(bias), "scatter_px": float(scatter)}


def compared(pair: str, figures: Figures, kept: Figures) -> Iterator[Check]:
    """Yield a check of each of the `figures` of a `pair`: points and errors about as `kept`, or better."""
    for name, value in figures.items():
        if name == "points":
            yield at_least(f"{pair}: {name}", value, FEWER_POINTS * kept[name], digits=0)
        else:
            yield at_most(f"{pair}: {name}", value, LARGER_ERROR * kept[name] + ROUNDING_PX, digits=4)


if __name__ == "__main__":
    sys.exit(main())
