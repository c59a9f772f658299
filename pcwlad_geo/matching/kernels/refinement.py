"""The compiled refinement of many points: Gauss-Newton with robust and structure weights.

One point at a time, all channels.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, get_type_hints

import numpy as np
from numba import typeof, types

from pcwlad_geo.matching.kernels.compiled import SeparateKernel, compiled, compiled_part, compiled_separately
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
from pcwlad_geo.matching.kernels.sampling import load_window, sample_deformed, sample_shift
from pcwlad_geo.matching.kernels.steps import (
    CONVERGED,
    DIVERGED,
    INVALID,
    MIN_SLOPE,
    NOT_CONVERGED,
    PATIENCE,
    SETTLED_AFTER,
    SETTLING_PX,
    STRUCTURE_FIXED,
    STRUCTURE_FOLLOWS,
    STRUCTURE_GIVEN,
    STRUCTURE_NONE,
    UNDETERMINED,
    Images,
    RefinementOptions,
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

    load: SeparateKernel
    correlate: SeparateKernel
    add_channel: SeparateKernel


NEAR_PX: Final = 0.1
"""Length below which the last move but one must be, as a single short move may be chance."""


@compiled()
def refine_points(
    images: Images,
    starts: Starts,
    options: RefinementOptions,
    work: Workspace,
    results: Results,
    parts: Parts,
) -> None:
    """Refine every corner of `starts` on the maps of `images` and fill `results`; `work` is scratch memory.

    Points whose window is not usable keep zeros and the status `INVALID`. `options` are the settings;
    `parts` are `PARTS`.
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
        results.status[p] = _refine_point(images, starts, p, options, work, results, parts)


@compiled_part()
def _valid_share(
    images: Images, shift_xy: Float64, row: int, col: int, options: RefinementOptions, valid: Float32
) -> float:
    """Fill the flat window of validity in both images and return the share of valid pixels."""
    side, step = 2 * options.half + 1, options.step
    rows, cols = images.target_valid.shape
    top, left = row - step * options.half, col - step * options.half
    down, right = int(np.rint(shift_xy[1])), int(np.rint(shift_xy[0]))
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


NO_OPTIONS: Final = RefinementOptions(*(kind() for kind in get_type_hints(RefinementOptions).values()))
"""All 0: their types are what counts."""
_FLAG, _INT, _OPTIONS = types.boolean, types.int64, typeof(NO_OPTIONS)  # type: ignore[no-untyped-call]
_FLAT, _PLANE = types.float32[::1], types.float32[:, ::1]
_NUMBERS, _MATRIX = types.float64[::1], types.float64[:, ::1]
_several: Any = types.Tuple
_FLATS_3, _FLATS_4, _MATRICES = _several(3 * (_FLAT,)), _several(4 * (_FLAT,)), _several(4 * (_MATRIX,))
_PLACE = _PLANE, _PLANE, _INT, _INT, _NUMBERS, _MATRIX, _FLAG, _FLAG
Flats = tuple[Float32, ...]


