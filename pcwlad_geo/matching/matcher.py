"""The stages in order: maps, corners, coarse match, refinement, consistency, field, consensus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.matching import keypoints
from pcwlad_geo.matching.coarse import match_coarsely
from pcwlad_geo.matching.guidance import (
    MIN_WINDOW_SAMPLE,
    TRIED_FIRST,
    WINDOW_SAMPLE,
    FieldGuide,
    Lost,
    Scales,
    WindowErrors,
    calibrate,
    forward_is_enough,
    guide_by_field,
    tries_larger,
    window_errors,
)
from pcwlad_geo.matching.keypoints import OUTCOMES, Candidates
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.mutual_structure import (
    correlations,
    passes_paper,
    shared_structure,
    significantly_correlated,
)
from pcwlad_geo.matching.outliers import consistent
from pcwlad_geo.matching.prepare import ChannelPair, Image, PreparedPair, measure_noise, prepare, rounding_of
from pcwlad_geo.matching.refinement import STEP_PX, InitialEstimate, Refined, refine
from pcwlad_geo.matching.types import TRAITS, MatchSettings, MethodTraits, TiePoints
from pcwlad_geo.types import Bool, Float64, Index

DISAGREEMENT_PX: Final = 0.5
"""Largest difference between the forward and the backward match of a point that is accepted."""
COARSE_SIGMA_PX: Final = 0.35
"""Sigma per axis of a match at a whole pixel, as method `coarse` ends with."""
SAMPLED: Final = 5
"""One of this many points is in the sample that is also matched backward. The points are ordered by cell and
rank, so that a divisor of the points of a cell would sample one rank only."""
SPARSE_FROM_PX: Final = 101
"""Windows of the second pass that are as wide as this or wider take every second pixel of rows and columns: a
quarter of the time, and the same error, as the maps hold no detail that the others would add."""
FIRST_SPARSE_FROM_PX: Final = 81
"""The same for the first pass, where the second one chooses the window and matches all points again: they
scatter by 5 to 9 % more, and what is left of them is the start and the field."""
MEASURED_UP_TO_PX: Final = 181
"""Side of the largest window that points are measured with: one of 257 px takes twice as long, for no more
than a hundredth of a pixel."""
AGAIN_PX: Final = 129
"""Least side of the window in which candidates without a match are tried once more."""
RETURNS_PX: Final = 0.25
"""Largest difference between the two directions of such a match."""
MIN_TO_SAMPLE: Final = 16
"""With fewer points than this all are matched backward, unless a sample was asked for."""

STRIPE_PX: Final = 61
"""Length of windows that see jitter, of few rows or of few columns."""
STRIPE_WIDTH_PX: Final = 5
"""Their width across."""

Back = Literal["forward only", "sample", "as needed", "always"]


LARGEST_VALUE: Final = 1e100
"""Largest pixel value, so that squares and sums of squares are finite."""


@dataclass(frozen=True, slots=True)
class Core:
    """The part of a window, in array indices, whose corners are wanted; the rest is halo."""

    row: int
    col: int
    row_stop: int
    col_stop: int
    origin_rc: tuple[int, int]
    """Row, column of the window's first pixel minus that of all cores, where the lattice of cells begins."""


def match_arrays(
    reference: NDArray[Any],
    target: NDArray[Any],
    *,
    reference_valid: Bool | None = None,
    target_valid: Bool | None = None,
    settings: MatchSettings | None = None,
    also: Index | None = None,
) -> TiePoints:
    """Match two images of the same ground on the same grid.

    Parameters
    ----------
    reference, target : (rows, cols) arrays
        Any real dtype; shapes may differ, the top-left pixels coincide up to the search radius.
    reference_valid, target_valid : (rows, cols) bool arrays, optional
        Pixels that count; non-finite values never do.
    settings : MatchSettings, optional
    also : (n, 2) array of int, optional
        Pixels (row, col) of the reference that are matched as well, corners or not.

    Returns
    -------
    TiePoints
        Consistent matches, pixel coordinates (col, row), corner-based.

    Raises
    ------
    InputError
        If an image is not a real two-dimensional array, is constant, or is smaller than a window.
    """
    settings = MatchSettings() if settings is None else settings
    if not isinstance(settings, MatchSettings):
        raise SettingsError(f"settings = {settings!r}: give MatchSettings(...)")
    ref, tgt = _image(reference, reference_valid, "reference"), _image(target, target_valid, "target")
    rows = max(ref.values.shape[0], tgt.values.shape[0])
    cols = max(ref.values.shape[1], tgt.values.shape[1])
    common = np.minimum(ref.values.shape, tgt.values.shape)
    if common.min() < settings.template:
        raise InputError(
            f"the images share {common[0]} x {common[1]} px: less than the matching window of "
            f"{settings.template} px; use larger images or a smaller template and window"
        )
    margin = margin_px(settings)
    pair = prepare(
        _on_canvas(ref, rows, cols, margin),
        _on_canvas(tgt, rows, cols, margin),
        channels=_traits(settings).channels,
    )
    core = Core(margin, margin, margin + rows, margin + cols, (-margin, -margin))
    first, _ = match_candidates(pair, core, settings, None if also is None else also + margin)
    kept = first[consistent_points(first, settings)]
    final = second_pass(pair.channels, kept, settings)
    return final.shifted(np.array([-margin, -margin]), np.array([-margin, -margin]))


