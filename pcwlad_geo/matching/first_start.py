"""Compile the kernels of a method before they are needed, and tell when that takes long."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numba.core import event
from numpy.typing import NDArray

from pcwlad_geo.matching.compiled import is_kept
from pcwlad_geo.matching.field_kernel import fit_surfaces
from pcwlad_geo.matching.matcher import match_arrays
from pcwlad_geo.matching.phase_kernels import combine_orientations, combine_scales, filter_rows
from pcwlad_geo.matching.refinement_loop import refine_points
from pcwlad_geo.matching.settings import TRAITS, MatchSettings, Method

SIDE_PX: Final = 128
WINDOW_PX: Final = 21
POINTS: Final = 60
"""Enough for the displacement field to be laid through them."""


def kernels_are_kept(method: Method) -> bool:
    """Tell whether an earlier process has left all that the method needs, so that starting is quick."""
    return all(is_kept(kernel) for kernel in kernels_of(method))


def kernels_of(method: Method) -> tuple[Callable[..., Any], ...]:
    """Return the kernels that a method may call."""
    always = (refine_points, fit_surfaces)
    phase = (filter_rows, combine_scales, combine_orientations)
    return always if TRAITS[method].channels == "gradients" else always + phase


def compile_kernels(method: Method, on_compiling: Callable[[bool], None]) -> None:
    """Match a small pair of images, so that every kernel of the method is compiled or loaded.

    Parameters
    ----------
    method : str
        Matching method.
    on_compiling : callable
        Called once where kernels must be compiled, before the first: True where they are kept for the next
        start, False where every process compiles them anew.
    """
    settings = MatchSettings(
        method=method,
        template=WINDOW_PX,
        window=WINDOW_PX,
        features=POINTS,
        search_radius=3,
        consensus="auto",
    )
    with event.install_listener("numba:compile", _FirstCompilation(on_compiling)):
        match_arrays(_blobs(0.0), _blobs(0.4), settings=settings)


class _FirstCompilation(event.Listener):
    """Tells of the first compilation in the thread that made it."""

    def __init__(self, tell: Callable[[bool], None]) -> None:
        self._tell = tell
        self._thread = threading.get_ident()
        self._told = False

    def on_start(self, event: Any) -> None:  # noqa: ANN401
        if self._told or threading.get_ident() != self._thread:
            return
        self._told = True
        statistics = getattr((event.data or {}).get("dispatcher"), "stats", None)
        self._tell(getattr(statistics, "cache_path", None) is not None)

    def on_end(self, event: Any) -> None:  # noqa: ANN401
        pass


def _blobs(shift_px: float) -> NDArray[np.float64]:
    """Return an image with corners everywhere."""
    row, col = np.mgrid[:SIDE_PX, :SIDE_PX] + shift_px
    wave = np.sin(0.031 * row * col) + np.sin(0.4 * row + 0.1 * col) * np.cos(0.5 * col)
    return np.asarray(np.tanh(2 * wave))
