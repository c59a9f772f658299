"""Learning of a rig: tie points between the lenses of some captures, and one adjustment of all."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from scipy.optimize import least_squares

from pcwlad_geo.errors import InputError, RegistrationRejectedError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.execution.runner import Runner, one_library_thread
from pcwlad_geo.matching.matcher import match_arrays
from pcwlad_geo.matching.pose import search_pose
from pcwlad_geo.matching.types import MatchSettings, TiePoints
from pcwlad_geo.rigs.adjustment import Adjusted, Observations, RigState, adjust
from pcwlad_geo.rigs.captures import Capture, Frame, first_lens, panel_shown, read_frame
from pcwlad_geo.rigs.rig import (
    MAP_STEP_PX,
    Lens,
    Rig,
    RigLens,
    Sharpness,
    lattice,
    map_places,
    map_shape,
    measured_side,
    resampled,
)
from pcwlad_geo.types import Bool, Float32, Float64

MOST_CAPTURES: Final = 30
"""Largest number of captures to learn from; more are thinned out evenly."""
START_SIDE_PX: Final = 360
"""Longer side of the frames in which approximate rotations are searched."""
COARSE_SIDE_PX: Final = 480
"""Longer side of the frames in the first round of matching, from approximate rotations."""
SEARCH_RADII_PX: Final = (7, 4, 3)
"""Search radius of each later round. There are several, as windows cut by the edge of a frame are biased
towards the prediction."""
WINDOW_SHARE: Final = (0.2, 0.1)
"""Side of the windows as a share of the frame's shorter side: usually, and after the first round where
captures overlap. Smaller windows reach nearer to the corners, where distortion is largest, but are too noisy
for a single capture."""
START_CAPTURES: Final = 4
"""Number of captures in which an approximate rotation is searched."""
FOCAL_RATIO_SPREAD: Final = (1.3, 2.2)
"""Factor within which the ratio of two focal lengths is searched: where metadata have both, and otherwise."""
MARGIN_SHARE: Final = 0.3
"""Least distance from the edges of a frame, as a share of the window, of points between captures and of those
with small windows: obliqueness deforms windows, and windows cut by more are biased inwards."""
FOCAL_FACTORS: Final = tuple(float(1.08**step) for step in sorted(range(-9, 10), key=abs))
"""Factors on a focal length without metadata that are tried, the likely ones first."""
MIN_START_POINTS: Final = 16
"""Least number of points that agree on an approximate rotation."""
START_AGREE_PX: Final = 2.5
"""Distance within which they agree, px of the small frames."""
MIN_OVERLAP_POINTS: Final = 25
"""Least number of features that agree on the overlap of two captures."""
MIN_LENS_POINTS: Final = 20
"""Least number of tie points of a lens in a capture."""
OVERLAP_SIGMA_PX: Final = 0.05
"""Standard deviation of points between captures, across their parallax. That of their matching is mostly
relief within the windows, which displaces them along the parallax only."""
LEAST_DISTORTION_SIGMA_PX: Final = 0.03
"""Standard deviation of distortion per axis that more points do not lessen: that of aliased detail, which
is displaced with the grid of px."""
FOCAL_SIGMA: Final = (0.01, 0.15)
"""Expected relative deviation of the focal length: with metadata of it, and without."""
CENTRE_SIGMA: Final = (0.004, 0.02)
"""Expected deviation of the principal point, as a share of the frame's longer side: calibrated, and not."""
RADIAL_SIGMA_PX: Final = (1.0, 40.0)
"""Expected deviation of each radial term at the corners of frames of 1280 px: calibrated, and not."""
TANGENTIAL_SIGMA_PX: Final = (0.5, 6.0)
"""Expected deviation of the tangential terms at the corners of frames of 1280 px: calibrated, and not."""
OVERLAP_SIGMA_FACTORS: Final = np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0, 1.0, 1.0])
"""(8,) factor on the sigmas of a lens where captures overlap, which determines the radial terms."""
ROTATION_SIGMA_RAD: Final = 0.15
"""Expected rotation of a lens to the reference."""
BASELINE_SIGMA: Final = (0.004, 0.004, 0.001)
"""Expected baseline over the mean distance; the lenses of a rig lie in one plane, nearly."""
SLOPE_SIGMA: Final = 0.2
"""Expected slopes of inverse depth by direction."""
INVERSE_DEPTH_SIGMA: Final = (0.15, 0.6)
"""Expected relative deviation of the inverse depth of a capture: with its height in metadata, and without."""
LEVEL_GROUND: Final = np.array([1.0, 0.0, 0.0])
"""(3,) inverse depth on the axis, and its slopes, of level ground at the mean distance."""


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
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
    """Side of the windows, see `WINDOW_SHARE`."""

    def lens_px(self, reference_px: Float64) -> Float64:
        """Return the predicted (n, 2) px in the lens of (n, 2) px in the reference's raw frame."""
        return _mapped(*self.models, self.pose_vector, self.plane, reference_px)