def to_index(points: TiePoints) -> Index:
    """Return the (n, 2) row, column array indices of the pixels whose centres the reference points are."""
    return np.floor(points.reference_xy_px[:, ::-1]).astype(np.intp)


def margin_px(settings: MatchSettings) -> int:
    """Return how far beyond a corner the windows reach, search included, px."""
    return max(settings.template, *settings.windows) // 2 + settings.search_radius + 16


def match_candidates(
    pair: PreparedPair, core: Core, settings: MatchSettings, also: Index | None = None
) -> tuple[TiePoints, Candidates]:
    """Run the first pass: match every candidate independently.

    Corners are taken in the `core`; the (n, 2) int array `also` holds more candidates (row, col), which need
    be no corners. Return the matches in pixel coordinates of the two arrays, not yet checked against one
    another, covariances formal, and all corners that were searched, with the stage that rejected each.
    """
    traits = _traits(settings)
    corners = np.concatenate([*([] if also is None else [also]), _corners(pair, core, settings)])
    reaches = settings.template, settings.search_radius
    coarse = match_coarsely(
        pair.reference_map, pair.target_map, corners, *reaches, settings.least_valid, pair.channels.threads
    )
    compared = coarse.ssim > -1.0
    similar = compared & (coarse.ssim >= settings.ssim_min)
    inside = similar & ~coarse.at_border
    outcome = np.select(
        [~compared, ~similar, coarse.at_border],
        [OUTCOMES.index(name) for name in ("not_comparable", "not_similar", "at_search_border")],
    ).astype(np.uint8)
    # the paper starts at the whole pixel; a start at the fitted peak needs fewer steps
    whole = coarse.offset_rc[:, ::-1].astype(np.float64)
    shift = coarse.shift_xy_px if traits.structure == "local" else whole
    index, score = np.flatnonzero(inside), coarse.distinctness
    if not traits.refined:
        covariance = np.tile(COARSE_SIGMA_PX**2 * np.eye(2), (len(index), 1, 1))
        forward_backward = np.full(len(index), np.nan)
        points = _points(corners[index], shift[index], covariance, score[index], forward_backward)
        return points, Candidates(_centres(corners), outcome)

    def match(some: Index) -> tuple[TiePoints, Bool]:
        start = InitialEstimate(shift[some], np.zeros((len(some), 2, 2)))
        refined, agree, forward_backward = _refine_both(
            pair.channels, corners[some], start, settings, settings.backward, _first_step(settings)
        )
        valid = _on_valid_target(pair.channels, corners[some], refined.shift_xy_px)
        outcome[some] = np.select(
            [~refined.converged, ~agree, ~valid],
            [OUTCOMES.index(name) for name in ("not_converged", "directions_disagree", "not_comparable")],
        )
        points = _points(
            corners[some], refined.shift_xy_px, refined.covariance_px2, score[some], forward_backward
        )
        found = refined.converged & agree & valid
        return points[found], found

    if settings.spare == 0 or settings.features_area_px2 is None:
        return match(index)[0], Candidates(_centres(corners), outcome)
    cell_px = keypoints.cell_side_px(settings.features, settings.per_cell, settings.features_area_px2)
    order, rank = keypoints.rank_in_cell(corners[index], score[index], cell_px, core.origin_rc)
    points, unneeded = _match_in_turns(match, index[order], rank, settings.per_cell - settings.spare)
    tried = np.delete(np.arange(len(corners)), unneeded)
    return points, Candidates(_centres(corners[tried]), outcome[tried])


