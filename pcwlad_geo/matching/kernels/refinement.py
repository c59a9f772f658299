"""The compiled refinement of many points (`kernels/refinement.c`).

It is Gauss-Newton with robust and structure weights.
"""

from __future__ import annotations

from ctypes import Structure, byref
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.kernels.library import POINTER, REAL, WHOLE, address, function
from pcwlad_geo.types import Bool, Float32, Float64

LANES: Final = 16
"""A row of a flat window is a multiple of this, so that rows begin on cache lines."""
EXTRA_TAPS: Final = 3
"""Number of spline coefficients that a window needs beyond its side, per axis."""

STRUCTURE_NONE: Final = 0
"""Structure mode: pixels are not weighted by mutual structure."""
STRUCTURE_FOLLOWS: Final = 1
"""Structure mode: mutual structure is computed at the current position at every step."""
STRUCTURE_FIXED: Final = 2
"""Structure mode: mutual structure is computed once, at the position given for it."""
STRUCTURE_GIVEN: Final = 3
"""Structure mode: mutual structure is passed in."""

CONVERGED: Final = 0
"""Status of a point: the shift has converged."""

Int64 = NDArray[np.int64]


class Images(NamedTuple):
    """Maps of both images, those of the target as spline coefficients."""

    reference: Float32
    """(channels, rows, cols); with a step of 2 the even columns come before the odd ones, and an odd last
    one is left out."""
    coefficients: Float32
    """(channels, rows, cols), in the same order."""
    reference_valid: Bool
    """(rows, cols)."""
    target_valid: Bool
    """(rows, cols)."""


class Starts(NamedTuple):
    """Where n points start; see `refinement.InitialEstimate`."""

    corners_rc: Int64
    """(n, 2) row, column array indices in the reference."""
    shift_xy: Float64
    """(n, 2) px."""
    linear: Float64
    """(n, 2, 2)."""
    structure_xy: Float64
    """(n, 2) px."""
    structure: Float32
    """(n, rows, cols) of the window, or (1, 1, 1) where it is not given."""


class Results(NamedTuple):
    """Results of n points, as `refine_points` finds them; see `refinement.Refined`."""

    shift_xy: Float64
    """(n, 2) px."""
    linear: Float64
    """(n, 2, 2)."""
    covariance: Float64
    """(n, 2, 2) px²."""
    status: Int64
    """(n,) `CONVERGED`; else 1: the iterations ended before, 2: the window leaves the image or has too few
    valid pixels, 3: the point moved too far or out of the image, or its equations are singular, 4: plain
    steps hardly shrink on the way, so that the position is not determined."""


LONGEST_STEP_PX: Final = 1.0
"""Largest length of a move."""
LARGEST_RELAXATION: Final = 20.0
"""Largest ratio of a move to the plain step."""
MIN_SLOPE: Final = 0.08
"""Least slope of the plain step; below it the weights follow the window to any position."""
SETTLED_AFTER: Final = 3
"""Number of moves after which a window is given up whose next one is longer than `SETTLING_PX`."""
SETTLING_PX: Final = 0.25
"""Moves towards a match become shorter from one to the next; those of windows that show something else do
not, and end somewhere by chance."""
PATIENCE: Final = 6
"""Number of steps after which a window is given up whose slope is below half of `MIN_SLOPE`."""
NEAR_PX: Final = 0.1
"""Length below which the last move but one must be, as a single short move may be chance."""
SIGMA_PER_MEAN_DEVIATION: Final = 1.2533
"""Standard deviation of a normal distribution over its mean absolute deviation, √(π / 2)."""


class RefinementOptions(Structure):
    """Settings of the refinement; see `refinement.refine`.

    `half_rows` and `half_cols` are half the sides of the window and `correlation_half` that of the local
    correlation, in pixels that are `step` apart: 1 for all pixels of the window, 2 for every second one of
    its rows and columns. `width` is the number of values in a row of a flat window, see `flat_width`,
    `blocks` that of the blocks along a side, and `reached_by_px` the length of the move that led to the
    start.
    """

    _fields_ = (
        *(
            (name, WHOLE)
            for name in (
                *("half_rows", "half_cols", "step", "correlation_half", "width", "structure_mode"),
                *("robust", "affine", "iterations", "blocks"),
            )
        ),
        *(
            (name, REAL)
            for name in ("reached_by_px", "tolerance_px", "relaxation", "least_valid", "largest_move_px")
        ),
    )


class _Limits(Structure):
    _fields_ = (
        *(
            (name, REAL)
            for name in (
                *("longest_step_px", "largest_relaxation", "min_slope", "near_px", "settling_px"),
                "sigma_per_mean_deviation",
            )
        ),
        ("settled_after", WHOLE),
        ("patience", WHOLE),
    )


class _Images(Structure):
    _fields_ = (
        *((name, POINTER) for name in ("reference", "coefficients", "reference_valid", "target_valid")),
        *((name, WHOLE) for name in ("channels", "rows", "cols", "valid_cols")),
        *((name, WHOLE) for name in ("target_rows", "target_cols", "target_valid_cols")),
    )


class _Starts(Structure):
    _fields_ = (*((name, POINTER) for name in Starts._fields), ("count", WHOLE))


class _Results(Structure):
    _fields_ = tuple((name, POINTER) for name in Results._fields)


def flat_width(extended: int) -> int:
    """Return the number of values in a row of a flat window that is `extended` pixels wide."""
    return -(-(extended + EXTRA_TAPS) // LANES) * LANES


def refine_points(images: Images, starts: Starts, options: RefinementOptions) -> Results:
    """Refine every corner of `starts` on the maps of `images`.

    Points whose window is not usable keep zeros and the status 2.
    """
    n = len(starts.corners_rc)
    results = Results(np.zeros((n, 2)), np.zeros((n, 2, 2)), np.zeros((n, 2, 2)), np.zeros(n, np.int64))
    maps = _Images(
        *(address(array, np.float32) for array in images[:2]),
        *(address(array, np.bool_) for array in images[2:]),
        *images.reference.shape,
        images.reference_valid.shape[1],
        *images.coefficients.shape[1:],
        images.target_valid.shape[1],
    )
    limits = _Limits(
        *(LONGEST_STEP_PX, LARGEST_RELAXATION, MIN_SLOPE, NEAR_PX, SETTLING_PX, SIGMA_PER_MEAN_DEVIATION),
        *(SETTLED_AFTER, PATIENCE),
    )
    numbers = function("refinement_memory", POINTER, POINTER, returns=WHOLE)(byref(maps), byref(options))
    memory, scores = np.zeros(numbers or 0, np.float32), np.zeros((options.blocks**2, 2))
    function("refine_points", *7 * [POINTER])(
        byref(maps),
        byref(
            _Starts(
                address(starts.corners_rc, np.int64),
                address(starts.shift_xy, np.float64),
                address(starts.linear, np.float64),
                address(starts.structure_xy, np.float64),
                address(starts.structure, np.float32),
                n,
            )
        ),
        byref(options),
        byref(limits),
        address(memory, np.float32),
        address(scores, np.float64),
        byref(_Results(*(address(array, array.dtype) for array in results))),
    )
    return results
