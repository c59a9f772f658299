"""The compiled refinement of many points (`kernels/refinement.c`).

It is Gauss-Newton with robust and structure weights.
"""

from __future__ import annotations

from ctypes import Structure, byref
from dataclasses import astuple, dataclass, fields
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.kernels.library import POINTER, REAL, WHOLE, address, function
from pcwlad_geo.types import Bool, Float32, Float64

Int64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class IterationLimits:
    """Limits of the moves of a point from step to step."""

    longest_step_px: float = 1.0
    """Largest length of a move."""
    largest_relaxation: float = 20.0
    """Largest ratio of a move to the plain step."""
    min_slope: float = 0.08
    """Least slope of the plain step; below it the weights follow the window to any position."""
    near_px: float = 0.1
    """Length below which the last move but one must be, as a single short move may be chance."""
    settling_px: float = 0.25
    """Length from which a move after `settled_after` gives the window up: moves to a match get shorter."""
    sigma_per_mean_deviation: float = 1.2533
    """Standard deviation of a normal distribution over its mean absolute deviation, √(π / 2)."""
    settled_after: int = 3
    """Number of moves before that."""
    patience: int = 6
    """Number of steps after which a window is given up whose slope is below half of `min_slope`."""


ITERATION_LIMITS: Final = IterationLimits()
"""Those in use."""
ROW_MULTIPLE: Final = 16
"""A row of a flat window is a multiple of this, so that rows begin on cache lines."""
EXTRA_TAPS: Final = 3
"""Number of spline coefficients that a window needs beyond its side, per axis."""


class StructureMode(IntEnum):
    """How pixels are weighted by mutual structure."""

    NONE = 0
    """They are not."""
    FOLLOWS = 1
    """It is computed at the current position at every step."""
    FIXED = 2
    """It is computed once, at the position given for it."""
    GIVEN = 3
    """It is passed in."""


class Status(IntEnum):
    """How the refinement of a point ends."""

    CONVERGED = 0
    NOT_CONVERGED = 1
    """The iterations ended before."""
    INVALID = 2
    """The window leaves the image or has too few valid pixels."""
    DIVERGED = 3
    """The point moved too far or out of the image, or its equations are singular."""
    UNDETERMINED = 4
    """Plain steps hardly shrink on the way, so that the position is not determined."""


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
    """Where n points start, float64 and in px; see `refinement.InitialEstimate`."""

    corners_rc: Int64
    """(n, 2) row, column array indices in the reference."""
    shift_xy: Float64
    linear: Float64
    structure_xy: Float64
    structure: Float32
    """(n, rows, cols) of the window, or (1, 1, 1) where it is not given."""


class Results(NamedTuple):
    """Results of n points; see `refinement.Refined`."""

    shift_xy: Float64
    linear: Float64
    covariance: Float64
    status: Int64
    """(n,) numbers of `Status`."""


class RefinementOptions(Structure):
    """Settings of the refinement; see `refinement.refine`.

    `half_rows`, `half_cols` and `correlation_half` are half the sides of the window and of the local
    correlation, in pixels that are `step` apart; `width` is that of a row, see `flat_width`, `blocks` the
    number of blocks along a side, and `reached_by_px` the length of the move that led to the start.
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
    _fields_ = tuple(
        (field.name, WHOLE if field.type == "int" else REAL) for field in fields(IterationLimits)
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
    return -(-(extended + EXTRA_TAPS) // ROW_MULTIPLE) * ROW_MULTIPLE


def refine_points(images: Images, starts: Starts, options: RefinementOptions) -> Results:
    """Refine every corner of `starts` on the maps of `images`.

    Points whose window is not usable keep zeros and `Status.INVALID`.
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
    limits = _Limits(*astuple(ITERATION_LIMITS))
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
