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
    Lens,
    Rig,
    RigLens,
    Sharpness,
    coarsened,
    coefficients_of,
    lattice,
    map_places,
    measured_side,
    resampled,
)
from pcwlad_geo.types import Bool, Float32, Float64

MOST_CAPTURES: Final = 30
"""Largest number of captures that are learned from; of more, these are taken evenly."""
START_SIDE_PX: Final = 360
"""Longer side of the frames in which lenses are first matched."""
COARSE_SIDE_PX: Final = 480
"""That of the first round, where the lenses are not yet known well."""
ROUND_RADII_PX: Final = (7, 4, 3)
"""Radius of the search in each of the rounds after it: near the edges of a frame windows see to one side, and
are led by where the round before has put them."""
WINDOW_SHARE: Final = (0.2, 0.1)
"""Side of the windows as a share of the frame's shorter side: usually, and after the first round where
captures overlap. Smaller ones reach nearer to the corners, where distortion is largest, and are noisier: one
capture does not do for them."""
TRIES: Final = 4
"""Captures in which a start is looked for."""
SCALE_SPREAD: Final = (1.3, 2.2)
"""Factor within which the ratio of two focal lengths is searched: where both are told, and elsewhere."""
MARGIN_SHARE: Final = 0.3
"""Points between captures, and in small windows all, are not nearer to an edge of a frame than this share of
their window: what is seen obliquely deforms windows, and those that are cut by more are drawn inwards."""
SCALES: Final = tuple(float(1.08**step) for step in sorted(range(-9, 10), key=abs))
"""Factors on a focal length that nothing tells, the likely ones first."""
MIN_START: Final = 16
"""Least number of points that agree on a start."""
AGREE_PX: Final = 2.5
"""Distance within which they agree, px of the small frames."""
MIN_OVERLAPPING: Final = 25
"""Least number of features that agree on how two captures overlap."""
MIN_LENS_POINTS: Final = 20
"""Least number of tie points of a lens in a capture."""
CAPTURE_SIGMA_PX: Final = 0.05
"""Standard deviation of points between captures, across their parallax. What their matching says is mostly
the relief in their windows, which moves them along it, where they tell of nothing but relief."""
LEAST_BEND_PX: Final = 0.03
"""Standard deviation per axis, of distortion, that no number of points lessens: frames sampled without a blur
hold detail that is finer than their px, which moves with these."""
FOCAL_SIGMA: Final = (0.01, 0.15)
"""Expected relative deviation of the focal length: where the frame tells it, and elsewhere."""
CENTRE_SIGMA: Final = (0.004, 0.02)
"""Of the principal point, as a share of the frame's longer side."""
BEND_SIGMA_PX: Final = (1.0, 40.0)
"""Of the distortion at the corners, px, by each radial term."""
SHARED_BEND: Final = np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0, 1.0, 1.0])
"""(8,) factor on the sigmas of a lens where captures overlap: they tell the distortion that all share."""
SHEAR_SIGMA_PX: Final = (0.5, 6.0)
"""Of the tangential terms."""
TURN_SIGMA: Final = 0.15
"""Of the rotation of a lens, rad."""
BASE_SIGMA: Final = (0.004, 0.004, 0.001)
"""Of the baseline over the mean distance; the lenses of a rig stand in one plane, nearly."""
TILT_SIGMA: Final = 0.2
"""Of the slopes of inverse depth per direction."""
INVERSE_DEPTH_SIGMA: Final = (0.15, 0.6)
"""Of the inverse depth of a capture: where the frames tell their height, and elsewhere."""


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
    """Of a window, see `WINDOW_SHARE`."""

    def lens_px(self, reference_px: Float64) -> Float64:
        """Return the (n, 2) px at which the lens should see (n, 2) px of the reference's raw frame."""
        first, second = self.models
        return _between(first, second, self.pose_vector, self.plane, reference_px)


