"""Which of several displacements the ground has, and whether all of it was reached."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcwlad_geo.matching import AUTO_FEATURES
from pcwlad_geo.products.finding import of_one_product
from pcwlad_geo.raster import middle_pixel_size_m
from pcwlad_geo.registration.decision import with_doubts
from pcwlad_geo.registration.motions import motion_of_the_ground
from pcwlad_geo.registration.rivals import (
    doubt_of_rivals,
    doubt_of_unreached,
    may_move,
    rivals_in,
    start_at,
    unreached_in,
)
from pcwlad_geo.registration.scene.matching import SceneMatches, match_scene
from pcwlad_geo.registration.scene.parameters import SceneContext
from pcwlad_geo.registration.starts.alignment import StartingAlignment
from pcwlad_geo.registration.starts.posing import can_be_posed


def select_ground_motion(
    scene: SceneMatches, start: StartingAlignment, context: SceneContext
) -> SceneMatches:
    """Return the matches of the motion that the ground has, refused where nothing tells which that is."""
    pair, before, settings = start.pair, start.prealignment, context.settings
    one_product, by = of_one_product(*_inputs(start)), context.parameters.motions
    if not can_be_posed(pair):  # by an RPC, which errs by more, and relief moves parts of the scene
        return replace(scene, motions=(), patches=())
    trusted = pair.georeferenced and not pair.by_hand and before.pose is None
    trusted = trusted and settings.prealign not in ("search", "none")
    sizes_m = middle_pixel_size_m(pair.reference.grid) if one_product else None
    typical_px = by.product_m / max(sizes_m) if sizes_m else by.georeferenced_px
    error_px = typical_px if trusted else None
    motions, usual, reason = motion_of_the_ground(scene.motions, scene.consistent, error_px, one_product, by)
    scene = replace(scene, motions=motions)
    if reason is not None:
        return replace(scene, decision=scene.decision.refused(reason))
    if error_px is None or len(motions) < 2:  # parts of frames move by their depth, and are right
        return scene
    if motions[0] is not usual:  # again, beyond the reach of the others
        best = motions[0][0]
        separation_px = np.subtract([other.displacement_px for other, _ in motions[1:]], best.displacement_px)
        radius_px = min(before.search_radius_px, max(2, int(np.hypot(*separation_px.T).min() / 3)))
        shift_px, evidence = best.displacement_px, best.significance
        around = replace(before, shift_px=shift_px, search_radius_px=radius_px, evidence=evidence)
        return replace(match_scene(replace(start, prealignment=around), context), motions=motions)
    consistent = scene.consistent & ~np.any([members for _, members in motions[1:]], axis=0)
    count = int(consistent.sum())
    counts = {**scene.counts, "inconsistent": len(consistent) - count, "tie_points": count}
    return replace(scene, consistent=consistent, counts=counts)


def _may_lie_elsewhere(start: StartingAlignment) -> bool:
    """Whether other displacements are asked: bands of one product, and images with RPCs, hardly err."""
    return can_be_posed(start.pair) and not of_one_product(*_inputs(start))


def _inputs(start: StartingAlignment) -> tuple[str, str]:
    return start.pair.reference.info.uri, start.pair.target.info.uri


def compare_with_rivals(scene: SceneMatches, start: StartingAlignment, context: SceneContext) -> SceneMatches:
    """Return the matches at the displacement at which the whole scene fits best, where the ground repeats.

    Others that fit as well, or better and may not be taken, are a doubt.
    """
    if not _may_lie_elsewhere(start):
        return scene
    by = context.parameters.rivals
    for _ in range(context.parameters.most_moves):
        rivals = rivals_in(start, scene.displacement_px)
        if not rivals:
            return scene
        best_px, distance_px = rivals[0].shift_xy, np.hypot(*(rivals[0].shift_xy - scene.displacement_px))
        rival_start = start_at(start, best_px, float(distance_px), separately=True, parameters=by)
        if rival_start is None or not (rivals[0].is_better and may_move(context.settings)):
            break
        rival = match_scene(rival_start, context)
        if not rival.decision.accepted:
            break
        scene = rival
    doubt = doubt_of_rivals(start, scene.displacement_px, rivals, by)
    return replace(scene, decision=with_doubts(scene.decision, doubt))


def reach_all_ground(scene: SceneMatches, start: StartingAlignment, context: SceneContext) -> SceneMatches:
    """Return the matches of all ground, also where a connected part of it lies beyond the search.

    Where the user has bounded that, or no smooth surface holds both, the part is a doubt.
    """
    if scene.epipolar or len(scene.motions) > 1 or not _may_lie_elsewhere(start):
        return scene
    at_px, consistent, by = scene.matches.reference_xy_px, scene.consistent, context.parameters.rivals
    lost_px = np.concatenate([scene.lost_px, at_px[~consistent]])
    start = replace(start, prealignment=scene.prealignment)
    ground = unreached_in(start, scene.displacement_px, lost_px, at_px[consistent], scene.window_px, by)
    if ground is None:
        return scene
    middle_px = (scene.displacement_px + ground.shift_px) / 2
    between = start_at(start, middle_px, ground.distance_px, separately=False, parameters=by)
    if between is not None and may_move(context.settings):
        if not scene.first_only:  # else fewer candidates might give fewer points of more ground
            settings = replace(context.settings, features=context.settings.features or AUTO_FEATURES)
            context = replace(context, settings=settings)
        whole = match_scene(between, context)
        more = whole.consistent.sum() > consistent.sum()
        if whole.decision.accepted and len(whole.motions) < 2 and more:
            return replace(whole, decision=with_doubts(whole.decision, *scene.decision.doubts))
    doubts = (*scene.decision.doubts, doubt_of_unreached(start, ground))
    return replace(scene, decision=replace(scene.decision, doubts=doubts))
