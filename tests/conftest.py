"""Fixtures that every test may use, and what the processes of a run of the tests share."""

from __future__ import annotations

import atexit
import gc
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

from tests.cli.process import Result, run_cli, run_here

REPOSITORY = Path(__file__).resolve().parents[1]

settings.register_profile("without a clock", deadline=None)  # a busy machine is no failure
settings.load_profile("without a clock")
# Here, before numpy loads: several threads on small matrices take several times as long as one.
for _pool in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_pool}_NUM_THREADS", "1")
# Tests start scripts of the gallery whose HOME is empty: each would search for fonts anew.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["MPLCONFIGDIR"] = tempfile.mkdtemp(prefix="pcwlad-geo-tests-")
    atexit.register(shutil.rmtree, os.environ["MPLCONFIGDIR"], ignore_errors=True)


def pytest_collection_finish() -> None:
    """Look for garbage among what tests make, not anew among the half million objects of all modules."""
    gc.collect()
    gc.freeze()


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


@pytest.fixture
def cli_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Run the command line in an empty working folder and in this process, which takes no second to start."""

    def run(*arguments: str | Path, work: str | None = None) -> Result:
        with monkeypatch.context() as patch:
            return run_here(tmp_path, arguments, work, patch)

    return run