@one_library_thread()
def learn(
    captures: Sequence[Capture],
    sharpness: Sequence[Mapping[str, Sharpness]],
    fisheye: bool,
    runner: Runner,
    on_event: EventCallback,
) -> Rig:
    """Return the rig of `captures` that all have the same lenses, of the same sizes.

    `sharpness` is that of the frames of each capture, see `inspect`; `fisheye` says whether lenses without a
    calibration in their metadata are fisheyes. `runner` runs the matching, and `on_event` receives its
    `Progress`. Raises `RegistrationRejectedError` if a lens cannot be matched.
    """
    order = sorted(
        captures[0].frames.values(), key=lambda each: (each.order, -math.prod(each.shape), each.lens)
    )
    lenses = [first_lens(each, fisheye, 1.1 * max(each.shape)) for each in order]
    some = evenly(captures, 5)
    expected = _first_state(some, lenses)
    state = _started(expected, some, order, runner, on_event)
    sigma = _sigmas(state, order, some)
    observed = _matched(state, some, order, COARSE_SIDE_PX, 10, WINDOW_SHARE[0], runner, on_event)
    state = adjust(state, expected, sigma, observed, 1.0).state
    expected = _first_state(captures, lenses)
    state = replace(expected, lenses=state.lenses, poses=state.poses)
    sigma = _sigmas(state, order, captures)
    if len(captures) > 1 and (overlaps := _overlaps(state, captures, order, runner, on_event)):
        state, expected, sigma = _with_overlaps(state, expected, sigma, overlaps)
    for radius in SEARCH_RADII_PX:
        later = radius != SEARCH_RADII_PX[0] and len(state.overlaps) > 0
        side, share = measured_side(order[0].shape), WINDOW_SHARE[later]
        observed = _matched(state, captures, order, side, radius, share, runner, on_event)
        density = _points_per_window(observed, order, share)
        found = adjust(state, expected, sigma, observed, density, sigma_by_lens=True)
        state = found.state
    return _rig_of(found, observed, captures, sharpness, order)


def _first_state(chosen: Sequence[Capture], lenses: Sequence[Lens]) -> RigState:
    """Return the state by metadata: lenses without rotation, over level ground."""
    heights = np.array([each.height_m or np.nan for each in chosen])
    planes = np.tile(LEVEL_GROUND, (len(chosen), 1))
    if np.isfinite(heights).all():
        planes[:, 0] = 1 / heights / np.mean(1 / heights)
    models = tuple(each.model for each in lenses)
    return RigState(models, np.stack([each.vector for each in lenses]), np.zeros((len(lenses), 6)), planes)


def _lenses_of(state: RigState, order: Sequence[Frame]) -> list[Lens]:
    """Return the lenses of a state; the frames of one capture, in the order of the lenses, are `order`."""
    facts = zip(state.models, order, state.lenses, strict=True)
    return [Lens(model, frame.shape, vector) for model, frame, vector in facts]


