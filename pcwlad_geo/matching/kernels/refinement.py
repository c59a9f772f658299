"""The compiled refinement of many points: Gauss-Newton with robust and structure weights.

One point at a time, all channels.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from pcwlad_geo.matching.kernels.compiled import compiled, compiled_part
from pcwlad_geo.matching.kernels.equations import (
    SIGMA_PER_MEAN_DEVIATION,
    add_block_scores,
    add_equations,
    column_sums,
    correlate,
    fit_gain,
    local_moments,
    sum_of_deviations,
    weighted_moments,
)
from pcwlad_geo.matching.kernels.sampling import (
    load_window,
    sample_deformed,
    sample_shift,
    sample_values,
)
from pcwlad_geo.matching.kernels.steps import (
    CONVERGED,
    DIVERGED,
    INVALID,
    MIN_SLOPE,
    NOT_CONVERGED,
    PATIENCE,
    STRUCTURE_FIXED,
    STRUCTURE_FOLLOWS,
    STRUCTURE_GIVEN,
    STRUCTURE_NONE,
    UNDETERMINED,
    Images,
    Options,
    Results,
    Starts,
    Workspace,
    invert,
    is_determined,
    learn_slopes,
    move,
    plain_step,
    sandwich,
)
from pcwlad_geo.types import Float32, Float64

NEAR_PX: Final = 0.1
"""Length below which the last move but one must be, as a single short move may be chance."""


@compiled()
def refine_points(
    images: Images, starts: Starts, options: Options, work: Workspace, results: Results
) -> None:
    """Refine every corner of `starts` on the maps of `images` and fill `results`; `work` is scratch memory.

    Points whose window is not usable keep zeros and the status `INVALID`. `options` are the settings.
    """
    reach = options.step * (options.half + options.correlation_half)
    for p in range(starts.corners_rc.shape[0]):
        row, col = starts.corners_rc[p]
        results.status[p] = INVALID
        if min(row, col) < reach:
            continue
        if row + reach >= images.reference.shape[1] or col + reach >= images.reference.shape[2]:
            continue
        if _valid_share(images, starts.shift_xy[p], row, col, options, work.valid) < options.least_valid:
            continue
        if options.structure_mode == STRUCTURE_NONE or options.structure_mode == STRUCTURE_GIVEN:
            _set_structure(starts, p, options, work)
        results.status[p] = _refine_point(images, starts, p, options, work, results)


@compiled_part()
def _valid_share(
    images: Images, shift_xy: Float64, row: int, col: int, options: Options, valid: Float32
) -> float:
    """Fill the flat window of validity in both images and return the share of valid pixels."""
    side, step = 2 * options.half + 1, options.step
    rows, cols = images.target_valid.shape
    top, left = row - step * options.half, col - step * options.half
    down, right = int(np.round(shift_xy[1])), int(np.round(shift_xy[0]))
    valid[:] = np.float32(0.0)
    good = 0
    for r in range(max(0, -((top + down) // step)), min(side, (rows - 1 - top - down) // step + 1)):
        y = top + step * r
        for c in range(max(0, -((left + right) // step)), min(side, (cols - 1 - left - right) // step + 1)):
            x = left + step * c
            here = images.reference_valid[np.uintp(y), np.uintp(x)]
            both = here & images.target_valid[np.uintp(y + down), np.uintp(x + right)]
            valid[np.uintp(r * options.width + c)] = np.float32(both)
            good += both
    return float(good / (side * side))


@compiled_part(inline=True)
def _load(
    images: Images,
    channel: int,
    row: int,
    col: int,
    shift: Float64,
    linear: Float64,
    deformed: bool,
    first: bool,
    looks: bool,
    options: Options,
    work: Workspace,
) -> bool:
    """Sample the target's extended window; return False if it leaves the image.

    The gradient is sampled too unless `looks`, that is, unless only the mutual structure is computed. The
    window of the reference, which stays the same, is copied at the first call.
    """
    side, step = 2 * (options.half + options.correlation_half) + 1, options.step
    reach = step * (side // 2)
    plane = images.coefficients[channel]
    if first:
        reference = images.reference[channel]
        load_window(reference, row - reach, col - reach, side, step, options.width, work.reference[channel])
    if deformed:
        return bool(
            sample_deformed(
                plane,
                row + shift[1],
                col + shift[0],
                linear,
                side,
                step,
                options.width,
                work.steps,
                work.value,
                work.slope_x,
                work.slope_y,
            )
        )
    top, left = row - reach + shift[1], col - reach + shift[0]
    coefficients, along = work.coefficients, work.along
    if looks:
        return bool(
            sample_values(plane, top, left, side, step, options.width, coefficients, along, work.value)
        )
    sampled = (work.along_slope, work.value, work.slope_x, work.slope_y)
    return bool(sample_shift(plane, top, left, side, step, options.width, coefficients, along, *sampled))


@compiled_part(inline=True)
def _correlate(channel: int, first: bool, options: Options, work: Workspace) -> None:
    """Fill the mutual structure of a channel: the squared positive local correlation of both windows.

    The local mean and precision of the reference stay the same and are computed at the first call.
    """
    size = 2 * options.correlation_half + 1
    side = 2 * options.half + 1
    n = side * options.width
    reference = work.reference[channel]
    how = side + size - 1, options.width, size, work.columns
    sums = work.sum_1, work.sum_11, work.sum_12
    if first:
        column_sums(reference, reference, *how, *sums)
        mean, precision = work.mean[channel], work.precision[channel]
        local_moments(work.sum_1, work.sum_11, n, size, work.means, mean, precision)
    column_sums(work.value, reference, *how, *sums)
    known = work.mean[channel], work.precision[channel], work.valid
    correlate(*sums, *known, work.structure[channel], n, size, work.means)


@compiled_part(inline=True)
def _set_structure(starts: Starts, p: int, options: Options, work: Workspace) -> None:
    """Fill weights that are not computed from the images: 1, or the given structure; 0 where not valid."""
    side = 2 * options.half + 1
    for k in range(work.structure.shape[0]):
        structure = work.structure[k]
        for i in range(len(structure)):
            structure[i] = work.valid[i]
        if options.structure_mode == STRUCTURE_GIVEN:
            for r in range(side):
                for c in range(side):
                    structure[r * options.width + c] *= starts.structure[p, r, c]


@compiled_part(inline=True)
def _refine_point(
    images: Images, starts: Starts, p: int, options: Options, work: Workspace, results: Results
) -> int:
    """Iterate until the shift converges; the last equations give the covariance. Return the status."""
    row, col = starts.corners_rc[p]
    deformed = options.affine or _any(starts.linear[p])
    shift, linear = results.shift_xy[p], results.linear[p]
    for axis in range(2):
        shift[axis] = starts.shift_xy[p, axis]
        for other in range(2):
            linear[axis, other] = starts.linear[p, axis, other]
    step, before, moved, slopes = work.step, work.before, work.moved, work.slopes
    slopes[0, 0] = slopes[1, 1] = 1.0 / options.relaxation
    slopes[0, 1] = slopes[1, 0] = 0.0
    length = options.reached_by_px
    # structure that is fixed is computed at its own position first, unless that is where the shift starts
    fixed, wanted = options.structure_mode == STRUCTURE_FIXED, starts.structure_xy[p]
    begin = -1 if fixed and (wanted[0] != shift[0] or wanted[1] != shift[1]) else 0
    for iteration in range(begin, options.iterations):
        first, looks, before_px = iteration == begin, iteration < 0, length
        near = before_px < NEAR_PX
        place = wanted if looks else shift
        correlates = options.structure_mode == STRUCTURE_FOLLOWS or (fixed and first)
        work.total[:] = 0.0
        work.total_right[:] = 0.0
        work.scores[:] = 0.0
        for k in range(images.reference.shape[0]):
            if not _load(images, k, row, col, place, linear, deformed, first, looks, options, work):
                return DIVERGED
            if correlates:
                _correlate(k, first, options, work)
            if not looks:
                _add_channel(k, near, options, work)
        if looks:
            continue
        if not invert(work.total):
            return DIVERGED
        plain_step(work.total, work.total_right, options.half, step, linear)
        if iteration > 0 and not options.affine:  # a deformation that moves too hides what the shift did
            learn_slopes(step, before, moved, iteration == 1, slopes)
        length = move(step, slopes, moved, shift)
        before[0], before[1] = step[0], step[1]
        if (
            np.hypot(shift[0] - starts.shift_xy[p, 0], shift[1] - starts.shift_xy[p, 1])
            > options.largest_move_px
        ):
            return DIVERGED
        # moves shrink faster and faster: the next one, which is left out, by the same ratio at least
        if near and length * min(length / before_px, 1.0) < options.tolerance_px:
            sandwich(work.total, work.scores, results.covariance[p])
            return CONVERGED if is_determined(slopes, MIN_SLOPE) else UNDETERMINED
        if iteration >= PATIENCE and not is_determined(slopes, MIN_SLOPE / 2):
            return UNDETERMINED
    return NOT_CONVERGED


@compiled_part(inline=True)
def _add_channel(channel: int, scored: bool, options: Options, work: Workspace) -> None:
    """Add the equations and the scores of a channel, unless its window is flat."""
    structure = work.structure[channel]
    # a single map may be inverted as a whole; an inverted channel of several shows other structure
    inverted_too = work.structure.shape[0] == 1
    side, width = 2 * options.half + 1, options.width
    n = side * width
    first = options.correlation_half * (width + 1)
    value, reference = work.value[first:], work.reference[channel, first:]
    slope_x, slope_y = work.slope_x[first:], work.slope_y[first:]
    h0, h1, known = fit_gain(structure, value, reference, n)
    if known <= 0.0:
        return
    offset, gain, per_sigma = np.float32(h0), np.float32(h1), np.float32(0.0)
    if options.robust:
        deviation = sum_of_deviations(structure, value, reference, offset, gain, n) / known
        per_sigma = np.float32(1.0 / max(SIGMA_PER_MEAN_DEVIATION * deviation, 1e-9))
    window = value, reference, slope_x, slope_y, offset, gain, per_sigma
    for k in range(work.moments.shape[0]):
        weight = structure
        if k > 0:
            weight = work.weight
            _multiply(structure, work.monomials[k - 1], n, weight)
        weighted_moments(weight, *window, n, work.moments[k])
    refitted, variance = add_equations(
        work.moments, float(gain), inverted_too, work.total, work.total_right, work.fit
    )
    if variance > 0.0 and scored:
        lattice = side, width, options.blocks, work.columns
        add_block_scores(structure, *window, work.fit, refitted / variance, *lattice, work.scores)


@compiled_part(fastmath=True)
def _multiply(first: Float32, second: Float32, n: int, out: Float32) -> None:
    for i in range(n):
        out[i] = first[i] * second[i]


@compiled_part()
def _any(linear: Float64) -> bool:
    return bool(linear[0, 0] != 0.0 or linear[0, 1] != 0.0 or linear[1, 0] != 0.0 or linear[1, 1] != 0.0)
