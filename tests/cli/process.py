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
from dataclasses import make_dataclass
from pathlib import Path

def made(**values):
    return make_dataclass("Made", list(values))(**values)

def register(reference, target, *, on_event, **keywords):
{work}

def write_pair(command, names, settings, places, *, overwrite, on_event):
    report = register(*names, on_event=on_event, overwrite=overwrite, **places)
    folder = output_folder(names[1], command, places.get("out_dir"))
    return made(report=report, paths=dict(numbers=folder / "report.json", report=folder / "report.html"))

def output_folder(target, job, out_dir=None):
    return Path(out_dir or "b_registered")

job = types.ModuleType("pcwlad_geo.job")
job.register, job.write_pair = register, write_pair
pair_job = types.ModuleType("pcwlad_geo.pair_job")
pair_job.output_folder = output_folder
job.products_found_once = contextlib.nullcontext
job.open_job_runner = lambda settings, executor, on_event: contextlib.nullcontext(
    types.SimpleNamespace(shares_jobs=False, threads=1)
)
"""
"""The modules `pcwlad_geo.job` and `pcwlad_geo.pair_job` with a stand-in for the work."""
STAND_IN = f"""
import sys
import pcwlad_geo
from pcwlad_geo.__main__ import main
{JOB}
pcwlad_geo.job = sys.modules["pcwlad_geo.job"] = job
pcwlad_geo.pair_job = sys.modules["pcwlad_geo.pair_job"] = pair_job
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
        job's, and returns what the command prints: a report, made by ``made(**values)``.
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
        for name in ("job", "pair_job"):
            patch.setattr(pcwlad_geo, name, stand_in[name], raising=False)
            patch.setitem(sys.modules, f"pcwlad_geo.{name}", stand_in[name])
        for name in ("register", "products_found_once", "open_job_runner"):
            patch.setattr(batch_run, name, getattr(stand_in["job"], name))
    out, err = io.StringIO(), io.StringIO()
    words = list(map(str, arguments))
    with redirect_stdout(out), redirect_stderr(err):
        status = run(words)
    return Result(words, status, out.getvalue(), err.getvalue())