@compiled_separately(_FLAG(*_PLACE, _OPTIONS, _FLATS_4, _FLATS_4))
def _load(
    plane: Float32,
    image: Float32,
    row: int,
    col: int,
    shift: Float64,
    linear: Float64,
    deformed: bool,
    first: bool,
    options: RefinementOptions,
    scratch: Flats,
    window: Flats,
) -> bool:
    """Sample the target's extended window; return False if it leaves the image.

    The window of the reference, which stays the same, is copied at the first call. The gradient is sampled
    even where only the mutual structure is computed: a second way to sample took a second to compile.
    """
    coefficients, along, along_slope, steps = scratch
    width, step = options.width, options.step
    side = 2 * (options.half + options.correlation_half) + 1
    reach = step * (side // 2)
    if first:
        load_window(image, row - reach, col - reach, side, step, width, window[0])
    if deformed:
        y, x = row + shift[1], col + shift[0]
        return bool(sample_deformed(plane, y, x, linear, side, step, width, steps, *window[1:]))
    top, left = row - reach + shift[1], col - reach + shift[0]
    places = side, step, width, coefficients, along, along_slope
    return bool(sample_shift(plane, top, left, *places, *window[1:]))


@compiled_separately(types.void(_FLAG, _OPTIONS, _FLAT, _FLAT, _FLAT, _FLATS_4, _FLATS_4))
def _correlate(
    first: bool,
    options: RefinementOptions,
    value: Float32,
    reference: Float32,
    columns: Float32,
    sums: Flats,
    known: Flats,
) -> None:
    """Fill the mutual structure of a channel: the squared positive local correlation of both windows.

    The local mean and precision of the reference stay the same and are computed at the first call.
    """
    sum_1, sum_11, sum_12, means = sums
    mean, precision, valid, structure = known
    size = 2 * options.correlation_half + 1
    side = 2 * options.half + 1
    n = side * options.width
    how = side + size - 1, options.width, size, columns
    if first:
        column_sums(reference, reference, *how, sum_1, sum_11, sum_12)
        local_moments(sum_1, sum_11, n, size, means, mean, precision)
    column_sums(value, reference, *how, sum_1, sum_11, sum_12)
    correlate(sum_1, sum_11, sum_12, mean, precision, valid, structure, n, size, means)


@compiled_part(inline=True)
def _set_structure(starts: Starts, p: int, options: RefinementOptions, work: Workspace) -> None:
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
    options: RefinementOptions,
    work: Workspace,
    results: Results,
    parts: Parts,
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
        work.total[:] = 0.0
        work.total_right[:] = 0.0
        work.scores[:] = 0.0
        for k in range(images.reference.shape[0]):
            if not _measure(
                images, k, row, col, place, linear, deformed, first, looks, near, options, work, parts
            ):
                return DIVERGED
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
        if iteration >= SETTLED_AFTER and length > SETTLING_PX and not options.affine:
            return NOT_CONVERGED
        if iteration >= PATIENCE and not is_determined(slopes, MIN_SLOPE / 2):
            return UNDETERMINED
    return NOT_CONVERGED


@compiled_part(inline=True)
def _measure(
    images: Images,
    k: int,
    row: int,
    col: int,
    place: Float64,
    linear: Float64,
    deformed: bool,
    first: bool,
    looks: bool,
    near: bool,
    options: RefinementOptions,
    work: Workspace,
    parts: Parts,
) -> bool:
    """Sample a channel and add its equations unless `looks`; return False if it leaves the image."""
    scratch = work.coefficients, work.along, work.along_slope, work.steps
    window = work.reference[k], work.value, work.slope_x, work.slope_y
    planes = images.coefficients[k], images.reference[k]
    if not parts.load(*planes, row, col, place, linear, deformed, first, options, scratch, window):
        return False
    fixed = options.structure_mode == STRUCTURE_FIXED
    if options.structure_mode == STRUCTURE_FOLLOWS or (fixed and first):
        sums = work.sum_1, work.sum_11, work.sum_12, work.means
        known = work.mean[k], work.precision[k], work.valid, work.structure[k]
        parts.correlate(first, options, work.value, work.reference[k], work.columns, sums, known)
    if not looks:
        weights = work.structure[k], work.weight, work.columns
        equations = work.moments, work.fit, work.total, work.scores
        # a single map may be inverted as a whole; an inverted channel of several shows other structure
        inverted_too = work.structure.shape[0] == 1
        parts.add_channel(
            near, inverted_too, options, window, weights, work.monomials, equations, work.total_right
        )
    return True


@compiled_separately(types.void(_FLAG, _FLAG, _OPTIONS, _FLATS_4, _FLATS_3, _PLANE, _MATRICES, _NUMBERS))
def _add_channel(
    scored: bool,
    inverted_too: bool,
    options: RefinementOptions,
    window: Flats,
    weights: Flats,
    monomials: Float32,
    equations: tuple[Float64, ...],
    total_right: Float64,
) -> None:
    """Add the equations and the scores of a channel, unless its window is flat."""
    structure, product, columns = weights
    moments, fit, total, scores = equations
    side, width = 2 * options.half + 1, options.width
    n = side * width
    first = options.correlation_half * (width + 1)
    reference, value, slope_x, slope_y = window
    value, reference = value[first:], reference[first:]
    slope_x, slope_y = slope_x[first:], slope_y[first:]
    h0, h1, known = fit_gain(structure, value, reference, n)
    if known <= 0.0:
        return
    offset, gain, per_sigma = np.float32(h0), np.float32(h1), np.float32(0.0)
    if options.robust:
        deviation = sum_of_deviations(structure, value, reference, offset, gain, n) / known
        per_sigma = np.float32(1.0 / max(SIGMA_PER_MEAN_DEVIATION * deviation, 1e-9))
    sampled = value, reference, slope_x, slope_y, offset, gain, per_sigma
    for k in range(moments.shape[0]):
        weight = structure
        if k > 0:
            weight = product
            _multiply(structure, monomials[k - 1], n, weight)
        weighted_moments(weight, *sampled, n, moments[k])
    refitted, variance = add_equations(moments, float(gain), inverted_too, total, total_right, fit)
    if variance > 0.0 and scored:
        lattice = side, width, options.blocks, columns
        add_block_scores(structure, *sampled, fit, refitted / variance, *lattice, scores)


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
    plane, valid, none = np.zeros((1, 1, 1), np.float32), np.zeros((1, 1), bool), np.zeros((0, 2))
    linear, whole = np.zeros((0, 2, 2)), np.zeros(0, np.int64)
    images, starts = Images(plane, plane, valid, valid), Starts(whole[:, None], none, linear, none, plane)
    results = Results(none, linear, linear, whole)
    arguments = images, starts, NO_OPTIONS, make_workspace(1, NO_OPTIONS), results, PARTS
    refine_points.compile(tuple(map(typeof, arguments)))  # type: ignore[attr-defined]