def _match_in_turns(
    match: Callable[[Index], tuple[TiePoints, Bool]], candidates: Index, rank: Index, wanted: int
) -> tuple[TiePoints, Index]:
    """Match the best candidates of every cell, then, where there is one, another for each that fails.

    The candidates are sorted by cell, the best of each first, with their rank in it. Returned are the points
    and the candidates that were not tried.
    """
    first, cell = rank < wanted, np.cumsum(rank == 0) - 1
    points, found = match(candidates[first])
    missing = wanted - np.bincount(cell[first], found)
    second = ~first & (rank - wanted < missing[cell])
    more, _ = match(candidates[second])
    return TiePoints.concatenate([points, more]), candidates[~first & ~second]


def _first_step(settings: MatchSettings) -> int:
    """Return the distance of the pixels of a window of the first pass."""
    chosen_later = settings.open_window and _traits(settings).structure == "local"
    return STEP_PX if chosen_later and settings.window >= FIRST_SPARSE_FROM_PX else 1


def step_of(window_px: int) -> int:
    """Return the distance of the pixels of a window of the second pass."""
    return STEP_PX if window_px >= SPARSE_FROM_PX else 1


SURROUNDINGS_PX: Final = 20
"""Half side of what tells the displacement of the ground right around a point."""
CLEARLY_ALIKE: Final = 0.05
"""By how much more another displacement than its own must correlate there."""


def rematch(
    pair: ChannelPair,
    points: TiePoints,
    guide: FieldGuide,
    settings: MatchSettings,
    window_px: int | None = None,
) -> TiePoints:
    """Run the second pass: match points again, with the deformation and structure given by the field.

    The points are in pixel coordinates of the arrays, and the guidance is theirs. The window `window_px`
    matches all points; None: that of the settings, for those with something new to say. The result has the
    same points in their order, covariances formal; a point that fails keeps its first position.
    """
    target, covariance = points.target_xy_px.copy(), points.covariance_px2.copy()
    again, led = matched_again(guide, settings), guide.leads
    if window_px is not None:
        again, settings = np.ones_like(led), replace(settings, window=window_px)
    for some, follows in ((again & ~led, True), (again & led, False)):
        index = np.flatnonzero(some)
        begin = target[index] - points.reference_xy_px[index]
        structure = None if follows else guide.structure_xy_px[index]
        if structure is not None and settings.window >= SPARSE_FROM_PX:
            begin = structure  # nearer to what a large window sees, and its structure is needed there anyway
        start = InitialEstimate(begin, guide.linear[index], structure, is_match=structure is not None)
        corners = to_index(points[index])
        back: Back = "forward only" if (guide.one_way if follows else guide.led_one_way) else "always"
        refined, agree, _ = _refine_both(pair, corners, start, settings, back, step_of(settings.window))
        good = refined.converged & agree
        target[index[good]] = points.reference_xy_px[index[good]] + refined.shift_xy_px[good]
        covariance[index[good]] = refined.covariance_px2[good]
    return replace(points, target_xy_px=target, covariance_px2=covariance)


def rematch_with(
    pair: ChannelPair, points: TiePoints, guide: FieldGuide, settings: MatchSettings, scales: Scales
) -> TiePoints:
    """Do what `rematch` does with one or two windows; points that fail in them keep to a smaller one.

    The `scales` are of windows of the settings.
    """
    if scales.windows_px == (settings.window,):
        return rematch(pair, points, guide, settings)
    tries = [_by_window(pair, points, guide, settings, window_px) for window_px in scales.windows_px]
    good = np.all([moved for _, moved in tries], axis=0)
    target, covariance = points.target_xy_px.copy(), points.covariance_px2.copy()
    target[good] = sum(
        weight * again.target_xy_px[good] for weight, (again, _) in zip(scales.weights, tries, strict=True)
    )
    # of two windows, one inside the other, the errors share those of the larger one
    own = min(scales.weights[0] ** 2, 1.0)
    covariance[good] = own * tries[0][0].covariance_px2[good] + (1 - own) * tries[-1][0].covariance_px2[good]
    smaller = [each for each in settings.windows if settings.window <= each < scales.windows_px[-1]]
    failed = np.flatnonzero(~good)
    for window_px in reversed(smaller):
        again, found = _by_window(pair, points[failed], guide.part(failed), settings, window_px)
        target[failed[found]] = again.target_xy_px[found]
        covariance[failed[found]] = again.covariance_px2[found]
        failed = failed[~found]
    return replace(points, target_xy_px=target, covariance_px2=covariance)


