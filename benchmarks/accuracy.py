"""Print the accuracy of the matching beside the published methods, and the studies behind it.

Usage::

    python benchmarks/accuracy.py [--study NAME] [--data FOLDER] [--jobs N] [--share SHARE] [--part PART]

Every figure comes through the public job. Lines below a table hold its figures against what must be reached.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.runs import Runner
from benchmarks.studies.bands import bands
from benchmarks.studies.candidates import candidates
from benchmarks.studies.closure import closure
from benchmarks.studies.crs import crs
from benchmarks.studies.cube import cube
from benchmarks.studies.difference import difference
from benchmarks.studies.field import displacement_field
from benchmarks.studies.flight import flight
from benchmarks.studies.jitter import jitter
from benchmarks.studies.layers import layers
from benchmarks.studies.metrology import metrology
from benchmarks.studies.models import models
from benchmarks.studies.paper import paper
from benchmarks.studies.pointwise import pointwise
from benchmarks.studies.pose import PARTS, pose
from benchmarks.studies.proof import proof
from benchmarks.studies.quality import QUALITY_PARTS, quality
from benchmarks.studies.radar import radar
from benchmarks.studies.refit import refit
from benchmarks.studies.refusal import refusal
from benchmarks.studies.rig import rig
from benchmarks.studies.robustness import robustness
from benchmarks.studies.rpc import rpc
from benchmarks.studies.rpcblock import rpcblock
from benchmarks.studies.sigma import sigma
from benchmarks.studies.stack import stack
from benchmarks.studies.tiles import tiles
from benchmarks.studies.watch import watch_study
from benchmarks.studies.windows import windows
from benchmarks.tables import Check, Table, as_text

REPOSITORY = Path(__file__).resolve().parents[1]

Study = Callable[[Path, Path, Runner], Iterator[Table]]

STUDIES: dict[str, Study] = {
    "paper": paper,
    "robustness": robustness,
    "difference": difference,
    "pointwise": pointwise,
    "metrology": metrology,
    "proof": proof,
    "watch": watch_study,
    "field": displacement_field,
    "sigma": sigma,
    "closure": closure,
    "crs": crs,
    "bands": bands,
    "candidates": candidates,
    "rpc": rpc,
    "refit": refit,
    "refusal": refusal,
    "quality": quality,
    "windows": windows,
    "tiles": tiles,
    "models": models,
    "jitter": jitter,
    "pose": pose,
    "radar": radar,
    "stack": stack,
    "cube": cube,
    "layers": layers,
    "rpcblock": rpcblock,
    "rig": rig,
    "flight": flight,
}


def main() -> int:
    """Run the studies asked for and print their tables."""
    arguments = _parse()
    names = list(STUDIES) if arguments.study == "all" else [arguments.study]
    asked = arguments.part or ()
    studies = STUDIES | {
        "pose": partial(pose, share=arguments.share, parts=[part for part in asked if part in PARTS]),
        "flight": partial(flight, share=arguments.share),
        "quality": partial(quality, parts=[part for part in asked if part in QUALITY_PARTS]),
    }
    runner = Runner(arguments.jobs)
    checks: list[Check] = []
    for name in names:
        begun = time.perf_counter()
        with tempfile.TemporaryDirectory(prefix="pcwlad-geo-bench-") as scratch:
            for table in studies[name](arguments.data, Path(scratch), runner):
                print(as_text(table), end="\n\n", flush=True)
                checks += table.checks
        print(f"[{name}: {time.perf_counter() - begun:.0f} s]\n", flush=True)
    missed = [check for check in checks if not check.holds]
    print(f"{len(checks) - len(missed)} of {len(checks)} figures reached")
    for check in missed:
        print(f"MISSES  {check.what}: {check.value} ({check.limit})")
    return 0


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--study", choices=[*STUDIES, "all"], default="paper", help="default: paper")
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("PCWLAD_GEO_TEST_DATA", REPOSITORY.parent / "shared" / "data")),
        help="folder of the real image pairs (default: PCWLAD_GEO_TEST_DATA, or ../shared/data)",
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="pairs at a time")
    parser.add_argument("--share", type=_share, default=1.0, help="of the cases of pose and flight, 0 to 1")
    parser.add_argument(
        "--part",
        choices=[*PARTS, *QUALITY_PARTS],
        action="append",
        help="of the studies pose and quality (may be repeated; default: all)",
    )
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        parser.error(f"no image pairs in {arguments.data}: give --data or set PCWLAD_GEO_TEST_DATA")
    return arguments


def _share(text: str) -> float:
    value = float(text)
    if not 0 < value <= 1:
        raise ValueError(text)
    return value


if __name__ == "__main__":
    sys.exit(main())
