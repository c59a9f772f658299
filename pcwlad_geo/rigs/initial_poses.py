"""Initial poses, before the adjustment: rotations of lenses, and overlaps of captures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from scipy.optimize import least_squares

from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.matching.pose.search import search_pose
from pcwlad_geo.rigs.adjustment import RigState
from pcwlad_geo.rigs.captures import Capture, Frame, read_frame
from pcwlad_geo.rigs.lens import Lens, lattice
from pcwlad_geo.rigs.lens_matching import LensTask, lenses_of, mapped_px, matched_pair
from pcwlad_geo.rigs.parameters import LEARNING
from pcwlad_geo.types import Float32, Float64

LEVEL_GROUND: Final = np.array([1.0, 0.0, 0.0])
"""(3,) inverse depth on the axis, and its slopes, of level ground at the mean distance."""


def evenly(captures: Sequence[Capture], most: int) -> list[Capture]:
    """Return at most `most` captures, evenly chosen."""
    return [captures[k] for k in np.unique(np.linspace(0, len(captures) - 1, most).astype(int))]


def started(
    state: RigState,
    captures: Sequence[Capture],
    order: Sequence[Frame],
    runner: Runner,
    on_event: EventCallback,
) -> RigState:
    """Return the state with the rotation of every lens, and its focal length if metadata lack it."""
    poses, vectors = state.poses.copy(), state.lenses.copy()
    names, lenses = [frame.lens for frame in order], lenses_of(state, order)
    pending = list(range(1, len(names)))
    for capture in evenly(captures, LEARNING.start_captures):
        frames = [capture.frames[name] for name in names]
        calls = [(frames[0], frames[k], lenses[0], lenses[k]) for k in pending]
        results = runner.run(find_start, calls, "starts", on_event)
        for k, pose in zip(list(pending), results, strict=True):
            if pose is not None:
                poses[k, :3], vectors[k, 0] = pose[:3], pose[3]
                pending.remove(k)
        if not pending:
            return replace(state, poses=poses, lenses=vectors)
    missing, count = ", ".join(names[k] for k in pending), min(LEARNING.start_captures, len(captures))
    raise RegistrationRejectedError(
        f"lens {missing} cannot be matched with {names[0]} in {count} captures: give captures of ground with "
        "structure, in flight, not of a panel"
    )


def find_start(reference: Frame, target: Frame, first: Lens, second: Lens) -> Float64 | None:
    """Return (4,) rotation vector and focal length of a lens from one capture; None where none is found.

    Given are the frames of the reference and of the lens, and their lenses by metadata.
    """
    images = [read_frame(frame) for frame in (reference, target)]
    focal_known = target.tells_focal
    for scale in [1.0] if focal_known else LEARNING.focal_factors:
        vector = second.vector.copy()
        vector[0] *= scale
        matrix = _agreed_similarity(reference, target, images, first, replace(second, vector=vector))
        if matrix is not None:
            return _rotation_of(first, second, matrix, focal_known)
    expected = second.focal_px / first.focal_px
    spread = LEARNING.focal_ratio_spread[not focal_known]
    similarity = similarity_of(images[0], images[1], (expected / spread, expected * spread))
    return None if similarity is None else _rotation_of(first, second, similarity, focal_known)


def _agreed_similarity(
    reference: Frame, target: Frame, images: Sequence[Float32], first: Lens, second: Lens
) -> Float64 | None:
    """Return the (2, 3) similarity from px of the reference to px of a lens of nearly the same orientation.

    None where too few tie points agree on one.
    """
    side = round(
        np.clip(max(reference.shape) * second.focal_px / first.focal_px, 160, LEARNING.start_side_px)
    )
    models, pose = (first, second), np.zeros(6)
    task = LensTask(
        0, 1, 1, reference, target, models, pose, LEVEL_GROUND, side, 16, LEARNING.window_share[0]
    )
    points = matched_pair(task, *images)
    if points is None or len(points[0]) < LEARNING.min_start_points:
        return None
    factor = max(reference.shape) / side
    within_px = LEARNING.start_agree_px * factor * second.focal_px / first.focal_px
    matrix, inside = cv2.estimateAffinePartial2D(points[0], points[1], ransacReprojThreshold=within_px)
    if matrix is None or inside.sum() < max(LEARNING.min_start_points, 0.5 * len(points[0])):
        return None
    return np.asarray(matrix, np.float64)


def similarity_of(reference: Float32, target: Float32, scales: tuple[float, float]) -> Float64 | None:
    """Return the (2, 3) similarity from px of a frame to px of another, corner-based; None if there is none.

    The frames, (rows, cols) `reference` and `target`, are of any sizes; `scales` are the smallest and largest
    scale, target px per reference px.
    """
    first, second = (_reduced(values, LEARNING.start_side_px) for values in (reference, target))
    steps = reference.shape[1] / first.shape[1], target.shape[1] / second.shape[1]
    ratio = steps[0] / steps[1]
    valid = np.ones(first.shape, bool), np.ones(second.shape, bool)
    pose = search_pose(first, second, *valid, scales=(scales[0] * ratio, scales[1] * ratio)).proposal
    if pose is None or not (pose.accepted or pose.agreeing >= 12):
        return None
    linear = pose.matrix[:, :2] * steps[1] / steps[0]
    half = np.array([0.5, 0.5])
    origin = steps[1] * (pose.matrix[:, 2] - pose.matrix[:, :2] @ half + half)
    return np.column_stack([linear, origin])


def _reduced(values: Float32, side_px: int) -> Float32:
    """Return a frame averaged to at most `side_px` on its longer side."""
    factor = min(1.0, side_px / max(values.shape))
    rows, cols = (max(16, round(n * factor)) for n in values.shape)
    return np.asarray(cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)


def _rotation_of(first: Lens, second: Lens, matrix: Float64, focal_known: bool) -> Float64:
    """Return the (4,) rotation vector and focal length that approximate a similarity of px."""
    places = lattice(first.shape, max(first.shape) // 4)
    target_px = places @ matrix[:, :2].T + matrix[:, 2]
    inside = second.inside(target_px, -0.1 * max(second.shape))
    if inside.sum() >= 4:
        places, target_px = places[inside], target_px[inside]
    rays = first.rays(places)
    scale = math.sqrt(abs(float(np.linalg.det(matrix[:, :2]))))
    focal = second.focal_px if focal_known else first.focal_px * scale
    angle = math.atan2(matrix[1, 0], matrix[0, 0])

    def misfit(x: Float64) -> Float64:
        vector = second.vector.copy()
        vector[0] = focal * (1.0 if focal_known else math.exp(x[3]))
        turned = np.column_stack([rays, np.ones(len(rays))]) @ cv2.Rodrigues(x[:3])[0].T
        projected = vector[0] * turned[:, :2] / np.maximum(turned[:, 2:], 0.05) + vector[1:3]
        return np.asarray((projected - target_px).ravel())

    best = least_squares(misfit, np.array([0.0, 0.0, angle, 0.0])).x
    best[3] = focal * (1.0 if focal_known else math.exp(best[3]))
    return np.asarray(best, np.float64)


def overlaps_of(
    state: RigState,
    captures: Sequence[Capture],
    order: Sequence[Frame],
    runner: Runner,
    on_event: EventCallback,
) -> list[tuple[int, int, Float64]]:
    """Return pairs of captures, at most two apart, whose reference frames overlap, and their (6,) poses."""
    name, lens = order[0].lens, lenses_of(state, order)[0]
    pairs = [(k, k + step) for step in (1, 2) for k in range(len(captures) - step)]
    calls = [(captures[k].frames[name], captures[m].frames[name], lens, state.planes[k]) for k, m in pairs]
    poses = runner.run(find_overlap, calls, "overlaps", on_event)
    return [(k, m, pose) for (k, m), pose in zip(pairs, poses, strict=True) if pose is not None]


def find_overlap(one: Frame, other: Frame, lens: Lens, plane: Float64) -> Float64 | None:
    """Return the (6,) rotation vector and baseline between two captures; None unless they clearly overlap.

    The frames are those of the reference lens, and the (3,) `plane` is the inverse depth of the first.
    """
    images = [read_frame(frame) for frame in (one, other)]
    features = overlap_of(*images)
    if features is None:
        return None
    source, aim, matrix = features
    start = np.zeros(6)
    start[2] = math.atan2(matrix[1, 0], matrix[0, 0])
    pose = _fitted_pose(lens, plane, source, aim, start, (2, 3, 4, 5))
    return _fitted_pose(lens, plane, source, aim, pose, (0, 1, 2, 3, 4, 5))


def overlap_of(reference: Float32, target: Float32) -> tuple[Float64, Float64, Float64] | None:
    """Return features that two frames of one lens have in common: None unless they clearly overlap.

    Features suffice within one band, and are much faster than a search for the pose. Returned are (n, 2) px
    of both, corner-based, and the (2, 3) similarity between them; `reference` and `target` are (rows, cols)
    frames of the same size.
    """
    features = []
    for values in (reference, target):
        small = _reduced(values, LEARNING.coarse_side_px)
        low, high = np.percentile(small, (1, 99))
        grey = np.clip((small - low) / max(high - low, 1e-9) * 255, 0, 255).astype(np.uint8)
        points, descriptors = cv2.SIFT.create(800).detectAndCompute(grey, None)
        if descriptors is None or len(points) < LEARNING.min_overlap_points:
            return None
        places = (np.array([point.pt for point in points]) + 0.5) / np.array(small.shape[::-1])
        features.append((places * np.array(values.shape[::-1]), descriptors))
    pairs = cv2.BFMatcher().knnMatch(features[0][1], features[1][1], k=2)
    good = [first for first, second in pairs if first.distance < 0.8 * second.distance]
    if len(good) < LEARNING.min_overlap_points:
        return None
    source = features[0][0][[match.queryIdx for match in good]]
    aim = features[1][0][[match.trainIdx for match in good]]
    within_px = 6 / min(1.0, LEARNING.coarse_side_px / max(reference.shape))
    matrix, inside = cv2.estimateAffinePartial2D(source, aim, ransacReprojThreshold=within_px)
    if matrix is None or int(inside.sum()) < LEARNING.min_overlap_points:
        return None
    inliers = inside.ravel() > 0
    return source[inliers], aim[inliers], np.asarray(matrix, np.float64)


def _fitted_pose(
    lens: Lens, plane: Float64, reference_px: Float64, lens_px: Float64, first: Float64, free: Sequence[int]
) -> Float64:
    """Return the pose between two captures that fits points best; only its `free` numbers change."""

    def misfit(x: Float64) -> Float64:
        pose = first.copy()
        pose[list(free)] = x
        at = mapped_px(lens, lens, pose, plane, reference_px)
        return np.nan_to_num(at - lens_px, nan=1e3).ravel()

    solution = least_squares(misfit, first[list(free)], loss="soft_l1", f_scale=2.0, x_scale=0.01)
    pose = first.copy()
    pose[list(free)] = solution.x
    return pose
