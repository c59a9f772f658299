"""A scene matched from one start, in two passes, and judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from pcwlad_geo.matching import AUTO_FEATURES, Scales, TiePoints
from pcwlad_geo.matching.epipolar import EPIPOLAR, epipolar_evidence, on_their_lines, parallax_evidence
from pcwlad_geo.matching.outliers import consistent_points
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.registration.decision import Decision, Evidence
from pcwlad_geo.registration.judge import agree_closely, judge
from pcwlad_geo.registration.match_record import MatchRecord, record_matching
from pcwlad_geo.registration.motions import Motion, motions_of, patches
from pcwlad_geo.registration.planning import plan
from pcwlad_geo.registration.scene.first_pass import run_first_pass, sum_counts
from pcwlad_geo.registration.scene.parameters import SceneContext, SceneParameters
from pcwlad_geo.registration.scene.second_pass import check_second_pass, run_second_pass
from pcwlad_geo.registration.scene.windows import match_settings
from pcwlad_geo.registration.starts.alignment import Prealignment, StartingAlignment, target_offset_px
from pcwlad_geo.registration.tiles import TileJob
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True, eq=False)
class SceneMatches:
    """What the tiles gave, merged."""

    matches: TiePoints
    """All of the first pass, view px; the consistent ones as the second pass left them."""
    consistent: Bool
    """(n,) which of them agree with their neighbours, or with the epipolar lines."""
    counts: dict[str, int]
    decision: Decision
    """By what the tiles gave."""
    prealignment: Prealignment
    record: MatchRecord
    """Of the first pass."""
    window_px: int
    """Side of the window of the last pass."""
    epipolar: bool = False
    """Whether they agree with their epipolar lines, which allow every depth."""
    motions: Sequence[tuple[Motion, Bool]] = ()
    """What parts of the matches agree on, see `motions_of`; the one that was taken comes first."""
    patches: Sequence[Motion] = ()
    """The motion taken, and that of parts smaller than a window; none where there are none."""
    jitter_px: float = 0.0
    """By how much rows and columns move within a window, RMS, view px."""
    bend_px: float = 0.0
    """What windows average away of a displacement that bends within them, RMS, view px."""
    job: TileJob | None = None
    """One of the tiles, as all were matched."""
    scales: Scales | None = None
    """The windows of the last pass; None where there was none."""
    lost_px: Float64 = field(default_factory=lambda: np.empty((0, 2)))
    """(n, 2) candidates of the first pass that gave no match, view px of the reference (col, row)."""
    first_only: bool = False
    """Whether the first candidates of a small image agreed, so that no others were matched."""

    @property
    def needs_smaller_windows(self) -> bool:
        """Whether smaller windows may give the places that are missing."""
        return self.decision.evidence is not None and self.decision.evidence.smaller_windows

    @property
    def displacement_px(self) -> Float64:
        """(2,) median (col, row) of the consistent ones, target view px minus reference view px."""
        return np.asarray(np.median(self.matches.displacement_px[self.consistent], axis=0))


def match_scene(start: StartingAlignment, context: SceneContext) -> SceneMatches:
    """Match all tiles of a scene from one start, and judge what they gave.

    Where the first candidates of a small image agree, but leave the decision or the motion of the ground
    open, all are matched. Where the points agree closely in too few places, and the size of the windows is
    not given, the scene is matched again with smaller windows, of which more fit into the same ground, and
    judged by these.
    """
    scene, by = _match_with_windows(start, context), context.parameters
    if scene.first_only and (not scene.decision.accepted or len(scene.motions) > 1 or scene.patches):
        context = context.with_settings(features=context.settings.features or AUTO_FEATURES)
        scene = _match_with_windows(start, context)
    settings, latest = context.settings, scene
    while (
        settings.matching_window.is_open
        and latest.needs_smaller_windows
        and latest.window_px > by.least_window_px
    ):
        window_px = max(by.least_window_px, int(by.few_places_share * latest.window_px) // 2 * 2 + 1)
        smaller = context.with_settings(window=window_px, template=min(settings.template, window_px))
        latest = _match_with_windows(start, smaller)
        if latest.decision.accepted:
            points = latest.matches[latest.consistent]
            if not agree_closely(points, by.judge):  # edges of nodata pull small windows apart
                break
            context.log.warn(
                f"windows of {scene.window_px} px give too few separate places to judge by: matched again "
                f"with windows of {window_px} px"
            )
            return latest
    return scene


def _match_with_windows(start: StartingAlignment, context: SceneContext) -> SceneMatches:
    """Match a scene once.

    Every candidate is matched on its own (`run_first_pass`), and those that agree with their neighbours are
    judged. If they are accepted, they are matched again, guided by the field of all of them, and candidates
    without a match are tried once more where that predicts their place (`run_second_pass`); the outcome is
    checked and calibrated (`check_second_pass`).
    """
    pair, overviews, prealignment = start.pair, start.overviews, start.prealignment
    offset, log, by = target_offset_px(pair, prealignment), context.log, context.parameters
    matching = match_settings(pair, offset, prealignment, context)
    planned = plan(pair, overviews, offset, matching, context.settings, by.plan)
    with log.stage("matching"):
        first = run_first_pass(planned, context)
    matches, counts = first.matches, sum_counts(first.results)
    consistent = consistent_points(matches, matching) if len(matches) else np.zeros(0, bool)
    judged = partial(
        judge,
        window_px=matching.window.side_px,
        radius_px=prealignment.search_radius_px,
        evidence=prealignment.net_evidence,
        parameters=by.judge,
    )
    decision, second = judged(matches, consistent, counts), None
    consistent, decision, epipolar = _by_geometry(
        matches, consistent, decision, start, matching.window.side_px, context
    )
    if decision.accepted:
        with log.stage("refining"):
            second = run_second_pass(first, matches, consistent, matching, not planned.sites, context)
            fine = replace(matching, window=MatchingWindow(second.scales.window_px))
            matches, consistent, checked = check_second_pass(second, matches, fine, epipolar)
        first = first.without(checked.lost_of[checked.lost_of >= 0])
        counts = {**sum_counts(first.results), "second_try": int(checked.recovered.sum())}
        if second.incomplete:  # do the others suffice?
            decision = judged(first.matches, consistent[: len(first.matches)], counts)
    counts |= {"inconsistent": int((~consistent).sum()), "tie_points": int(consistent.sum())}
    record = record_matching(
        pair, overviews, offset, matching, planned.without_structure, first.jobs, first.results, by.record
    )
    scene = SceneMatches(
        matches=matches,
        consistent=consistent,
        counts=counts,
        decision=decision,
        prealignment=prealignment,
        record=record,
        window_px=second.scales.window_px if second else matching.window.side_px,
        epipolar=epipolar,
        jitter_px=second.jitter_px if second else 0.0,
        bend_px=second.bend_px if second else 0.0,
        job=first.jobs[0] if first.jobs else None,
        scales=second.scales if second else None,
        lost_px=first.lost.reference_xy_px,
        first_only=any(result.first_only for result in first.results),
    )
    other_motion = second.other_motion if second else None
    return scene if epipolar else _with_motions(scene, other_motion, start, matching.window.side_px, by)


def _with_motions(
    scene: SceneMatches,
    other_motion: tuple[Float64, Bool] | None,
    start: StartingAlignment,
    window_px: int,
    by: SceneParameters,
) -> SceneMatches:
    """Return the scene with the motions that its parts have, and those of patches smaller than a window."""
    matches, consistent = scene.matches, scene.consistent
    where = np.asarray(start.pair.offset_px, dtype=np.float64), window_px
    motions: Sequence[tuple[Motion, Bool]] = ()
    moving: Sequence[Motion] = ()
    if scene.decision.accepted:
        motions = motions_of(matches, consistent, *where, start.prealignment.search_radius_px, by.motions)
    if other_motion:
        moving = patches(matches, consistent, other_motion, *where, by.motions)
    return replace(scene, motions=motions, patches=moving)


def _by_geometry(
    matches: TiePoints,
    consistent: Bool,
    decision: Decision,
    start: StartingAlignment,
    window_px: int,
    context: SceneContext,
) -> tuple[Bool, Decision, bool]:
    """Return the consistent matches, the decision, and whether both are by epipolar lines.

    Otherwise they are by a smooth field. Left open, the lines decide for frames alone that are accepted
    without them.
    """
    pair, prealignment, geometry = start.pair, start.prealignment, context.settings.geometry
    least = context.parameters.judge.least_significance
    frames = pair.reference.info.grid.crs is None and not (pair.georeferenced and prealignment.pose is None)
    by_lines = geometry == "epipolar"
    if geometry == "auto" and frames and decision.accepted:
        by_lines = parallax_evidence(matches, consistent, window_px) >= least
    if not by_lines:
        return consistent, decision, False
    on_lines = on_their_lines(matches)
    significance = (
        epipolar_evidence(matches, window_px, prealignment.search_radius_px) + prealignment.net_evidence
    )
    if not decision.accepted and on_lines.sum() >= EPIPOLAR.least_matches and significance >= least:
        evidence = Evidence(0, 0, significance)
        if decision.evidence is not None:
            evidence = replace(decision.evidence, significance=significance, past_search_border=None)
        decision = Decision(None, evidence)
    return on_lines, decision, True