@one_library_thread()
def learn(
    captures: Sequence[Capture],
    sharpness: Sequence[Mapping[str, Sharpness]],
    fisheye: bool,
    runner: Runner,
    on_event: EventCallback,
) -> Rig:
    """Return the rig of `captures` that all have the same lenses, of the same sizes.

    `sharpness` is what the frames of each look like, see `inspect`; `fisheye` says whether lenses that tell
    no calibration are fisheyes. `runner` runs the matching, and `on_event` receives its `Progress`. Raises
    `RegistrationRejectedError` if a lens cannot be matched.
    """
    order = sorted(
        captures[0].frames.values(), key=lambda each: (each.order, -math.prod(each.shape), each.lens)
    )
    names = [each.lens for each in order]
    lenses = [first_lens(each, fisheye, 1.1 * max(each.shape)) for each in order]
    given = list(lenses)
    some = evenly(captures, 5)
    state = _started(_first_state(some, names, lenses), some, names, lenses, runner, on_event)
    sigma = _sigmas(state, order, _all_heights(some))
    observed = _matched(state, some, names, lenses, COARSE_SIDE_PX, 10, WINDOW_SHARE[0], runner, on_event)
    state = adjust(state, _first_state(some, names, given), sigma, observed, 1.0).state
    expected = _first_state(captures, names, given)
    state = replace(expected, lenses=state.lenses, poses=state.poses)
    sigma = _sigmas(state, order, _all_heights(captures))
    if len(captures) > 1:
        extra = _overlapping(state, captures, names[0], lenses[0], runner, on_event)
        state, sigma = _with_poses(state, sigma, extra)
        between = np.arange(len(state.poses)) >= len(state.lenses)  # only of these a start is an expectation
        expected = replace(expected, poses=state.poses * between[:, None], overlaps=state.overlaps)
    for radius in ROUND_RADII_PX:
        lenses = [replace(lens, vector=v) for lens, v in zip(lenses, state.lenses, strict=True)]
        later = radius != ROUND_RADII_PX[0] and len(state.overlaps) > 0
        side, share = measured_side(order[0].shape), WINDOW_SHARE[later]
        observed = _matched(state, captures, names, lenses, side, radius, share, runner, on_event)
        found = adjust(state, expected, sigma, observed, _overlap(observed, order, share), by_lens=True)
        state = found.state
    return _rig_of(found, observed, captures, sharpness, order)


def _first_state(chosen: Sequence[Capture], names: Sequence[str], lenses: Sequence[Lens]) -> RigState:
    heights = np.array([each.height_m or np.nan for each in chosen])
    planes = np.zeros((len(chosen), 3))
    planes[:, 0] = 1.0
    if np.isfinite(heights).all():
        planes[:, 0] = 1 / heights / np.mean(1 / heights)
    models = tuple(each.model for each in lenses)
    return RigState(models, np.stack([each.vector for each in lenses]), np.zeros((len(names), 6)), planes)


def evenly(captures: Sequence[Capture], most: int) -> list[Capture]:
    """Return at most so many captures, evenly chosen."""
    return [captures[k] for k in np.unique(np.linspace(0, len(captures) - 1, most).astype(int))]


def _all_heights(chosen: Sequence[Capture]) -> bool:
    return all(each.height_m is not None for each in chosen)


def _sigmas(state: RigState, order: Sequence[Frame], heights: bool) -> RigState:
    """Return how far each parameter is expected from its start."""
    lenses = np.empty_like(state.lenses)
    for number, frame in enumerate(order):
        calibrated = frame.calibrated is not None
        focal_px, side = state.lenses[number, 0], max(frame.shape)
        corner = math.hypot(*frame.shape) / 2 / focal_px
        bend, shear = (each[0 if calibrated else 1] for each in (BEND_SIGMA_PX, SHEAR_SIGMA_PX))
        share = side / 1280  # frames of fewer pixels bend by fewer
        lenses[number, 0] = FOCAL_SIGMA[0 if frame.tells_focal else 1] * focal_px
        lenses[number, 1:3] = CENTRE_SIGMA[0 if calibrated else 1] * side
        lenses[number, 3:6] = bend * share / focal_px / corner ** np.array([3, 5, 7])
        lenses[number, 6:8] = shear * share / focal_px / (3 * corner**2)
    poses = np.zeros_like(state.poses)
    poses[1:, :3], poses[1:, 3:] = TURN_SIGMA, BASE_SIGMA
    planes = np.empty_like(state.planes)
    planes[:, 0], planes[:, 1:] = INVERSE_DEPTH_SIGMA[0 if heights else 1], TILT_SIGMA
    return RigState(state.models, lenses, poses, planes)


