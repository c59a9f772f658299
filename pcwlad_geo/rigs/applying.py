"""One capture: its quality, the plane of its ground, and the warp of every lens into the common frame."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.maps import oriented_gradients, scene_epsilon
from pcwlad_geo.matching.refinement import ChannelMaps, InitialEstimate, Refined, refine
from pcwlad_geo.raster.gdal import check_dataset, ignoring, reading
from pcwlad_geo.raster.source import open_raster
from pcwlad_geo.registration.fitting import FAIR_PX, GOOD_PX, POOR_KEPT_SHARE, Grade
from pcwlad_geo.rigs.adjustment import Adjusted, Observations, RigState, adjust, predict
from pcwlad_geo.rigs.captures import Capture, Frame, panel_shown, read_frame
from pcwlad_geo.rigs.learning import INVERSE_DEPTH_SIGMA, measure_sharpness
from pcwlad_geo.rigs.rig import (
    Rig,
    RigLens,
    Sharpness,
    grade_of,
    map_places,
    measured_side,
    resampled,
)
from pcwlad_geo.types import Bool, Float32, Float64, Index

CaptureStatus = Literal["corrected", "rejected", "unusable", "failed"]

CAPTURE_TAG: Final = "PCWLAD_GEO_CAPTURE"
"""Tag of a raster with the name of its capture."""
CELLS: Final = 160
"""Number of cells of a frame, each with at most one place that is measured in every lens."""
BLURRED_SHARE: Final = 0.55
"""Share of the least detail learned below which a frame is blurred."""
COVERED_SHARE: Final = 0.12
"""Share of the contrast learned below which a lens is covered."""
MIN_AGREEING_SHARE: Final = 0.3
"""Least share of the places of a lens that agree with the rig."""
MIN_PLACES: Final = 12
"""Least number of them that agree."""
AGREE_PX: Final = 1.0
"""Distance from the model within which a place agrees, px of the measured frame."""
LEAST_SIGMA_PX: Final = 0.05
"""Least standard deviation of a place, px of the measured frame."""
DISTANCE_RATIO: Final = 6.0
"""How many times nearer than the nearest capture learned from, or farther than the farthest, is plausible."""
CHANCE_RATIO: Final = 0.55
"""Median distance of the agreeing places of a lens, over `AGREE_PX`, from which they agree by chance: that of
uniformly distributed places is 0.7."""
PANEL_RATIO: Final = 1.5
"""Captures that are nearer than the nearest capture learned from by this factor are searched for a panel."""
TEST_WINDOW_SHARE: Final = 0.6
"""Side of the windows that test a capture, as a share of those of the fit: objects off the plane of the
ground may be small."""
REACH_PX: Final = 12
"""Search radius of a displaced place, px of the measured frame."""
DISPLACED_CORRELATION: Final = 0.1
"""Least gain of correlation over that near the prediction for a place to count as displaced: repetitive
structure, as rows of plants, gains less."""


@dataclass(frozen=True, slots=True, eq=False)
class CaptureTask:
    """What a worker needs to correct one capture."""

    rig: Rig
    capture: Capture
    crop: tuple[int, int, int, int]
    """First column and first row in the common frame, then numbers of columns and rows."""
    path: str
    """Where the raster is written."""
    digest: str
    """Digest of the inputs, which is written to the raster."""
    compress: str = "DEFLATE"


@dataclass(frozen=True, slots=True, eq=False)
class CaptureOutcome:
    """What became of a capture."""

    name: str
    status: CaptureStatus
    """`rejected`: a bad capture; `unusable`: its files cannot be used; `failed`: an unexpected error."""
    reason: str | None = None
    file: str | None = None
    """Name of the raster in the output folder."""
    points: int | None = None
    """Places that agree with the rig."""
    residual_px: float | None = None
    """Their median distance from it, px of the common frame."""
    inverse_depth: float | None = None
    """Inverse depth: mean distance of the captures learned from over the distance of this one."""
    distance_m: float | None = None
    """Distance of the ground; None if the rig has no scale in metres."""
    sigma_px: float | None = None
    """Largest standard deviation of the mapping to a lens in the middle of the frame."""
    quality: Grade | None = None
    """Grade as of a registration: `good` if 90 % of the frame is expected to lie within 0.5 px, of the
    coarser lens; `fair` within 1 px; `poor` otherwise. The `reason` says why it is not good."""
    expected_ce90_px: float | None = None
    """Error that 90 % of the frame is expected not to exceed, by places that were not used in the fit."""
    seconds: float | None = None
    done_before: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
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


def doubt_of(expected_ce90_px: float) -> str | None:
    """Return why a capture, or a rig, is not good; None if it is."""
    if expected_ce90_px <= GOOD_PX:
        return None
    return (
        f"a tenth of the frame is expected to lie more than {expected_ce90_px:.1f} px off: ground of several "
        "depths, or lenses that moved"
    )


class BadCaptureError(Exception):
    """The capture cannot be corrected, and why."""


def correct_capture(task: CaptureTask) -> CaptureOutcome:
    """Correct one capture, or say why that cannot be done; nothing is raised but for an unexpected error."""
    begun = time.perf_counter()
    name = task.capture.name
    try:
        placed, frames, values = placed_capture(task.rig, task.capture)
        write_capture(task, placed, frames, values)
    except BadCaptureError as error:
        return CaptureOutcome(name, "rejected", str(error))
    except InputError as error:
        return CaptureOutcome(name, "unusable", str(error))
    near = float(placed.plane[0])
    return CaptureOutcome(
        name,
        "corrected",
        doubt_of(placed.expected_ce90_px),
        file=f"{name}.tif",
        points=placed.points,
        residual_px=placed.residual_px,
        inverse_depth=near,
        distance_m=None if task.rig.distance_m is None else task.rig.distance_m / near,
        sigma_px=placed.sigma_px,
        quality=grade_of(placed.expected_ce90_px),
        expected_ce90_px=placed.expected_ce90_px,
        seconds=time.perf_counter() - begun,
    )


def placed_capture(rig: Rig, capture: Capture) -> tuple[Placed, list[Frame], list[Float32]]:
    """Return where the ground of a capture was, and its frames with their (rows, cols) values.

    Raises `BadCaptureError` if it cannot be corrected.
    """
    frames = [capture.frames[each] for each in rig.names]
    values = [read_frame(each.path, each.shape) for each in frames]
    height_m, distance_m = capture.height_m, rig.distance_m
    expected = None if height_m is None or distance_m is None else distance_m / height_m
    try:
        sharpness = {name: measure_sharpness(plane) for name, plane in zip(rig.names, values, strict=True)}
        check_sharpness({each.name: each.sharpness for each in rig.lenses}, sharpness)
        placed = with_expected_error(place(rig, values, expected), values)
    except BadCaptureError as error:
        raise BadCaptureError(panel_shown(frames, values) or str(error)) from error
    near = placed.plane[0] > PANEL_RATIO * rig.inverse_depth[1]
    panel = panel_shown(frames, values) if near or any(each.panel for each in frames) else None
    if panel is not None:
        raise BadCaptureError(panel)
    return placed, frames, values


def with_expected_error(placed: Placed, values: Sequence[Float32]) -> Placed:
    """Return a capture with its expected error, by places that its fit has not used.

    The (rows, cols) `values` are its frames. Raises `BadCaptureError` if hardly any place agrees.
    """
    rig = placed.rig
    errors_px, count = [], 0
    for number, each in enumerate(rig.lenses[1:], 1):
        corners, found = _refined(rig, number, values, placed.plane, test=True)
        own_px = _reduction(rig, each) * min(1.0, each.lens.focal_px / rig.reference.lens.focal_px)
        errors_px.append(own_px * np.hypot(*found.shift_xy_px[found.converged].T))
        count += len(corners)
    every = np.concatenate(errors_px)
    agreeing = int((every < FAIR_PX).sum())
    measured = all(map(len, errors_px))
    expected = max([np.percentile(every, 90), *map(np.median, errors_px)]) if measured else math.inf
    if expected > FAIR_PX and agreeing <= POOR_KEPT_SHARE * count:
        raise BadCaptureError(
            f"only {agreeing} of {count} places lie within {FAIR_PX:g} px of one ground: it has several "
            "depths, as near scenes do, its lenses show different ground, or the rig is not of this camera "
            "as it is"
        )
    return replace(placed, expected_ce90_px=float(expected))


def _displacement(one: Float32, other: Float32, row: int, col: int, half: int) -> tuple[float, float]:
    """Return the (col, row) shift of a window: 0, unless another one correlates distinctly better."""
    top, left = max(row - half - REACH_PX, 0), max(col - half - REACH_PX, 0)
    template = one[row - half : row + half + 1, col - half : col + half + 1]
    area = other[top : row + half + 1 + REACH_PX, left : col + half + 1 + REACH_PX]
    score = np.nan_to_num(cv2.matchTemplate(area, template, cv2.TM_CCOEFF_NORMED), posinf=-1.0)
    zero = row - half - top, col - half - left
    near = score[max(zero[0] - 2, 0) : zero[0] + 3, max(zero[1] - 2, 0) : zero[1] + 3]
    if score.max() <= near.max() + DISPLACED_CORRELATION:
        return 0.0, 0.0
    down, right = np.array(np.unravel_index(score.argmax(), score.shape)) - zero
    return float(right), float(down)


def check_sharpness(expected: Mapping[str, Sharpness], measured: Mapping[str, Sharpness]) -> None:
    """Raise `BadCaptureError` if the frame of a lens is blurred, or has much less contrast than expected."""
    covered = [
        name
        for name, usual in expected.items()
        if not measured[name].contrast > COVERED_SHARE * usual.contrast
    ]
    blurred = [
        name for name, usual in expected.items() if measured[name].detail < BLURRED_SHARE * usual.detail
    ]
    if covered:
        raise BadCaptureError(
            f"lens {', '.join(covered)} shows hardly anything: it was covered, or it failed"
        )
    if blurred:
        raise BadCaptureError(f"lens {', '.join(blurred)} is blurred")


def try_capture(rig: Rig, capture: Capture) -> float | str:
    """Return the error expected of a capture, px, or why it cannot be corrected."""
    try:
        return placed_capture(rig, capture)[0].expected_ce90_px
    except BadCaptureError as error:
        return str(error)


def place(rig: Rig, values: Sequence[Float32], expected: float | None) -> Placed:
    """Fit the plane of the ground of a capture and small rotations of its lenses.

    The (rows, cols) `values` are its frames in the order of the lenses, and `expected` is the inverse depth
    by its height, None if unknown. Raises `BadCaptureError` if the lenses do not show one ground.
    """
    middle = math.sqrt(rig.inverse_depth[0] * rig.inverse_depth[1])
    near = expected if expected is not None else middle
    starts = [near] if expected is not None else _starts(rig, middle)
    best: Placed | None = None
    reasons: list[str] = []
    for start in starts:
        plane = np.array([start, 0.0, 0.0])
        now = rig
        try:
            for _ in range(3):
                observed = _measured(now, values, plane)
                placed, moved = _adjusted(now, rig, observed, plane, near, expected is not None)
                now, plane = placed.rig, placed.plane
                if moved < 1.5:  # px of the measured frame
                    break
        except BadCaptureError as error:
            reasons.append(str(error))
            continue
        if best is None or placed.points > best.points:
            best = placed
        if placed.points > 0.6 * CELLS * (len(values) - 1):
            break
    if best is None:
        raise BadCaptureError(reasons[0])
    return best


def _starts(rig: Rig, middle: float) -> list[float]:
    """Return initial inverse depths: the middle, then others whose parallax lies beyond its search radius."""
    parallax = max(float(np.hypot(*each.baseline[:2])) for each in rig.lenses) * rig.reference.lens.focal_px
    shape = rig.reference.lens.shape
    factor = max(shape) / measured_side(shape)
    starts = [middle]
    for near in np.geomspace(rig.inverse_depth[0] / 2, rig.inverse_depth[1] * 2, 5):
        if abs(near - middle) * parallax > 1.5 * factor:
            starts.append(float(near))
    return starts


def _measured(rig: Rig, values: Sequence[Float32], plane: Float64) -> Observations:
    """Measure places of the reference in the other lenses, all in the common frame at reduced size."""
    parts = []
    for number, each in enumerate(rig.lenses[1:], 1):
        factor = _reduction(rig, each)
        corners, found = _refined(rig, number, values, plane)
        good = found.converged
        variance = np.trace(found.covariance_px2[good], axis1=1, axis2=2) / 2
        sigma_px: Float64 = np.asarray(factor * np.maximum(np.sqrt(variance), LEAST_SIGMA_PX), np.float64)
        origin_px: Float64 = np.asarray((corners[good][:, ::-1] + 0.5) * factor, np.float64)
        target_px = origin_px + found.shift_xy_px[good] * factor
        parts.append(_in_raw_frames(rig, number, plane, origin_px, target_px, sigma_px))
    return Observations.joined(parts)


def _refined(
    rig: Rig, number: int, values: Sequence[Float32], plane: Float64, *, test: bool = False
) -> tuple[Index, Refined]:
    """Return (n, 2) row, column of places, and their refined shifts between the reference and a lens.

    Both are warped by the plane to the common frame, at the size in which the lens is measured. A `test` has
    other places, smaller windows, and finds places that are displaced beyond the reach of the refinement.
    """
    lens = rig.lenses[number]
    first, first_valid = _in_common_frame(rig, rig.reference, values[0], plane, _reduction(rig, lens))
    second, second_valid = _in_common_frame(rig, lens, values[number], plane, _reduction(rig, lens))
    window = _window_px(first.shape)
    if test:
        window = max(21, round(TEST_WINDOW_SHARE * window)) // 2 * 2 + 1
    corners = corners_by_cell(first, first_valid & second_valid, window, between=test)
    if not test and len(corners) < MIN_PLACES:
        raise BadCaptureError(f"lens {lens.name} has too little structure where {rig.names[0]} sees it")
    maps = _channels(first, first_valid), _channels(second, second_valid)
    shift_xy_px = np.zeros((len(corners), 2))
    if test:
        one, other = (np.dstack(list(each.maps[::2])) for each in maps)
        for k, (row, col) in enumerate(corners.tolist()):
            shift_xy_px[k] = _displacement(one, other, row, col, window // 2)
    start = InitialEstimate(shift_xy_px, np.zeros((len(corners), 2, 2)))
    return corners, refine(*maps, corners, start, window_px=window)


def _window_px(shape: Sequence[int]) -> int:
    return int(np.clip(0.25 * min(shape), 21, 61)) // 2 * 2 + 1


def _points_per_window(rig: Rig, observed: Observations) -> float:
    """Return how many places of a lens share a window, on average."""
    shape = [round(n / _reduction(rig, rig.lenses[1])) for n in rig.reference.lens.shape]
    return len(observed) / (len(rig.lenses) - 1) * _window_px(shape) ** 2 / math.prod(shape)


def _in_raw_frames(
    rig: Rig, number: int, plane: Float64, origin_px: Float64, target_px: Float64, sigma_px: Float64
) -> Observations:
    """Return places of the common frame as positions in the raw frames."""
    lens = rig.lenses[number]
    rays, moved = rig.common_rays(origin_px), rig.common_rays(target_px)
    observed = lens.project(moved, plane[0] + moved @ plane[1:])
    raw = rig.reference.lens.project(rays)
    good = np.isfinite(observed).all(axis=1) & np.isfinite(raw).all(axis=1)
    count = int(good.sum())
    per_px = lens.lens.focal_px / rig.reference.lens.focal_px
    capture, of_lens = np.zeros(count, np.intp), np.full(count, number)
    return Observations(capture, of_lens, of_lens, raw[good], observed[good], sigma_px[good] * per_px)


def _in_common_frame(
    rig: Rig, each: RigLens, values: Float32, plane: Float64, factor: float
) -> tuple[Float32, Bool]:
    """Return a frame warped to the common frame, reduced by a factor, and the mask of valid px."""
    rows, cols = (round(n / factor) for n in rig.reference.lens.shape)
    rays = rig.common_rays(map_places((rows, cols), (0.0, 0.0), factor))
    lens_px = each.project(rays, plane[0] + rays @ plane[1:])
    reduction = factor * each.lens.focal_px / rig.reference.lens.focal_px
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
    side = max(8.0, math.sqrt(rows * cols / CELLS))
    begin = side / 2 * between
    response = cv2.cornerMinEigenVal(cv2.GaussianBlur(values, (0, 0), 1.0), 9)
    kernel = np.ones((window_px, window_px), np.uint8)
    inside = cv2.erode(valid.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    response = np.where(inside > 0, response, -1.0)
    found = []
    for top in np.arange(begin, rows, side).astype(int):
        for left in np.arange(begin, cols, side).astype(int):
            cell = response[top : top + round(side), left : left + round(side)]
            row, col = np.unravel_index(int(cell.argmax()), cell.shape)
            if cell[row, col] > 0:
                found.append((top + row, left + col))
    return np.array(found, np.intp).reshape(-1, 2)


def _adjusted(
    now: Rig, rig: Rig, observed: Observations, plane: Float64, near: float, height_known: bool
) -> tuple[Placed, float]:
    """Return the fitted plane and rotations, and the 90 % of the change from `now` and `plane`, px.

    The `rig` is as learned, `near` the expected inverse depth.
    """
    lenses, poses = np.stack([each.lens.vector for each in rig.lenses]), _poses(rig)
    models = tuple(each.lens.model for each in rig.lenses)
    expected = RigState(models, lenses, poses, np.array([[near, 0, 0]]))
    start = replace(expected, planes=plane[None])
    turn = rig.drift_px / rig.reference.lens.focal_px
    pose_sigma = np.zeros_like(poses)
    pose_sigma[1:, :2], pose_sigma[1:, 2] = turn, turn / rig.reference.lens.corner
    slope_sigma = rig.tilt * near
    planes = np.array([[INVERSE_DEPTH_SIGMA[not height_known] * near, slope_sigma, slope_sigma]])
    sigma = RigState(models, np.zeros_like(lenses), pose_sigma, planes)
    density = _points_per_window(rig, observed)
    result = adjust(start, expected, sigma, observed, density, unit_mean_depth=False)
    scale = rig.reference.lens.focal_px / lenses[observed.lens, 0]
    length = np.hypot(*result.residual_px.T) * scale
    _check_agreement(rig, observed, length, result)
    turned = tuple(replace(each, rotation=result.state.poses[k, :3]) for k, each in enumerate(rig.lenses))
    factor = np.array([_reduction(rig, each) for each in rig.lenses])[observed.lens]
    agreeing = length < AGREE_PX * factor
    placed = Placed(
        replace(rig, lenses=turned),
        result.state.planes[0],
        int(agreeing.sum()),
        float(np.median(length[agreeing])),
        _sigma_px(rig, result),
    )
    change = predict(replace(start, poses=_poses(now)), observed, 0.0) - predict(result.state, observed, 0.0)
    return placed, float(np.percentile(np.hypot(*change.T) * scale / factor, 90))


def _poses(rig: Rig) -> Float64:
    """Return the (lenses, 6) rotation vectors and baselines."""
    return np.stack([np.concatenate([each.rotation, each.baseline]) for each in rig.lenses])


def _reduction(rig: Rig, lens: RigLens) -> float:
    """Return how many px of the reference a px spans in which a lens is measured: not finer than its own."""
    first = rig.reference.lens
    return max(max(first.shape) / measured_side(first.shape), first.focal_px / lens.lens.focal_px)


def _check_agreement(rig: Rig, observed: Observations, length: Float64, result: Adjusted) -> None:
    """Raise `BadCaptureError` if a lens disagrees with the reference, or the distance is not plausible."""
    lost = []
    for number, each in enumerate(rig.lenses[1:], 1):
        factor = _reduction(rig, each)
        own = length[observed.lens == number]
        close, least = own[own < AGREE_PX * factor], max(MIN_PLACES, MIN_AGREEING_SHARE * len(own))
        if len(close) < least or np.median(close) > CHANCE_RATIO * AGREE_PX * factor:
            lost.append(f"{each.name} ({len(close)} of {len(own)} places)")
    near = float(result.state.planes[0, 0])
    if lost:
        where = "it is too near, or the rig was learned from other captures than of flight, or lenses moved"
        raise BadCaptureError(
            f"lens {', '.join(lost)} does not see what {rig.names[0]} sees: "
            f"{where if len(lost) > 1 else 'it was covered, or it moved'}"
        )
    if not rig.inverse_depth[0] / DISTANCE_RATIO < near < rig.inverse_depth[1] * DISTANCE_RATIO:
        away = "" if rig.distance_m is None else f" ({rig.distance_m / max(near, 1e-9):.1f} m)"
        raise BadCaptureError(
            f"its ground is {1 / max(near, 1e-9):.2g} times as far as learned{away}: too near or too far"
        )


def _sigma_px(rig: Rig, result: Adjusted) -> float:
    """Return the largest sigma of the mapping to a lens on the axis: of capture and rig, reference px."""
    focal, poses = rig.reference.lens.focal_px, result.state.lenses.size
    plane = poses + result.state.poses.size
    largest = 0.0
    for number, each in enumerate(rig.lenses[1:], 1):
        index = [poses + 6 * number, poses + 6 * number + 1, plane]
        x, y = each.baseline[:2]
        covariance = result.covariance[np.ix_(index, index)]
        rows = focal * np.array([[0.0, 1.0, x], [-1.0, 0.0, y]])
        of_capture = float(np.sqrt(np.diag(rows @ covariance @ rows.T).max()))
        of_rig = each.mapping_sigma_px[0] * focal / each.lens.focal_px
        largest = max(largest, math.hypot(of_capture, of_rig))
    return largest


def write_capture(
    task: CaptureTask, placed: Placed, frames: Sequence[Frame], values: Sequence[Float32]
) -> None:
    """Warp every lens once into the common crop and write one raster, with names, wavelengths and EXIF.

    The `values` are the (rows, cols) `frames` of the lenses as they were measured.
    """
    left, top, cols, rows = task.crop
    rays = placed.rig.common_rays(map_places((rows, cols), (float(left), float(top)), 1.0))
    inverse_depth = placed.plane[0] + rays @ placed.plane[1:]
    bands: list[tuple[str, RigLens, Frame, NDArray[Any]]] = []
    dtype = np.result_type(*(each.dtype for each in frames))
    for each, frame, raw in zip(placed.rig.lenses, frames, values, strict=True):
        lens_px = each.project(rays, inverse_depth)
        planes = _bands_of(frame, raw)
        for number, plane in enumerate(planes, 1):
            name = each.name if len(planes) == 1 else f"{each.name} {number}"
            bands.append((name, each, frame, _as_dtype(resampled(plane, lens_px, (rows, cols)), dtype)))
    _write(task, placed, bands)


def _bands_of(frame: Frame, values: Float32) -> list[Float32]:
    """Return the bands of a frame; `values` are those of the only one."""
    with open_raster(frame.path) as dataset:
        if dataset.count == 1:
            return [values]
        check_dataset(frame.path, dataset, 1)
        with reading(frame.path):
            read = dataset.read(list(range(1, min(dataset.count, 3) + 1)), out_dtype=np.float32)
    return [np.ascontiguousarray(each) for each in read]


def _as_dtype(warped: Float32, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return values in the type of the output; nodata, outside the frame of a lens, is 0 or NaN."""
    if dtype.kind == "f":
        return warped.astype(dtype)
    limits = np.iinfo(dtype)
    known = np.isfinite(warped)
    least = 1 if limits.min == 0 else limits.min  # a value of 0 is distinct from nodata, as of gdalwarp
    whole = np.clip(np.rint(np.where(known, warped, 0)), least, limits.max).astype(dtype)
    return np.where(known, whole, 0).astype(dtype)


