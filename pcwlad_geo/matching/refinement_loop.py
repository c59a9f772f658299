"""The compiled refinement of many points: Gauss-Newton with robust and structure weights.

One point at a time, all channels; `refinement_plain` is the numpy twin.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from pcwlad_geo.matching.refinement_equations import add_block_scores, normal_equations
from pcwlad_geo.matching.refinement_kernel import (
    Float32,
    Float64,
    box_mean,
    fit_gain,
    local_correlation,
    robust_weights,
    sample_affine,
    sample_shift,
)
from pcwlad_geo.matching.refinement_state import (
    CONVERGED,
    DIVERGED,
    INVALID,
    NOT_CONVERGED,
    STRUCTURE_FIXED,
    STRUCTURE_FOLLOWS,
    STRUCTURE_GIVEN,
    Images,
    Options,
    Results,
    Starts,
    Workspace,
)

SIGMA_PER_MEAN_DEVIATION: Final = 1.2533
"""σ of a normal distribution over its mean absolute deviation."""
LONGEST_STEP_PX: Final = 1.0


@njit(cache=True, nogil=True)
def refine_points(
    images: Images, starts: Starts, options: Options, work: Workspace, results: Results
) -> None:
    """Refine every corner; points that could not be started keep zeros and the status INVALID."""
    reach = options.half + options.correlation_half
    for p in range(starts.corners_rc.shape[0]):
        row, col = starts.corners_rc[p]
        results.status[p] = INVALID
        if min(row, col) < reach:
            continue
        if row + reach >= images.reference.shape[1] or col + reach >= images.reference.shape[2]:
            continue
        if _valid_share(images, starts.shift_xy[p], row, col, work.valid) < options.least_valid:
            continue
        _reference_moments(images, row, col, options, work)
        if not _initial_structure(images, starts, p, options, work):
            continue
        results.status[p] = _refine_point(images, starts, p, options, work, results)


@njit(cache=True, nogil=True)
def _valid_share(images: Images, shift_xy: Float64, row: int, col: int, valid: Float32) -> float:
    """Fill the window of validity in both images; returns its mean."""
    side = valid.shape[0]
    half = side // 2
    rows, cols = images.target_valid.shape
    down, right = int(np.round(shift_xy[1])), int(np.round(shift_xy[0]))
    good = 0
    for r in range(side):
        for c in range(side):
            y, x = row - half + r, col - half + c
            inside = 0 <= y + down < rows and 0 <= x + right < cols
            both = inside and images.reference_valid[y, x] and images.target_valid[y + down, x + right]
            valid[r, c] = np.float32(1.0) if both else np.float32(0.0)
            good += 1 if both else 0
    return float(good / (side * side))


@njit(cache=True, nogil=True)
def _window(images: Images, channel: int, row: int, col: int, options: Options) -> Float32:
    """Return the reference's window of a channel, extended for the local correlation."""
    reach = options.half + options.correlation_half
    return images.reference[channel, row - reach : row + reach + 1, col - reach : col + reach + 1]


@njit(cache=True, nogil=True)
def _reference_moments(images: Images, row: int, col: int, options: Options, work: Workspace) -> None:
    """Fill local mean and variance of the reference, which stay the same at every step."""
    size = 2 * options.correlation_half + 1
    for k in range(images.reference.shape[0]):
        window = _window(images, k, row, col, options)
        mean, variance = work.mean_r[k], work.var_r[k]
        box_mean(window, size, mean, work.columns)
        for r in range(window.shape[0]):
            for c in range(window.shape[1]):
                work.product[r, c] = window[r, c] * window[r, c]
        box_mean(work.product, size, variance, work.columns)
        for r in range(mean.shape[0]):
            for c in range(mean.shape[1]):
                variance[r, c] = max(variance[r, c] - mean[r, c] * mean[r, c], np.float32(0.0))


