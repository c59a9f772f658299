"""Kernels run whether or not they can be kept on disk; what is kept is used, unless it is outdated."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numba
import pytest

REPOSITORY = Path(__file__).resolve().parents[2]

KERNEL = """
from pcwlad_geo.matching.kernels.compiled import compiled
from part import twice

@compiled(fastmath=True)
def kernel(x):
    return twice(x) + 1.0
"""
PART = """
from pcwlad_geo.matching.kernels.compiled import compiled_part

@compiled_part()
def twice(x):
    return 2.0 * x
"""
SCRIPT = """
from kernel import kernel
from pcwlad_geo.matching.kernels.compiled import can_be_cached, is_cached

print(can_be_cached(kernel), is_cached(kernel), kernel(3.0))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "kernel.py").write_text(KERNEL)
    (folder / "part.py").write_text(PART)
    return folder


def run(package: Path, script: str = SCRIPT, **environment: str) -> str:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    path = os.pathsep.join([str(package), str(REPOSITORY)])
    command = [sys.executable, "-W", "error", "-B", "-c", script]
    done = subprocess.run(
        command, env={**clean, "PYTHONPATH": path, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_kernel_is_kept_for_the_next_process(package: Path) -> None:
    assert run(package) == "True False 7.0"
    assert run(package) == "True True 7.0"


@pytest.mark.slow
def test_a_kernel_is_compiled_again_when_its_file_has_changed(package: Path) -> None:
    run(package)
    (package / "kernel.py").write_text(KERNEL.replace("1.0", "10.0"))
    assert run(package) == "True False 16.0"
    assert run(package) == "True True 16.0"


@pytest.mark.slow
def test_a_kernel_is_compiled_again_when_another_file_has_changed(package: Path) -> None:
    run(package)
    (package / "part.py").write_text(PART.replace("2.0", "3.0"))
    assert run(package) == "True False 10.0"
    assert run(package) == "True True 10.0"


def test_an_index_that_names_what_is_gone_counts_for_nothing(package: Path) -> None:
    assert run(package) == "True False 7.0"
    (index,) = package.rglob("kernel.kernel-*.nbi")
    version, end = pickle.dumps(numba.__version__, protocol=-1), b"."
    index.write_bytes(version + b"cpcwlad_geo.matching.kernels.compiled\nGone\n" + end)
    assert run(package) == "True False 7.0"
    assert run(package) == "True True 7.0"


def test_kernels_run_where_no_folder_can_be_written(package: Path) -> None:
    (package / "__pycache__").write_text("a file where the folder should be")
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/cache", "LOCALAPPDATA": "/dev/null"}
    assert run(package, **nowhere) == "False False 7.0"
    assert run(package, **nowhere) == "False False 7.0"


def test_kernels_run_without_numba_s_compiler(package: Path) -> None:
    assert run(package, NUMBA_DISABLE_JIT="1") == "False False 7.0"


MAPS = """
import hashlib
import numpy as np
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.prepare import Image, prepare

rng = np.random.default_rng(1)
images = []
for _ in range(2):
    values = rng.normal(100.0, 20.0, (150, 131))
    images.append(Image(values, values < 150, scene_epsilon(values)))
pair = prepare(*images, channels="orientations")
digest = hashlib.sha256()
for stack, whole in ((pair.channels.reference, pair.reference_map), (pair.channels.target, pair.target_map)):
    for array in (stack.maps, stack.coefficients, whole.values, pair.contrast):
        digest.update(np.ascontiguousarray(array).tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
def test_maps_do_not_depend_on_whether_the_kernels_were_compiled_or_loaded(tmp_path: Path) -> None:
    cache = str(tmp_path / "cache")
    first = run(REPOSITORY, MAPS, NUMBA_CACHE_DIR=cache)
    kept = list(Path(cache).rglob("*.nbi"))
    assert {path.name.split("-")[0] for path in kept} >= {
        "phase_congruency.filter_rows",
        "phase_congruency.combine_scales",
        "phase_congruency.combine_orientations",
    }
    assert run(REPOSITORY, MAPS, NUMBA_CACHE_DIR=cache) == first
    assert len(list(Path(cache).rglob("*.nbi"))) == len(kept)
