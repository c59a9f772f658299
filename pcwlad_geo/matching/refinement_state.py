"""What the compiled refinement works on: images, starts, options, results and scratch memory.

Named tuples, since those are what compiled functions take.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.refinement_kernel import Float32, Float64

STRUCTURE_NONE: Final = 0
STRUCTURE_FOLLOWS: Final = 1
STRUCTURE_FIXED: Final = 2
STRUCTURE_GIVEN: Final = 3

CONVERGED: Final = 0
NOT_CONVERGED: Final = 1
INVALID: Final = 2
DIVERGED: Final = 3

Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]


class Images(NamedTuple):
    """Maps of both images; the target's as spline coefficients. (channels, rows, cols) and (rows, cols)."""

    reference: Float32
    coefficients: Float32
    reference_valid: Bool
    target_valid: Bool


class Starts(NamedTuple):
    """Where n points begin; see `refinement.Start`. `structure` has one row at least."""

    corners_rc: Int64
    shift_xy: Float64
    linear: Float64
    structure_xy: Float64
    structure: Float32


class Options(NamedTuple):
    """Settings of the refinement; see `refinement.refine`."""

    half: int
    correlation_half: int
    structure_mode: int
    robust: bool
    affine: bool
    iterations: int
    tolerance_px: float
    relaxation: float
    least_valid: float
    largest_move_px: float
    blocks: int


class Results(NamedTuple):
    """Filled by `refine_points`: (n, 2), (n, 2, 2), (n, 2, 2), (n,)."""

    shift_xy: Float64
    linear: Float64
    covariance: Float64
    status: Int64


class Workspace(NamedTuple):
    """Scratch memory of one point: extended windows, then windows, then the equations."""

    value: Float32
    slope_x: Float32
    slope_y: Float32
    product: Float32
    along: Float32
    along_slope: Float32
    columns: Float32
    mean_r: Float32
    var_r: Float32
    mean_s: Float32
    mean_ss: Float32
    mean_rs: Float32
    structure: Float32
    weight: Float32
    valid: Float32
    matrix: Float64
    right: Float64
    total: Float64
    total_right: Float64
    scores: Float64


def make_workspace(channels: int, options: Options) -> Workspace:
    """Allocate the scratch memory that `refine_points` uses for one point after the other."""
    side = 2 * options.half + 1
    extended = side + 2 * options.correlation_half
    count = 6 if options.affine else 2
    window, plane, stack = (extended, extended), (side, side), (channels, side, side)

    def empty(shape: tuple[int, ...]) -> Float32:
        return np.empty(shape, np.float32)

    return Workspace(
        value=empty(window),
        slope_x=empty(window),
        slope_y=empty(window),
        product=empty(window),
        along=empty((extended + 3, extended)),
        along_slope=empty((extended + 3, extended)),
        columns=empty((extended,)),
        mean_r=empty(stack),
        var_r=empty(stack),
        mean_s=empty(plane),
        mean_ss=empty(plane),
        mean_rs=empty(plane),
        structure=empty(stack),
        weight=empty(plane),
        valid=empty(plane),
        matrix=np.zeros((count, count)),
        right=np.zeros(count),
        total=np.zeros((count, count)),
        total_right=np.zeros(count),
        scores=np.zeros((options.blocks**2, 2)),
    )
