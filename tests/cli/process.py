"""The command line in a process of its own, the job replaced by a stand-in where that is enough."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from tests.patience import PATIENCE_S

Result = subprocess.CompletedProcess[str]

JOB = """
import contextlib, types
from pathlib import Path

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
job.open_job_runner = lambda settings, executor, on_event: contextlib.nullcontext(
    types.SimpleNamespace(shares_jobs=False, threads=1)
)
"""
"""The module `pcwlad_geo.job` with a stand-in for the work."""
STAND_IN = f"""
import sys
import pcwlad_geo
from pcwlad_geo.__main__ import main
{JOB}
pcwlad_geo.job = sys.modules["pcwlad_geo.job"] = job
main()
"""
"""The command line with a job that needs no libraries: its tests start many processes."""


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
    return [sys.executable, "-c", STAND_IN.format(work=_body(work))]


def _body(work: str) -> str:
    return textwrap.indent(textwrap.dedent(work), "    ")


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


def run_here(
    folder: Path, arguments: Sequence[str | Path], work: str | None, patch: pytest.MonkeyPatch
) -> Result:
    """Run the command line in a folder and in this process, for what is no matter of processes."""
    import pcwlad_geo  # inside: conftest imports this module before numpy may load
    from pcwlad_geo.cli.app import run
    from pcwlad_geo.multi.batch import run as batch_run

    patch.chdir(folder)
    patch.setenv("COLUMNS", "100")
    if work is not None:
        stand_in: dict[str, Any] = {}
        exec(JOB.format(work=_body(work)), stand_in)
        patch.setattr(pcwlad_geo, "job", stand_in["job"])
        patch.setitem(sys.modules, "pcwlad_geo.job", stand_in["job"])
        for name in ("register", "products_found_once", "open_job_runner"):
            patch.setattr(batch_run, name, getattr(stand_in["job"], name))
    out, err = io.StringIO(), io.StringIO()
    words = list(map(str, arguments))
    with redirect_stdout(out), redirect_stderr(err):
        status = run(words)
    return Result(words, status, out.getvalue(), err.getvalue())