def _write(
    task: CaptureTask, placed: Placed, bands: Sequence[tuple[str, RigLens, Frame, NDArray[Any]]]
) -> None:
    (rows, cols), dtype = bands[0][3].shape, bands[0][3].dtype
    with (
        ignoring(NotGeoreferencedWarning),
        rasterio.open(
            task.path,
            "w",
            driver="GTiff",
            height=rows,
            width=cols,
            count=len(bands),
            dtype=dtype.name,
            nodata=math.nan if dtype.kind == "f" else 0,
            tiled=True,
            compress=task.compress,
            predictor="3" if dtype.kind == "f" else "2",
            zlevel=1,
            interleave="band",
            photometric="MINISBLACK",
        ) as out,
    ):
        out.update_tags(**_common_tags(task, placed, bands[0][2]))
        for number, (name, lens, frame, values) in enumerate(bands, 1):
            out.write(values, number)
            out.set_band_description(number, name)
            out.update_tags(number, **{f"XMP_{key}": value for key, value in frame.xmp.items()})
            if lens.wavelength_nm is not None:
                centre, width = lens.wavelength_nm
                out.update_tags(number, WAVELENGTH=f"{centre:g}", WAVELENGTH_UNITS="nm", FWHM=f"{width:g}")
                out.update_tags(
                    number,
                    ns="IMAGERY",
                    CENTRAL_WAVELENGTH_UM=f"{centre / 1e3:g}",
                    FWHM_UM=f"{width / 1e3:g}",
                )


def _common_tags(task: CaptureTask, placed: Placed, frame: Frame) -> Mapping[str, str]:
    left, top, *_ = task.crop
    lens = task.rig.reference.lens
    col, row = lens.vector[1:3] - (left, top)
    return {
        # two names are parameters of rasterio's function for tags
        **{name: value for name, value in frame.exif.items() if name not in ("bidx", "ns")},
        CAPTURE_TAG: task.capture.name,
        "PCWLAD_GEO_INPUTS": task.digest,
        "CAMERA_MODEL": "pinhole, no distortion",
        "CAMERA_FOCAL_PX": f"{lens.focal_px:.4f}",
        "CAMERA_PRINCIPAL_POINT_PX": f"{col:.4f} {row:.4f}",
        "RIG_ROTATIONS_RAD": "; ".join(
            " ".join(f"{each:.9f}" for each in lens.rotation) for lens in placed.rig.lenses
        ),
        "RIG_INVERSE_DEPTH": " ".join(f"{each:.6f}" for each in placed.plane),
    }