def _by_window(
    pair: ChannelPair, points: TiePoints, guide: FieldGuide, settings: MatchSettings, window_px: int
) -> tuple[TiePoints, Bool]:
    """Match points again with a window; return them, and the mask of those that did not fail.

    The first window never fails: the points are where it put them.
    """
    if window_px == settings.window:
        return rematch(pair, points, guide, settings), np.ones(len(points), bool)
    again = rematch(pair, points, guide, settings, window_px)
    return again, ~_unmoved(again, points)


def try_again(
    pair: ChannelPair, lost: Lost, settings: MatchSettings, scales: Scales
) -> tuple[TiePoints, Index]:
    """Match candidates without a match once more, where their neighbours predict, in a larger window.

    The structure is taken where the match is, not where it is predicted: a match that is led there returns to
    where it was led, right or wrong. Both directions must agree, with each other and with the prediction. The
    `scales` are those of the second pass, with which the matches found are then measured. Return those found,
    in pixel coordinates of the arrays as the lost are, not yet checked against one another, and the (m,) intp
    index of the lost that they are.
    """
    widest = max(settings.template, *settings.windows)  # the arrays reach as far
    largest = max(scales.windows_px)
    window_px = widest if largest >= MEASURED_UP_TO_PX else max(min(AGAIN_PX, widest), largest)
    corners = np.floor(lost.reference_xy_px[:, ::-1]).astype(np.intp)
    refined, _, difference_px = _refine_both(
        pair,
        corners,
        InitialEstimate(lost.guide.structure_xy_px, lost.guide.linear),
        replace(settings, window=window_px),
        "always",
        step_of(window_px),
    )
    off_px = np.linalg.norm(refined.shift_xy_px - lost.guide.structure_xy_px, axis=1)
    good = refined.converged & (difference_px < RETURNS_PX) & (off_px < lost.limit_px)
    good &= _on_valid_target(pair, corners, refined.shift_xy_px)
    index = np.flatnonzero(good)
    # a window that is so large sees across a cloud, but nothing was measured in the middle of it
    index = index[significantly_correlated(pair, corners[index], refined.shift_xy_px[index])]
    points = _points(
        corners[index],
        refined.shift_xy_px[index],
        refined.covariance_px2[index],
        np.zeros(len(index)),
        difference_px[index],
    )
    guide = replace(lost.guide, one_way=False).part(index)
    return rematch_with(pair, points, guide, settings, scales), index


def _on_valid_target(pair: ChannelPair, corners: Index, shift_xy_px: Float64) -> Bool:
    """Return whether matches lie on valid pixels of the target: a large window sees across a small cloud."""
    valid = pair.target.valid
    there = np.floor(np.nan_to_num(_centres(corners) + shift_xy_px)).astype(np.intp)[:, ::-1]
    row, col = np.clip(there, 0, np.array(valid.shape) - 1).T
    return np.asarray(valid[row, col])


def can_try_again(settings: MatchSettings) -> bool:
    """Return whether candidates without a match are tried once more."""
    traits = _traits(settings)
    return traits.refined and traits.structure == "local" and settings.consensus != "off"


def displacement_by_windows(
    pair: ChannelPair,
    points: TiePoints,
    guide: FieldGuide,
    settings: MatchSettings,
    windows_px: Sequence[int],
) -> Float64:
    """Return (k, n, 2) displacements (col, row) of the n points by each of k windows, NaN for failures."""
    moved = []
    for window_px in windows_px:
        again = rematch(pair, points, guide, settings, window_px)
        moved.append(np.where(_unmoved(again, points)[:, None], np.nan, again.displacement_px))
    return np.stack(moved)


