"""The compiled fit of robust local surfaces through neighbours (`kernels/local_surfaces.c`)."""

from __future__ import annotations

from ctypes import Structure, byref
from functools import partial
from typing import Final

import numpy as np

from pcwlad_geo.matching.kernels.library import POINTER, REAL, WHOLE, address, function, in_threads, shares
from pcwlad_geo.types import Bool, Float64, Index

ROUNDS: Final = 4
"""Number of reweighted fits of a surface."""
RIDGE: Final = 1e-6
"""Relative ridge on all terms but the constant: neighbours on a line do not determine the slope across it."""
TINY: Final = 1e-12
"""Ridge on all terms, which keeps the normal matrix invertible."""
MIN_SCALE_PX: Final = 1e-6
"""Least scale of the residuals, which keeps the weights finite where the fit is exact."""


class _SurfaceLimits(Structure):
    _fields_ = (("rounds", WHOLE), ("ridge", REAL), ("tiny", REAL), ("min_scale_px", REAL))


def fit_surfaces(
    xy_px: Float64,
    displacement_px: Float64,
    at_xy_px: Float64,
    neighbours: Index,
    usable: Bool,
    order: int,
    value: Float64,
    slope: Float64,
    scale: Float64,
    leverage: Float64,
    threads: int = 1,
) -> None:
    """Fit a robust surface to the displacements of the usable neighbours of each place.

    Parameters
    ----------
    xy_px, displacement_px : (m, 2) float64 arrays
        Positions and displacements (col, row) of the points.
    at_xy_px : (n, 2) float64 array
        Places (col, row).
    neighbours, usable : (n, k) intp and bool arrays
        Indices of points near each place, and which of them take part.
    order : int
        1: a plane, 2: a quadratic surface.
    value, slope, scale, leverage : (n, 2), (n, 2, 2), (n,), (n,) float64 arrays
        Filled with the surface at the place, its derivatives (component, by x and y), the median distance
        from it, and the variance of the value over that of one neighbour. Unchanged where there are fewer
        than two neighbours for each term.
    threads : int
        Number of threads that share the places.
    """
    n, most = neighbours.shape
    limits = _SurfaceLimits(ROUNDS, RIDGE, TINY, MIN_SCALE_PX)
    neighbours, usable = np.ascontiguousarray(neighbours, np.int64), np.ascontiguousarray(usable)

    def fit_some(some: slice) -> None:
        memory = np.empty(10 * most)
        function("fit_surfaces", *5 * [POINTER], *3 * [WHOLE], *6 * [POINTER])(
            *(address(array, np.float64) for array in (xy_px, displacement_px, at_xy_px[some])),
            address(neighbours[some], np.int64),
            address(usable[some], np.bool_),
            len(neighbours[some]),
            most,
            order,
            byref(limits),
            address(memory, np.float64),
            *(address(array[some], np.float64) for array in (value, slope, scale, leverage)),
        )

    in_threads([partial(fit_some, some) for some in shares(n, threads)], threads)
