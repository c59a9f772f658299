"""Fixtures that every test may use, and what the processes of a run of the tests share."""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.process import Result, run_cli

REPOSITORY = Path(__file__).resolve().parents[1]
COMPILE = "from pcwlad_geo.registration.tiles import compile_kernels; compile_kernels('oriented')"

# Here, before numpy loads: several threads on small matrices take several times as long as one.
for _pool in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_pool}_NUM_THREADS", "1")
# Tests start commands whose HOME is empty: each would search for fonts anew.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["MPLCONFIGDIR"] = tempfile.mkdtemp(prefix="pcwlad-geo-tests-")
    atexit.register(shutil.rmtree, os.environ["MPLCONFIGDIR"], ignore_errors=True)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels once, before several workers would all do so; forget those of other sources."""
    kernels = REPOSITORY / "pcwlad_geo/matching/kernels"
    if "PYTEST_XDIST_WORKER" not in os.environ:
        newest = max((path.stat().st_mtime for path in kernels.glob("*.py")), default=0.0)
        for index in (kernels / "__pycache__").glob("*.nbi"):
            if index.stat().st_mtime < newest:  # numba notices changes of a kernel's own file only
                index.unlink(missing_ok=True)
    workers = getattr(session.config.option, "numprocesses", None)
    if workers and "PYTEST_XDIST_WORKER" not in os.environ:
        places = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
        subprocess.run(
            [sys.executable, "-c", COMPILE],
            env={**os.environ, "PYTHONPATH": places},
            stdout=subprocess.DEVNULL,
            check=False,  # if it fails, tests will say why
        )


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real image pairs; the test is skipped where they are not."""
    folder = Path(os.environ.get("PCWLAD_GEO_TEST_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real image pairs in {folder} (set PCWLAD_GEO_TEST_DATA)")
    return folder


@pytest.fixture
def cli(tmp_path: Path) -> Callable[..., Result]:
    """Run the command line in an empty working folder."""

    def run(*arguments: str | Path, work: str | None = None) -> Result:
        return run_cli(tmp_path, arguments, work)

    return run
