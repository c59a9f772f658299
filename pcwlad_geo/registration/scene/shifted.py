"""A scene matched again, as the shift that was found places the target.

Where the place of the target errs, it is seen deformed: an RPC takes the height of the ground beside, and a
map shown on another, such as degrees at a pole, is bent otherwise there. In a window the displacement then
changes, and its mean is not that of the middle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcwlad_geo.raster import Grid, RasterInfo, ViewPair, map_px
from pcwlad_geo.raster.rpc.planning import plan_rpc_views
from pcwlad_geo.registration.rpc import shifted
from pcwlad_geo.registration.scene.matching import SceneMatches, match_scene
from pcwlad_geo.registration.scene.parameters import SceneContext
from pcwlad_geo.registration.starts.alignment import StartingAlignment, by_georeferencing
from pcwlad_geo.registration.starts.overviews import read_overviews
from pcwlad_geo.tiepoints.table import TiePointTable, locate
from pcwlad_geo.types import Float64


def match_again_from_shifted_rpc(
    scene: SceneMatches, pair: ViewPair, context: SceneContext
) -> tuple[SceneMatches, ViewPair]:
    """Match a target with RPC again, as the shift found so far places it."""
    for _ in range(2):
        shift_px = _shift_px(scene, pair)
        if np.hypot(*shift_px) < context.parameters.near_px:
            break
        shifted_pair = plan_rpc_views(pair.reference.info, shifted(pair.target.info, shift_px))
        latest = _matched(shifted_pair, context)
        if not latest.decision.accepted:
            break
        scene, pair = replace(latest, prealignment=scene.prealignment), shifted_pair
    return scene, pair


def match_again_on_bent_map(
    scene: SceneMatches, pair: ViewPair, context: SceneContext
) -> tuple[SceneMatches, ViewPair]:
    """Match a target that is seen on another map again, where that bends the shift found within windows.

    What was decided about the scene stays. Two maps of a small region bend the shift by nothing that can be
    measured, and are not matched again.
    """
    target = pair.target.info
    one_motion = len(scene.motions) <= 1 and not scene.patches
    if not one_motion or scene.prealignment.pose is not None or type(target.grid) is not Grid:
        return scene, pair
    if pair.target.grid is target.grid or not target.georeferenced:
        return scene, pair
    shift_px = _shift_px(scene, pair)
    if _bend_px(scene, pair, shift_px) < context.parameters.bent_px:
        return scene, pair
    placed = replace(target, grid=target.grid.part((-shift_px[0], -shift_px[1]), target.grid.shape))
    placed_pair = replace(pair, target=replace(pair.target, info=placed))
    latest = _matched(placed_pair, context)
    if not latest.decision.accepted:
        return scene, pair
    rematched = replace(
        latest, prealignment=scene.prealignment, decision=scene.decision, motions=scene.motions
    )
    return rematched, placed_pair


def _matched(pair: ViewPair, context: SceneContext) -> SceneMatches:
    prealignment = by_georeferencing(context.settings.search_radius)
    return match_scene(StartingAlignment(prealignment, pair, read_overviews(pair)), context)


def _shift_px(scene: SceneMatches, pair: ViewPair) -> Float64:
    """Return the (2,) median displacement (col, row) of the tie points, target px."""
    table = located(scene, pair, (pair.reference.info, pair.target.info))
    return np.asarray(np.median(table.select("matched").displacement_px, axis=0))


def _bend_px(scene: SceneMatches, pair: ViewPair, shift_px: Float64) -> float:
    """Return by how much windows measure a (2,) shift of the target (col, row) wrong, the median, view px.

    To the second order, the mean over a square window differs from its middle as that of four places does
    that lie a root of a sixth of its side away.
    """
    view, target = pair.reference.grid, pair.target.info.grid
    away_px = scene.window_px / np.sqrt(6.0)
    around_px = away_px * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    points_px = scene.matches.reference_xy_px[scene.consistent]
    at_px = (points_px[:: max(1, len(points_px) // 64), None] + around_px).reshape(-1, 2)
    moved_px = map_px(map_px(at_px, view, target) + shift_px, target, view) - at_px
    moved_px = moved_px.reshape(-1, 5, 2)
    bend_px = np.hypot(*(moved_px[:, 1:].mean(axis=1) - moved_px[:, 0]).T)
    return float(np.median(bend_px[np.isfinite(bend_px)])) if np.isfinite(bend_px).any() else 0.0


def located(scene: SceneMatches, pair: ViewPair, originals: tuple[RasterInfo, RasterInfo]) -> TiePointTable:
    """Return the matches in px of the original files, the inconsistent ones ``rejected``.

    The pair are the views that they were found on, the `originals` reference and target as their own
    georeferencing places them. Those are inconsistent, too, that a map which ends there, as at 180 degrees,
    displaces by half an image more than others.
    """
    table = locate(scene.matches, pair, originals)
    consistent = scene.consistent
    if scene.prealignment.pose is None and consistent.any():  # in a pose displacements differ by that much
        lengths_px = np.hypot(*table.displacement_px.T)
        half_px = max(pair.target.info.grid.shape) / 2
        consistent = consistent & (lengths_px <= np.median(lengths_px[consistent]) + half_px)
    return replace(table, status=np.where(consistent, "matched", "rejected"))