def evenly(captures: Sequence[Capture], most: int) -> list[Capture]:
    """Return at most `most` captures, evenly chosen."""
    return [captures[k] for k in np.unique(np.linspace(0, len(captures) - 1, most).astype(int))]


def _sigmas(state: RigState, order: Sequence[Frame], chosen: Sequence[Capture]) -> RigState:
    """Return the expected standard deviation of each parameter."""
    lenses = np.empty_like(state.lenses)
    for number, frame in enumerate(order):
        unknown = int(frame.calibrated is None)
        focal_px, side = state.lenses[number, 0], max(frame.shape)
        corner = math.hypot(*frame.shape) / 2 / focal_px
        share = side / 1280  # distortion in px grows with the number of px
        lenses[number, 0] = FOCAL_SIGMA[not frame.tells_focal] * focal_px
        lenses[number, 1:3] = CENTRE_SIGMA[unknown] * side
        lenses[number, 3:6] = RADIAL_SIGMA_PX[unknown] * share / focal_px / corner ** np.array([3, 5, 7])
        lenses[number, 6:8] = TANGENTIAL_SIGMA_PX[unknown] * share / focal_px / (3 * corner**2)
    poses = np.zeros_like(state.poses)
    poses[1:, :3], poses[1:, 3:] = ROTATION_SIGMA_RAD, BASELINE_SIGMA
    planes = np.empty_like(state.planes)
    planes[:, 0] = INVERSE_DEPTH_SIGMA[any(each.height_m is None for each in chosen)]
    planes[:, 1:] = SLOPE_SIGMA
    return RigState(state.models, lenses, poses, planes)


def _mapped(first: Lens, second: Lens, pose: Float64, plane: Float64, reference_px: Float64) -> Float64:
    """Return the (n, 2) px in the second lens of (n, 2) px in the first one; NaN behind the lens."""
    rays = first.rays(reference_px)
    axes = np.column_stack([rays, np.ones(len(rays))])
    turned = axes @ cv2.Rodrigues(pose[:3])[0].T + (axes[:, [2, 0, 1]] @ plane)[:, None] * pose[3:]
    turned[turned[:, 2] < 0.05] = np.nan
    return second.project(turned[:, :2] / turned[:, 2:])


def _started(
    state: RigState,
    chosen: Sequence[Capture],
    order: Sequence[Frame],
    runner: Runner,
    on_event: EventCallback,
) -> RigState:
    """Return the state with the rotation of every lens, and its focal length if metadata lack it."""
    poses, vectors = state.poses.copy(), state.lenses.copy()
    names, lenses = [each.lens for each in order], _lenses_of(state, order)
    left = list(range(1, len(names)))
    for capture in evenly(chosen, START_CAPTURES):
        frames = [capture.frames[name] for name in names]
        calls = [(frames[0], frames[k], lenses[0], lenses[k]) for k in left]
        results = runner.run(find_start, calls, "starts", on_event).results
        for k, found in zip(list(left), results, strict=True):
            if found is not None:
                poses[k, :3], vectors[k, 0] = found[:3], found[3]
                left.remove(k)
        if not left:
            return replace(state, poses=poses, lenses=vectors)
    missing, count = ", ".join(names[k] for k in left), min(START_CAPTURES, len(chosen))
    raise RegistrationRejectedError(
        f"lens {missing} cannot be matched with {names[0]} in {count} captures: give captures of ground with "
        "structure, in flight, not of a panel"
    )