def _between(first: Lens, second: Lens, pose: Float64, plane: Float64, reference_px: Float64) -> Float64:
    rays = first.rays(reference_px)
    axes = np.column_stack([rays, np.ones(len(rays))])
    turned = axes @ cv2.Rodrigues(pose[:3])[0].T + (axes[:, [2, 0, 1]] @ plane)[:, None] * pose[3:]
    turned[turned[:, 2] < 0.05] = np.nan
    return second.project(turned[:, :2] / turned[:, 2:])


def _started(
    state: RigState,
    chosen: Sequence[Capture],
    names: Sequence[str],
    lenses: list[Lens],
    runner: Runner,
    on_event: EventCallback,
) -> RigState:
    """Return the state with a rotation, and where it is not told a focal length, of every lens."""
    poses, vectors = state.poses.copy(), state.lenses.copy()
    left = list(range(1, len(names)))
    for number in np.unique(np.linspace(0, len(chosen) - 1, TRIES).astype(int)):
        frames = chosen[number].frames
        calls = [
            (frames[names[0]], frames[names[k]], lenses[0], lenses[k], frames[names[k]].tells_focal)
            for k in left
        ]
        results = runner.run(find_start, calls, "starts", on_event).results
        for k, found in zip(list(left), results, strict=True):
            if found is not None:
                poses[k, :3], vectors[k, 0] = found[:3], found[3]
                lenses[k] = replace(lenses[k], vector=vectors[k])
                left.remove(k)
        if not left:
            return replace(state, poses=poses, lenses=vectors)
    missing = ", ".join(names[k] for k in left)
    raise RegistrationRejectedError(
        f"lens {missing} cannot be matched with {names[0]} in {min(TRIES, len(chosen))} captures: give "
        "captures of ground with structure, in flight, not of a panel"
    )


def find_start(
    reference: Frame, target: Frame, first: Lens, second: Lens, focal_known: bool
) -> Float64 | None:
    """Return (4,) rotation vector and focal length of a lens from one capture; None where none is found.

    Given are the frames of the reference and of the lens, their lenses as far as they are known, and whether
    the focal length of the lens is known beside that of the reference.
    """
    images = [read_frame(each.path, each.shape) for each in (reference, target)]
    for scale in [1.0] if focal_known else SCALES:
        vector = second.vector.copy()
        vector[0] *= scale
        matrix = _agreed_similarity(reference, target, images, first, replace(second, vector=vector))
        if matrix is not None:
            return _as_rotation(first, second, matrix, focal_known)
    expected = second.focal_px / first.focal_px
    spread = SCALE_SPREAD[0 if focal_known else 1]
    found = similarity_of(images[0], images[1], (expected / spread, expected * spread))
    return None if found is None else _as_rotation(first, second, found, focal_known)


def _agreed_similarity(
    reference: Frame, target: Frame, images: Sequence[Float32], first: Lens, second: Lens
) -> Float64 | None:
    """Return the (2, 3) similarity from px of the reference to px of a lens that looks the same way, nearly.

    None where too few points of both agree on one.
    """
    side = round(np.clip(max(reference.shape) * second.focal_px / first.focal_px, 160, START_SIDE_PX))
    level = np.array([1.0, 0.0, 0.0])
    task = _Task(
        capture=0,
        pose=1,
        lens=1,
        reference=reference,
        target=target,
        models=(first, second),
        pose_vector=np.zeros(6),
        plane=level,
        side_px=side,
        radius_px=16,
        share=WINDOW_SHARE[0],
    )
    points = _matched_here(task, images[0], images[1])
    if points is None or len(points[0]) < MIN_START:
        return None
    factor = max(reference.shape) / side
    within_px = AGREE_PX * factor * second.focal_px / first.focal_px
    matrix, inside = cv2.estimateAffinePartial2D(points[0], points[1], ransacReprojThreshold=within_px)
    if matrix is None or inside.sum() < max(MIN_START, 0.5 * len(points[0])):
        return None
    return np.asarray(matrix, np.float64)


