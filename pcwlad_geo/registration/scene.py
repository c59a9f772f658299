"""All tiles of a scene, matched twice: each point on its own, then guided by all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import cv2
import numpy as np

from pcwlad_geo.correction.models import AffineCorrection, ProjectiveCorrection, affine_between
from pcwlad_geo.correction.selection import COMMON_SIGMA
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.events import EventCallback, JobLog, Progress, only_warnings
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.matching.calibration import calibrate
from pcwlad_geo.matching.epipolar import EPIPOLAR, epipolar_evidence, on_their_lines, parallax_evidence
from pcwlad_geo.matching.field import Prediction, Surface, predict
from pcwlad_geo.matching.guidance import GUIDANCE, FieldGuide, Predictor, guide_by_field
from pcwlad_geo.matching.jitter import jitter_px
from pcwlad_geo.matching.keypoints import OUTCOMES, Candidates
from pcwlad_geo.matching.lost_candidates import Lost, can_try_again, expect_lost
from pcwlad_geo.matching.outliers import confirmed, consistent_points
from pcwlad_geo.matching.pose import mean_distance_px
from pcwlad_geo.matching.second_pass import matched_again
from pcwlad_geo.matching.types import (
    FIRST_WINDOW_PX,
    LARGE_WINDOWS_PX,
    OTHER_WINDOWS_PX,
    TRAITS,
    MatchSettings,
    TiePoints,
)
from pcwlad_geo.matching.windows import WINDOWS, Scales, WindowErrors, choose_scales, window_sample
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import of_one_product
from pcwlad_geo.raster.file_tree import file_name
from pcwlad_geo.raster.grid import jacobian, middle_pixel_size_m
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.rpc.ortho import plan_rpc_views
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.registration.advice import refusal
from pcwlad_geo.registration.judge import JudgeParameters, Verdict, agree_closely, is_doubtful, judge
from pcwlad_geo.registration.match_record import MatchRecord, record_matching
from pcwlad_geo.registration.motions import (
    Motion,
    MotionParameters,
    motion_of_the_ground,
    motions_of,
    other_displacement,
    patches,
    share_displaced,
)
from pcwlad_geo.registration.planning import Plan, common_region, farthest_px, plan
from pcwlad_geo.registration.prealign import (
    Overviews,
    PoseStarts,
    Prealignment,
    StartingAlignment,
    by_georeferencing,
    by_search,
    can_be_posed,
    direct_start,
    has_few_values,
    load_start_matcher,
    posed_start,
    proposed_start,
    read_overviews,
    scales_of_frames,
    searches_first,
    target_offset_px,
)
from pcwlad_geo.registration.quality import Doubt
from pcwlad_geo.registration.rivals import (
    doubt_of_rivals,
    doubt_of_unreached,
    may_move,
    rivals_in,
    start_at,
    unreached_in,
)
from pcwlad_geo.registration.rpc import shifted
from pcwlad_geo.registration.tiles import (
    KEPT_BYTES,
    TileJob,
    TileResult,
    compare_stripes,
    compare_surroundings,
    compare_windows,
    match_tile,
    rematch_tile,
)
from pcwlad_geo.tiepoints.table import TiePointTable, locate
from pcwlad_geo.types import Bool, Float64, Index

MIN_WINDOW_PX: Final = 41
"""Smallest side of a matching window, and of a common area that is matched, px."""
WINDOWS_ACROSS: Final = 1.6
"""An overlap narrower than this many windows gets smaller ones."""
FEW_PLACES_SHARE: Final = 0.7
"""Side of the next smaller windows where points agree in too few places, as a share of the last ones."""
CHOSEN_ACROSS: Final = 3
"""An overlap narrower than this many of the largest window keeps the first: near edges a window sees to one
side only, and of a small image most is near edges."""
MIN_PERSPECTIVE_PX: Final = 1.0
"""A homography is taken only if it differs from its best affine fit by more than this at some point, px."""
HOMOGRAPHY_ERROR_RATIO: Final = 0.9
"""A homography is taken only if its mean squared error is less than this share of an affine pose's."""
STILL_PX: Final = 0.1
"""Mean movement of the target by a new pose below which it is not matched again, px."""
SMALLER_WINDOWS: Final = (0.56, 0.75)
"""Sides of the windows that tell the error of a given one, shares of its own."""
NEAR_PX: Final = 0.5
"""A target that was found nearer than this to where it was assumed is not matched again, target px."""
MOST_MOVES: Final = 3
"""Largest number of times that matches on ground that repeats are compared with those a period off."""
SHARED_GREY_ERROR_PX: Final = 0.2
"""Error per axis that matches of grey values share, as slopes and shadows have tones of their own in each
band: RMS of six pairs on which structure tells more, 0.06 to 0.33 px."""


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """What the tiles gave, merged."""

    matches: TiePoints
    """All of the first pass, view px; the kept ones as the second pass left them."""
    kept: Bool
    counts: dict[str, int]
    verdict: Verdict
    prealignment: Prealignment
    record: MatchRecord
    """Of the first pass."""
    window_px: int
    """Side of the window of the last pass."""
    epipolar: bool = False
    """Whether the matches were kept by their epipolar lines, which allow every depth."""
    motions: Sequence[tuple[Motion, Bool]] = ()
    """What parts of the matches agree on, see `judge.motions_of`; that which was taken comes first."""
    patches: Sequence[Motion] = ()
    """The motion taken, and that of parts smaller than a window; none where there are none."""
    jitter_px: float = 0.0
    """By how much rows and columns move within a window, RMS, view px."""
    job: TileJob | None = None
    """One of the tiles, as all were matched."""
    scales: Scales | None = None
    """The windows of the last pass; None where there was none."""
    lost_px: Float64 = field(default_factory=lambda: np.empty((0, 2)))
    """(n, 2) candidates of the first pass that gave no match, view px of the reference (col, row)."""
    doubts: tuple[Doubt, ...] = ()
    """What speaks against the displacement taken."""
    first_only: bool = False
    """Whether the first candidates of a small image agreed, so that no others were matched."""

    @property
    def displacement_px(self) -> Float64:
        """(2,) median (col, row) of what is kept, px of the target view minus those of the reference view."""
        return np.asarray(np.median(self.matches.displacement_px[self.kept], axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class _FirstPass:
    """Every candidate that found a partner, each on its own."""

    jobs: list[TileJob]
    results: list[TileResult]
    """In the order of the jobs."""

    @property
    def matches(self) -> TiePoints:
        return TiePoints.concatenate([result.points for result in self.results])

    @property
    def tile_of(self) -> Index:
        """(n,) tile of each match."""
        return np.repeat(np.arange(len(self.results)), [len(result.points) for result in self.results])

    @property
    def lost(self) -> Candidates:
        """Every candidate that found none, tile after tile."""
        return Candidates.concatenate([result.lost for result in self.results])

    @property
    def lost_tile_of(self) -> Index:
        """(m,) tile of each of these."""
        return np.repeat(np.arange(len(self.results)), [len(result.lost) for result in self.results])

    @property
    def tones_variance_px2(self) -> float:
        """Variance, per axis, that matches have because they are of grey values; 0 if they are not.

        A correction takes `COMMON_SIGMA` of their sigma for the error that all of them share.
        """
        by_tones = self.jobs[0].reference_scene.tones is not None
        return (SHARED_GREY_ERROR_PX / COMMON_SIGMA) ** 2 if by_tones else 0.0

    def without(self, found: Index) -> _FirstPass:
        """Return the pass without those lost candidates that were `found` later."""
        is_found = np.zeros(len(self.lost), bool)
        is_found[found] = True
        results = []
        for tile, result in enumerate(self.results):
            gone = is_found[self.lost_tile_of == tile]
            fewer = np.bincount(result.lost.outcome[gone], minlength=len(OUTCOMES)).tolist()
            counts = {
                name: count - (fewer[OUTCOMES.index(name)] if name in OUTCOMES else 0)
                for name, count in result.counts.items()
            }
            results.append(replace(result, lost=result.lost.part(~gone), counts=counts))
        return replace(self, results=results)


def match_scene(start: StartingAlignment, settings: Settings, log: JobLog, runner: Runner) -> Matched:
    """Match all tiles of a scene from one start, and judge what they gave.

    Where the first candidates of a small image agree, but leave the verdict or the motion of the ground open,
    all are matched. Where the points agree closely in too few places, and the size of the windows is not
    given, the scene is matched again with smaller windows, of which more fit into the same ground, and judged
    by these.
    """
    matched = _match_with_windows(start, settings, log, runner)
    if matched.first_only and (not matched.verdict.accepted or len(matched.motions) > 1 or matched.patches):
        settings = replace(settings, features=settings.candidates)
        matched = _match_with_windows(start, settings, log, runner)
    again = matched
    while settings.window is None and again.verdict.smaller_windows and again.window_px > MIN_WINDOW_PX:
        window_px = max(MIN_WINDOW_PX, int(FEW_PLACES_SHARE * again.window_px) // 2 * 2 + 1)
        smaller = replace(settings, window=window_px, template=min(settings.template, window_px))
        again = _match_with_windows(start, smaller, log, runner)
        if again.verdict.accepted:
            if not agree_closely(again.matches[again.kept]):  # edges of nodata pull small windows apart
                break
            log.warn(
                f"windows of {matched.window_px} px give too few separate places to judge by: matched again "
                f"with windows of {window_px} px"
            )
            return again
    return matched


def _match_with_windows(start: StartingAlignment, settings: Settings, log: JobLog, runner: Runner) -> Matched:
    """Match a scene once.

    Every candidate is matched on its own (`_first_pass`), and those that agree with their neighbours are kept
    and judged. If they are accepted, they are matched again, guided by the field of all of them, and what was
    lost is tried once more where that tells its place (`_second_pass`); the outcome is checked and calibrated
    (`_checked`).
    """
    pair, overviews, prealignment = start.pair, start.overviews, start.prealignment
    offset = target_offset_px(pair, prealignment)
    matching = _match_settings(pair, offset, prealignment, settings, log)
    planned = plan(pair, overviews, offset, matching, settings)
    with log.stage("matching"):
        first = _first_pass(planned, log, runner)
    matches, counts = first.matches, _sum_counts(first.results)
    kept = consistent_points(matches, matching) if len(matches) else np.zeros(0, bool)
    radius_px, evidence = prealignment.search_radius_px, prealignment.net_evidence
    verdict = judge(matches, kept, counts, matching.window, radius_px, evidence=evidence)
    kept, verdict, epipolar = _by_geometry(matches, kept, verdict, pair, prealignment, settings, matching)
    window_px, jitter, other_motion, scales = matching.window, 0.0, None, None
    if verdict.accepted:
        with log.stage("refining"):
            second = _second_pass(first, matches, kept, matching, not planned.sites, log, runner)
            scales, jitter, other_motion = second.scales, second.jitter_px, second.other_motion
            window_px = scales.window_px
            matches, kept, checked = _checked(second, matches, replace(matching, window=window_px), epipolar)
        first = first.without(checked.lost_of[checked.lost_of >= 0])
        counts = {**_sum_counts(first.results), "second_try": int(checked.recovered.sum())}
        if second.incomplete:  # do the others suffice?
            found = kept[: len(first.matches)]
            verdict = judge(first.matches, found, counts, matching.window, radius_px, evidence=evidence)
    offset_px = np.asarray(pair.offset_px, dtype=np.float64)
    where = offset_px, matching.window
    motions = motions_of(matches, kept, *where, radius_px) if verdict.accepted and not epipolar else ()
    moved = patches(matches, kept, other_motion, *where) if other_motion and not epipolar else ()
    counts |= {"inconsistent": int((~kept).sum()), "tie_points": int(kept.sum())}
    record = record_matching(
        pair, overviews, offset, matching, planned.without_structure, first.jobs, first.results
    )
    return Matched(
        matches=matches,
        kept=kept,
        counts=counts,
        verdict=verdict,
        prealignment=prealignment,
        record=record,
        window_px=window_px,
        epipolar=epipolar,
        motions=motions,
        patches=moved,
        jitter_px=jitter,
        job=first.jobs[0] if first.jobs else None,
        scales=scales,
        lost_px=first.lost.reference_xy_px,
        first_only=any(result.first_only for result in first.results),
    )


def _by_geometry(
    matches: TiePoints,
    kept: Bool,
    verdict: Verdict,
    pair: ViewPair,
    prealignment: Prealignment,
    settings: Settings,
    matching: MatchSettings,
) -> tuple[Bool, Verdict, bool]:
    """Return what is kept, the verdict, and whether both are by epipolar lines instead of a smooth field.

    Left open, the lines decide for frames alone that are accepted without them.
    """
    window_px = matching.window
    frames = pair.reference.info.grid.crs is None and not (pair.georeferenced and prealignment.pose is None)
    by_lines = settings.geometry == "epipolar"
    if settings.geometry == "auto" and frames and verdict.accepted:
        by_lines = parallax_evidence(matches, kept, window_px) >= JudgeParameters().least_significance
    if not by_lines:
        return kept, verdict, False
    found = on_their_lines(matches)
    significance = (
        epipolar_evidence(matches, window_px, prealignment.search_radius_px) + prealignment.net_evidence
    )
    if (
        not verdict.accepted
        and found.sum() >= EPIPOLAR.least_matches
        and significance >= JudgeParameters().least_significance
    ):
        verdict = replace(
            verdict, accepted=True, reason=None, significance=significance, past_search_border=None
        )
    return found, verdict, True


def _first_pass(planned: Plan, log: JobLog, runner: Runner) -> _FirstPass:
    """Match the tiles planned, and small windows of second choice where the first gave too little."""
    first = _FirstPass([], [])
    upcoming, kept_bytes = planned.first, KEPT_BYTES * runner.threads if runner.shares_memory else 0
    for _ in range(3):  # the first choices, and two that follow
        threads = runner.threads if len(upcoming) == 1 else 1
        upcoming = [replace(job, kept_bytes=kept_bytes, threads=threads) for job in upcoming]
        results = runner.run(match_tile, [(job,) for job in upcoming], "matching", log.on_event)
        first = _FirstPass(first.jobs + upcoming, first.results + results)
        upcoming = planned.following(first.results)
        if not upcoming:
            break
    _warn_of_failures(first.results, log)
    return first


@dataclass(frozen=True, slots=True, eq=False)
class _SecondPass:
    """What the second pass gave, not yet checked."""

    points: TiePoints
    """The consistent matches as it left them, then candidates that it recovered by a second try."""
    match_of: Index
    """(n,) the match of the first pass that each is; -1 for candidates that had none."""
    lost_of: Index
    """(n,) the lost candidate of the first pass that each is; -1 for matches."""
    recovered: Bool
    """(n,) whether each was recovered."""
    surface: Surface | None
    shared_variance_px2: float
    incomplete: bool
    """Whether a tile could not be read a second time."""
    scales: Scales
    """The windows that the points were matched with."""
    window_variance_px2: float | None
    """Variance per axis that the differences of windows tell, where enough points do."""
    jitter_px: float
    """See `Matched`."""
    other_motion: tuple[Float64, Bool] | None
    """See `judge.other_displacement`; None where too few points lie at it."""

    def part(self, some: Bool) -> _SecondPass:
        """Return those of the (n,) mask."""
        which = {name: getattr(self, name)[some] for name in ("points", "match_of", "lost_of", "recovered")}
        return replace(self, **which)


@dataclass(frozen=True, slots=True, eq=False)
class _Retried:
    """Candidates that the second pass tries once more: lost ones, and matches that were inconsistent."""

    lost: Lost
    tile_of: Index
    match_of: Index
    """(n,) see `_SecondPass`."""
    lost_of: Index


def _checked(
    second: _SecondPass, matches: TiePoints, matching: MatchSettings, epipolar: bool
) -> tuple[TiePoints, Bool, _SecondPass]:
    """Check and calibrate what the second pass gave.

    Return the matches given, then the recovered candidates, rejected ones where the first pass put them, with
    their formal covariance; the (n,) mask of those that are kept; and the pass of these alone.
    """
    points = second.points
    second = second.part(on_their_lines(points) if epipolar else consistent_points(points, matching))
    good = calibrate(
        second.points, second.surface, second.shared_variance_px2, matching, second.window_variance_px2
    )
    old = second.match_of >= 0
    target, covariance = matches.target_xy_px.copy(), matches.covariance_px2.copy()
    forward_backward = matches.forward_backward_px.copy()
    index = second.match_of[old]
    target[index], covariance[index] = good.target_xy_px[old], good.covariance_px2[old]
    forward_backward[index] = good.forward_backward_px[old]
    moved = replace(
        matches, target_xy_px=target, covariance_px2=covariance, forward_backward_px=forward_backward
    )
    kept = np.zeros(len(matches) + np.count_nonzero(~old), bool)
    kept[index], kept[len(matches) :] = True, True
    return TiePoints.concatenate([moved, good[~old]]), kept, second


def _second_pass(
    first: _FirstPass,
    matches: TiePoints,
    kept: Bool,
    matching: MatchSettings,
    retry: bool,
    log: JobLog,
    runner: Runner,
) -> _SecondPass:
    """Match the consistent points again, guided by the field of all of them, and maybe what was lost."""
    index, predict_there = np.flatnonzero(kept), partial(_predict_on, runner, log.on_event)
    points, tile_of = matches[index], first.tile_of[index]
    guide = guide_by_field(points, matching, predict_there, runner.threads)
    other_motion = other_displacement(matches, kept)
    other_px = None if other_motion is None else other_motion[0]
    scales, errors, jitter, displaced = _scales(first, points, tile_of, guide, other_px, log, runner)
    retried = _retry_candidates(first, matches, kept, guide, matching, predict_there) if retry else None
    # points of which nothing is new to say need no visit
    rematched = matched_again(guide, matching) | (scales != Scales.of(matching.window))
    visited = tile_of[rematched] if retried is None else np.concatenate([tile_of[rematched], retried.tile_of])
    tiles, nothing = np.unique(visited), np.zeros(0, np.intp)
    parts = [np.flatnonzero(rematched & (tile_of == tile)) for tile in tiles]
    retries = [np.flatnonzero(retried.tile_of == tile) if retried else nothing for tile in tiles]
    calls = [
        (
            first.jobs[tile],
            points[part],
            guide.part(part),
            scales,
            retried.lost.part(lost) if retried else None,
        )
        for tile, part, lost in zip(tiles, parts, retries, strict=True)
    ]
    results = runner.run(rematch_tile, calls, "refining", log.on_event) if calls else []
    _warn_of_failures(results, log)
    target, covariance = points.target_xy_px.copy(), points.covariance_px2.copy()
    unread = np.zeros(len(points), bool)
    for part, result in zip(parts, results, strict=True):
        target[part], covariance[part] = result.points.target_xy_px, result.points.covariance_px2
        unread[part] = result.status == "failed"
    moved = replace(points, target_xy_px=target, covariance_px2=covariance)
    found = [lost[result.saved_from] for lost, result in zip(retries, results, strict=True)]
    recovered = np.concatenate([nothing, *found])
    joined = _SecondPass(
        points=TiePoints.concatenate([moved, *(result.saved for result in results)]),
        match_of=np.concatenate([index, retried.match_of[recovered] if retried else nothing]),
        lost_of=np.concatenate([np.full(len(index), -1), retried.lost_of[recovered] if retried else nothing]),
        recovered=np.repeat([False, True], [len(index), len(recovered)]),
        surface=guide.surface,
        shared_variance_px2=guide.shared_variance_px2 + first.tones_variance_px2,
        incomplete=bool(unread.any()),
        scales=scales,
        window_variance_px2=None if errors is None else errors.variance_px2(scales),
        jitter_px=jitter,
        other_motion=other_motion if displaced >= MotionParameters().displaced_share else None,
    )
    return joined.part(~np.concatenate([unread, np.zeros(len(recovered), bool)]))


def _retry_candidates(
    first: _FirstPass,
    matches: TiePoints,
    kept: Bool,
    guide: FieldGuide,
    matching: MatchSettings,
    predict_there: Predictor,
) -> _Retried | None:
    """Return what is matched once more; None if the neighbours cannot predict where it lies."""
    if np.count_nonzero(kept) < GUIDANCE.least_points or not can_try_again(matching):
        return None
    candidates, off = first.lost, np.flatnonzero(~kept)
    places = np.concatenate([candidates.reference_xy_px, matches.reference_xy_px[off]])
    lost = expect_lost(places, matches[kept], guide, matching, predict_there)
    predicted = lost.guide.structure_xy_px[len(candidates) :]
    moved = confirmed(matches.reference_xy_px, matches.displacement_px, off, predicted, matching.window)
    tried = np.concatenate([np.ones(len(candidates), bool), ~moved])
    return _Retried(
        lost.part(np.flatnonzero(tried)),
        np.concatenate([first.lost_tile_of, first.tile_of[off]])[tried],
        np.concatenate([np.full(len(candidates), -1), off])[tried],
        np.concatenate([np.arange(len(candidates)), np.full(len(off), -1)])[tried],
    )


def _scales(
    first: _FirstPass,
    points: TiePoints,
    tile_of: Index,
    guide: FieldGuide,
    other_px: Float64 | None,
    log: JobLog,
    runner: Runner,
) -> tuple[Scales, WindowErrors | None, float, float]:
    """Choose the windows of the second pass; return them, their errors, and what they average out.

    That is the jitter, and the share of the points around which a displacement by `other_px` more fits
    better. Errors are None and the rest is 0 where too few points tell. The `points` are the consistent ones,
    each with its tile and its part of the guide. The tiles that are asked are spread over the scene.
    """
    settings = first.jobs[0].settings
    if not len(window_sample(guide, settings)):
        return Scales.of(settings.window), None, 0.0, 0.0
    tiles, counts = np.unique(tile_of, return_counts=True)
    # multiples of the golden ratio are spread evenly, however many are taken
    spread = np.argsort((5**0.5 - 1) / 2 * np.arange(len(tiles)) % 1, kind="stable")
    enough = int(np.searchsorted(np.cumsum(counts[spread]), WINDOWS.sample)) + 1
    chosen = np.sort(spread[:enough])
    every = max(1, int(counts[chosen].sum() / WINDOWS.sample))
    inside = [np.flatnonzero(tile_of == tile) for tile in tiles[chosen]]
    sample = [these[::every] for these in inside]
    on_event = partial(only_warnings, log.on_event)  # the progress is no stage's own

    def measured(
        compare: Callable[..., Float64], sample: Sequence[Index], *windows_px: Sequence[int]
    ) -> Float64:
        calls = [
            (first.jobs[tile], points[some], guide.part(some), *windows_px)
            for tile, some in zip(tiles[chosen], sample, strict=True)
        ]
        return np.concatenate(runner.run(compare, calls, "refining", on_event), axis=1)

    scales, errors = choose_scales(partial(measured, compare_windows, sample), settings)
    more = [these[:: max(1, every // 2)] for these in inside]
    sampled = np.concatenate(more)
    xy, moved_px = points.reference_xy_px[sampled], points.displacement_px[sampled]
    jitter, displaced = jitter_px(xy, measured(compare_stripes, more) - moved_px), 0.0
    if other_px is not None:
        best_px = measured(partial(compare_surroundings, other_px=other_px), more)[0]
        displaced = share_displaced(best_px - moved_px, other_px)
    return scales, errors, jitter, displaced


def _predict_on(
    runner: Runner, on_event: EventCallback, xy: Float64, moved: Float64, at: Float64, surface: Surface
) -> Prediction:
    """Do what `field.predict` does, shared out where there are many places."""
    warn = partial(only_warnings, on_event)  # of lost workers; the progress is no stage's own
    size = max(2000, -(-len(at) // 64))  # each is sent all points of the field
    if len(at) <= size:
        return predict(xy, moved, at, surface, runner.threads)
    calls = [(xy, moved, at[begin : begin + size], surface) for begin in range(0, len(at), size)]
    return Prediction.concatenate(runner.run(predict, calls, "refining", warn))


def _match_settings(
    pair: ViewPair, offset: tuple[int, int], prealignment: Prealignment, settings: Settings, log: JobLog
) -> MatchSettings:
    region = common_region(pair, offset)
    rows, cols = region.rows, region.cols
    if prealignment.method in ("georeferencing", "pose"):  # a resampled view reaches beyond the overlap
        rows, cols = min(rows, pair.overlap.rows), min(cols, pair.overlap.cols)
    narrow = min(rows, cols)
    if narrow < MIN_WINDOW_PX:
        raise InputError(
            f"the common area is {cols} x {rows} px of the matching grid: too small to match "
            f"(at least {MIN_WINDOW_PX} px a side); use rasters that share more ground"
        )
    template, window = settings.template, settings.window or FIRST_WINDOW_PX
    most = max(MIN_WINDOW_PX, int(narrow / WINDOWS_ACROSS) // 2 * 2 - 1)
    if max(template, window) > most:
        template, window = min(template, most), min(window, most)
        log.warn(
            f"narrow overlap of {narrow} px: matching windows shrunk to {template} px (coarse), "
            f"{window} px (fine)"
        )
    margin = round(0.4 * template)
    others = _other_windows(settings, window, narrow)
    return MatchSettings(
        method=settings.method,
        features=settings.features if settings.points is None else settings.candidates,
        keypoints=settings.keypoints,
        features_area_px2=float(max((rows - margin) * (cols - margin), 1)),
        template=template,
        window=window,
        other_windows=others,
        open_window=others[: len(OTHER_WINDOWS_PX)] == OTHER_WINDOWS_PX,
        search_radius=min(prealignment.search_radius_px, farthest_px(pair, offset)),
        ssim_min=settings.ssim_min,
        iterations=settings.iterations,
        consensus=settings.consensus,
        backward="sample" if settings.points in ("all", "dense") else "as needed",
    )


def _other_windows(settings: Settings, window_px: int, narrow_px: int) -> tuple[int, ...]:
    """Return what some points are matched with beside the first window.

    If that is not given, it is what the second pass may choose from, unless the overlap, `narrow_px` wide, is
    narrow for it. Otherwise smaller windows tell the error of the given one. None where points are
    not guided.
    """
    if TRAITS[settings.method].structure != "local" or settings.consensus == "off":
        return ()
    if settings.window is None and narrow_px >= CHOSEN_ACROSS * max(OTHER_WINDOWS_PX):
        fitting = (window for window in LARGE_WINDOWS_PX if WINDOWS_ACROSS * window <= narrow_px)
        return *OTHER_WINDOWS_PX, *fitting
    return tuple(int(share * window_px) // 2 * 2 + 1 for share in SMALLER_WINDOWS)


def _sum_counts(results: Sequence[TileResult]) -> dict[str, int]:
    total: dict[str, int] = {"tiles": len(results), "candidates": 0}
    for result in results:
        for name, count in result.counts.items():
            total[name] = total.get(name, 0) + count
    return total


def _warn_of_failures(results: Sequence[TileResult], log: JobLog) -> None:
    failed = [result for result in results if result.status == "failed"]
    if failed and len(failed) == len(results):
        raise InputError(failed[0].reason or "no tile could be read")
    for result in failed:
        log.warn(f"tile {result.id} left out: {result.reason}")


def match_from_best_start(
    pair: ViewPair, overviews: Overviews, settings: Settings, log: JobLog, runner: Runner
) -> tuple[Matched, ViewPair]:
    """Match from the best start known; where that fails and the user left it open, from searches.

    The second result are the views that were matched: those given, or others where the target was found in
    another pose.
    """
    best: tuple[Matched, StartingAlignment] | None = None
    searched, tried = False, 0
    for start in _starts(pair, overviews, settings, log):
        searched |= start is None or start.prealignment.searched
        if start is None:
            continue
        tried += 1
        start = replace(start, prealignment=replace(start.prealignment, searched=searched, tried=tried))
        try:
            result = match_scene(start, settings, log, runner)
        except InputError:
            if start.prealignment.pose is None:
                raise
            continue  # a pose in which too little is common
        if result.verdict.accepted and start.prealignment.pose is not None:
            result, start = _match_again_in_pose(result, start, settings, log, runner)
        if result.verdict.accepted:
            result = _compare_with_rivals(result, start, settings, log, runner)
            doubts = result.doubts
            result = replace(_select_ground_motion(result, start, settings, log, runner), doubts=doubts)
            if result.verdict.accepted:
                result = _reach_all_ground(result, start, settings, log, runner)
                _warn_of_start(pair, result.prealignment, log)
            return result, start.pair
        if best is None or result.verdict.significance >= best[0].verdict.significance:
            best = result, start
    if best is None:
        raise InputError("no start for the matching: give --prealign auto")
    result, used = best
    final = replace(result.prealignment, searched=searched, tried=tried)
    few_values = _with_few_values(pair, overviews)
    reason = refusal(result.verdict, final, georeferenced=pair.georeferenced, few_values=few_values)
    reason += _sizes_note(pair) if searched else ""
    return replace(result, prealignment=final, verdict=replace(result.verdict, reason=reason)), used.pair


def _with_few_values(pair: ViewPair, overviews: Overviews) -> list[str]:
    """Return the names of those of two rasters that are masks or maps of classes."""
    both = (pair.reference, overviews.reference), (pair.target, overviews.target)
    return [file_name(view.info.uri) for view, patch in both if has_few_values(patch)]


def _sizes_note(pair: ViewPair) -> str:
    """Return what a refusal says of two frames whose sizes differ much, but not why; empty of others."""
    _, guessed = scales_of_frames(pair)
    if guessed is None:
        return ""
    larger, ratio = ("reference", 1 / guessed) if guessed < 1 else ("target", guessed)
    return (
        f". The pixels of the {larger} may be {ratio:.1f} times as small, and scales about that were tried "
        "too: if neither a quarter to four times that nor ¼ to 4 is theirs, reduce the larger frame first "
        "(gdal_translate -outsize)"
    )


def _starts(
    pair: ViewPair, overviews: Overviews, settings: Settings, log: JobLog
) -> Iterator[StartingAlignment | None]:
    """Yield what to start from, the best first; None where a search finds nothing credible."""
    radius = settings.search_radius
    direct = StartingAlignment(direct_start(pair, settings), pair, overviews)
    search_first = searches_first(pair, settings)
    if not search_first:
        yield direct
    if settings.start_matcher is not None and settings.prealign in ("auto", "search") and can_be_posed(pair):
        with log.stage("prealignment"):
            matcher = load_start_matcher(settings.start_matcher)
            proposed = proposed_start(pair, matcher, settings.start_matcher, radius)
        yield proposed
    posed, guessed = None, None
    if search_first or (settings.prealign == "auto" and radius is None):
        with log.stage("prealignment"):
            log.on_event(Progress("prealignment", 0, 1))
            found, _ = by_search(pair, overviews, radius)
            log.on_event(Progress("prealignment", 1, 1))
        yield None if found is None else StartingAlignment(found, pair, overviews)
        if can_be_posed(pair):
            with log.stage("prealignment"):
                expected, guessed = scales_of_frames(pair)
                posed = PoseStarts(pair, overviews, settings, expected)
                start = posed.by_structure()
            yield start
    if search_first:
        yield direct
    elif (start := direct.by_tones(settings)) is not None:
        yield start
    if posed is not None:
        yield from _starts_by_grey_values(posed, log)
    if guessed is not None:
        with log.stage("prealignment"):
            posed = PoseStarts(pair, overviews, settings, guessed)
            start = posed.by_structure()
        yield start
        yield from _starts_by_grey_values(posed, log)


def _starts_by_grey_values(posed: PoseStarts, log: JobLog) -> Iterator[StartingAlignment]:
    starts = posed.by_grey_values()
    while True:
        with log.stage("prealignment"):
            start = next(starts, None)
        if start is None:
            return
        yield start


def _match_again_in_pose(
    matched: Matched, start: StartingAlignment, settings: Settings, log: JobLog, runner: Runner
) -> tuple[Matched, StartingAlignment]:
    """Match a target again in the pose that the tie points tell, until that no longer moves.

    The first pose is only as good as the search: in it the windows are turned and scaled by some percent, and
    it may know no perspective. A pose of doubtful evidence has to pass twice: all correct ones of the
    pose set do; a false one, of a wall and a path in an image beside its mirror image, passed only once. One
    that `must_stand` has to pass each time.
    """
    must_stand = start.must_stand
    for number in range(3):
        points, before = matched.matches[matched.kept], matched.prealignment
        reference = start.pair.reference
        as_it_is = np.eye(3)
        as_it_is[:2, 2] = start.pair.offset_px
        try:
            matrix = pose_from_points(points, frames=reference.info.grid.crs is None)
            again = posed_start(start.pair, matrix, before.search_radius_px)
            again = (again.by_tones(settings) or again) if start.matches_tones else again
            told = again.prealignment
            prealignment = replace(before, pose=told.pose, matched_by=told.matched_by)
            found = match_scene(replace(again, prealignment=prealignment), settings, log, runner)
        except InputError:  # points in a corner of the overlap tell no pose of the whole
            break
        if not found.verdict.accepted:
            doubtful = number == 0 and is_doubtful(before.net_evidence)
            return (found, again) if doubtful or must_stand else (matched, start)
        matched, start = found, again
        moved_px = mean_distance_px(matrix, as_it_is, reference.grid.shape)
        if not matrix[2, :2].any() and moved_px < STILL_PX:
            break
    return matched, start


def pose_from_points(points: TiePoints, *, frames: bool) -> Float64:
    """Return the (3, 3) matrix from reference to target px that fits points by least squares.

    It is a homography if both are frames, the points are many, and it fits them better than an affine pose.
    """
    here, there = points.reference_xy_px, points.target_xy_px
    matrix = np.eye(3)
    matrix[:2] = affine_between(here, there)
    if not frames or len(points) < GUIDANCE.least_points:
        return matrix
    middle = np.eye(3)
    middle[:2, 2] = here.mean(axis=0)
    homography, _ = cv2.findHomography(here - middle[:2, 2], there)
    if homography is None:
        return matrix
    homography = homography @ inverse(middle)
    placed = [ProjectiveCorrection("", each).forward(here) for each in (matrix, homography)]
    error_px2 = [((there - each) ** 2).mean() for each in placed]
    nearest = AffineCorrection("", affine_between(here, placed[1])).forward(here)
    perspective_px = np.linalg.norm(placed[1] - nearest, axis=1).max()
    better = error_px2[1] < HOMOGRAPHY_ERROR_RATIO * error_px2[0]
    return homography if better and perspective_px > MIN_PERSPECTIVE_PX else matrix


def _select_ground_motion(
    matched: Matched, start: StartingAlignment, settings: Settings, log: JobLog, runner: Runner
) -> Matched:
    """Return the matches of the motion that the ground has, refused where nothing tells which that is."""
    pair, before = start.pair, start.prealignment
    one_product, typical = of_one_product(pair.reference.info.uri, pair.target.info.uri), MotionParameters()
    if not can_be_posed(pair):  # by an RPC, which errs by more, and relief moves parts of the scene
        return replace(matched, motions=(), patches=())
    trusted = pair.georeferenced and before.pose is None and settings.prealign not in ("search", "none")
    sizes_m = middle_pixel_size_m(pair.reference.grid) if one_product else None
    error_px = (
        (typical.product_m / max(sizes_m) if sizes_m else typical.georeferenced_px) if trusted else None
    )
    motions, usual, reason = motion_of_the_ground(matched.motions, matched.kept, error_px, one_product)
    matched = replace(matched, motions=motions)
    if reason is not None:
        return replace(matched, verdict=replace(matched.verdict, accepted=False, reason=reason))
    if error_px is None or len(motions) < 2:  # parts of frames move by their depth, and are right
        return matched
    if motions[0] is not usual:  # again, beyond the reach of the others
        best = motions[0][0]
        separation_px = np.subtract([other.displacement_px for other, _ in motions[1:]], best.displacement_px)
        radius_px = min(before.search_radius_px, max(2, int(np.hypot(*separation_px.T).min() / 3)))
        shift_px, evidence = best.displacement_px, best.significance
        around = replace(before, shift_px=shift_px, search_radius_px=radius_px, evidence=evidence)
        again = match_scene(replace(start, prealignment=around), settings, log, runner)
        return replace(again, motions=motions)
    kept = matched.kept & ~np.any([near for _, near in motions[1:]], axis=0)
    counts = {**matched.counts, "inconsistent": int((~kept).sum()), "tie_points": int(kept.sum())}
    return replace(matched, kept=kept, counts=counts)


def _may_lie_elsewhere(start: StartingAlignment) -> bool:
    """Whether other displacements are asked: bands of one product, and images with RPCs, hardly err."""
    inputs = start.pair.reference.info.uri, start.pair.target.info.uri
    return can_be_posed(start.pair) and not of_one_product(*inputs)


def _compare_with_rivals(
    matched: Matched, start: StartingAlignment, settings: Settings, log: JobLog, runner: Runner
) -> Matched:
    """Return the matches at the displacement at which the whole scene fits best, where the ground repeats.

    Others that fit as well, or better and may not be taken, are a doubt.
    """
    if not _may_lie_elsewhere(start):
        return matched
    for _ in range(MOST_MOVES):
        rivals = rivals_in(start, matched.displacement_px)
        if not rivals:
            return matched
        best_px, away_px = rivals[0].shift_xy, rivals[0].shift_xy - matched.displacement_px
        moved = start_at(start, best_px, float(np.hypot(*away_px)), apart=True)
        if moved is None or not (rivals[0].is_better and may_move(settings)):
            break
        again = match_scene(moved, settings, log, runner)
        if not again.verdict.accepted:
            break
        matched = again
    return replace(matched, doubts=(doubt_of_rivals(start, matched.displacement_px, rivals),))


def _reach_all_ground(
    matched: Matched, start: StartingAlignment, settings: Settings, log: JobLog, runner: Runner
) -> Matched:
    """Return the matches of all ground, also where a connected part of it lies beyond the search.

    Where the user has bounded that, or no smooth surface holds both, the part is a doubt.
    """
    if matched.epipolar or len(matched.motions) > 1 or not _may_lie_elsewhere(start):
        return matched
    at_px, kept, found_px = matched.matches.reference_xy_px, matched.kept, matched.displacement_px
    lost_px = np.concatenate([matched.lost_px, at_px[~kept]])
    start = replace(start, prealignment=matched.prealignment)
    ground = unreached_in(start, found_px, lost_px, at_px[kept], matched.window_px)
    if ground is None:
        return matched
    between = start_at(start, (found_px + ground.shift_px) / 2, ground.distance_px, apart=False)
    if between is not None and may_move(settings):
        again = match_scene(between, settings, log, runner)
        if again.verdict.accepted and len(again.motions) < 2 and again.kept.sum() > kept.sum():
            return replace(again, doubts=matched.doubts)
    return replace(matched, doubts=(*matched.doubts, doubt_of_unreached(start, ground)))


def _warn_of_start(pair: ViewPair, prealignment: Prealignment, log: JobLog) -> None:
    if prealignment.matched_by == "grey values":
        log.warn(
            "the two share too little structure: what is matched are their grey values, and slopes and "
            "shadows may have other tones in one than in the other; tie points share an error of some "
            f"{SHARED_GREY_ERROR_PX} px per axis, which their sigmas hold"
        )
    if prealignment.method == "search" and pair.georeferenced:
        col, row = prealignment.shift_px
        log.warn(
            f"the georeferencing is off by about ({col:.0f}, {row:.0f}) px (col, row; of the "
            "coarser raster): found by a search"
        )
    elif prealignment.pose is not None and pair.georeferenced:
        predicted = jacobian(
            pair.reference.info.grid.middle_px, pair.reference.info.grid, pair.target.info.grid
        )
        pose = prealignment.pose.beside(predicted[0])
        log.warn(f"the georeferencing is off: a search found the target at {pose}, beside where that puts it")


def match_again_from_shifted_rpc(
    matched: Matched, pair: ViewPair, settings: Settings, log: JobLog, runner: Runner
) -> tuple[Matched, ViewPair]:
    """Match a target with RPC again, as the shift found so far places it.

    Where the RPC errs, the image is seen with the height of the ground beside: relief distorts the windows by
    the more, the larger the error is.
    """
    for _ in range(2):
        table = located(matched, pair, (pair.reference.info, pair.target.info))
        shift_px = np.median(table.select("matched").displacement_px, axis=0)
        if np.hypot(*shift_px) < NEAR_PX:
            break
        target = shifted(pair.target.info, shift_px)
        shifted_pair = plan_rpc_views(pair.reference.info, target)
        prealignment = by_georeferencing(settings.search_radius)
        start = StartingAlignment(prealignment, shifted_pair, read_overviews(shifted_pair))
        again = match_scene(start, settings, log, runner)
        if not again.verdict.accepted:
            break
        matched, pair = replace(again, prealignment=matched.prealignment), shifted_pair
    return matched, pair


def located(matched: Matched, pair: ViewPair, originals: tuple[RasterInfo, RasterInfo]) -> TiePointTable:
    """Return the matches in px of the original files, those that were not kept ``rejected``.

    The pair are the views that they were found on, the `originals` reference and target as their own
    georeferencing places them.
    """
    table = locate(matched.matches, pair, originals)
    return replace(table, status=np.where(matched.kept, "matched", "rejected"))
