"""Tie points between the lenses of a capture, and between captures that overlap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pcwlad_geo.errors import InputError, RegistrationRejectedError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.matching import MatchSettings, TiePoints, match_arrays
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.rigs.adjustment import Observations, RigState
from pcwlad_geo.rigs.captures import Capture, Frame, read_frame
from pcwlad_geo.rigs.lens import Lens
from pcwlad_geo.rigs.parameters import LEARNING
from pcwlad_geo.rigs.warping import MAP_STEP_PX, map_places, map_shape, resampled
from pcwlad_geo.types import Bool, Float32, Float64


@dataclass(frozen=True, slots=True, eq=False)
class LensTask:
    """One lens of one capture against its reference, or the reference of another capture."""

    capture: int
    pose: int
    lens: int
    reference: Frame
    target: Frame
    models: tuple[Lens, Lens]
    pose_vector: Float64
    plane: Float64
    side_px: int
    radius_px: int
    share: float
    """Side of the windows, see `LearningParameters.window_share`."""

    def lens_px(self, reference_px: Float64) -> Float64:
        """Return the predicted (n, 2) px in the lens of (n, 2) `reference_px`, of the raw frame."""
        return mapped_px(*self.models, self.pose_vector, self.plane, reference_px)


def mapped_px(first: Lens, second: Lens, pose: Float64, plane: Float64, reference_px: Float64) -> Float64:
    """Return the (n, 2) px in the second lens of the (n, 2) `reference_px` in the first; NaN behind the lens.

    The (6,) `pose` is rotation vector and baseline, the (3,) `plane` inverse depth and its slopes.
    """
    rays = first.rays(reference_px)
    axes = np.column_stack([rays, np.ones(len(rays))])
    turned = axes @ cv2.Rodrigues(pose[:3])[0].T + (axes[:, [2, 0, 1]] @ plane)[:, None] * pose[3:]
    turned[turned[:, 2] < 0.05] = np.nan
    return second.project(turned[:, :2] / turned[:, 2:])


def lenses_of(state: RigState, order: Sequence[Frame]) -> list[Lens]:
    """Return the lenses of a state; the frames of one capture, in the order of the lenses, are `order`."""
    facts = zip(state.models, order, state.lenses, strict=True)
    return [Lens(model, frame.shape, vector) for model, frame, vector in facts]


def matched(
    state: RigState,
    captures: Sequence[Capture],
    order: Sequence[Frame],
    side_px: int,
    radius_px: int,
    share: float,
    runner: Runner,
    on_event: EventCallback,
) -> Observations:
    """Match every lens of every capture, and the reference lens of captures that overlap."""
    tasks = []
    names, lenses = [frame.lens for frame in order], lenses_of(state, order)
    for number, (capture, plane) in enumerate(zip(captures, state.planes, strict=True)):
        frames = [capture.frames[name] for name in names]
        for k in range(1, len(names)):
            pair = lenses[0], lenses[k]
            # not finer than the coarser of the two lenses
            side = round(min(side_px, max(pair[0].shape) / max(1.0, pair[0].focal_px / pair[1].focal_px)))
            pose = state.poses[k]
            tasks.append(
                LensTask(number, k, k, frames[0], frames[k], pair, pose, plane, side, radius_px, share)
            )
    for number, (one, other) in enumerate(state.overlaps, len(names)):
        first, second = (captures[k].frames[names[0]] for k in (one, other))
        pair, pose, plane = (lenses[0], lenses[0]), state.poses[number], state.planes[one]
        tasks.append(
            LensTask(one, number, 0, first, second, pair, pose, plane, side_px, 3 * radius_px, share)
        )
    results = runner.run(match_task, [(task,) for task in tasks], "matching", on_event)
    good = [points for points in results if points is not None]
    matched_lenses = {int(points.lens[0]) for points in good}
    missing = [names[k] for k in range(1, len(names)) if k not in matched_lenses]
    if missing:
        raise RegistrationRejectedError(
            f"lens {', '.join(missing)} cannot be matched with {names[0]} in any of {len(captures)} "
            "captures: the lenses show different ground, or ground without structure"
        )
    return Observations.joined(good)


def match_task(task: LensTask) -> Observations | None:
    """Return the tie points of a lens with its reference; None if there are too few."""
    images = [read_frame(frame) for frame in (task.reference, task.target)]
    positions = matched_pair(task, *images)
    if positions is None or len(positions[0]) < LEARNING.min_lens_points:
        return None
    reference_px, lens_px, sigma_px = positions
    if task.lens == 0:  # the reference lens of another capture
        sigma_px = np.full_like(sigma_px, LEARNING.overlap_sigma_px)
    capture, pose, lens = (np.full(len(reference_px), k) for k in (task.capture, task.pose, task.lens))
    return Observations(capture, pose, lens, reference_px, lens_px, sigma_px)


def matched_pair(
    task: LensTask, reference: Float32, target: Float32
) -> tuple[Float64, Float64, Float64] | None:
    """Match a lens, warped into the reference's frame; return (n, 2) px of both and their (n,) sigma.

    The (rows, cols) `reference` and `target` are the frames.
    """
    whole = task.reference.shape
    factor = max(whole) / min(task.side_px, max(whole))
    rows, cols = (max(16, round(n / factor)) for n in whole)
    factor_xy = np.array([whole[1] / cols, whole[0] / rows])  # whole px make them differ a little
    images, valid = _pair_in_view(task, reference, target, (rows, cols), factor_xy)
    settings = match_settings(images[0].shape, task.radius_px, task.share)
    try:
        points = match_arrays(*images, target_valid=valid, settings=settings)
    except InputError:  # too small, or nothing to compare
        return None
    points = points[np.asarray((points.sigma_px < 1.0).all(axis=1))]
    positions = _in_frames(task, points, factor_xy)
    # a lens of few px cannot have small windows, and would lose most of its points to the margin
    least_share = LEARNING.window_share[1]
    small = task.share == least_share and settings.window.side_px <= least_share * min(rows, cols) + 1
    if task.lens != 0 and not small:
        return positions
    # another capture of the reference, or small windows
    margin_px = LEARNING.margin_share * settings.window.side_px * factor
    first, second = task.models
    lens_margin_px = margin_px * max(second.shape) / max(first.shape)
    inside = first.inside(positions[0], margin_px) & second.inside(positions[1], lens_margin_px)
    return positions[0][inside], positions[1][inside], positions[2][inside]


def _in_frames(task: LensTask, points: TiePoints, factor_xy: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the px in both raw frames of points in the view, and their sigma in px of the lens."""
    reference_px = points.reference_xy_px * factor_xy
    lens_px = task.lens_px(points.target_xy_px * factor_xy)
    shifted_px = task.lens_px(points.target_xy_px * factor_xy + 1.0)
    per_px = np.hypot(*(shifted_px - lens_px).T) / math.sqrt(2)
    sigma_px = np.sqrt((points.sigma_px**2).mean(axis=1)) * factor_xy.mean() * per_px
    good = np.isfinite(lens_px).all(axis=1) & np.isfinite(sigma_px)
    return reference_px[good], lens_px[good], sigma_px[good]


