"""The first start tells that it compiles, leaves nothing to compile, and gives what later ones give."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pcwlad_geo.registration.tiles import COMPILED_ONCE

REPOSITORY = Path(__file__).resolve().parents[2]
TELL = """
from pcwlad_geo.events import Warned
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.registration.tiles import load_kernels
load_kernels("coarse", InThisProcess(), lambda event: isinstance(event, Warned) and print(event.message))
"""

DIGEST = """
import hashlib
import cv2
import numpy as np
from pcwlad_geo.matching.refinement import ChannelMaps, InitialEstimate, refine

rng = np.random.default_rng(1)
noise = rng.normal(size=(3, 150, 150)).astype(np.float32)
noise = np.stack([np.abs(cv2.GaussianBlur(plane, (0, 0), 2)) for plane in noise])
valid = rng.random((150, 150)) > 0.1
stacks = [ChannelMaps(noise[:, i : 140 + i, i : 140 + i], valid[:140, :140]) for i in (0, 1)]
corners = rng.integers(45, 95, (40, 2))
digest = hashlib.sha256()
for window, linear, affine, fixed in (
    (41, 0.0, False, False), (81, 0.0, False, False), (61, 0.01, False, True), (61, 0.0, True, False)
):
    structure = np.zeros((40, 2)) if fixed else None
    start = InitialEstimate(np.full((40, 2), -0.8), np.full((40, 2, 2), linear), structure)
    found = refine(*stacks, corners, start, window_px=window, affine=affine, use_structure=not affine)
    for array in (found.shift_xy_px, found.linear, found.covariance_px2, found.converged):
        digest.update(array.tobytes())
    print(int(found.converged.sum()))
print(digest.hexdigest())
"""

COMPLETE = """
import sys
import numpy as np
from pcwlad_geo.registration.tiles import compile_kernels
from pcwlad_geo.matching.matcher import match_arrays
from pcwlad_geo.matching.types import MatchSettings
from tests.matching.landscape import Landscape

LANDSCAPE = Landscape()
WHERE = lambda x, y: (0.02 * x + 1.0, 0.01 * y - 2.0)  # windows deform too

def signatures():
    return {
        (name, kernel): len(value.signatures)
        for name, module in list(sys.modules.items()) if name.startswith("pcwlad_geo.")
        for kernel, value in vars(module).items()
        if hasattr(value, "signatures") and hasattr(value, "py_func")
    }

for method in ("oriented", "pcwlad"):
    compile_kernels(method)
    before = signatures()
    assert sum(before.values()) >= 2, before
    for dtype in (np.float32, np.float64, np.uint16):
        images = [(100 * LANDSCAPE.image(200, 0, where)).astype(dtype) for where in (None, WHERE)]
        valid = np.ones(images[0].shape, bool)
        valid[:9, :9] = False
        settings = MatchSettings(method=method, template=41, window=41, features=60)
        assert len(match_arrays(*images, reference_valid=valid, settings=settings)) > 24
    assert signatures() == before
"""


def python(code: str, **environment: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=REPOSITORY,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of kernels that the starts below fill."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def starts(cache: Path) -> list[str]:
    """Return what a process with nothing compiled tells and refines, and what one after it does."""
    return [python(TELL + DIGEST, NUMBA_CACHE_DIR=str(cache), PYTHONWARNINGS="error") for _ in range(2)]


@pytest.mark.slow
def test_the_first_start_tells_and_the_second_does_not(starts: list[str]) -> None:
    first, second = starts
    assert first == f"{COMPILED_ONCE}\n{second}"
    assert COMPILED_ONCE not in second


@pytest.mark.slow
def test_a_kernel_from_disk_gives_what_the_one_just_compiled_gave(starts: list[str], cache: Path) -> None:
    compiled, kept = (start.removeprefix(f"{COMPILED_ONCE}\n").split() for start in starts)
    assert kept == compiled
    assert len(kept) == 5
    assert all(int(line) > 0 for line in kept[:-1])
    files = list(cache.rglob("refinement.refine_points-*.nb*"))
    assert len(files) == 2, "one index, one kernel: parts are not kept by themselves"


@pytest.mark.slow
def test_nothing_is_left_to_be_compiled() -> None:
    python(COMPLETE)
