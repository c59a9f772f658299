"""The compiled refinement of many points: Gauss-Newton with robust and structure weights.

One point at a time, all channels.
"""

from __future__ import annotations

from typing import Final, NamedTuple, get_type_hints

import numpy as np
from numba import typeof, types

from pcwlad_geo.matching.kernels.compiled import Apart, compiled, compiled_apart, compiled_part
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
    make_workspace,
    move,
    plain_step,
    sandwich,
)
from pcwlad_geo.types import Float32, Float64


class Parts(NamedTuple):
    """What `refine_points` calls by address for every channel: fewer lines are compiled at a time."""

    load: Apart
    correlate: Apart
    add_channel: Apart


NEAR_PX: Final = 0.1
"""Length below which the last move but one must be, as a single short move may be chance."""


@compiled()
def refine_points(
    images: Images, starts: Starts, options: Options, work: Workspace, results: Results, parts: Parts
) -> None:
    """Refine every corner of `starts` on the maps of `images` and fill `results`; `work` is scratch memory.

    Points whose window is not usable keep zeros and the status `INVALID`. `options` are the settings;
    `parts` are `PARTS`.
    """
    reach = options.half + options.correlation_half
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
        results.status[p] = _refine_point(images, starts, p, options, work, results, parts)


@compiled_part()
def _valid_share(
    images: Images, shift_xy: Float64, row: int, col: int, options: Options, valid: Float32
) -> float:
    """Fill the flat window of validity in both images and return the share of valid pixels."""
    side = 2 * options.half + 1
    rows, cols = images.target_valid.shape
    top, left = row - options.half, col - options.half
    down, right = int(np.round(shift_xy[1])), int(np.round(shift_xy[0]))
    valid[:] = np.float32(0.0)
    good = 0
    for r in range(max(0, -top - down), min(side, rows - top - down)):
        for c in range(max(0, -left - right), min(side, cols - left - right)):
            here = images.reference_valid[np.uintp(top + r), np.uintp(left + c)]
            both = here & images.target_valid[np.uintp(top + down + r), np.uintp(left + right + c)]
            valid[np.uintp(r * options.width + c)] = np.float32(both)
            good += both
    return float(good / (side * side))


_FLAT, _PLANE, _NUMBERS, _MATRIX = (
    types.float32[::1],
    types.float32[:, ::1],
    types.float64[::1],
    types.float64[:, ::1],
)
_FLAG, _INT = types.boolean, types.int64


@compiled_apart(
    _FLAG(_PLANE, _PLANE, _INT, _INT, _NUMBERS, _MATRIX, *3 * (_FLAG,), _INT, _INT, *8 * (_FLAT,))
)
def _load(
    plane: Float32,
    image: Float32,
    row: int,
    col: int,
    shift: Float64,
    linear: Float64,
    deformed: bool,
    first: bool,
    looks: bool,
    reach: int,
    width: int,
    coefficients: Float32,
    along: Float32,
    along_slope: Float32,
    steps: Float32,
    reference: Float32,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
) -> bool:
    """Sample the target's extended window; return False if it leaves the image.

    The gradient is sampled too unless `looks`, that is, unless only the mutual structure is computed. The
    window of the reference, which stays the same, is copied at the first call.
    """
    side = 2 * reach + 1
    if first:
        load_window(image, row - reach, col - reach, side, side, width, reference)
    if deformed:
        y, x = row + shift[1], col + shift[0]
        return bool(sample_deformed(plane, y, x, linear, side, width, steps, value, slope_x, slope_y))
    top, left = row - reach + shift[1], col - reach + shift[0]
    if looks:
        return bool(sample_values(plane, top, left, side, width, coefficients, along, value))
    sampled = along_slope, value, slope_x, slope_y
    return bool(sample_shift(plane, top, left, side, width, coefficients, along, *sampled))


