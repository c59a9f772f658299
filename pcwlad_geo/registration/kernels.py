"""Load the matcher's kernels before the tiles need them; the first start says that it compiles them."""

from __future__ import annotations

from typing import Final

import numpy as np

from pcwlad_geo.matching.field import Surface, predict
from pcwlad_geo.matching.first_start import compile_kernels, kernels_are_kept
from pcwlad_geo.matching.settings import Method
from pcwlad_geo.registration.progress import EventCallback, Warned
from pcwlad_geo.registration.tasks import Runner

KEPT: Final = "first start: the inner loops are compiled now, which takes about half a minute, once"
NOT_KEPT: Final = (
    "the inner loops are compiled at every start, which takes about half a minute, as there is no folder "
    "to keep them in: set NUMBA_CACHE_DIR to one that can be written"
)


def load_kernels(method: Method, runner: Runner, on_event: EventCallback) -> None:
    """Let the workers load the kernels of a method; what is not on disk is compiled before, here.

    Parameters
    ----------
    method : str
    runner : Runner
    on_event : callable
        Receives a warning before anything is compiled.
    """
    if not kernels_are_kept(method):
        compile_kernels(method, lambda kept: on_event(Warned(KEPT if kept else NOT_KEPT)))
    runner.prepare(compile_kernels, (method, _say_nothing))


def load_own_kernel() -> None:
    """Load the kernel that this process calls itself, between the passes, while the workers match."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 0.0], [0.0, 2.0]])
    predict(corners, corners, corners[:1], Surface(6, 1))


def _say_nothing(kept: bool) -> None:
    pass
