"""Where the ground of a capture was: its plane, and small rotations of the lenses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from pcwlad_geo.matching.maps import oriented_gradients, scene_epsilon
from pcwlad_geo.matching.refinement import ChannelMaps, InitialEstimate, Refined, refine
from pcwlad_geo.rigs.adjustment import Adjusted, Observations, RigState, adjust, predict
from pcwlad_geo.rigs.inspection import BadCaptureError
from pcwlad_geo.rigs.parameters import CAPTURE, LEARNING
from pcwlad_geo.rigs.rig import Rig, RigLens
from pcwlad_geo.rigs.warping import map_places, measured_side, resampled
from pcwlad_geo.types import Bool, Float32, Float64, Index


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """The plane of the ground of a capture, and the rotations of its lenses."""

    rig: Rig
    """The rig, with the rotations of this capture."""
    plane: Float64
    """(3,) inverse depth on the axis, and its slopes."""
    points: int
    residual_px: float
    sigma_px: float
    expected_ce90_px: float = math.nan
    """See `CaptureOutcome`; NaN before `with_expected_error`."""


def place(rig: Rig, values: Sequence[Float32], expected: float | None) -> Placement:
    """Fit the plane of the ground of a capture and small rotations of its lenses.

    The (rows, cols) `values` are its frames in the order of the lenses, and `expected` is the inverse depth
    by its height, None if unknown. Raises `BadCaptureError` if the lenses do not show one ground.
    """
    middle = math.sqrt(rig.inverse_depth[0] * rig.inverse_depth[1])
    inverse_depth = expected if expected is not None else middle
    starts = [inverse_depth] if expected is not None else _starts(rig, middle)
    best: Placement | None = None
    reasons: list[str] = []
    for start in starts:
        plane = np.array([start, 0.0, 0.0])
        now = rig
        try:
            for _ in range(3):
                observed = _measured(now, values, plane)
                placement, change_px = _adjusted(
                    now, rig, observed, plane, inverse_depth, expected is not None
                )
                now, plane = placement.rig, placement.plane
                if change_px < 1.5:  # px of the measured frame
                    break
        except BadCaptureError as error:
            reasons.append(str(error))
            continue
        if best is None or placement.points > best.points:
            best = placement
        if placement.points > 0.6 * CAPTURE.cells * (len(values) - 1):
            break
    if best is None:
        raise BadCaptureError(reasons[0])
    return best


def _starts(rig: Rig, middle: float) -> list[float]:
    """Return initial inverse depths: the middle, then others whose parallax lies beyond its search radius."""
    parallax = max(float(np.hypot(*lens.baseline[:2])) for lens in rig.lenses) * rig.reference.lens.focal_px
    shape = rig.reference.lens.shape
    factor = max(shape) / measured_side(shape)
    starts = [middle]
    for inverse_depth in np.geomspace(rig.inverse_depth[0] / 2, rig.inverse_depth[1] * 2, 5):
        if abs(inverse_depth - middle) * parallax > 1.5 * factor:
            starts.append(float(inverse_depth))
    return starts


def _measured(rig: Rig, values: Sequence[Float32], plane: Float64) -> Observations:
    """Measure places of the reference in the other lenses, all in the common frame at reduced size."""
    parts = []
    for number, lens in enumerate(rig.lenses[1:], 1):
        factor = reduction_of(rig, lens)
        corners, refinement = refined(rig, number, values, plane)
        good = refinement.converged
        variance = np.trace(refinement.covariance_px2[good], axis1=1, axis2=2) / 2
        sigma_px: Float64 = np.asarray(
            factor * np.maximum(np.sqrt(variance), CAPTURE.least_sigma_px), np.float64
        )
        origin_px: Float64 = np.asarray((corners[good][:, ::-1] + 0.5) * factor, np.float64)
        target_px = origin_px + refinement.shift_xy_px[good] * factor
        parts.append(_in_raw_frames(rig, number, plane, origin_px, target_px, sigma_px))
    return Observations.joined(parts)


def refined(
    rig: Rig, number: int, values: Sequence[Float32], plane: Float64, *, test: bool = False
) -> tuple[Index, Refined]:
    """Return (n, 2) row, column of places, and their refined shifts between the reference and a lens.

    The (rows, cols) `values` of both are warped by the (3,) `plane` to the common frame, at the size in
    which the lens is measured. A `test` has other places, smaller windows, and finds places that are
    displaced beyond the reach of the refinement.
    """
    lens = rig.lenses[number]
    first, first_valid = _in_common_frame(rig, rig.reference, values[0], plane, reduction_of(rig, lens))
    second, second_valid = _in_common_frame(rig, lens, values[number], plane, reduction_of(rig, lens))
    window = _window_px(first.shape)
    if test:
        window = max(21, round(CAPTURE.test_window_share * window)) // 2 * 2 + 1
    corners = corners_by_cell(first, first_valid & second_valid, window, between=test)
    if not test and len(corners) < CAPTURE.min_places:
        raise BadCaptureError(f"lens {lens.name} has too little structure where {rig.names[0]} sees it")
    maps = _channels(first, first_valid), _channels(second, second_valid)
    shift_xy_px = np.zeros((len(corners), 2))
    if test:
        one, other = (np.dstack(list(image.maps[::2])) for image in maps)
        for k, (row, col) in enumerate(corners.tolist()):
            shift_xy_px[k] = _displacement(one, other, row, col, window // 2)
    start = InitialEstimate(shift_xy_px, np.zeros((len(corners), 2, 2)))
    return corners, refine(*maps, corners, start, window_px=window)


def _displacement(one: Float32, other: Float32, row: int, col: int, half: int) -> tuple[float, float]:
    """Return the (col, row) shift of a window: 0, unless another one correlates distinctly better."""
    first_row, first_col = max(row - half - CAPTURE.reach_px, 0), max(col - half - CAPTURE.reach_px, 0)
    template = one[row - half : row + half + 1, col - half : col + half + 1]
    area = other[first_row : row + half + 1 + CAPTURE.reach_px, first_col : col + half + 1 + CAPTURE.reach_px]
    score = np.nan_to_num(cv2.matchTemplate(area, template, cv2.TM_CCOEFF_NORMED), posinf=-1.0)
    zero = row - half - first_row, col - half - first_col
    around_prediction = score[max(zero[0] - 2, 0) : zero[0] + 3, max(zero[1] - 2, 0) : zero[1] + 3]
    if score.max() <= around_prediction.max() + CAPTURE.displaced_correlation:
        return 0.0, 0.0
    down, right = np.array(np.unravel_index(score.argmax(), score.shape)) - zero
    return float(right), float(down)


def _window_px(shape: Sequence[int]) -> int:
    return int(np.clip(0.25 * min(shape), 21, 61)) // 2 * 2 + 1


def _points_per_window(rig: Rig, observed: Observations) -> float:
    """Return how many places of a lens share a window, on average."""
    shape = [round(n / reduction_of(rig, rig.lenses[1])) for n in rig.reference.lens.shape]
    return len(observed) / (len(rig.lenses) - 1) * _window_px(shape) ** 2 / math.prod(shape)


def _in_raw_frames(
    rig: Rig, number: int, plane: Float64, origin_px: Float64, target_px: Float64, sigma_px: Float64
) -> Observations:
    """Return places of the common frame as positions in the raw frames."""
    lens = rig.lenses[number]
    rays, moved_rays = rig.common_rays(origin_px), rig.common_rays(target_px)
    observed = lens.project(moved_rays, plane[0] + moved_rays @ plane[1:])
    raw = rig.reference.lens.project(rays)
    good = np.isfinite(observed).all(axis=1) & np.isfinite(raw).all(axis=1)
    count = int(good.sum())
    per_px = lens.lens.focal_px / rig.reference.lens.focal_px
    capture, of_lens = np.zeros(count, np.intp), np.full(count, number)
    return Observations(capture, of_lens, of_lens, raw[good], observed[good], sigma_px[good] * per_px)


def _in_common_frame(
    rig: Rig, lens: RigLens, values: Float32, plane: Float64, factor: float
) -> tuple[Float32, Bool]:
    """Return a frame warped to the common frame, reduced by a factor, and the mask of valid px."""
    rows, cols = (round(n / factor) for n in rig.reference.lens.shape)
    rays = rig.common_rays(map_places((rows, cols), (0.0, 0.0), factor))
    lens_px = lens.project(rays, plane[0] + rays @ plane[1:])
    reduction = factor * lens.lens.focal_px / rig.reference.lens.focal_px
    warped = resampled(values, lens_px, (rows, cols), reduction)
    valid = np.isfinite(warped)
    fill = float(warped[valid].mean()) if valid.any() else 0.0
    return np.where(valid, warped, np.float32(fill)), valid


def _channels(values: Float32, valid: Bool) -> ChannelMaps:
    maps, _ = oriented_gradients(values, scene_epsilon(values, valid), smooth_px=1.0)
    inside = cv2.erode(valid.astype(np.uint8), np.ones((7, 7), np.uint8), borderValue=1)
    return ChannelMaps(maps, np.asarray(inside, bool))


def corners_by_cell(values: Float32, valid: Bool, window_px: int, *, between: bool = False) -> Index:
    """Return (n, 2) row, column of the best corner of each cell of a frame, away from its edges.

    The window about it must be `valid`, a mask of the shape of the (rows, cols) `values`. With `between` the
    cells are shifted by half of their size.
    """
    rows, cols = values.shape
    side = max(8.0, math.sqrt(rows * cols / CAPTURE.cells))
    begin = side / 2 * between
    response = cv2.cornerMinEigenVal(cv2.GaussianBlur(values, (0, 0), 1.0), 9)
    kernel = np.ones((window_px, window_px), np.uint8)
    inside = cv2.erode(valid.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    response = np.where(inside > 0, response, -1.0)
    corners = []
    for first_row in np.arange(begin, rows, side).astype(int):
        for first_col in np.arange(begin, cols, side).astype(int):
            cell = response[first_row : first_row + round(side), first_col : first_col + round(side)]
            row, col = np.unravel_index(int(cell.argmax()), cell.shape)
            if cell[row, col] > 0:
                corners.append((first_row + row, first_col + col))
    return np.array(corners, np.intp).reshape(-1, 2)


def _adjusted(
    now: Rig, rig: Rig, observed: Observations, plane: Float64, inverse_depth: float, has_height: bool
) -> tuple[Placement, float]:
    """Return the fitted plane and rotations, and the 90 % of the change from `now` and `plane`, px.

    The `rig` is as learned, `near` the expected inverse depth.
    """
    lenses, poses = np.stack([lens.lens.vector for lens in rig.lenses]), _poses(rig)
    models = tuple(lens.lens.model for lens in rig.lenses)
    expected = RigState(models, lenses, poses, np.array([[inverse_depth, 0, 0]]))
    start = replace(expected, planes=plane[None])
    turn = rig.drift_px / rig.reference.lens.focal_px
    pose_sigma = np.zeros_like(poses)
    pose_sigma[1:, :2], pose_sigma[1:, 2] = turn, turn / rig.reference.lens.corner
    slope_sigma = rig.tilt * inverse_depth
    planes = np.array(
        [[LEARNING.inverse_depth_sigma[not has_height] * inverse_depth, slope_sigma, slope_sigma]]
    )
    sigma = RigState(models, np.zeros_like(lenses), pose_sigma, planes)
    density = _points_per_window(rig, observed)
    result = adjust(start, expected, sigma, observed, density, unit_mean_depth=False)
    scale = rig.reference.lens.focal_px / lenses[observed.lens, 0]
    length = np.hypot(*result.residual_px.T) * scale
    _check_agreement(rig, observed, length, result)
    turned = tuple(replace(lens, rotation=result.state.poses[k, :3]) for k, lens in enumerate(rig.lenses))
    factor = np.array([reduction_of(rig, lens) for lens in rig.lenses])[observed.lens]
    agreeing = length < CAPTURE.agree_px * factor
    placement = Placement(
        replace(rig, lenses=turned),
        result.state.planes[0],
        int(agreeing.sum()),
        float(np.median(length[agreeing])),
        _sigma_px(rig, result),
    )
    change = predict(replace(start, poses=_poses(now)), observed, 0.0) - predict(result.state, observed, 0.0)
    return placement, float(np.percentile(np.hypot(*change.T) * scale / factor, 90))


def _poses(rig: Rig) -> Float64:
    """Return the (lenses, 6) rotation vectors and baselines."""
    return np.stack([np.concatenate([lens.rotation, lens.baseline]) for lens in rig.lenses])


def reduction_of(rig: Rig, lens: RigLens) -> float:
    """Return how many px of the reference a px spans in which a lens is measured: not finer than its own."""
    first = rig.reference.lens
    return max(max(first.shape) / measured_side(first.shape), first.focal_px / lens.lens.focal_px)


def _check_agreement(rig: Rig, observed: Observations, length: Float64, result: Adjusted) -> None:
    """Raise `BadCaptureError` if a lens disagrees with the reference, or the distance is not plausible."""
    disagreeing = []
    for number, lens in enumerate(rig.lenses[1:], 1):
        factor = reduction_of(rig, lens)
        distance = length[observed.lens == number]
        close = distance[distance < CAPTURE.agree_px * factor]
        least = max(CAPTURE.min_places, CAPTURE.min_agreeing_share * len(distance))
        if len(close) < least or np.median(close) > CAPTURE.chance_ratio * CAPTURE.agree_px * factor:
            disagreeing.append(f"{lens.name} ({len(close)} of {len(distance)} places)")
    inverse_depth = float(result.state.planes[0, 0])
    if disagreeing:
        where = "it is too near, or the rig was learned from other captures than of flight, or lenses moved"
        raise BadCaptureError(
            f"lens {', '.join(disagreeing)} does not see what {rig.names[0]} sees: "
            f"{where if len(disagreeing) > 1 else 'it was covered, or it moved'}"
        )
    low, high = rig.inverse_depth
    if not low / CAPTURE.distance_ratio < inverse_depth < high * CAPTURE.distance_ratio:
        away = "" if rig.distance_m is None else f" ({rig.distance_m / max(inverse_depth, 1e-9):.1f} m)"
        raise BadCaptureError(
            f"its ground is {1 / max(inverse_depth, 1e-9):.2g} times as far as learned{away}: "
            "too near or too far"
        )


def _sigma_px(rig: Rig, result: Adjusted) -> float:
    """Return the largest sigma of the mapping to a lens on the axis: of capture and rig, reference px."""
    focal, poses = rig.reference.lens.focal_px, result.state.lenses.size
    plane = poses + result.state.poses.size
    largest = 0.0
    for number, lens in enumerate(rig.lenses[1:], 1):
        index = [poses + 6 * number, poses + 6 * number + 1, plane]
        x, y = lens.baseline[:2]
        covariance = result.covariance[np.ix_(index, index)]
        rows = focal * np.array([[0.0, 1.0, x], [-1.0, 0.0, y]])
        of_capture = float(np.sqrt(np.diag(rows @ covariance @ rows.T).max()))
        of_rig = lens.mapping_sigma_px[0] * focal / lens.lens.focal_px
        largest = max(largest, math.hypot(of_capture, of_rig))
    return largest
