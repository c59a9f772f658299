"""A target matched again in the pose that its tie points have."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.estimation.transforms import AffineTransform, ProjectiveTransform
from pcwlad_geo.matching import TiePoints
from pcwlad_geo.matching.guidance import GUIDANCE
from pcwlad_geo.matching.pose.distances import mean_distance_px
from pcwlad_geo.raster.grid import TiltedGrid
from pcwlad_geo.registration.judge import is_doubtful
from pcwlad_geo.registration.scene.matching import SceneMatches, match_scene
from pcwlad_geo.registration.scene.parameters import SceneContext, SceneParameters
from pcwlad_geo.registration.starts.alignment import StartingAlignment
from pcwlad_geo.registration.starts.posing import posed_start
from pcwlad_geo.types import Float64


def match_again_in_pose(
    scene: SceneMatches, start: StartingAlignment, context: SceneContext, *, perspective: bool
) -> tuple[SceneMatches, StartingAlignment]:
    """Match a target again in the pose that its tie points have, until that no longer moves.

    The first pose is only as good as the search: in it the windows are turned and scaled by some percent, and
    it may know no perspective, which is looked for where one of the two may be a photograph. A pose of
    doubtful evidence has to pass twice: all correct ones of the pose set do; a false one, of a wall and a
    path in an image beside its mirror image, passed only once. One that `must_stand` has to pass each time.
    """
    must_stand, by = start.must_stand, context.parameters
    for number in range(3):
        points, before = scene.matches[scene.consistent], scene.prealignment
        reference = start.pair.reference
        unmoved = np.eye(3)
        unmoved[:2, 2] = start.pair.offset_px
        try:
            seen_so = isinstance(start.pair.target.info.grid, TiltedGrid)
            matrix = pose_from_points(points, perspective=perspective, refine=seen_so, parameters=by)
            posed = posed_start(start.pair, matrix, before.search_radius_px)
            posed = (posed.by_tones(context.settings) or posed) if start.matches_tones else posed
            pose, matched_by = posed.prealignment.pose, posed.prealignment.matched_by
            prealignment = replace(before, pose=pose, matched_by=matched_by)
            latest = match_scene(replace(posed, prealignment=prealignment), context)
        except InputError:  # points in a corner of the overlap tell no pose of the whole
            break
        if not latest.decision.accepted:
            doubtful = number == 0 and is_doubtful(before.net_evidence, by.judge)
            return (latest, posed) if doubtful or must_stand else (scene, start)
        scene, start = latest, posed
        distance_px = mean_distance_px(matrix, unmoved, reference.grid.shape)
        if not matrix[2, :2].any() and distance_px < by.still_px:
            break
    return scene, start


def pose_from_points(
    points: TiePoints,
    *,
    perspective: bool,
    refine: bool = False,
    parameters: SceneParameters = SceneParameters(),
) -> Float64:
    """Return the (3, 3) matrix from reference to target px that fits points by least squares.

    It is a homography if there may be `perspective`, the points are many, and it fits them better than an
    affine pose, by a large change or one that is to `refine` a perspective.
    """
    reference_px, target_px = points.reference_xy_px, points.target_xy_px
    matrix = AffineTransform.fit(reference_px, target_px).matrix
    if not perspective or len(points) < GUIDANCE.least_points:
        return matrix
    middle = np.eye(3)
    middle[:2, 2] = reference_px.mean(axis=0)
    homography, _ = cv2.findHomography(reference_px - middle[:2, 2], target_px)
    if homography is None:
        return matrix
    homography = homography @ inverse(middle)
    models_px = [ProjectiveTransform(model)(reference_px) for model in (matrix, homography)]
    error_px2 = [((target_px - model_px) ** 2).mean() for model_px in models_px]
    nearest = AffineTransform.fit(reference_px, models_px[1])(reference_px)
    perspective_px = np.linalg.norm(models_px[1] - nearest, axis=1).max()
    better = error_px2[1] < parameters.homography_error_ratio * error_px2[0]
    least_px = parameters.still_px if refine else parameters.perspective_px
    return homography if better and perspective_px > least_px else matrix
