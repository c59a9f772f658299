"""Compiled steps of the refinement, from normal equations to moves, and the types it works on."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.kernels.compiled import compiled_part
from pcwlad_geo.matching.kernels.equations import MOMENTS
from pcwlad_geo.matching.kernels.sampling import LANES, TAPS_BEYOND
from pcwlad_geo.types import Bool, Float32, Float64

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
NOT_CONVERGED: Final = 1
"""Status of a point: the iterations ended before the shift converged."""
INVALID: Final = 2
"""Status of a point: its window leaves the image or has too few valid pixels."""
DIVERGED: Final = 3
"""Status of a point: it moved too far or out of the image, or its equations are singular."""
UNDETERMINED: Final = 4
"""Status of a point: plain steps hardly shrink on the way, so that the position is not determined."""

Int64 = NDArray[np.int64]


class Images(NamedTuple):
    """Maps of both images, those of the target as spline coefficients."""

    reference: Float32
    """(channels, rows, cols)."""
    coefficients: Float32
    """(channels, rows, cols)."""
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
    """(n, window, window), or (1, 1, 1) where it is not given."""


class RefinementOptions(NamedTuple):
    """Settings of the refinement; see `refinement.refine`."""

    half: int
    """Half side of the window, in pixels that are `step` apart."""
    step: int
    """1 for all pixels of the window, 2 for every second one of its rows and columns."""
    correlation_half: int
    width: int
    """Number of values in a row of a flat window, padding included."""
    structure_mode: int
    robust: bool
    affine: bool
    iterations: int
    reached_by_px: float
    """Length of the move that led to the start."""
    tolerance_px: float
    relaxation: float
    least_valid: float
    largest_move_px: float
    blocks: int


class Results(NamedTuple):
    """Results of n points, filled in by `refine_points`; see `refinement.Refined`."""

    shift_xy: Float64
    """(n, 2) px."""
    linear: Float64
    """(n, 2, 2)."""
    covariance: Float64
    """(n, 2, 2) px²."""
    status: Int64
    """(n,) `CONVERGED`, or why not."""


class Workspace(NamedTuple):
    """Scratch memory of one point: flat windows of one channel or, with a first axis, of all.

    `make_workspace` sets the shapes.
    """

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
    """Return the number of values in a row of a flat window: whole vectors, taps of the spline included."""
    return -(-(extended + TAPS_BEYOND) // LANES) * LANES


def make_workspace(channels: int, options: RefinementOptions) -> Workspace:
    """Allocate the memory that `refine_points` reuses for every point, for `channels` and `options`."""
    side = 2 * options.half + 1
    extended = side + 2 * options.correlation_half
    count = 3 if options.affine else 1

    def flat(rows: int) -> Float32:
        # loops over whole windows read a little beyond the last row
        return np.zeros(rows * options.width + 2 * options.width, np.float32)

    def stack(many: int) -> Float32:
        return np.zeros((many, side * options.width), np.float32)

    taps = extended + TAPS_BEYOND
    return Workspace(
        coefficients=flat(taps * options.step**2),
        along=flat(taps * options.step),
        along_slope=flat(taps * options.step),
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


def _monomials(options: RefinementOptions) -> Float32:
    """Return x, y, x², xy, y² of a flat window's pixels, (5, side · width)."""
    step = np.arange(-options.half, options.half + 1) / options.half
    x = np.zeros((len(step), options.width))
    y = np.zeros((len(step), options.width))
    x[:, : len(step)], y[:, : len(step)] = step, step[:, None]
    return np.stack([x, y, x * x, x * y, y * y]).astype(np.float32).reshape(5, -1)


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


@compiled_part()
def invert(matrix: Float64) -> bool:
    """Invert the (n, n) positive definite `matrix` in place (Gauss-Jordan); return False if it is not."""
    n = matrix.shape[0]
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > 0.0:
            return False
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] /= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]
    return True


@compiled_part()
def plain_step(inverse: Float64, right: Float64, half: int, step: Float64, linear: Float64) -> None:
    """Fill in the plain Gauss-Newton step of the shift, and add that of the deformation.

    The (k, k) `inverse` normal matrix and the (k,) right side `right` are those of `equations.add_equations`;
    the window is 2 `half` + 1 px wide. The (2,) `step` (col, row) is filled, px, and the (2, 2) deformation
    `linear` changed in place.
    """
    count = len(right) // 2
    for axis in range(2):
        step[axis] = _dot(inverse[axis * count], right)
        for k in range(1, count):
            linear[axis, k - 1] += _dot(inverse[axis * count + k], right) / half


