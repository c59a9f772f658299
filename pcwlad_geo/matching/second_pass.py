"""The second pass: points matched again, with the deformation and structure that the field gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from pcwlad_geo.matching.both_directions import Back, refine_both
from pcwlad_geo.matching.calibration import calibrate
from pcwlad_geo.matching.guidance import FieldGuide, guide_by_field
from pcwlad_geo.matching.outliers import consistent_points
from pcwlad_geo.matching.prepare import ChannelPair
from pcwlad_geo.matching.refinement import SPARSE_STEP_PX, InitialEstimate
from pcwlad_geo.matching.types import TRAITS, MatchSettings, TiePoints, to_index
from pcwlad_geo.matching.window import WINDOWS, MatchingWindow
from pcwlad_geo.matching.windows import Scales, choose_scales, window_sample
from pcwlad_geo.types import Bool, Float64


def step_of(window_px: int) -> int:
    """Return the distance of the pixels of a window of the second pass."""
    return SPARSE_STEP_PX if window_px >= WINDOWS.sparse_from_px else 1


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
    repeated, led = matched_again(guide, settings), guide.leads
    if window_px is not None:
        repeated, settings = np.ones_like(led), replace(settings, window=MatchingWindow(window_px))
    for group, follows in ((repeated & ~led, True), (repeated & led, False)):
        index = np.flatnonzero(group)
        begin = target[index] - points.reference_xy_px[index]
        structure = None if follows else guide.structure_xy_px[index]
        if structure is not None and settings.window.side_px >= WINDOWS.sparse_from_px:
            begin = structure  # nearer to what a large window sees, and its structure is needed there anyway
        start = InitialEstimate(begin, guide.linear[index], structure, is_match=structure is not None)
        corners = to_index(points[index])
        direction: Back = "forward only" if (guide.one_way if follows else guide.led_one_way) else "always"
        refined, agree, _ = refine_both(
            pair, corners, start, settings, direction, step_of(settings.window.side_px)
        )
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
    if scales.windows_px == (settings.window.side_px,):
        return rematch(pair, points, guide, settings)
    tries = [_by_window(pair, points, guide, settings, window_px) for window_px in scales.windows_px]
    good = np.all([succeeded_in for _, succeeded_in in tries], axis=0)
    target, covariance = points.target_xy_px.copy(), points.covariance_px2.copy()
    weighted = zip(scales.weights, tries, strict=True)
    target[good] = sum(weight * matched.target_xy_px[good] for weight, (matched, _) in weighted)
    # of two windows, one inside the other, the errors share those of the larger one
    share, first, last = min(scales.weights[0] ** 2, 1.0), tries[0][0], tries[-1][0]
    covariance[good] = share * first.covariance_px2[good] + (1 - share) * last.covariance_px2[good]
    smaller = [
        side_px
        for side_px in settings.window.all_px
        if settings.window.side_px <= side_px < scales.windows_px[-1]
    ]
    failed = np.flatnonzero(~good)
    for window_px in reversed(smaller):
        matched, succeeded = _by_window(pair, points[failed], guide.part(failed), settings, window_px)
        target[failed[succeeded]] = matched.target_xy_px[succeeded]
        covariance[failed[succeeded]] = matched.covariance_px2[succeeded]
        failed = failed[~succeeded]
    return replace(points, target_xy_px=target, covariance_px2=covariance)


def _by_window(
    pair: ChannelPair, points: TiePoints, guide: FieldGuide, settings: MatchSettings, window_px: int
) -> tuple[TiePoints, Bool]:
    """Match points again with a window; return them, and the mask of those that did not fail.

    The first window never fails: the points are where it put them.
    """
    if window_px == settings.window.side_px:
        return rematch(pair, points, guide, settings), np.ones(len(points), bool)
    matched = rematch(pair, points, guide, settings, window_px)
    return matched, ~_unmoved(matched, points)


def displacement_by_windows(
    pair: ChannelPair,
    points: TiePoints,
    guide: FieldGuide,
    settings: MatchSettings,
    windows_px: Sequence[int],
) -> Float64:
    """Return (k, n, 2) displacements (col, row) of the n points by each of k windows, NaN for failures."""
    displacements = []
    for window_px in windows_px:
        matched = rematch(pair, points, guide, settings, window_px)
        displacements.append(np.where(_unmoved(matched, points)[:, None], np.nan, matched.displacement_px))
    return np.stack(displacements)


def _unmoved(matched: TiePoints, points: TiePoints) -> Bool:
    return np.asarray((matched.target_xy_px == points.target_xy_px).all(axis=1))


def matched_again(guide: FieldGuide, settings: MatchSettings) -> Bool:
    """Return the (n,) mask of the points of `guide` that the second pass with `settings` matches again."""
    traits = TRAITS[settings.method]
    if not (traits.refined and traits.structure == "local"):
        return np.zeros_like(guide.leads)
    something_new = guide.deforms or (settings.backward == "sample" and not guide.one_way)
    return guide.leads | something_new


def second_pass(pair: ChannelPair, points: TiePoints, settings: MatchSettings) -> TiePoints:
    """Guide, match again, check and calibrate the `points` of one `pair` with `settings`."""
    guide = guide_by_field(points, settings)
    sample = window_sample(points.reference_xy_px, settings.window)
    measured = partial(displacement_by_windows, pair, points[sample], guide.part(sample), settings)
    single = Scales.of(settings.window.side_px), None
    scales, errors = choose_scales(measured, settings.window) if len(sample) else single
    matched = rematch_with(pair, points, guide, settings, scales)
    settings = replace(settings, window=MatchingWindow(scales.window_px))
    good = matched[consistent_points(matched, settings)]
    variance_px2 = None if errors is None else errors.variance_px2(scales)
    return calibrate(good, guide.surface, guide.shared_variance_px2, settings, variance_px2)
