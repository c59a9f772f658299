"""The command line in a process of its own, the job replaced by a stand-in where that is enough."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path

from tests.patience import PATIENCE_S

Result = subprocess.CompletedProcess[str]

STAND_IN = """
import contextlib, sys, types
from pathlib import Path
import pcwlad_geo
from pcwlad_geo.__main__ import main

def register(reference, target, *, on_event, **keywords):
{work}

def output_folder(target, job, out_dir=None):
    return Path(out_dir or "b_registered")

def output_paths(target, job, *, out_dir=None, **elsewhere):
    folder = output_folder(target, job, out_dir)
    return dict(numbers=folder / "report.json", report=folder / "report.html", raster=folder / "absent.tif")

job = types.ModuleType("pcwlad_geo.job")
job.register = register
job.output_paths, job.output_folder = output_paths, output_folder
job.products_found_once = contextlib.nullcontext
job.open_job_runner = lambda settings, executor, on_event: contextlib.nullcontext()
pcwlad_geo.job = sys.modules["pcwlad_geo.job"] = job
main()
"""
"""The command line with a job that needs no libraries: its tests start many processes."""

TIMERS_RUN_OUT = "threading.Timer.start = lambda timer: timer.function()"
"""A statement that makes of any machine one so slow that every timer has run out at once."""


def environment(tmp_path: Path) -> dict[str, str]:
    """Return an environment whose HOME is empty."""
    return {**os.environ, "HOME": str(tmp_path), "PYTHONWARNINGS": "error", "COLUMNS": "100"}


def command(work: str | None) -> list[str]:
    """Return the command that runs the command line.

    Parameters
    ----------
    work : str, optional
        Body of a function ``register(reference, target, *, on_event, **keywords)`` that stands in for the
        job's.
    """
    if work is None:
        return [sys.executable, "-m", "pcwlad_geo"]
    return [sys.executable, "-c", STAND_IN.format(work=textwrap.indent(textwrap.dedent(work), "    "))]


def run_cli(folder: Path, arguments: Sequence[str | Path], work: str | None = None) -> Result:
    """Run the command line in a folder, to its end."""
    return subprocess.run(
        [*command(work), *map(str, arguments)],
        cwd=folder,
        env=environment(folder),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