def _pair_in_view(
    task: LensTask, reference: Float32, target: Float32, shape: tuple[int, int], factor_xy: Float64
) -> tuple[tuple[Float32, Float32], Bool]:
    """Return the reference, the lens warped to it by the prediction, and the mask of the latter."""
    rows, cols = shape
    view = reference
    if shape != reference.shape:
        view = np.asarray(cv2.resize(reference, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)
    lens_px = task.lens_px(map_places(shape, (0.0, 0.0), 1.0) * factor_xy)
    col = lens_px[:, 0].reshape(map_shape(shape))
    reduction = float(np.nanmedian(np.abs(np.diff(col, axis=1))) / MAP_STEP_PX)
    warped = resampled(target, lens_px, shape, reduction if math.isfinite(reduction) else 1.0)
    return (view, np.nan_to_num(warped)), np.isfinite(warped)


def match_settings(shape: tuple[int, ...], radius_px: int, share: float) -> MatchSettings:
    """Return settings for frames of a (rows, cols) `shape`, with windows of a `share` of its shorter side.

    Points are not predicted by a smooth field: near the corners, where distortion is strongest, that would
    absorb half of it.
    """
    side = int(np.clip(share * min(shape), 31, 81)) // 2 * 2 + 1
    return MatchSettings(
        features=400,
        search_radius=radius_px,
        window=MatchingWindow(side),
        template=side + 20,
        ssim_min=0.0,
        consensus="off",
    )


def points_per_window(observed: Observations, order: Sequence[Frame], share: float) -> float:
    """Return how many points share a window, on average."""
    views = len(np.unique(np.column_stack([observed.capture, observed.pose]), axis=0))
    side = match_settings(order[0].shape, 5, share).window.side_px
    return len(observed) / max(views, 1) * side**2 / math.prod(order[0].shape)
