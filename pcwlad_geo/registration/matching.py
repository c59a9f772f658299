"""The tie points of a pair: matched, or read from a file, and checked against what may contradict them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pcwlad_geo.correction.points import thin
from pcwlad_geo.correction.selection_parameters import SELECTION
from pcwlad_geo.events import EventCallback, JobLog, Progress, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner, one_library_thread
from pcwlad_geo.matching import TiePoints
from pcwlad_geo.matching.clusters import contradicted_clusters
from pcwlad_geo.raster import ViewPair, Window, file_px_per_px
from pcwlad_geo.registration.decision import Decision, with_doubts
from pcwlad_geo.registration.edge_sides import shared_errors
from pcwlad_geo.registration.frame_cleaning import CleanedPair, with_infos, without_marks
from pcwlad_geo.registration.frame_evidence import FrameEvidence, frame_evidence
from pcwlad_geo.registration.frame_smoothing import without_pattern
from pcwlad_geo.registration.match_record import record_ground
from pcwlad_geo.registration.motions import Motion, describe_motions
from pcwlad_geo.registration.point_file import UNKNOWN_ORIGIN, user_points
from pcwlad_geo.registration.positions import position_conflict
from pcwlad_geo.registration.quality import Doubt
from pcwlad_geo.registration.result import Matches, Pair, PairGeometry
from pcwlad_geo.registration.rpc import check_start
from pcwlad_geo.registration.scene.best_start import match_from_best_start
from pcwlad_geo.registration.scene.matching import SceneMatches, match_scene
from pcwlad_geo.registration.scene.parameters import SceneContext, SceneParameters
from pcwlad_geo.registration.scene.shifted import (
    located,
    match_again_from_shifted_rpc,
    match_again_on_bent_map,
)
from pcwlad_geo.registration.starts.alignment import Prealignment, StartingAlignment
from pcwlad_geo.registration.starts.overviews import read_overviews
from pcwlad_geo.registration.starts.parameters import START
from pcwlad_geo.registration.tiles import forget_tiles
from pcwlad_geo.tiepoints.table import TiePointTable


@dataclass(frozen=True, slots=True)
class PairParameters:
    """From which sizes on what the tie points of a pair show is warned of."""

    scene: SceneParameters = field(default_factory=SceneParameters)
    """Those of the matching of the scene."""
    parallax_ratio: float = 2.0
    """Least ratio of the displacement along the epipolar lines to that across them, where none can be."""
    parallax_px: float = 0.5
    """Least parallax, RMS, target px."""
    context_px: int = 60
    """Width around the tie points that is looked at besides, px: less than matching reads around them."""
    light_px: float = 0.12
    """Half of the distance between edges and grey values that is warned of, target px."""
    jitter_px: float = 0.05
    """Least jitter of rows and columns, RMS, target px."""


@one_library_thread()
def match_pair(
    pair: Pair,
    runner: Runner,
    *,
    on_event: EventCallback = ignore,
    parameters: PairParameters = PairParameters(),
) -> Matches:
    """Find the tie points of a pair, or read those of the file that its settings name.

    Raises `InputError` if the input cannot be read or holds nothing to match.

    Parameters
    ----------
    runner : Runner
        Runs the tiles.
    on_event : callable
        Receives progress and warnings; an exception that it raises ends the work.
    """
    log = JobLog(on_event, list(pair.warnings), dict(pair.seconds))
    path = pair.settings.tie_points
    try:
        if path:
            matches = _with_frame_evidence(_from_file(pair, path, log), log, runner, parameters)
        else:
            matches = _of_ground(pair, log, runner, parameters)
    finally:
        forget_tiles()
    matches = _with_rpc_note(_with_positions(matches))
    return replace(matches, warnings=tuple(log.warnings), seconds=log.seconds)


def _of_ground(pair: Pair, log: JobLog, runner: Runner, parameters: PairParameters) -> Matches:
    """Match a pair without what stands still in both frames."""
    with log.stage("reading"):
        cleaned = without_marks(pair, in_memory=runner.shares_memory)
    matches = _matched_as(cleaned, pair, log, runner, parameters)
    if not matches.accepted or any(doubt.grade == "poor" for doubt in matches.decision.doubts):
        return matches
    points_px = np.median(matches.tie_points.select("matched").displacement_px, axis=0)
    frames = cleaned.pair if cleaned else pair
    smooth = without_pattern(frames, points_px, in_memory=runner.shares_memory)
    of_ground = _matched_as(smooth, pair, log, runner, parameters) if smooth else matches
    return of_ground if of_ground.accepted else matches


def _matched_as(
    cleaned: CleanedPair | None, pair: Pair, log: JobLog, runner: Runner, parameters: PairParameters
) -> Matches:
    """Match a pair, or what was made of its frames, and ask whether the ground agrees."""
    frames = cleaned.pair if cleaned else pair
    if cleaned:
        log.warn(cleaned.note)
        runner = runner if runner.is_local else InThisProcess()
    matches = _without_clusters(_by_matching(frames, log, runner, parameters), log, parameters)
    matches = _with_frame_evidence(matches, log, runner, parameters)
    if not cleaned:
        return matches
    views = with_infos(matches.views, pair.views.reference.info, pair.views.target.info)
    return replace(matches, pair=pair, views=views, frames=cleaned.scratch)


def _with_frame_evidence(
    matches: Matches, log: JobLog, runner: Runner, parameters: PairParameters
) -> Matches:
    """Refuse or doubt a pair that agrees in what stands still in both frames, unless its ground is found.

    Points of a file are only doubted.
    """
    pair, evidence = matches.pair, _frame_evidence(matches, parameters)
    if evidence is None or evidence.doubt is None or _is_other_motion(evidence, matches, parameters):
        return matches
    from_file = pair.settings.tie_points is not None
    if evidence.ground_px is not None and not from_file and pair.reference.grid == pair.target.grid:
        ground = _by_matching(pair, log, runner, parameters, evidence.ground_px)
        ground = _without_clusters(ground, log, parameters)
        of_ground = _frame_evidence(ground, parameters)
        if ground.accepted and not (of_ground and of_ground.is_frame):
            col, row = evidence.ground_px
            log.warn(
                "what stands still in both frames agrees at no displacement; the ground was found about "
                f"({col:+.0f}, {row:+.0f}) px off, and is matched there"
            )
            return ground
    if evidence.is_frame and not from_file:
        return replace(matches, decision=matches.decision.refused(evidence.doubt))
    log.warn(evidence.doubt)
    return replace(matches, decision=with_doubts(matches.decision, Doubt("poor", evidence.doubt)))


def _is_other_motion(evidence: FrameEvidence, matches: Matches, parameters: PairParameters) -> bool:
    """Return whether the ground that it proposes is what moves otherwise, as clouds over it do.

    Of images with georeferencing the motions were weighed already: the ground's is likelier near none.
    """
    if evidence.ground_px is None or not matches.pair.georeferenced:
        return False
    ways = [np.subtract(motion.displacement_px, evidence.ground_px) for motion in matches.motions[1:]]
    return any(np.hypot(*way) <= parameters.scene.motions.judge.agree_px for way in ways)


def _frame_evidence(matches: Matches, parameters: PairParameters) -> FrameEvidence | None:
    """Return what speaks for the ground of accepted matches; None if nothing is to be asked."""
    if not matches.accepted:
        return None
    pair, points, within = matches.pair, matches.tie_points.select("matched"), None
    if pair.settings.extent is not None and len(points):  # nothing beyond it is read
        low_px, high_px = points.reference_px.min(axis=0), points.reference_px.max(axis=0)
        within = Window.around(low_px, high_px).padded(parameters.context_px)
    return frame_evidence(pair.reference, pair.target, points.reference_px, points.target_px, within=within)


def _with_positions(matches: Matches) -> Matches:
    """Return as many matches as are wanted, refused or doubted if the positions of the cameras contradict.

    Points of a file are only doubted.
    """
    if not matches.accepted:
        return matches
    pair, thinned = matches.pair, _thinned(matches)
    points = thinned.tie_points.select("matched")
    conflict = position_conflict(pair.reference, pair.target, points.reference_px, points.target_px)
    if conflict is None:
        return thinned
    if conflict.no_overlap and pair.settings.tie_points is None:
        return replace(matches, decision=matches.decision.refused(conflict.text))
    return replace(thinned, decision=with_doubts(thinned.decision, Doubt("poor", conflict.text)))


def _with_rpc_note(matches: Matches) -> Matches:
    """Return the matches, with a refusal that also mentions the RPC of the target."""
    refusal, rpc = matches.decision.refusal, matches.pair.rpc
    if refusal is None or rpc is None:
        return matches
    note = (
        f"{refusal}; check also that the RPC in {rpc.source.origin} belongs to the "
        "target as it is, not to an image that it was cropped or decimated from"
    )
    return replace(matches, decision=matches.decision.refused(note))


def _without_clusters(matches: Matches, log: JobLog, parameters: PairParameters) -> Matches:
    """Reject clusters of tie points that contradict what all others predict, each with a warning.

    They stay in the table as rejected, and count for the quality, as the ground may have moved there. A
    user's own points are not asked: who knows better takes the rejected ones back in such a file. Nor are
    those of an epipolar geometry, in which another depth is no contradiction.
    """
    if not matches.accepted:
        return matches
    if matches.geometry.name == "epipolar":
        _warn_of_parallax(matches.geometry, log, parameters)
        return matches
    table = matches.tie_points
    agreeing = np.flatnonzero(table.status == "matched")
    unit_px = float(file_px_per_px(matches.views.target).max())
    window_px = matches.window_px * unit_px
    predicted_px, displacement_px = table.predicted_px[agreeing], table.displacement_px[agreeing]
    clusters = contradicted_clusters(predicted_px, displacement_px, window_px, unit_px)
    if not clusters:
        return matches
    status = table.status.copy()
    for cluster in clusters:
        index = agreeing[cluster.index]
        status[index] = "rejected"
        (col, row), (d_col, d_row) = np.median(table.target_px[index], axis=0), cluster.offset_px
        log.warn(
            f"{len(index)} tie points around ({col:.0f}, {row:.0f}) px (col, row) of the target agree among "
            f"themselves and lie ({d_col:+.1f}, {d_row:+.1f}) px off what all others predict: rejected as "
            "wrong matches; if the ground has moved there, or is at another depth, they are right, and the "
            "correction does not hold there"
        )
    rejected = int((status != table.status).sum())
    counts = dict(matches.counts)
    counts["inconsistent"] += rejected
    counts["tie_points"] -= rejected
    table = replace(table, status=status)
    return replace(matches, tie_points=table, every=table, counts=counts)


def _warn_of_parallax(geometry: PairGeometry, log: JobLog, parameters: PairParameters) -> None:
    across, along = geometry.across_px, geometry.along_px
    if across is None or along is None:
        return
    if along < max(parameters.parallax_ratio * across, parameters.parallax_px):
        return
    log.warn(
        f"the displacement holds parallax: {across:.2f} px (RMS) across the epipolar lines, {along:.2f} px "
        "along them beside what one plane gives: the tie points are right at every depth, and one smooth "
        "correction cannot follow them all"
    )


def _thinned(matches: Matches) -> Matches:
    """Keep as many tie points as the user wants, spread evenly, the most precise of each neighbourhood.

    Here and nowhere else, so that what is fitted, checked, printed and written are the same points.
    """
    limit, table = matches.pair.settings.points, matches.tie_points
    if not isinstance(limit, int) or not matches.accepted:
        return matches
    thinned = table.status == "matched"
    if matches.roles is not None:  # check points are not fitted, and stay
        thinned &= matches.roles != "check"
    agreeing = np.flatnonzero(thinned)
    selected = thin(table.predicted_px[agreeing], np.hypot(*table.sigma_px[agreeing].T), int(limit))
    surplus = agreeing[~selected]
    counts = {**matches.counts, "thinned": len(surplus), "tie_points": int(selected.sum())}
    record = matches.record
    if record is not None:
        record = replace(record, thinned_px=table.reference_px[surplus])
    remaining = np.ones(len(table), dtype=bool)
    remaining[surplus] = False
    roles = None if matches.roles is None else matches.roles[remaining]
    return replace(matches, tie_points=table[remaining], counts=counts, record=record, roles=roles)


def _from_file(pair: Pair, path: Path | str, log: JobLog) -> Matches:
    with log.stage("reading"):
        points = user_points(path, pair.views)
        record = record_ground(pair.views)
    origin = points.origin
    if origin.left_out:
        log.warn(
            f"{origin.left_out} points that the matching had kept are left out of {path}: residuals of the "
            "fit are those of chosen points; the check points are still all that were held out before"
        )
    doubts = _doubts_of_motions(points.motions)
    if origin.folder is None:
        doubts = (*doubts, Doubt("fair", UNKNOWN_ORIGIN))
    return Matches(
        pair=pair,
        tie_points=points.table,
        decision=with_doubts(Decision(points.refusal), *doubts),
        counts=points.counts,
        prealignment=Prealignment("tie points of a file", (0.0, 0.0), 0),
        record=record,
        views=pair.views,
        every=points.every,
        window_px=origin.window_px or pair.settings.matching_window.side_px,
        motions=points.motions,
        jitter_px=points.jitter_px,
        bend_px=points.bend_px,
        origin=origin,
        roles=points.roles,
    )


def _by_matching(
    pair: Pair,
    log: JobLog,
    runner: Runner,
    parameters: PairParameters,
    around_px: tuple[float, float] | None = None,
) -> Matches:
    """Match a pair from the best start, or of frames around a displacement, but for none at all."""
    settings, views = pair.settings, pair.views
    context = SceneContext(settings, log, runner, parameters.scene)
    with log.stage("reading"):
        log.on_event(Progress("reading", 0, 1))
        overviews = read_overviews(views)
        log.on_event(Progress("reading", 1, 1))
    if around_px is None:
        scene, views = match_from_best_start(views, overviews, context)
    else:
        radius_px = min(START.radius_px, max(2, round(np.abs(around_px).max()) - 3))
        start = StartingAlignment(Prealignment("search", around_px, radius_px, True), views, overviews)
        scene = match_scene(start, context)
    if scene.decision.accepted:
        scene, views = _matched_at_the_shift(pair, scene, views, context)
    table = located(scene, views, (pair.views.reference.info, pair.target))
    geometry = PairGeometry.of(table, scene.epipolar and scene.decision.accepted)
    several = len(scene.motions) > 1
    motions = tuple(motion for motion, _ in scene.motions) if several else tuple(scene.patches)
    if motions and scene.decision.accepted:
        log.warn(describe_motions(motions, accepted=True))
    for doubt in scene.decision.doubts:
        log.warn(doubt.text)
    if scene.decision.accepted and geometry.name == "planar":
        points = scene.matches[scene.consistent]
        table = _with_shared_errors(table, points, views, log, parameters.light_px)
    unit_px = float(file_px_per_px(views.target).max())
    jitter_px = scene.jitter_px * unit_px
    if jitter_px >= parameters.jitter_px:
        log.warn(
            f"rows or columns are displaced against each other by {jitter_px:.2f} px (RMS) within a matching "
            "window, and a tie point is the mean over it: the raster was resampled by nearest neighbour, or "
            "its scanner shook (jitter: try a smaller --window with --model jitter)"
        )
    return Matches(
        pair=pair,
        tie_points=table,
        decision=with_doubts(scene.decision, *_doubts_of_motions(motions)),
        counts=scene.counts,
        prealignment=scene.prealignment,
        record=scene.record,
        views=views,
        every=table,
        window_px=scene.window_px,
        geometry=geometry,
        motions=motions,
        jitter_px=jitter_px,
        bend_px=scene.bend_px * unit_px,
        job=scene.job,
        scales=scene.scales,
    )


def _matched_at_the_shift(
    pair: Pair, scene: SceneMatches, views: ViewPair, context: SceneContext
) -> tuple[SceneMatches, ViewPair]:
    """Return a scene and its views, matched again where the shift found changes how the target is seen."""
    if pair.rpc is None:
        return match_again_on_bent_map(scene, views, context)
    check_start(pair.rpc, scene.prealignment, views.reference.grid, context.settings)
    return match_again_from_shifted_rpc(scene, views, context)


def _doubts_of_motions(motions: Sequence[Motion]) -> tuple[Doubt, ...]:
    return (Doubt("fair", describe_motions(motions, accepted=True)),) if motions else ()


def _with_shared_errors(
    table: TiePointTable, points: TiePoints, views: ViewPair, log: JobLog, least_light_px: float
) -> TiePointTable:
    """Return tie points whose sigmas hold the error that they share where edges or light differ."""
    errors, unit_px = shared_errors(views, points), file_px_per_px(views.target)
    sides_px, light_px = errors.of_sides_px * unit_px, errors.of_light_px * unit_px
    if sides_px.any():
        log.warn(
            f"rising and falling edges lie ({2 * sides_px[0]:.1f}, {2 * sides_px[1]:.1f}) px (col, row) "
            "apart, as where one image shows heights, or other shadows: the tie points are means of the two, "
            "and share an error of half of that, which no residual shows and their sigmas hold"
        )
    if light_px.max() >= least_light_px:
        log.warn(
            f"grey values lie ({2 * light_px[0]:.1f}, {2 * light_px[1]:.1f}) px (col, row) beside what the "
            "edges tell, as in other light: the tie points share an error of up to that, which no residual "
            "shows and their sigmas hold"
        )
    shared_px2 = np.diag((np.maximum(sides_px, light_px) / SELECTION.common_sigma) ** 2)
    return replace(table, covariance_px2=table.covariance_px2 + shared_px2) if shared_px2.any() else table