@compiled_part()
def learn_slopes(step: Float64, before: Float64, moved: Float64, first: bool, slopes: Float64) -> None:
    """Update the slopes of the plain step from the last move (Broyden's update).

    The (2,) arrays `step`, `before` and `moved` (col, row) are the plain step now, that before the move, and
    the move, px. The `first` move gives one slope for all directions, later ones their own. The (2, 2)
    `slopes`, minus the derivative of the plain step by the shift, are changed in place.
    """
    length2 = moved[0] ** 2 + moved[1] ** 2
    if length2 == 0.0:
        return
    if first:
        slope = ((before[0] - step[0]) * moved[0] + (before[1] - step[1]) * moved[1]) / length2
        slopes[0, 0] = slopes[1, 1] = min(max(slope, 1.0 / LARGEST_RELAXATION), 1.0)
    for axis in range(2):
        error = before[axis] - step[axis] - slopes[axis, 0] * moved[0] - slopes[axis, 1] * moved[1]
        slopes[axis, 0] += error * moved[0] / length2
        slopes[axis, 1] += error * moved[1] / length2


@compiled_part()
def move(step: Float64, slopes: Float64, moved: Float64, shift: Float64) -> float:
    """Move the shift to where the plain step is expected to vanish; return how long the move would be, px.

    For the (2,) plain `step` (col, row), px, and the (2, 2) `slopes` of `learn_slopes`, the (2,) `moved` is
    filled with the move, at most `LONGEST_STEP_PX` long, and the (2,) `shift` moved in place.
    """
    determinant = slopes[0, 0] * slopes[1, 1] - slopes[0, 1] * slopes[1, 0]
    x, y = step[0], step[1]
    if determinant > 0.0:
        x = (slopes[1, 1] * step[0] - slopes[0, 1] * step[1]) / determinant
        y = (slopes[0, 0] * step[1] - slopes[1, 0] * step[0]) / determinant
    if x * step[0] + y * step[1] <= 0.0:
        x, y = step[0], step[1]
    length = float(np.hypot(x, y))
    longest = LARGEST_RELAXATION * float(np.hypot(step[0], step[1]))
    if length > longest:
        x, y, length = x * longest / length, y * longest / length, longest
    limit = max(length / LONGEST_STEP_PX, 1.0)
    moved[0], moved[1] = x / limit, y / limit
    shift[0] += moved[0]
    shift[1] += moved[1]
    return length


@compiled_part()
def is_determined(slopes: Float64, least: float) -> bool:
    """Return whether the symmetric part of the (2, 2) `slopes` has no eigenvalue below `least`."""
    mean, half_difference = (slopes[0, 0] + slopes[1, 1]) / 2.0, (slopes[0, 0] - slopes[1, 1]) / 2.0
    smaller = mean - np.hypot(half_difference, (slopes[0, 1] + slopes[1, 0]) / 2.0)
    return bool(smaller >= least)


@compiled_part()
def _dot(first: Float64, second: Float64) -> float:
    total = 0.0
    for k in range(len(first)):
        total += first[k] * second[k]
    return total


@compiled_part()
def sandwich(inverse: Float64, scores: Float64, covariance: Float64) -> None:
    """Fill the sandwich covariance of the shift: the scatter of the blocks' scores between two inverses.

    They are the (k, k) `inverse` normal matrix and the (blocks * blocks, 2) `scores` of
    `equations.add_block_scores`; the (2, 2) `covariance` is filled, px².
    """
    other = inverse.shape[0] // 2
    covariance[:] = 0.0
    for block in range(scores.shape[0]):
        x = inverse[0, 0] * scores[block, 0] + inverse[0, other] * scores[block, 1]
        y = inverse[other, 0] * scores[block, 0] + inverse[other, other] * scores[block, 1]
        covariance[0, 0] += x * x
        covariance[0, 1] += x * y
        covariance[1, 0] += x * y
        covariance[1, 1] += y * y
