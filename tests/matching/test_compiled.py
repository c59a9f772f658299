"""Kernels run whether or not they can be kept on disk; what is kept is used, and dropped when outdated."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]

KERNEL = """
from pcwlad_geo.matching.compiled import compiled
from part import twice

@compiled(fastmath=True)
def kernel(x):
    return twice(x) + 1.0
"""
PART = """
from pcwlad_geo.matching.compiled import compiled_part

@compiled_part()
def twice(x):
    return 2.0 * x
"""
SCRIPT = """
from kernel import kernel
from pcwlad_geo.matching.compiled import can_be_kept, is_kept

print(can_be_kept(kernel), is_kept(kernel), kernel(3.0))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "kernel.py").write_text(KERNEL)
    (folder / "part.py").write_text(PART)
    return folder


def run(package: Path, **environment: str) -> str:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    path = os.pathsep.join([str(package), str(REPOSITORY)])
    command = [sys.executable, "-W", "error", "-B", "-c", SCRIPT]
    done = subprocess.run(
        command, env={**clean, "PYTHONPATH": path, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_kernel_is_kept_for_the_next_process(package: Path) -> None:
    assert run(package) == "True False 7.0"
    assert run(package) == "True True 7.0"


def test_a_kernel_is_compiled_again_when_a_part_of_it_has_changed(package: Path) -> None:
    run(package)
    (package / "part.py").write_text(PART.replace("2.0", "5.0"))
    assert run(package) == "True False 16.0"
    assert run(package) == "True True 16.0"


def test_kernels_run_where_no_folder_can_be_written(package: Path) -> None:
    (package / "__pycache__").write_text("a file where the folder should be")
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/cache", "LOCALAPPDATA": "/dev/null"}
    assert run(package, **nowhere) == "False False 7.0"
    assert run(package, **nowhere) == "False False 7.0"


def test_kernels_run_without_numba_s_compiler(package: Path) -> None:
    assert run(package, NUMBA_DISABLE_JIT="1") == "False False 7.0"