@compiled_apart(types.void(_FLAG, _INT, _INT, _INT, *11 * (_FLAT,)))
def _correlate(
    first: bool,
    half: int,
    correlation_half: int,
    width: int,
    reference: Float32,
    value: Float32,
    columns: Float32,
    sum_1: Float32,
    sum_11: Float32,
    sum_12: Float32,
    means: Float32,
    mean: Float32,
    precision: Float32,
    valid: Float32,
    structure: Float32,
) -> None:
    """Fill the mutual structure of a channel: the squared positive local correlation of both windows.

    The local mean and precision of the reference stay the same and are computed at the first call.
    """
    size = 2 * correlation_half + 1
    side = 2 * half + 1
    n = side * width
    how = side + size - 1, width, size, columns
    sums = sum_1, sum_11, sum_12
    if first:
        column_sums(reference, reference, *how, *sums)
        local_moments(sum_1, sum_11, n, size, means, mean, precision)
    column_sums(value, reference, *how, *sums)
    correlate(*sums, mean, precision, valid, structure, n, size, means)


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
    images: Images,
    starts: Starts,
    p: int,
    options: Options,
    work: Workspace,
    results: Results,
    parts: Parts,
) -> int:
    """Iterate until the shift converges; the last equations give the covariance. Return the status."""
    row, col = starts.corners_rc[p]
    half, correlation_half, width = options.half, options.correlation_half, options.width
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
    # structure that is fixed is computed at its own position first
    begin = -1 if options.structure_mode == STRUCTURE_FIXED else 0
    for iteration in range(begin, options.iterations):
        first, looks, before_px = iteration == begin, iteration < 0, length
        near = before_px < NEAR_PX
        place = starts.structure_xy[p] if looks else shift
        correlates = looks or options.structure_mode == STRUCTURE_FOLLOWS
        work.total[:] = 0.0
        work.total_right[:] = 0.0
        work.scores[:] = 0.0
        for k in range(images.reference.shape[0]):
            window = work.reference[k], work.value, work.slope_x, work.slope_y
            structure = work.structure[k]
            if not parts.load(
                images.coefficients[k],
                images.reference[k],
                row,
                col,
                place,
                linear,
                deformed,
                first,
                looks,
                half + correlation_half,
                width,
                work.coefficients,
                work.along,
                work.along_slope,
                work.steps,
                *window,
            ):
                return DIVERGED
            if correlates:
                sums = work.columns, work.sum_1, work.sum_11, work.sum_12, work.means
                known = work.mean[k], work.precision[k], work.valid
                parts.correlate(first, half, correlation_half, width, *window[:2], *sums, *known, structure)
            if not looks:
                # a single map may be inverted as a whole; an inverted one of several shows other structure
                inverted_too = work.structure.shape[0] == 1
                parts.add_channel(
                    near,
                    inverted_too,
                    options.robust,
                    half,
                    correlation_half,
                    width,
                    options.blocks,
                    *window,
                    structure,
                    work.weight,
                    work.columns,
                    work.monomials,
                    work.moments,
                    work.fit,
                    work.total,
                    work.total_right,
                    work.scores,
                )
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


@compiled_apart(
    types.void(*3 * (_FLAG,), *4 * (_INT,), *7 * (_FLAT,), _PLANE, *3 * (_MATRIX,), _NUMBERS, _MATRIX)
)
def _add_channel(
    scored: bool,
    inverted_too: bool,
    robust: bool,
    half: int,
    correlation_half: int,
    width: int,
    blocks: int,
    reference: Float32,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
    structure: Float32,
    product: Float32,
    columns: Float32,
    monomials: Float32,
    moments: Float64,
    fit: Float64,
    total: Float64,
    total_right: Float64,
    scores: Float64,
) -> None:
    """Add the equations and the scores of a channel, unless its window is flat."""
    side = 2 * half + 1
    n = side * width
    first = correlation_half * (width + 1)
    value, reference = value[first:], reference[first:]
    slope_x, slope_y = slope_x[first:], slope_y[first:]
    h0, h1, known = fit_gain(structure, value, reference, n)
    if known <= 0.0:
        return
    offset, gain, per_sigma = np.float32(h0), np.float32(h1), np.float32(0.0)
    if robust:
        deviation = sum_of_deviations(structure, value, reference, offset, gain, n) / known
        per_sigma = np.float32(1.0 / max(SIGMA_PER_MEAN_DEVIATION * deviation, 1e-9))
    window = value, reference, slope_x, slope_y, offset, gain, per_sigma
    for k in range(moments.shape[0]):
        weight = structure
        if k > 0:
            weight = product
            _multiply(structure, monomials[k - 1], n, weight)
        weighted_moments(weight, *window, n, moments[k])
    refitted, variance = add_equations(moments, float(gain), inverted_too, total, total_right, fit)
    if variance > 0.0 and scored:
        lattice = side, width, blocks, columns
        add_block_scores(structure, *window, fit, refitted / variance, *lattice, scores)


@compiled_part(fastmath=True)
def _multiply(first: Float32, second: Float32, n: int, out: Float32) -> None:
    for i in range(n):
        out[i] = first[i] * second[i]


@compiled_part()
def _any(linear: Float64) -> bool:
    return bool(linear[0, 0] != 0.0 or linear[0, 1] != 0.0 or linear[1, 0] != 0.0 or linear[1, 1] != 0.0)


PARTS: Final = Parts(_load, _correlate, _add_channel)
"""The last argument of `refine_points`."""


def compile_refinement() -> None:
    """Compile `refine_points` or load it, without its `PARTS`."""
    options = Options(*(kind() for kind in get_type_hints(Options).values()))
    plane, valid, none = np.zeros((1, 1, 1), np.float32), np.zeros((1, 1), bool), np.zeros((0, 2))
    linear, whole = np.zeros((0, 2, 2)), np.zeros(0, np.int64)
    images, starts = Images(plane, plane, valid, valid), Starts(whole[:, None], none, linear, none, plane)
    results = Results(none, linear, linear, whole)
    arguments = images, starts, options, make_workspace(1, options), results, PARTS
    refine_points.compile(tuple(map(typeof, arguments)))  # type: ignore[attr-defined]
