"""The compiled fit of robust local surfaces through neighbours (`kernels/local_surfaces.c`)."""

from __future__ import annotations

from ctypes import Structure, byref
from dataclasses import astuple, dataclass
from functools import partial
from typing import Final

import numpy as np

from pcwlad_geo.matching.kernels.library import POINTER, REAL, WHOLE, address, function, in_threads, shares
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class SurfaceLimits:
    """Limits of the reweighted fits of a surface."""

    rounds: int = 4
    """Number of fits."""
    ridge: float = 1e-6
    """Relative ridge on all terms but the constant: neighbours on a line leave the slope across it open."""
    tiny: float = 1e-12
    """Ridge on all terms, which keeps the normal matrix invertible."""
    min_scale_px: float = 1e-6
    """Least scale of the residuals, which keeps the weights finite where the fit is exact."""


SURFACE_LIMITS: Final = SurfaceLimits()
"""Those in use."""


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

    The points have (m, 2) positions `xy_px` and (m, 2) displacements `displacement_px` (col, row), the places
    are the (n, 2) `at_xy_px`; all are float64. The (n, k) intp `neighbours` are indices of points near each
    place, of which the (n, k) bool `usable` take part. The `order` is 1 for a plane, 2 for a quadratic
    surface. Filled are, in float64, (n, 2) `value`, the surface at the place, (n, 2, 2) `slope`, its
    derivatives (component, by x and y), (n,) `scale`, the median distance from it, and (n,) `leverage`, the
    variance of the value over that of one neighbour. They stay where there are fewer than two neighbours for
    each term.
    """
    n, most = neighbours.shape
    limits = _SurfaceLimits(*astuple(SURFACE_LIMITS))
    neighbours, usable = np.ascontiguousarray(neighbours, np.int64), np.ascontiguousarray(usable)

    def fit_some(part: slice) -> None:
        memory = np.empty(10 * most)
        function("fit_surfaces", *5 * [POINTER], *3 * [WHOLE], *6 * [POINTER])(
            *(address(array, np.float64) for array in (xy_px, displacement_px, at_xy_px[part])),
            address(neighbours[part], np.int64),
            address(usable[part], np.bool_),
            len(neighbours[part]),
            most,
            order,
            byref(limits),
            address(memory, np.float64),
            *(address(array[part], np.float64) for array in (value, slope, scale, leverage)),
        )

    in_threads([partial(fit_some, part) for part in shares(n, threads)], threads)