def displacement_by_stripes(pair: ChannelPair, points: TiePoints, guide: FieldGuide) -> Float64:
    """Return (2, n, 2) displacements (col, row) by windows of few rows, then of few columns, NaN if lost.

    The n `points` and their `guide` are in pixel coordinates of the arrays of `pair`.
    """
    begin = np.where(guide.leads[:, None], guide.structure_xy_px, points.displacement_px)
    corners = to_index(points)
    start = InitialEstimate(begin, guide.linear)
    found_by = []
    for window_px in ((STRIPE_WIDTH_PX, STRIPE_PX), (STRIPE_PX, STRIPE_WIDTH_PX)):
        found = refine(
            pair.reference,
            pair.target,
            corners,
            start,
            window_px=window_px,
            use_structure=False,
            threads=pair.threads,
        )
        found_by.append(np.where(found.converged[:, None], found.shift_xy_px, np.nan))
    return np.stack(found_by)


def displacement_by_surroundings(
    pair: ChannelPair, points: TiePoints, guide: FieldGuide, other_px: Float64
) -> Float64:
    """Return (1, n, 2) the displacement (col, row) that fits best right around each of n points.

    It is the point's own, or that and the (2,) `other_px` (col, row), or one of two as far away in other
    directions, which fit as often by chance. The `points` are in pixel coordinates of the arrays of `pair`.
    """
    corners = to_index(points)
    there = corners + np.rint(points.displacement_px[:, ::-1]).astype(np.intp)
    offsets = np.array([np.zeros(2), other_px, -other_px, other_px[::-1] * (1, -1)])
    alike = np.stack(
        [
            correlations(pair, corners, there + np.rint(each[::-1]).astype(np.intp), SURROUNDINGS_PX)
            for each in offsets
        ]
    )
    alike[0] += CLEARLY_ALIKE
    best: Float64 = points.displacement_px + offsets[alike.argmax(axis=0)]
    return best[None]


def window_sample(guide: FieldGuide, settings: MatchSettings) -> Index:
    """Return the (m,) points of the `guide` that tell which of the windows of `settings` is best."""
    n = len(guide.linear)
    if n < MIN_WINDOW_SAMPLE or len(settings.windows) == 1:
        return np.zeros(0, np.intp)
    return np.unique(np.linspace(0, n - 1, min(WINDOW_SAMPLE, n)).astype(np.intp))


def _unmoved(again: TiePoints, points: TiePoints) -> Bool:
    return np.asarray((again.target_xy_px == points.target_xy_px).all(axis=1))


def matched_again(guide: FieldGuide, settings: MatchSettings) -> Bool:
    """Return the (n,) mask of the points of `guide` that the second pass with `settings` matches again."""
    traits = _traits(settings)
    if not (traits.refined and traits.structure == "local"):
        return np.zeros_like(guide.leads)
    something_new = guide.deforms or (settings.backward == "sample" and not guide.one_way)
    return guide.leads | (something_new or _first_step(settings) > 1)


def second_pass(pair: ChannelPair, points: TiePoints, settings: MatchSettings) -> TiePoints:
    """Guide, match again, check and calibrate the `points` of one `pair` with `settings`."""
    guide = guide_by_field(points, settings)
    sample = window_sample(guide, settings)
    measured = partial(displacement_by_windows, pair, points[sample], guide.part(sample), settings)
    scales, errors = choose_scales(measured, settings) if len(sample) else (Scales.of(settings.window), None)
    again = rematch_with(pair, points, guide, settings, scales)
    settings = replace(settings, window=scales.window_px)
    good = again[consistent_points(again, settings)]
    variance_px2 = None if errors is None else errors.variance_px2(scales)
    return calibrate(good, guide.surface, guide.shared_variance_px2, settings, variance_px2)


def choose_scales(
    measured: Callable[[Sequence[int]], Float64], settings: MatchSettings
) -> tuple[Scales, WindowErrors | None]:
    """Choose the windows of the second pass, where they are open, and tell the errors of all that were tried.

    Larger windows are tried one after the other, as long as the last one seems good. `measured` gives the (k,
    n, 2) displacements of n points by k windows, as `displacement_by_windows` does.
    """
    tried = settings.windows[:TRIED_FIRST]
    moved = measured(tried)
    open_to = [window for window in settings.windows[TRIED_FIRST:] if window <= MEASURED_UP_TO_PX]
    while True:
        errors = window_errors(moved, tried)
        if errors is None or not settings.open_window:
            return Scales.of(settings.window), errors
        scales = errors.best(tried, settings.window)
        if not open_to or not tries_larger(scales, tried):
            return scales, errors
        tried = (*tried, open_to.pop(0))
        moved = np.concatenate([moved, measured(tried[-1:])])