def find_start(reference: Frame, target: Frame, first: Lens, second: Lens) -> Float64 | None:
    """Return (4,) rotation vector and focal length of a lens from one capture; None where none is found.

    Given are the frames of the reference and of the lens, and their lenses by metadata.
    """
    images = [read_frame(each.path, each.shape) for each in (reference, target)]
    focal_known = target.tells_focal
    for scale in [1.0] if focal_known else FOCAL_FACTORS:
        vector = second.vector.copy()
        vector[0] *= scale
        matrix = _agreed_similarity(reference, target, images, first, replace(second, vector=vector))
        if matrix is not None:
            return _rotation_of(first, second, matrix, focal_known)
    expected = second.focal_px / first.focal_px
    spread = FOCAL_RATIO_SPREAD[not focal_known]
    found = similarity_of(images[0], images[1], (expected / spread, expected * spread))
    return None if found is None else _rotation_of(first, second, found, focal_known)


def _agreed_similarity(
    reference: Frame, target: Frame, images: Sequence[Float32], first: Lens, second: Lens
) -> Float64 | None:
    """Return the (2, 3) similarity from px of the reference to px of a lens of nearly the same orientation.

    None where too few tie points agree on one.
    """
    side = round(np.clip(max(reference.shape) * second.focal_px / first.focal_px, 160, START_SIDE_PX))
    models, pose = (first, second), np.zeros(6)
    task = _Task(0, 1, 1, reference, target, models, pose, LEVEL_GROUND, side, 16, WINDOW_SHARE[0])
    points = _matched_pair(task, *images)
    if points is None or len(points[0]) < MIN_START_POINTS:
        return None
    factor = max(reference.shape) / side
    within_px = START_AGREE_PX * factor * second.focal_px / first.focal_px
    matrix, inside = cv2.estimateAffinePartial2D(points[0], points[1], ransacReprojThreshold=within_px)
    if matrix is None or inside.sum() < max(MIN_START_POINTS, 0.5 * len(points[0])):
        return None
    return np.asarray(matrix, np.float64)


def similarity_of(reference: Float32, target: Float32, scales: tuple[float, float]) -> Float64 | None:
    """Return the (2, 3) similarity from px of a frame to px of another, corner-based; None if there is none.

    The frames, (rows, cols) `reference` and `target`, are of any sizes; `scales` are the smallest and largest
    scale, target px per reference px.
    """
    first, second = (_reduced(values, START_SIDE_PX) for values in (reference, target))
    steps = reference.shape[1] / first.shape[1], target.shape[1] / second.shape[1]
    ratio = steps[0] / steps[1]
    valid = np.ones(first.shape, bool), np.ones(second.shape, bool)
    found = search_pose(first, second, *valid, scales=(scales[0] * ratio, scales[1] * ratio)).found
    if found is None or not (found.accepted or found.agreeing >= 12):
        return None
    linear = found.matrix[:, :2] * steps[1] / steps[0]
    half = np.array([0.5, 0.5])
    origin = steps[1] * (found.matrix[:, 2] - found.matrix[:, :2] @ half + half)
    return np.column_stack([linear, origin])


def _reduced(values: Float32, side_px: int) -> Float32:
    """Return a frame averaged to at most `side_px` on its longer side."""
    factor = min(1.0, side_px / max(values.shape))
    rows, cols = (max(16, round(n * factor)) for n in values.shape)
    return np.asarray(cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)