def similarity_of(reference: Float32, target: Float32, scales: tuple[float, float]) -> Float64 | None:
    """Return the (2, 3) similarity from px of a frame to px of another, corner-based; None without one.

    The frames, (rows, cols) `reference` and `target`, are of any sizes; `scales` are the smallest and largest
    scale, target px per reference px.
    """
    small, steps = [], []
    for values in (reference, target):
        factor = min(1.0, START_SIDE_PX / max(values.shape))
        rows, cols = (max(16, round(n * factor)) for n in values.shape)
        small.append(cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA).astype(np.float32))
        steps.append(values.shape[1] / cols)
    ratio = steps[0] / steps[1]
    valid = [np.ones(each.shape, bool) for each in small]
    found = search_pose(small[0], small[1], valid[0], valid[1], scales=(scales[0] * ratio, scales[1] * ratio))
    if found is None or not (found.accepted or found.agreeing >= 12):
        return None
    linear = found.matrix[:, :2] * steps[1] / steps[0]
    half = np.array([0.5, 0.5])
    origin = steps[1] * (found.matrix[:, 2] - found.matrix[:, :2] @ half + half)
    return np.column_stack([linear, origin])


def _as_rotation(first: Lens, second: Lens, matrix: Float64, focal_known: bool) -> Float64:
    """Return rotation vector and focal length that place px nearly as a similarity does."""
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
    names: Sequence[str],
    lenses: Sequence[Lens],
    side_px: int,
    radius_px: int,
    share: float,
    runner: Runner,
    on_event: EventCallback,
) -> Observations:
    """Match every lens of every capture, and captures that have a pose between them."""
    tasks = []
    now = [replace(lens, vector=vector) for lens, vector in zip(lenses, state.lenses, strict=True)]
    for number, capture in enumerate(chosen):
        frames = [capture.frames[name] for name in names]
        plane = state.planes[number]
        for k in range(1, len(names)):
            side, pair = _side(side_px, now[0], now[k]), (now[0], now[k])
            facts = number, k, k, frames[0], frames[k], pair, state.poses[k], plane
            tasks.append(_Task(*facts, side, radius_px, share))
    for pose, (one, other) in enumerate(state.overlaps, len(names)):
        ends = (chosen[k].frames[names[0]] for k in (one, other))
        facts = one, pose, 0, *ends, (now[0], now[0]), state.poses[pose], state.planes[one]
        tasks.append(_Task(*facts, side_px, 3 * radius_px, share))
    found = runner.run(match_task, [(task,) for task in tasks], "matching", on_event).results
    good = [each for each in found if each is not None]
    _check_all_matched(good, names, len(chosen))
    return Observations.joined(good)


def _check_all_matched(found: Sequence[Observations], names: Sequence[str], captures: int) -> None:
    matched = {int(each.lens[0]) for each in found}
    lost = [names[k] for k in range(1, len(names)) if k not in matched]
    if lost:
        raise RegistrationRejectedError(
            f"lens {', '.join(lost)} cannot be matched with {names[0]} in any of {captures} captures: the "
            "lenses show different ground, or ground without structure"
        )


def _side(side_px: int, first: Lens, second: Lens) -> int:
    """Return the longer side of the frame to match in: at least the coarser one's px, at most `side_px`."""
    finest = max(first.shape) / max(1.0, first.focal_px / second.focal_px)
    return round(min(side_px, finest))


def match_task(task: _Task) -> Observations | None:
    """Return what a lens sees of its reference; None where too few points are found."""
    images = [read_frame(each.path, each.shape) for each in (task.reference, task.target)]
    found = _matched_here(task, *images)
    if found is None or len(found[0]) < MIN_LENS_POINTS:
        return None
    reference_px, lens_px, sigma_px = found
    if task.lens == 0:  # of another capture
        sigma_px = np.full_like(sigma_px, CAPTURE_SIGMA_PX)
    capture, pose, lens = (np.full(len(reference_px), k) for k in (task.capture, task.pose, task.lens))
    return Observations(capture, pose, lens, reference_px, lens_px, sigma_px)