def consistent_points(points: TiePoints, settings: MatchSettings) -> Bool:
    """Return the (n,) mask of the `points` that agree with their neighbours in windows of `settings`."""
    sigma = np.sqrt(np.trace(points.covariance_px2, axis1=1, axis2=2))
    return consistent(points.reference_xy_px, points.displacement_px, sigma, settings.window)


def _refine_both(
    pair: ChannelPair,
    corners: Index,
    start: InitialEstimate,
    settings: MatchSettings,
    back: Back,
    step_px: int = 1,
) -> tuple[Refined, Bool, Float64]:
    """Refine forward and, where the method asks for it, backward.

    Returned are the mean of the directions, whether they agree, and their (n,) difference: infinite where the
    backward match failed, NaN where it was not made.
    """
    forward = _refine_one_way(pair, corners, start, settings, step_px)
    forward_backward = np.full(len(corners), np.nan)
    if not _traits(settings).backward:
        ok = np.ones(len(corners), bool)
        if settings.method == "pcwlad":
            ok = passes_paper(pair, corners, start, forward, settings.window, settings.ssim_min)
        return forward, ok, forward_backward
    mean, covariance = forward.shift_xy_px.copy(), forward.covariance_px2.copy()

    def match_backward(some: Index) -> None:
        there, moved = forward.shift_xy_px[some], forward.linear[some]
        structure = None if start.structure_xy_px is None else start.structure_xy_px[some]
        returned, backward = _refine_back(pair, corners[some], there, moved, structure, settings, step_px)
        mean[some] = (there + returned) / 2
        covariance[some] = (covariance[some] + backward.covariance_px2) / 2
        forward_backward[some] = np.where(
            backward.converged, np.linalg.norm(there - returned, axis=1), np.inf
        )

    # points whose forward match did not converge need no backward match
    arrived = np.flatnonzero(forward.converged)
    all_of_them = back == "always" or (back == "as needed" and len(arrived) < MIN_TO_SAMPLE)
    if back != "forward only":
        match_backward(arrived[:: 1 if all_of_them else SAMPLED])
    if back == "as needed" and not forward_is_enough(forward_backward, settings):
        match_backward(arrived[np.isnan(forward_backward[arrived])])
    converged = forward.converged & ~np.isinf(forward_backward)
    return (
        Refined(mean, forward.linear, covariance, converged),
        ~(forward_backward >= DISAGREEMENT_PX),
        forward_backward,
    )


def _refine_back(
    pair: ChannelPair,
    corners: Index,
    shift_xy: Float64,
    linear: Float64,
    structure_xy: Float64 | None,
    settings: MatchSettings,
    step_px: int,
) -> tuple[Float64, Refined]:
    """Refine from target to reference; return the shifts, as seen forward, and the whole result."""
    landed = corners + np.round(shift_xy[:, ::-1]).astype(np.intp)
    # the backward window is centred on a whole target pixel; between that and the exact target position the
    # field differs by deformation times the remainder
    remainder = (landed - corners)[:, ::-1] - shift_xy
    deformation = np.einsum("nij,nj->ni", linear, remainder)
    start = InitialEstimate(
        -(shift_xy + deformation),
        inverse(np.eye(2) + linear) - np.eye(2),
        None if structure_xy is None else -(structure_xy + deformation),
        is_match=structure_xy is not None,
    )
    backward = _refine_one_way(pair.turned, landed, start, settings, step_px)
    return -backward.shift_xy_px - deformation, backward


def _refine_one_way(
    pair: ChannelPair, corners: Index, start: InitialEstimate, settings: MatchSettings, step_px: int
) -> Refined:
    traits = _traits(settings)
    if traits.structure == "filter":
        start = replace(start, structure=shared_structure(pair, corners, start, settings.window))
    refined = partial(
        refine,
        pair.reference,
        pair.target,
        corners,
        window_px=settings.window,
        step_px=step_px,
        affine=traits.affine,
        iterations=settings.iterations,
        least_valid=settings.least_valid,
        threads=pair.threads,
    )
    result = refined(start, use_structure=traits.structure == "local", robust=traits.robust)
    if traits.structure == "filter":
        # taken once, at the whole-pixel match, the structure would pull the answer towards that pixel
        moved = InitialEstimate(result.shift_xy_px, result.linear)
        moved = replace(moved, structure=shared_structure(pair, corners, moved, settings.window))
        result = refined(moved)
    return result


