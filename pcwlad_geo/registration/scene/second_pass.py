"""The second pass of a scene: the consistent points again, guided by the field of all of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pcwlad_geo.events import EventCallback, only_warnings
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.matching import FieldGuide, MatchSettings, Scales, TiePoints, guide_by_field
from pcwlad_geo.matching.calibration import calibrate
from pcwlad_geo.matching.epipolar import on_their_lines
from pcwlad_geo.matching.field import Prediction, Surface, predict
from pcwlad_geo.matching.guidance import GUIDANCE, Predictor
from pcwlad_geo.matching.lost_candidates import Lost, can_try_again, expect_lost
from pcwlad_geo.matching.outliers import confirmed, consistent_points
from pcwlad_geo.matching.second_pass import matched_again
from pcwlad_geo.registration.motions import other_displacement
from pcwlad_geo.registration.scene.first_pass import FirstPass, warn_of_failures
from pcwlad_geo.registration.scene.parameters import SceneContext
from pcwlad_geo.registration.scene.windows import choose_windows
from pcwlad_geo.registration.tiles import rematch_tile
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True, eq=False)
class SecondPass:
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
    bend_px: float
    """See `SceneMatches`."""
    other_motion: tuple[Float64, Bool] | None
    """See `motions.other_displacement`; None where too few points lie at it."""

    def part(self, mask: Bool) -> SecondPass:
        """Return those of the (n,) `mask`."""
        names = "points", "match_of", "lost_of", "recovered"
        return replace(self, **{name: getattr(self, name)[mask] for name in names})


@dataclass(frozen=True, slots=True, eq=False)
class _Retry:
    """Candidates that the second pass tries once more: those without a match, and inconsistent matches."""

    candidates: Lost
    tile_of: Index
    """(n,) their tiles."""
    match_of: Index
    """(n,) see `SecondPass`."""
    lost_of: Index
    """(n,) likewise."""


def run_second_pass(
    first: FirstPass,
    matches: TiePoints,
    consistent: Bool,
    matching: MatchSettings,
    with_retry: bool,
    context: SceneContext,
) -> SecondPass:
    """Match the consistent points again, guided by the field of all of them.

    The (n,) mask `consistent` is of the matches of the first pass. Candidates without a match are tried once
    more if that is wanted.
    """
    log, runner, motions = context.log, context.runner, context.parameters.motions
    index, predictor = np.flatnonzero(consistent), partial(_predict_on, runner, log.on_event)
    points, tile_of = matches[index], first.tile_of[index]
    guide = guide_by_field(points, matching, predictor, runner.threads)
    other_motion = other_displacement(matches, consistent, motions)
    other_px = None if other_motion is None else other_motion[0]
    choice = choose_windows(first, points, tile_of, guide, other_px, context)
    scales = choice.scales
    retry = _retried(first, matches, consistent, guide, matching, predictor) if with_retry else None
    # points of which nothing is new to say need no visit
    rematched = matched_again(guide, matching) | (scales != Scales.of(matching.window.side_px))
    tiles_of_all = [tile_of[rematched]] if retry is None else [tile_of[rematched], retry.tile_of]
    tiles, nothing = np.unique(np.concatenate(tiles_of_all)), np.zeros(0, np.intp)
    parts = [np.flatnonzero(rematched & (tile_of == tile)) for tile in tiles]
    retries = [np.flatnonzero(retry.tile_of == tile) if retry else nothing for tile in tiles]
    calls = [
        (
            first.jobs[tile],
            points[part],
            guide.part(part),
            scales,
            retry.candidates.part(rows) if retry else None,
        )
        for tile, part, rows in zip(tiles, parts, retries, strict=True)
    ]
    results = runner.run(rematch_tile, calls, "refining", log.on_event) if calls else []
    warn_of_failures(results, log)
    target, covariance = points.target_xy_px.copy(), points.covariance_px2.copy()
    unread = np.zeros(len(points), bool)
    for part, result in zip(parts, results, strict=True):
        target[part], covariance[part] = result.points.target_xy_px, result.points.covariance_px2
        unread[part] = result.status == "failed"
    refined = replace(points, target_xy_px=target, covariance_px2=covariance)
    successes = [rows[result.saved_from] for rows, result in zip(retries, results, strict=True)]
    recovered = np.concatenate([nothing, *successes])
    joined = SecondPass(
        points=TiePoints.concatenate([refined, *(result.saved for result in results)]),
        match_of=np.concatenate([index, retry.match_of[recovered] if retry else nothing]),
        lost_of=np.concatenate([np.full(len(index), -1), retry.lost_of[recovered] if retry else nothing]),
        recovered=np.repeat([False, True], [len(index), len(recovered)]),
        surface=guide.surface,
        shared_variance_px2=guide.shared_variance_px2 + first.tones_variance_px2,
        incomplete=bool(unread.any()),
        scales=scales,
        window_variance_px2=None if choice.errors is None else choice.errors.variance_px2(scales),
        jitter_px=choice.jitter_px,
        bend_px=0.0 if choice.errors is None else choice.errors.bend_px(scales),
        other_motion=other_motion if choice.displaced_share >= motions.displaced_share else None,
    )
    return joined.part(~np.concatenate([unread, np.zeros(len(recovered), bool)]))


def _predict_on(
    runner: Runner, on_event: EventCallback, xy: Float64, displacement: Float64, at: Float64, surface: Surface
) -> Prediction:
    """Do what `field.predict` does, shared out where there are many places."""
    warn = partial(only_warnings, on_event)  # of lost workers; the progress is no stage's own
    size = max(2000, -(-len(at) // 64))  # each is sent all points of the field
    if len(at) <= size:
        return predict(xy, displacement, at, surface, runner.threads)
    calls = [(xy, displacement, at[begin : begin + size], surface) for begin in range(0, len(at), size)]
    return Prediction.concatenate(runner.run(predict, calls, "refining", warn))


def check_second_pass(
    second: SecondPass, matches: TiePoints, matching: MatchSettings, epipolar: bool
) -> tuple[TiePoints, Bool, SecondPass]:
    """Check and calibrate what the second pass gave.

    Return the matches given, then the recovered candidates, rejected ones where the first pass put them, with
    their formal covariance; the (n,) mask of the consistent ones; and the pass of these alone.
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
    refined = replace(
        matches, target_xy_px=target, covariance_px2=covariance, forward_backward_px=forward_backward
    )
    consistent = np.zeros(len(matches) + np.count_nonzero(~old), bool)
    consistent[index], consistent[len(matches) :] = True, True
    return TiePoints.concatenate([refined, good[~old]]), consistent, second


