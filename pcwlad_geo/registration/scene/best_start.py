"""A scene matched from the first start that holds."""

from __future__ import annotations

from dataclasses import replace

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import ViewPair
from pcwlad_geo.registration.advice import refusal
from pcwlad_geo.registration.rpc import relief_note
from pcwlad_geo.registration.scene.ground import compare_with_rivals, reach_all_ground, select_ground_motion
from pcwlad_geo.registration.scene.matching import SceneMatches, match_scene
from pcwlad_geo.registration.scene.parameters import SceneContext
from pcwlad_geo.registration.scene.pose import match_again_in_pose
from pcwlad_geo.registration.scene.starts import note_of_sizes, starts, warn_of_start, with_few_values
from pcwlad_geo.registration.starts.alignment import StartingAlignment
from pcwlad_geo.registration.starts.overviews import Overviews


def match_from_best_start(
    pair: ViewPair, overviews: Overviews, context: SceneContext
) -> tuple[SceneMatches, ViewPair]:
    """Match from the best start known; where that fails and the user left it open, from searches.

    The second result are the views that were matched: those given, or others where the target was found in
    another pose.
    """
    best: tuple[SceneMatches, StartingAlignment] | None = None
    searched, count = False, 0
    for start in starts(pair, overviews, context):
        searched |= start is None or start.prealignment.searched
        if start is None:
            continue
        count += 1
        start = replace(start, prealignment=replace(start.prealignment, searched=searched, tried=count))
        try:
            scene = match_scene(start, context)
        except InputError:
            if start.prealignment.pose is None:
                raise
            continue  # a pose in which too little is common
        if scene.decision.accepted and start.prealignment.pose is not None:
            scene, start = match_again_in_pose(scene, start, context, perspective=pair.in_perspective)
        if scene.decision.accepted:
            return _on_its_ground(scene, start, pair, context), start.pair
        if best is None or scene.decision.significance >= best[0].decision.significance:
            best = scene, start
    if best is None:
        raise InputError("no start for the matching: give --prealign auto")
    scene, start = best
    prealignment = replace(scene.prealignment, searched=searched, tried=count)
    few_values = with_few_values(pair, overviews)
    reason = refusal(scene.decision, prealignment, georeferenced=pair.georeferenced, few_values=few_values)
    reason += note_of_sizes(pair) if searched else ""
    note = relief_note(pair.reference.info, pair.target.info)
    reason += f"; {note}" if note else ""
    return replace(scene, prealignment=prealignment, decision=scene.decision.refused(reason)), start.pair


def _on_its_ground(
    scene: SceneMatches, start: StartingAlignment, pair: ViewPair, context: SceneContext
) -> SceneMatches:
    """Return the matches at the displacement of the ground, and of all of it, as far as that can be known."""
    scene = compare_with_rivals(scene, start, context)
    doubts = scene.decision.doubts
    scene = select_ground_motion(scene, start, context)
    scene = replace(scene, decision=replace(scene.decision, doubts=doubts))
    if scene.decision.accepted:
        scene = reach_all_ground(scene, start, context)
        warn_of_start(pair, scene.prealignment, context)
    return scene
