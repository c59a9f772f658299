"""All tiles of a scene, matched twice: each point on its own, then guided by all of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.field import Prediction, Surface, predict
from pcwlad_geo.matching.guidance import calibrate, guide_by_field
from pcwlad_geo.matching.matcher import consistent_points, matched_again
from pcwlad_geo.matching.settings import MatchSettings
from pcwlad_geo.matching.tie_points import TiePoints
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.registration.job_log import JobLog
from pcwlad_geo.registration.judge import Verdict, judge
from pcwlad_geo.registration.match_record import MatchRecord, record_matching
from pcwlad_geo.registration.planning import Plan, common_region, plan
from pcwlad_geo.registration.prealign import Look, target_offset_px
from pcwlad_geo.registration.progress import Event, EventCallback, Warned
from pcwlad_geo.registration.result import Prealignment
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.registration.tasks import Runner
from pcwlad_geo.registration.tiles import Guided, TileJob, TileResult, match_tile, rematch_tile

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
Index = NDArray[np.intp]

LEAST_WINDOW_PX: Final = 41
WINDOWS_ACROSS: Final = 1.6
"""An overlap narrower than this many windows gets smaller ones."""
PLACES_PER_CALL: Final = 2000
MOST_CALLS: Final = 64
"""Of the predictions of a field: each takes all its points along."""
MOST_WAVES: Final = 3
"""Of small windows: the first choices, and what follows where they give too little."""


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


@dataclass(frozen=True, slots=True, eq=False)
class _FirstPass:
    """Every candidate that found a partner, each on its own."""

    jobs: list[TileJob]
    results: list[TileResult]
    """In the order of the jobs."""
    workers: list[int | None]
    """Which worker did each job."""

    @property
    def matches(self) -> TiePoints:
        return TiePoints.concatenate([result.points for result in self.results])

    @property
    def tile_of(self) -> Index:
        """(n,) tile of each match."""
        return np.repeat(np.arange(len(self.results)), [len(result.points) for result in self.results])

    @property
    def guided(self) -> Iterator[tuple[Index, Guided]]:
        """Which matches the tiles that guide themselves have matched again, and the result."""
        begin = 0
        for result in self.results:
            if result.guided is not None:
                yield result.guided.index + begin, result.guided
            begin += len(result.points)


def match_scene(
    pair: ViewPair, look: Look, prealignment: Prealignment, settings: Settings, log: JobLog, runner: Runner
) -> Matched:
    """Match all tiles of a scene from one start, and judge what they gave."""
    offset = target_offset_px(pair, prealignment)
    matching = _match_settings(pair, offset, prealignment, settings, log)
    planned = plan(pair, look, offset, matching, settings)
    with log.stage("matching"):
        first = _first_pass(planned, log, runner)
    matches, counts = first.matches, _sum_counts(first.results)
    kept = consistent_points(matches, matching) if len(matches) else np.zeros(0, bool)
    verdict = judge(matches, kept, counts, matching.window, prealignment.search_radius_px)
    if verdict.accepted:
        with log.stage("refining"):
            again = _second_pass(first, matches, kept, matching, log, runner)
            matches, kept = _checked(again, matches, kept, matching)
        if again.lost.any():  # do the others suffice?
            verdict = judge(first.matches, kept, counts, matching.window, prealignment.search_radius_px)
    counts["inconsistent"] = int((~kept).sum())
    counts["tie_points"] = int(kept.sum())
    record = record_matching(pair, look, offset, matching, planned.barren, first.jobs, first.results)
    return Matched(matches, kept, counts, verdict, prealignment, record)


def _first_pass(planned: Plan, log: JobLog, runner: Runner) -> _FirstPass:
    """Match the tiles planned, and small windows of second choice where the first gave too little."""
    first = _FirstPass([], [], [])
    upcoming = planned.first
    for _ in range(MOST_WAVES):
        if runner.heeds_affinity:
            upcoming = [replace(job, returns=not job.guides_itself) for job in upcoming]
        ran = runner.run(match_tile, [(job,) for job in upcoming], "matching", log.on_event)
        first = _FirstPass(first.jobs + upcoming, first.results + ran.results, first.workers + ran.workers)
        upcoming = planned.following(first.results)
        if not upcoming:
            break
    _warn_of_failures(first.results, log)
    return first


@dataclass(frozen=True, slots=True, eq=False)
class _Again:
    """All matches, those of the second pass as it left them."""

    points: TiePoints
    surface: Surface | None
    shared_variance_px2: Float64
    """(n,)."""
    lost: Bool
    """(n,) in tiles that could not be read a second time."""


def _second_pass(
    first: _FirstPass, matches: TiePoints, kept: Bool, matching: MatchSettings, log: JobLog, runner: Runner
) -> _Again:
    """Match the consistent points again, guided by the field of all of them."""
    if any(True for _ in first.guided):
        return _gather(first, matches)
    return _rematch(first, matches, kept, matching, log, runner)


def _checked(
    again: _Again, matches: TiePoints, kept: Bool, matching: MatchSettings
) -> tuple[TiePoints, Bool]:
    """Return the matches with those kept that still agree, where the second pass put them, calibrated."""
    index = np.flatnonzero(kept & ~again.lost)
    final = np.zeros_like(kept)
    final[index] = consistent_points(again.points[index], matching)
    good = calibrate(again.points[final], again.surface, again.shared_variance_px2[final], matching)
    # rejected points are listed with their formal covariance
    target, covariance = matches.target_xy_px.copy(), matches.covariance_px2.copy()
    target[final], covariance[final] = good.target_xy_px, good.covariance_px2
    return replace(matches, target_xy_px=target, covariance_px2=covariance), final


def _gather(first: _FirstPass, matches: TiePoints) -> _Again:
    """Collect the second passes of tiles that guide themselves."""
    target, covariance = matches.target_xy_px.copy(), matches.covariance_px2.copy()
    shared = np.zeros(len(matches))
    for index, guided in first.guided:
        target[index], covariance[index] = guided.points.target_xy_px, guided.points.covariance_px2
        shared[index] = guided.shared_variance_px2
    surfaces = Counter(guided.surface for _, guided in first.guided for _ in range(len(guided.index)))
    surface = surfaces.most_common(1)[0][0] if surfaces else None
    points = replace(matches, target_xy_px=target, covariance_px2=covariance)
    return _Again(points, surface, shared, np.zeros(len(matches), bool))


def _rematch(
    first: _FirstPass, matches: TiePoints, kept: Bool, matching: MatchSettings, log: JobLog, runner: Runner
) -> _Again:
    """Visit the tiles again, guided by the field of all consistent points."""
    index = np.flatnonzero(kept)
    guide = guide_by_field(matches[index], matching, partial(_predict_on, runner, log.on_event))
    again = np.flatnonzero(matched_again(guide, matching))
    tile_of = first.tile_of[index[again]]
    tiles = np.unique(tile_of)
    parts = [again[tile_of == tile] for tile in tiles]
    calls = [
        (first.jobs[tile], matches[index[part]], guide.part(part))
        for tile, part in zip(tiles, parts, strict=True)
    ]
    workers = [first.workers[tile] for tile in tiles]
    results = runner.run(rematch_tile, calls, "refining", log.on_event, workers).results if calls else []
    _warn_of_failures(results, log)
    target, covariance = matches.target_xy_px.copy(), matches.covariance_px2.copy()
    lost = np.zeros(len(matches), bool)
    for part, result in zip(parts, results, strict=True):
        target[index[part]] = result.points.target_xy_px
        covariance[index[part]] = result.points.covariance_px2
        lost[index[part]] = result.status == "failed"
    points = replace(matches, target_xy_px=target, covariance_px2=covariance)
    return _Again(points, guide.surface, np.full(len(matches), guide.shared_variance_px2), lost)


def _predict_on(
    runner: Runner, on_event: EventCallback, xy: Float64, moved: Float64, at: Float64, surface: Surface
) -> Prediction:
    """Do what `field.predict` does, shared out where there are many places."""

    def warn(event: Event) -> None:  # of lost workers; the progress is no stage's own
        if isinstance(event, Warned):
            on_event(event)

    size = max(PLACES_PER_CALL, -(-len(at) // MOST_CALLS))
    if len(at) <= size:
        return predict(xy, moved, at, surface)
    calls = [(xy, moved, at[begin : begin + size], surface) for begin in range(0, len(at), size)]
    return Prediction.concatenate(runner.run(predict, calls, "refining", warn).results)


def _match_settings(
    pair: ViewPair, offset: tuple[int, int], prealignment: Prealignment, settings: Settings, log: JobLog
) -> MatchSettings:
    region = common_region(pair, offset)
    rows, cols = region.rows, region.cols
    if prealignment.method == "georeferencing":  # a resampled view reaches beyond the overlap
        rows, cols = min(rows, pair.overlap.rows), min(cols, pair.overlap.cols)
    narrow = min(rows, cols)
    if narrow < LEAST_WINDOW_PX:
        raise InputError(
            f"the common area is {cols} x {rows} px of the matching grid: too small to match "
            f"(at least {LEAST_WINDOW_PX} px a side); use rasters that share more ground"
        )
    template, window = settings.template, settings.window
    most = max(LEAST_WINDOW_PX, int(narrow / WINDOWS_ACROSS) // 2 * 2 - 1)
    if max(template, window) > most:
        template, window = min(template, most), min(window, most)
        log.warn(
            f"narrow overlap of {narrow} px: matching windows shrunk to {template} px (coarse), "
            f"{window} px (fine)"
        )
    margin = round(0.4 * template)
    return MatchSettings(
        method=settings.method,
        features=settings.features,
        keypoints=settings.keypoints,
        features_area_px2=float(max((rows - margin) * (cols - margin), 1)),
        template=template,
        window=window,
        search_radius=prealignment.search_radius_px,
        ssim_min=settings.ssim_min,
        iterations=settings.iterations,
        consensus=settings.consensus,
        backward="sample" if settings.points == "all" else "as needed",
    )


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