def _rotation_of(first: Lens, second: Lens, matrix: Float64, focal_known: bool) -> Float64:
    """Return the (4,) rotation vector and focal length that approximate a similarity of px."""
    places = lattice(first.shape, max(first.shape) // 4)
    wanted = places @ matrix[:, :2].T + matrix[:, 2]
    inside = second.inside(wanted, -0.1 * max(second.shape))
    if inside.sum() >= 4:
        places, wanted = places[inside], wanted[inside]
    rays = first.rays(places)
    scale = math.sqrt(abs(float(np.linalg.det(matrix[:, :2]))))
    focal = second.focal_px if focal_known else first.focal_px * scale
    angle = math.atan2(matrix[1, 0], matrix[0, 0])

    def misfit(x: Float64) -> Float64:
        vector = second.vector.copy()
        vector[0] = focal * (1.0 if focal_known else math.exp(x[3]))
        turned = np.column_stack([rays, np.ones(len(rays))]) @ cv2.Rodrigues(x[:3])[0].T
        projected = vector[0] * turned[:, :2] / np.maximum(turned[:, 2:], 0.05) + vector[1:3]
        return np.asarray((projected - wanted).ravel())

    best = least_squares(misfit, np.array([0.0, 0.0, angle, 0.0])).x
    best[3] = focal * (1.0 if focal_known else math.exp(best[3]))
    return np.asarray(best, np.float64)


def _matched(
    state: RigState,
    chosen: Sequence[Capture],
    order: Sequence[Frame],
    side_px: int,
    radius_px: int,
    share: float,
    runner: Runner,
    on_event: EventCallback,
) -> Observations:
    """Match every lens of every capture, and the reference lens of captures that overlap."""
    tasks = []
    names, lenses = [each.lens for each in order], _lenses_of(state, order)
    for number, (capture, plane) in enumerate(zip(chosen, state.planes, strict=True)):
        frames = [capture.frames[name] for name in names]
        for k in range(1, len(names)):
            pair = lenses[0], lenses[k]
            # not finer than the coarser of the two lenses
            side = round(min(side_px, max(pair[0].shape) / max(1.0, pair[0].focal_px / pair[1].focal_px)))
            pose = state.poses[k]
            tasks.append(_Task(number, k, k, frames[0], frames[k], pair, pose, plane, side, radius_px, share))
    for number, (one, other) in enumerate(state.overlaps, len(names)):
        first, second = (chosen[k].frames[names[0]] for k in (one, other))
        pair, pose, plane = (lenses[0], lenses[0]), state.poses[number], state.planes[one]
        tasks.append(_Task(one, number, 0, first, second, pair, pose, plane, side_px, 3 * radius_px, share))
    found = runner.run(match_task, [(task,) for task in tasks], "matching", on_event).results
    good = [each for each in found if each is not None]
    matched = {int(each.lens[0]) for each in good}
    lost = [names[k] for k in range(1, len(names)) if k not in matched]
    if lost:
        raise RegistrationRejectedError(
            f"lens {', '.join(lost)} cannot be matched with {names[0]} in any of {len(chosen)} captures: the "
            "lenses show different ground, or ground without structure"
        )
    return Observations.joined(good)


def match_task(task: _Task) -> Observations | None:
    """Return the tie points of a lens with its reference; None if there are too few."""
    images = [read_frame(each.path, each.shape) for each in (task.reference, task.target)]
    found = _matched_pair(task, *images)
    if found is None or len(found[0]) < MIN_LENS_POINTS:
        return None
    reference_px, lens_px, sigma_px = found
    if task.lens == 0:  # the reference lens of another capture
        sigma_px = np.full_like(sigma_px, OVERLAP_SIGMA_PX)
    capture, pose, lens = (np.full(len(reference_px), k) for k in (task.capture, task.pose, task.lens))
    return Observations(capture, pose, lens, reference_px, lens_px, sigma_px)


def _matched_pair(
    task: _Task, reference: Float32, target: Float32
) -> tuple[Float64, Float64, Float64] | None:
    """Match a lens, warped into the raw frame of the reference; return px of both and their sigma."""
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
    found = _in_frames(task, points, factor_xy)
    # a lens of few px cannot have small windows, and would lose most of its points to the margin
    small = task.share == WINDOW_SHARE[1] and settings.window <= WINDOW_SHARE[1] * min(rows, cols) + 1
    if task.lens != 0 and not small:
        return found
    margin_px = MARGIN_SHARE * settings.window * factor  # another capture of the reference, or small windows
    first, second = task.models
    lens_margin_px = margin_px * max(second.shape) / max(first.shape)
    inside = first.inside(found[0], margin_px) & second.inside(found[1], lens_margin_px)
    return found[0][inside], found[1][inside], found[2][inside]


def _in_frames(task: _Task, points: TiePoints, factor_xy: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the px in both raw frames of points in the view, and their sigma in px of the lens."""
    reference_px = points.reference_xy_px * factor_xy
    lens_px = task.lens_px(points.target_xy_px * factor_xy)
    shifted_px = task.lens_px(points.target_xy_px * factor_xy + 1.0)
    per_px = np.hypot(*(shifted_px - lens_px).T) / math.sqrt(2)
    sigma_px = np.sqrt((points.sigma_px**2).mean(axis=1)) * factor_xy.mean() * per_px
    good = np.isfinite(lens_px).all(axis=1) & np.isfinite(sigma_px)
    return reference_px[good], lens_px[good], sigma_px[good]


def _pair_in_view(
    task: _Task, reference: Float32, target: Float32, shape: tuple[int, int], factor_xy: Float64
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
        window=side,
        template=side + 20,
        ssim_min=0.0,
        consensus="off",
    )


def _points_per_window(observed: Observations, order: Sequence[Frame], share: float) -> float:
    """Return how many points share a window, on average."""
    views = len(np.unique(np.column_stack([observed.capture, observed.pose]), axis=0))
    side = match_settings(order[0].shape, 5, share).window
    return len(observed) / max(views, 1) * side**2 / math.prod(order[0].shape)


def _overlaps(
    state: RigState,
    chosen: Sequence[Capture],
    order: Sequence[Frame],
    runner: Runner,
    on_event: EventCallback,
) -> list[tuple[int, int, Float64]]:
    """Return pairs of captures, at most two apart, whose reference frames overlap, and their (6,) poses."""
    name, lens = order[0].lens, _lenses_of(state, order)[0]
    pairs = [(k, k + step) for step in (1, 2) for k in range(len(chosen) - step)]
    calls = [(chosen[k].frames[name], chosen[m].frames[name], lens, state.planes[k]) for k, m in pairs]
    found = runner.run(find_overlap, calls, "overlaps", on_event).results
    return [(k, m, pose) for (k, m), pose in zip(pairs, found, strict=True) if pose is not None]


def find_overlap(one: Frame, other: Frame, lens: Lens, plane: Float64) -> Float64 | None:
    """Return the (6,) rotation vector and baseline between two captures; None unless they clearly overlap.

    The frames are those of the reference lens, and the (3,) `plane` is the inverse depth of the first.
    """
    images = [read_frame(each.path, each.shape) for each in (one, other)]
    found = overlap_of(*images)
    if found is None:
        return None
    source, aim, matrix = found
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
    found = []
    for values in (reference, target):
        small = _reduced(values, COARSE_SIDE_PX)
        low, high = np.percentile(small, (1, 99))
        grey = np.clip((small - low) / max(high - low, 1e-9) * 255, 0, 255).astype(np.uint8)
        points, descriptors = cv2.SIFT.create(800).detectAndCompute(grey, None)
        if descriptors is None or len(points) < MIN_OVERLAP_POINTS:
            return None
        places = (np.array([each.pt for each in points]) + 0.5) / np.array(small.shape[::-1])
        found.append((places * np.array(values.shape[::-1]), descriptors))
    pairs = cv2.BFMatcher().knnMatch(found[0][1], found[1][1], k=2)
    good = [first for first, second in pairs if first.distance < 0.8 * second.distance]
    if len(good) < MIN_OVERLAP_POINTS:
        return None
    source = found[0][0][[each.queryIdx for each in good]]
    aim = found[1][0][[each.trainIdx for each in good]]
    within_px = 6 / min(1.0, COARSE_SIDE_PX / max(reference.shape))
    matrix, inside = cv2.estimateAffinePartial2D(source, aim, ransacReprojThreshold=within_px)
    if matrix is None or int(inside.sum()) < MIN_OVERLAP_POINTS:
        return None
    kept = inside.ravel() > 0
    return source[kept], aim[kept], np.asarray(matrix, np.float64)


def _fitted_pose(
    lens: Lens, plane: Float64, reference_px: Float64, lens_px: Float64, first: Float64, free: Sequence[int]
) -> Float64:
    """Return the pose between two captures that fits points best; only its `free` numbers change."""

    def misfit(x: Float64) -> Float64:
        pose = first.copy()
        pose[list(free)] = x
        at = _mapped(lens, lens, pose, plane, reference_px)
        return np.nan_to_num(at - lens_px, nan=1e3).ravel()

    found = least_squares(misfit, first[list(free)], loss="soft_l1", f_scale=2.0, x_scale=0.01)
    pose = first.copy()
    pose[list(free)] = found.x
    return pose


def _with_overlaps(
    state: RigState, expected: RigState, sigma: RigState, overlaps: Sequence[tuple[int, int, Float64]]
) -> tuple[RigState, RigState, RigState]:
    """Return the states with the poses between captures added; these are expected to be as they are."""
    between = np.stack([pose for *_, pose in overlaps])
    weak = np.tile([0.5, 0.5, 0.5, 2.0, 2.0, 2.0], (len(overlaps), 1))
    pairs = tuple((one, other) for one, other, _ in overlaps)
    return (
        replace(state, poses=np.vstack([state.poses, between]), overlaps=pairs),
        replace(expected, poses=np.vstack([expected.poses, between])),
        replace(sigma, lenses=sigma.lenses * OVERLAP_SIGMA_FACTORS, poses=np.vstack([sigma.poses, weak])),
    )


def _rig_of(
    found: Adjusted,
    observed: Observations,
    chosen: Sequence[Capture],
    sharpness: Sequence[Mapping[str, Sharpness]],
    order: Sequence[Frame],
) -> Rig:
    """Return the rig of an adjustment, with the precision of its mapping."""
    state = found.state
    deviation = np.sqrt(np.maximum(np.diag(found.covariance), 0))
    models = _lenses_of(state, order)
    lenses = []
    for number, frame in enumerate(order):
        first, pose = number * 8, state.lenses.size + number * 6
        mapping, distortion = _precision(found, number, models[0], models[number])
        own = [each[frame.lens] for each in sharpness]
        lenses.append(
            RigLens(
                name=frame.lens,
                lens=models[number],
                rotation=state.poses[number, :3],
                baseline=state.poses[number, 3:],
                sigma=np.concatenate([deviation[first : first + 8], deviation[pose : pose + 6]]),
                mapping_sigma_px=mapping,
                distortion_sigma_px=distortion,
                calibrated=frame.calibrated,
                sharpness=replace(usual_of(own), detail=min(each.detail for each in own)),
                wavelength_nm=frame.wavelength_nm,
            )
        )
    heights = [each.height_m for each in chosen if each.height_m]
    counted = found.kept & (observed.pose < len(order))  # those between captures are not of the mapping
    return Rig(
        lenses=tuple(lenses),
        camera=order[0].camera,
        distance_m=len(heights) / sum(1 / each for each in heights) if len(heights) == len(chosen) else None,
        inverse_depth=(float(state.planes[:, 0].min()), float(state.planes[:, 0].max())),
        tilt=float(np.clip(np.sqrt((state.planes[:, 1:] ** 2).mean()), 0.05, 0.5)),
        drift_px=_drift_px(found, observed, len(order)),
        captures=len(chosen),
        points=int(counted.sum()),
        residual_px=float(np.median(np.hypot(*found.residual_px.T)[counted])),
    )


def _drift_px(found: Adjusted, observed: Observations, lenses: int) -> float:
    """Return the RMS over captures and lenses of the median residual, px, within limits."""
    medians = []
    for capture in np.unique(observed.capture):
        for lens in range(1, lenses):
            some = found.kept & (observed.capture == capture) & (observed.pose == lens)
            if some.sum() >= MIN_LENS_POINTS:
                medians.append(np.median(found.residual_px[some], axis=0))
    return float(np.clip(np.sqrt(np.mean(np.square(medians))) if medians else 0.05, 0.02, 1.0))


def _precision(found: Adjusted, number: int, first: Lens, second: Lens) -> tuple[tuple[float, float], float]:
    """Return median and largest sigma of the mapping to a lens, and the largest one of its distortion.

    The covariance is propagated by samples, as the chain of derivatives would be long.
    """
    state = found.state
    places = lattice(first.shape, max(first.shape) // 8)
    base = _mapped(first, second, state.poses[number], LEVEL_GROUND, places)
    shown = second.inside(base, -0.1 * max(second.shape))
    if shown.any():
        places, base = places[shown], base[shown]
    pose = state.lenses.size + number * 6
    index = np.unique([*range(8), *range(number * 8, number * 8 + 8), *range(pose, pose + 6)])
    values, vectors = np.linalg.eigh(found.covariance[np.ix_(index, index)])
    root = vectors * np.sqrt(np.maximum(values, 0))
    generator = np.random.default_rng(0)
    mapping, distortion = [], []
    for _ in range(60):
        vector = state.vector
        vector[index] += root @ generator.standard_normal(len(index))
        other = state.with_vector(vector)
        reference = replace(first, vector=other.lenses[0])
        lens = replace(second, vector=other.lenses[number])
        mapping.append(_mapped(reference, lens, other.poses[number], LEVEL_GROUND, places) - base)
        distortion.append(second.distortion_px(lens, max(second.shape) // 8))
    sigma = np.sqrt(np.nanmean(np.square(mapping), axis=0).mean(axis=1))
    shortest = min(map(len, distortion))
    own = np.sqrt(np.mean([np.square(each[:shortest]) for each in distortion], axis=0).mean(axis=1))
    largest = float(np.hypot(own.max(), LEAST_DISTORTION_SIGMA_PX))
    return (float(np.nanmedian(sigma)), float(np.nanmax(sigma))), largest


def usual_of(sharpness: Sequence[Sharpness]) -> Sharpness:
    """Return the median sharpness and contrast (of an even number the higher one) of frames of a lens."""
    figures = np.array([(each.detail, each.contrast) for each in sharpness])
    return Sharpness(*(float(each) for each in np.percentile(figures, 50, axis=0, method="higher")))


def inspect(capture: Capture) -> tuple[str | None, dict[str, Sharpness]]:
    """Return what shows that a capture is of a panel, or None, and the sharpness of its frames by lens."""
    frames = list(capture.frames.values())
    values = [read_frame(each.path, each.shape) for each in frames]
    sharpness = {each.lens: measure_sharpness(plane) for each, plane in zip(frames, values, strict=True)}
    return panel_shown(frames, values), sharpness


def measure_sharpness(values: Float32) -> Sharpness:
    """Return sharpness and contrast of a frame of (rows, cols) `values`.

    In the finest detail noise could replace the energy that blur removes: so the bands of one and of two px
    are compared, after a smoothing that removes most noise. Motion blurs along one direction only: the least
    of four directions counts.
    """
    fine = cv2.GaussianBlur(values, (0, 0), 1.0)
    middle = cv2.GaussianBlur(values, (0, 0), 2.0)
    coarse = cv2.GaussianBlur(values, (0, 0), 4.0)
    sharp, soft = fine - middle, middle - coarse
    ratios = [
        _slope_energy(sharp, 1, *step) / max(_slope_energy(soft, 2, *step), 1e-12)
        for step in ((0, 1), (1, 0), (1, 1), (1, -1))
    ]
    mean = abs(float(values.mean()))
    # the contrast is that of the smoothed frame, as noise is strong in dark frames
    return Sharpness(min(ratios), float(coarse.std()) / max(mean, 1e-12))


def _slope_energy(plane: Float32, length: int, down: int, right: int) -> float:
    """Return the mean square of differences along a direction, over a `length` in px."""
    moved = np.roll(plane, (length * down, length * right), (0, 1))
    return float(np.mean(np.square(plane - moved)))