def _matched_here(
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
    # a lens of few px has no small windows, and hardly a point beyond the margin of those that it has
    small = task.share == WINDOW_SHARE[1] and settings.window <= WINDOW_SHARE[1] * min(rows, cols) + 1
    if task.lens != 0 and not small:
        return found
    margin_px = MARGIN_SHARE * settings.window * factor  # another capture of the reference, or small windows
    inside = _inside(found[0], whole, margin_px) & _inside(found[1], whole, margin_px)
    return found[0][inside], found[1][inside], found[2][inside]


def _inside(xy_px: Float64, shape: tuple[int, int], margin_px: float) -> Bool:
    return np.asarray(((xy_px > margin_px) & (xy_px < np.array(shape[::-1]) - margin_px)).all(axis=1))


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
    """Return the reference, and the lens as the reference should see it, with the mask of the latter."""
    rows, cols = shape
    view = reference
    if shape != reference.shape:
        view = np.asarray(cv2.resize(reference, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)
    places, counts = map_places(shape, (0.0, 0.0), 1.0)
    at = task.lens_px(places * factor_xy)
    steps = np.nanmedian(np.abs(np.diff(at.reshape(*counts, 2)[:, :, 0], axis=1))) / 8
    target, at = coarsened(target, at, float(steps) if np.isfinite(steps) else 1.0)
    warped = resampled(coefficients_of(np.ascontiguousarray(target, np.float32)), at, counts, (rows, cols))
    valid = np.isfinite(warped)
    return (np.asarray(view, np.float32), np.nan_to_num(warped)), valid


def match_settings(shape: tuple[int, ...], radius_px: int, share: float) -> MatchSettings:
    """Return settings for frames of a `shape`: windows that are small enough for it.

    A smooth field must not lead the points: near the corners, where the distortion that is looked for bends
    most, it takes half of that away.
    """
    side = int(np.clip(share * min(shape), 31, 81)) // 2 * 2 + 1
    template = min(101, side + 20)
    return MatchSettings(
        features=400,
        search_radius=radius_px,
        window=side,
        template=template,
        ssim_min=0.0,
        consensus="off",
    )


def _overlap(observed: Observations, order: Sequence[Frame], share: float) -> float:
    """Return how many points share a window, on average."""
    views = len(np.unique(np.column_stack([observed.capture, observed.pose]), axis=0))
    side = match_settings(order[0].shape, 5, share).window
    return len(observed) / max(views, 1) * side**2 / math.prod(order[0].shape)


def _overlapping(
    state: RigState, chosen: Sequence[Capture], name: str, lens: Lens, runner: Runner, on_event: EventCallback
) -> list[tuple[int, int, Float64]]:
    """Return captures whose reference frames overlap with the next two's, and the poses between them."""
    lens = replace(lens, vector=state.lenses[0])
    pairs = [(k, k + step) for step in (1, 2) for k in range(len(chosen) - step)]
    calls = [(chosen[k].frames[name], chosen[m].frames[name], lens, state.planes[k]) for k, m in pairs]
    found = runner.run(find_overlap, calls, "overlaps", on_event).results
    return [(k, m, pose) for (k, m), pose in zip(pairs, found, strict=True) if pose is not None]


def find_overlap(one: Frame, other: Frame, lens: Lens, plane: Float64) -> Float64 | None:
    """Return the (6,) rotation and base between two captures; None where they do not overlap clearly.

    The frames are those of the reference lens, and the (3,) `plane` is the inverse depth of the
    first.
    """
    images = [read_frame(each.path, each.shape) for each in (one, other)]
    found = overlap_of(images[0], images[1])
    if found is None:
        return None
    source, aim, matrix = found
    start = np.zeros(6)
    start[2] = math.atan2(matrix[1, 0], matrix[0, 0])
    pose = _fitted_pose(lens, plane, source, aim, start, (2, 3, 4, 5))
    return _fitted_pose(lens, plane, source, aim, pose, (0, 1, 2, 3, 4, 5))


def overlap_of(reference: Float32, target: Float32) -> tuple[Float64, Float64, Float64] | None:
    """Return what two frames of one lens have in common: None where they do not overlap clearly.

    Frames of one band look alike: features are enough, and much faster than a search for the pose. Returned
    are (n, 2) px of both, corner-based, and the (2, 3) similarity between them; `reference` and `target` are
    (rows, cols) frames of the same size.
    """
    factor = min(1.0, COARSE_SIDE_PX / max(reference.shape))
    found = []
    for values in (reference, target):
        rows, cols = (max(16, round(n * factor)) for n in values.shape)
        small = cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA)
        low, high = np.percentile(small, (1, 99))
        grey = np.clip((small - low) / max(high - low, 1e-9) * 255, 0, 255).astype(np.uint8)
        points, descriptors = cv2.SIFT.create(800).detectAndCompute(grey, None)
        if descriptors is None or len(points) < MIN_OVERLAPPING:
            return None
        places = (np.array([each.pt for each in points]) + 0.5) / np.array([cols, rows])
        found.append((places * np.array(values.shape[::-1]), descriptors))
    pairs = cv2.BFMatcher().knnMatch(found[0][1], found[1][1], k=2)
    good = [first for first, second in pairs if first.distance < 0.8 * second.distance]
    if len(good) < MIN_OVERLAPPING:
        return None
    source = found[0][0][[each.queryIdx for each in good]]
    aim = found[1][0][[each.trainIdx for each in good]]
    matrix, inside = cv2.estimateAffinePartial2D(source, aim, ransacReprojThreshold=6 / factor)
    if matrix is None or int(inside.sum()) < MIN_OVERLAPPING:
        return None
    kept = inside.ravel() > 0
    return source[kept], aim[kept], np.asarray(matrix, np.float64)


def _fitted_pose(
    lens: Lens, plane: Float64, reference_px: Float64, lens_px: Float64, first: Float64, free: Sequence[int]
) -> Float64:
    """Return the pose between two captures that fits points best, most of them on the plane."""

    def misfit(x: Float64) -> Float64:
        pose = first.copy()
        pose[list(free)] = x
        at = _between(lens, lens, pose, plane, reference_px)
        return np.nan_to_num(at - lens_px, nan=1e3).ravel()

    found = least_squares(misfit, first[list(free)], loss="soft_l1", f_scale=2.0, x_scale=0.01)
    pose = first.copy()
    pose[list(free)] = found.x
    return pose


def _with_poses(
    state: RigState, sigma: RigState, extra: Sequence[tuple[int, int, Float64]]
) -> tuple[RigState, RigState]:
    """Return state and expected deviations with the poses between captures added."""
    if not extra:
        return state, sigma
    poses = np.vstack([state.poses, *(pose for *_, pose in extra)])
    weak = np.tile([0.5, 0.5, 0.5, 2.0, 2.0, 2.0], (len(extra), 1))
    pairs = tuple((one, other) for one, other, _ in extra)
    return (
        replace(state, poses=poses, overlaps=pairs),
        replace(
            sigma, lenses=sigma.lenses * SHARED_BEND, poses=np.vstack([sigma.poses, weak]), overlaps=pairs
        ),
    )


def _rig_of(
    found: Adjusted,
    observed: Observations,
    chosen: Sequence[Capture],
    sharpness: Sequence[Mapping[str, Sharpness]],
    order: Sequence[Frame],
) -> Rig:
    """Return the rig of an adjustment, with the precision of what it maps."""
    state = found.state
    deviation = np.sqrt(np.maximum(np.diag(found.covariance), 0))
    lenses = []
    for number, frame in enumerate(order):
        lens = Lens(state.models[number], frame.shape, state.lenses[number])
        first, pose = number * 8, state.lenses.size + number * 6
        mapping, distortion = _precision(found, number, frame.shape)
        own = [each[frame.lens] for each in sharpness]
        lenses.append(
            RigLens(
                name=frame.lens,
                lens=lens,
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
    heights = [each.height_m for each in chosen]
    known = [each for each in heights if each]
    distance = len(known) / sum(1 / each for each in known) if len(known) == len(heights) else None
    between = observed.pose < len(order)
    length = np.hypot(*found.residual_px.T)[found.kept & between]
    return Rig(
        lenses=tuple(lenses),
        camera=order[0].camera,
        distance_m=distance,
        inverse_depth=(float(state.planes[:, 0].min()), float(state.planes[:, 0].max())),
        tilt=float(np.clip(np.sqrt((state.planes[:, 1:] ** 2).mean()), 0.05, 0.5)),
        drift_px=_drift_px(found, observed, len(order)),
        captures=len(chosen),
        points=int((found.kept & between).sum()),
        residual_px=float(np.median(length)),
    )


def _drift_px(found: Adjusted, observed: Observations, lenses: int) -> float:
    """Return how far the points of a lens in one capture are off together, px, beyond chance."""
    offs = []
    for capture in np.unique(observed.capture):
        for lens in range(1, lenses):
            some = found.kept & (observed.capture == capture) & (observed.pose == lens)
            if some.sum() >= MIN_LENS_POINTS:
                offs.append(np.median(found.residual_px[some], axis=0))
    return float(np.clip(np.sqrt(np.mean(np.square(offs))) if offs else 0.05, 0.02, 1.0))


def _precision(found: Adjusted, number: int, shape: tuple[int, int]) -> tuple[tuple[float, float], float]:
    """Return median and largest sigma of what a lens is mapped to, and the largest of its distortion."""
    state = found.state
    reference = Lens(state.models[0], shape, state.lenses[0])
    places = lattice(reference.shape, max(shape) // 8)
    generator = np.random.default_rng(0)  # sampled, as the chain of the derivatives would be long
    own = [*range(8), *range(number * 8, number * 8 + 8)]
    pose = state.lenses.size + number * 6
    index = np.unique([*own, *range(pose, pose + 6)])
    covariance = found.covariance[np.ix_(index, index)]
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    moved, bent = [], []
    now = Lens(state.models[number], shape, state.lenses[number])
    base = _between(reference, now, state.poses[number], np.array([1.0, 0, 0]), places)
    for _ in range(60):
        vector = state.vector
        vector[index] += root @ generator.standard_normal(len(index))
        other = state.with_vector(vector)
        first = replace(reference, vector=other.lenses[0])
        second = replace(now, vector=other.lenses[number])
        moved.append(_between(first, second, other.poses[number], np.array([1.0, 0, 0]), places) - base)
        bent.append(now.distortion_px(second, max(shape) // 8))
    sigma = np.sqrt(np.nanmean(np.square(moved), axis=0).mean(axis=1))
    shortest = min(map(len, bent))
    bend = np.sqrt(np.mean([np.square(each[:shortest]) for each in bent], axis=0).mean(axis=1))
    return (float(np.nanmedian(sigma)), float(np.nanmax(sigma))), float(np.hypot(bend.max(), LEAST_BEND_PX))


def usual_of(sharpness: Sequence[Sharpness]) -> Sharpness:
    """Return the median (the higher one of two) of what frames of a lens look like."""
    figures = np.array([(each.detail, each.contrast) for each in sharpness])
    return Sharpness(*(float(each) for each in np.percentile(figures, 50, axis=0, method="higher")))


def inspect(capture: Capture) -> tuple[str | None, dict[str, Sharpness]]:
    """Return whether a capture shows a panel, and how, and what the frames of its lenses look like."""
    frames = list(capture.frames.values())
    values = [read_frame(each.path, each.shape) for each in frames]
    sharpness = {each.lens: measure_sharpness(plane) for each, plane in zip(frames, values, strict=True)}
    return panel_shown(frames, values), sharpness


def measure_sharpness(values: Float32) -> Sharpness:
    """Return what a frame of (rows, cols) `values` looks like.

    Noise has as much energy in the finest detail as blur takes away: so the bands of one and of two px are
    compared, of which noise holds little after the first smoothing. Motion takes detail away along its
    direction alone: the least of four directions counts.
    """
    fine = cv2.GaussianBlur(values, (0, 0), 1.0)
    middle = cv2.GaussianBlur(values, (0, 0), 2.0)
    coarse = cv2.GaussianBlur(values, (0, 0), 4.0)
    sharp, soft = fine - middle, middle - coarse
    ratios = [
        _slope_energy(sharp, 1, *step) / max(_slope_energy(soft, 2, *step), 1e-12)
        for step in ((0, 1), (1, 0), (1, 1), (1, -1))
    ]
    mean = abs(float(values.mean()))  # without noise, as dark frames have the more of it
    return Sharpness(min(ratios), float(coarse.std()) / max(mean, 1e-12))


def _slope_energy(plane: Float32, length: int, down: int, right: int) -> float:
    """Return the mean square of differences along a direction, over so many px."""
    moved = np.roll(plane, (length * down, length * right), (0, 1))
    return float(np.mean(np.square(plane - moved)))