@njit(cache=True, nogil=True)
def _sample(
    plane: Float32, row: int, col: int, dx: float, dy: float, linear: Float64, deformed: bool, work: Workspace
) -> bool:
    """Sample the target's extended window and its gradient; False if it sticks out."""
    side = work.value.shape[0]
    if deformed:
        return bool(
            sample_affine(plane, row + dy, col + dx, linear, side, work.value, work.slope_x, work.slope_y)
        )
    top, left = row - side // 2 + dy, col - side // 2 + dx
    return bool(
        sample_shift(
            plane, top, left, side, work.value, work.slope_x, work.slope_y, work.along, work.along_slope
        )
    )


@njit(cache=True, nogil=True)
def _correlate(images: Images, channel: int, row: int, col: int, options: Options, work: Workspace) -> None:
    """Fill the structure of a channel: squared positive local correlation with what was sampled."""
    size = 2 * options.correlation_half + 1
    structure = work.structure[channel]
    local_correlation(
        _window(images, channel, row, col, options),
        work.value,
        size,
        structure,
        work.product,
        work.mean_r[channel],
        work.var_r[channel],
        work.mean_s,
        work.mean_ss,
        work.mean_rs,
        work.columns,
    )
    for r in range(structure.shape[0]):
        for c in range(structure.shape[1]):
            structure[r, c] *= work.valid[r, c]


@njit(cache=True, nogil=True)
def _initial_structure(images: Images, starts: Starts, p: int, options: Options, work: Workspace) -> bool:
    """Fill the structure weights that stay for all steps; False if the window sticks out."""
    row, col = starts.corners_rc[p]
    deformed = options.affine or _any(starts.linear[p])
    for k in range(images.reference.shape[0]):
        if options.structure_mode == STRUCTURE_FIXED:
            dx, dy = starts.structure_xy[p]
            if not _sample(images.coefficients[k], row, col, dx, dy, starts.linear[p], deformed, work):
                return False
            _correlate(images, k, row, col, options, work)
            continue
        structure, given = work.structure[k], options.structure_mode == STRUCTURE_GIVEN
        for r in range(structure.shape[0]):
            for c in range(structure.shape[1]):
                structure[r, c] = work.valid[r, c] * (starts.structure[p, r, c] if given else np.float32(1.0))
    return True


@njit(cache=True, nogil=True)
def _refine_point(
    images: Images, starts: Starts, p: int, options: Options, work: Workspace, results: Results
) -> int:
    """Step until the shift stands still; one more pass gives the covariance there. Returns the status."""
    row, col = starts.corners_rc[p]
    deformed = options.affine or _any(starts.linear[p])
    shift, linear = results.shift_xy[p], results.linear[p]
    shift[:] = starts.shift_xy[p]
    linear[:] = starts.linear[p]
    status = NOT_CONVERGED
    for iteration in range(options.iterations + 1):
        final = status == CONVERGED or iteration == options.iterations
        if not _equations(images, row, col, shift, linear, deformed, final, options, work):
            return DIVERGED
        if not _invert(work.total):
            return DIVERGED
        if final:
            _sandwich(work.total, work.scores, results.covariance[p])
            return status
        length = _step(work.total, work.total_right, options, shift, linear)
        if (
            np.hypot(shift[0] - starts.shift_xy[p, 0], shift[1] - starts.shift_xy[p, 1])
            > options.largest_move_px
        ):
            return DIVERGED
        if length < options.tolerance_px:
            status = CONVERGED
    return status


