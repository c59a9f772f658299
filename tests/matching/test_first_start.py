"""The first start says that it compiles, and leaves nothing to be compiled later."""

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


@pytest.mark.slow
def test_the_first_start_tells_and_the_second_does_not(tmp_path: Path) -> None:
    assert [python(TELL, NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(2)] == [f"{COMPILED_ONCE}\n", ""]


@pytest.mark.slow
def test_nothing_is_left_to_be_compiled() -> None:
    python(COMPLETE)
