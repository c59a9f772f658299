"""Print what the report costs: its share of a whole `register` run, and the size of the page.

Usage::

    python benchmarks/report.py [--side 4096] [--repeats 3] [--jobs 2] [--scratch FOLDER]

Every run is a process of its own. The time of the report is that of the page, the import of its figures'
library included, as `seconds.report` of report.json has it; the run is the whole process.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import sys
import tempfile
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.speed_studies.processes import measure
from benchmarks.speed_studies.scene_files import ScenePair, make_pair
from benchmarks.tables import Table, as_text, at_most

REPOSITORY: Final = Path(__file__).resolve().parents[1]
MAX_SHARE: Final = 0.15
MAX_MB: Final = 5.0


@dataclass(frozen=True, slots=True)
class Run:
    """One run of the command line."""

    run_s: float
    """Wall time of the process."""
    report_s: float
    page_mb: float

    @property
    def share(self) -> float:
        """Part of the run that the report takes."""
        return self.report_s / self.run_s


def main() -> int:
    """Make the scene, run, print."""
    arguments = _parse()
    folder = tempfile.TemporaryDirectory(prefix="pcwlad-geo-bench-")
    with nullcontext(arguments.scratch) if arguments.scratch else folder as scratch:
        pair = make_pair(Path(scratch) / "scenes", arguments.side)
        _run(pair, Path(scratch), arguments.jobs)  # compiles whatever is not in the cache yet
        runs = [_run(pair, Path(scratch), arguments.jobs) for _ in range(arguments.repeats)]
    rows = [
        [f"run {number}", run.run_s, run.report_s, f"{run.share:.1%}", f"{run.page_mb:.2f}"]
        for number, run in enumerate(runs, 1)
    ]
    checks = [
        at_most("report / run, median", statistics.median(run.share for run in runs), MAX_SHARE),
        at_most("page", max(run.page_mb for run in runs), MAX_MB, "MB"),
    ]
    title = f"Report of a pair of {arguments.side}², register, {arguments.jobs} jobs"
    print(as_text(Table(title, ("", "run s", "report s", "share", "page MB"), rows, checks)))
    return 0


def _run(pair: ScenePair, scratch: Path, jobs: int) -> Run:
    out = scratch / "out"
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-m", "pcwlad_geo", "register", str(pair.reference), str(pair.target)]
    command += ["-o", str(out), "--progress", "none", "--jobs", str(jobs)]
    cost = measure(command, environment={"PYTHONPATH": str(REPOSITORY)}, folder=scratch)
    if cost.status != 0:
        raise SystemExit(f"the run failed: {cost.reason}")
    seconds = json.loads((out / "report.json").read_text(encoding="utf-8"))["seconds"]
    return Run(cost.wall_s, seconds["report"], (out / "report.html").stat().st_size / 1e6)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--side", type=int, default=4096, help="of the scene, px (default: 4096)")
    parser.add_argument("--repeats", type=int, default=3, help="runs (default: 3)")
    parser.add_argument("--jobs", type=int, default=2, help="processes of a run (default: 2)")
    parser.add_argument("--scratch", type=Path, help="keep the scene there, and use it if it is there")
    arguments = parser.parse_args()
    if not sys.platform.startswith("linux"):
        parser.error("this benchmark reads /proc: run it on Linux")
    return arguments


if __name__ == "__main__":
    sys.exit(main())