@njit(cache=True, nogil=True)
def _equations(
    images: Images,
    row: int,
    col: int,
    shift: Float64,
    linear: Float64,
    deformed: bool,
    final: bool,
    options: Options,
    work: Workspace,
) -> bool:
    """Add up the normal equations of all channels; False if the window sticks out or none is usable."""
    channels, pad = images.reference.shape[0], options.correlation_half
    work.total[:] = 0.0
    work.total_right[:] = 0.0
    work.scores[:] = 0.0
    usable = 0
    for k in range(channels):
        if not _sample(images.coefficients[k], row, col, shift[0], shift[1], linear, deformed, work):
            return False
        if options.structure_mode == STRUCTURE_FOLLOWS:
            _correlate(images, k, row, col, options, work)
        window, structure = _window(images, k, row, col, options), work.structure[k]
        h0, h1, known = _weigh(window, structure, options, work)
        # an inverted channel of several shows other structure; a single map may be inverted as a whole
        if known <= 0.0 or (channels > 1 and h1 <= 0.0):
            continue
        variance = normal_equations(
            window,
            work.value,
            pad,
            work.slope_x,
            work.slope_y,
            work.weight,
            h0,
            h1,
            options.affine,
            work.matrix,
            work.right,
        )
        if variance <= 0.0:
            continue
        usable += 1
        for i in range(len(work.right)):
            work.total_right[i] += work.right[i] / variance
            for j in range(len(work.right)):
                work.total[i, j] += work.matrix[i, j] / variance
        if final:
            add_block_scores(
                window,
                work.value,
                pad,
                work.slope_x,
                work.slope_y,
                work.weight,
                h0,
                h1,
                variance,
                options.blocks,
                work.scores,
            )
    return usable > 0


@njit(cache=True, nogil=True)
def _weigh(
    window: Float32, structure: Float32, options: Options, work: Workspace
) -> tuple[float, float, float]:
    """Fill the weights of a channel; returns offset, gain and the sum of weights."""
    pad = options.correlation_half
    h0, h1, deviation, known = fit_gain(window, work.value, pad, structure)
    if not options.robust:
        work.weight[:] = structure
        return h0, h1, known
    if known <= 0.0:
        return h0, h1, known
    scale = SIGMA_PER_MEAN_DEVIATION * deviation
    robust_weights(window, work.value, pad, structure, h0, h1, scale, work.weight)
    h0, h1, _, known = fit_gain(window, work.value, pad, work.weight)
    return h0, h1, known


@njit(cache=True, nogil=True)
def _invert(matrix: Float64) -> bool:
    """Invert a positive definite matrix in place (Gauss-Jordan; no pivoting needed); False if it is not."""
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


@njit(cache=True, nogil=True)
def _step(inverse: Float64, right: Float64, options: Options, shift: Float64, linear: Float64) -> float:
    """Move shift and deformation in place; returns the length of the shift's step before it is limited."""
    count = len(right) // 2
    for axis in range(2):
        for k in range(1, count):
            linear[axis, k - 1] += _dot(inverse[axis * count + k], right) / options.half
    move_x = options.relaxation * _dot(inverse[0], right)
    move_y = options.relaxation * _dot(inverse[count], right)
    length = float(np.hypot(move_x, move_y))
    limit = max(length / LONGEST_STEP_PX, 1.0)
    shift[0] += move_x / limit
    shift[1] += move_y / limit
    return length


@njit(cache=True, nogil=True)
def _dot(first: Float64, second: Float64) -> float:
    total = 0.0
    for k in range(len(first)):
        total += first[k] * second[k]
    return total


@njit(cache=True, nogil=True)
def _any(linear: Float64) -> bool:
    return bool(linear[0, 0] != 0.0 or linear[0, 1] != 0.0 or linear[1, 0] != 0.0 or linear[1, 1] != 0.0)


@njit(cache=True, nogil=True)
def _sandwich(inverse: Float64, scores: Float64, covariance: Float64) -> None:
    """Fill the covariance of the shift: the scatter of the blocks' scores between two inverse matrices."""
    other = inverse.shape[0] // 2
    covariance[:] = 0.0
    for block in range(scores.shape[0]):
        x = inverse[0, 0] * scores[block, 0] + inverse[0, other] * scores[block, 1]
        y = inverse[other, 0] * scores[block, 0] + inverse[other, other] * scores[block, 1]
        covariance[0, 0] += x * x
        covariance[0, 1] += x * y
        covariance[1, 0] += x * y
        covariance[1, 1] += y * y