def _corners(pair: PreparedPair, core: Core, settings: MatchSettings) -> Index:
    """Return the candidates of the core: row, column array indices."""
    if core.row >= core.row_stop:
        return np.zeros((0, 2), np.intp)
    side = max(settings.template, settings.window)
    share = cv2.blur(pair.reference_map.valid, (side, side), borderType=cv2.BORDER_CONSTANT)
    usable = (share >= settings.least_valid) & (pair.reference_map.valid > 0)
    reach = margin_px(settings) - 8
    usable[:reach], usable[-reach:], usable[:, :reach], usable[:, -reach:] = False, False, False, False
    usable &= pair.contrast >= 0
    corners, response = keypoints.detect_corners(pair.reference_map.values, usable, pair.contrast)
    inside = (corners >= (core.row, core.col)).all(axis=1) & (corners < (core.row_stop, core.col_stop)).all(
        axis=1
    )
    if settings.keypoints == "strongest":
        return keypoints.strongest(corners[inside], response[inside], settings.features)
    area = settings.features_area_px2 or float(
        usable[core.row : core.row_stop, core.col : core.col_stop].sum()
    )
    cell_px = keypoints.cell_side_px(settings.features, settings.per_cell, area)
    chosen = keypoints.by_cell(corners, response, cell_px, core.origin_rc, settings.per_cell)
    # a cell belongs to the core that holds its first pixel, so that neighbouring tiles share no cell
    first = (chosen + np.asarray(core.origin_rc)) // cell_px * cell_px - np.asarray(core.origin_rc)
    owned = (first >= (core.row, core.col)).all(axis=1) & (first < (core.row_stop, core.col_stop)).all(axis=1)
    result: Index = chosen[owned]
    return result


def _points(
    corners: Index, shift_xy: Float64, covariance: Float64, score: Float64, forward_backward_px: Float64
) -> TiePoints:
    centre = _centres(corners)
    return TiePoints(centre, centre + shift_xy, covariance, score, forward_backward_px)


def _centres(corners: Index) -> Float64:
    return corners[:, ::-1].astype(np.float64) + 0.5


def _image(values: NDArray[Any], valid: Bool | None, which: str) -> Image:
    array = np.asarray(values)
    if array.ndim != 2 or array.dtype.kind not in "uifb":
        raise InputError(
            f"the {which} is a {array.ndim}-dimensional array of {array.dtype}: "
            "give a two-dimensional real one"
        )
    if valid is not None and np.shape(valid) != array.shape:
        raise InputError(
            f"the mask of the {which} has shape {np.shape(valid)}, the image {array.shape}: "
            "give one of the image's shape"
        )
    if valid is not None and np.asarray(valid).dtype.kind not in "bui":
        raise InputError(
            f"the mask of the {which} is of {np.asarray(valid).dtype}: give True where a pixel counts"
        )
    good = np.isfinite(array) if valid is None else np.isfinite(array) & (np.asarray(valid) != 0)
    numbers = np.where(good, array, 0).astype(np.float64)
    if not good.any() or np.ptp(numbers[good]) == 0:
        raise InputError(f"the {which} is constant or has no valid pixel: there is nothing to match")
    if np.abs(numbers).max() > LARGEST_VALUE:
        raise InputError(f"the {which} has values beyond {LARGEST_VALUE:.0e}: mask them, or scale it")
    noise = replace(measure_noise(numbers, good), rounding=rounding_of(array.dtype.name))
    return Image(numbers, good, scene_epsilon(numbers, good), noise)


def _on_canvas(image: Image, rows: int, cols: int, margin: int) -> Image:
    after = (margin + rows - image.values.shape[0], margin + cols - image.values.shape[1])
    widths = [(margin, after[0]), (margin, after[1])]
    return replace(image, values=np.pad(image.values, widths), valid=np.pad(image.valid, widths))


def _traits(settings: MatchSettings) -> MethodTraits:
    return TRAITS[settings.method]