def _retried(
    first: FirstPass,
    matches: TiePoints,
    consistent: Bool,
    guide: FieldGuide,
    matching: MatchSettings,
    predictor: Predictor,
) -> _Retry | None:
    """Return what is matched once more; None if the neighbours cannot predict where it lies.

    The (n,) mask `consistent` is of the matches of the first pass.
    """
    if np.count_nonzero(consistent) < GUIDANCE.least_points or not can_try_again(matching):
        return None
    candidates, off = first.lost, np.flatnonzero(~consistent)
    places = np.concatenate([candidates.reference_xy_px, matches.reference_xy_px[off]])
    expected = expect_lost(places, matches[consistent], guide, matching, predictor)
    predicted = expected.guide.structure_xy_px[len(candidates) :]
    moving = confirmed(
        matches.reference_xy_px, matches.displacement_px, off, predicted, matching.window.side_px
    )
    selection = np.concatenate([np.ones(len(candidates), bool), ~moving])
    return _Retry(
        expected.part(np.flatnonzero(selection)),
        np.concatenate([first.lost_tile_of, first.tile_of[off]])[selection],
        np.concatenate([np.full(len(candidates), -1), off])[selection],
        np.concatenate([np.arange(len(candidates)), np.full(len(off), -1)])[selection],
    )
