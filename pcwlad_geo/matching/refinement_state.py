"""What the compiled refinement works on: images, starts, options, results and scratch memory.

Named tuples, since those are what compiled functions take.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.refinement_equations import MOMENTS
from pcwlad_geo.matching.refinement_sampling import LANES, TAPS_BEYOND, Float32, Float64

STRUCTURE_NONE: Final = 0
STRUCTURE_FOLLOWS: Final = 1
STRUCTURE_FIXED: Final = 2
STRUCTURE_GIVEN: Final = 3

CONVERGED: Final = 0
NOT_CONVERGED: Final = 1
INVALID: Final = 2
DIVERGED: Final = 3
UNDETERMINED: Final = 4

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
    width: int
    """Numbers in a row of a flat window, padding included."""
    structure_mode: int
    robust: bool
    affine: bool
    iterations: int
    reached_by_px: float
    """Length of the move that has led to the start."""
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
    """Scratch memory of one point: flat windows of one channel or, with a first axis, of all."""

    coefficients: Float32
    along: Float32
    along_slope: Float32
    value: Float32
    slope_x: Float32
    slope_y: Float32
    reference: Float32
    sum_1: Float32
    sum_11: Float32
    sum_12: Float32
    means: Float32
    columns: Float32
    steps: Float32
    """0, 1, 2, …"""
    mean: Float32
    precision: Float32
    structure: Float32
    weight: Float32
    valid: Float32
    monomials: Float32
    """x, y, x², xy, y² of the window's pixels, in half windows."""
    moments: Float64
    fit: Float64
    total: Float64
    total_right: Float64
    scores: Float64
    step: Float64
    before: Float64
    moved: Float64
    slopes: Float64


def flat_width(extended: int) -> int:
    """Return the length of a row of a flat window: whole vectors, taps of the spline included."""
    return -(-(extended + TAPS_BEYOND) // LANES) * LANES


def make_workspace(channels: int, options: Options) -> Workspace:
    """Allocate the scratch memory that `refine_points` uses for one point after the other."""
    side = 2 * options.half + 1
    extended = side + 2 * options.correlation_half
    count = 3 if options.affine else 1

    def flat(rows: int) -> Float32:
        # loops over whole windows look a little beyond the last row
        return np.zeros(rows * options.width + 2 * options.width, np.float32)

    def stack(many: int) -> Float32:
        return np.zeros((many, side * options.width), np.float32)

    return Workspace(
        coefficients=flat(extended + TAPS_BEYOND),
        along=flat(extended + TAPS_BEYOND),
        along_slope=flat(extended + TAPS_BEYOND),
        value=flat(extended),
        slope_x=flat(extended),
        slope_y=flat(extended),
        reference=np.zeros((channels, (extended + 2) * options.width), np.float32),
        sum_1=flat(side),
        sum_11=flat(side),
        sum_12=flat(side),
        means=flat(3 * side),
        columns=np.zeros(3 * options.width, np.float32),
        steps=np.arange(options.width, dtype=np.float32),
        mean=stack(channels),
        precision=stack(channels),
        structure=stack(channels),
        weight=flat(side),
        valid=flat(side),
        monomials=_monomials(options) if options.affine else np.zeros((0, 1), np.float32),
        moments=np.zeros((6 if options.affine else 1, MOMENTS)),
        fit=np.zeros((3, 2)),
        total=np.zeros((2 * count, 2 * count)),
        total_right=np.zeros(2 * count),
        scores=np.zeros((options.blocks**2, 2)),
        step=np.zeros(2),
        before=np.zeros(2),
        moved=np.zeros(2),
        slopes=np.zeros((2, 2)),
    )


def _monomials(options: Options) -> Float32:
    """Return x, y, x², xy, y² of a flat window's pixels, (5, side · width)."""
    step = np.arange(-options.half, options.half + 1) / options.half
    x = np.zeros((len(step), options.width))
    y = np.zeros((len(step), options.width))
    x[:, : len(step)], y[:, : len(step)] = step, step[:, None]
    return np.stack([x, y, x * x, x * y, y * y]).astype(np.float32).reshape(5, -1)
