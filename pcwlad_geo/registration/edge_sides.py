"""Errors that all tie points share, as edges or light differ between both images; no residual shows them.

A shadow lies beside what casts it, and the edges of a height model need not be those of an image: such a pair
agrees on the mean of the displacements of both sides of things. Here the edges of either sign of one image
are compared with all edges of the other. Slopes in other light have other edges, and nearly the same grey
values: where these correlate closely, the displacement that they tell is compared with that of the points.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.matching import TiePoints
from pcwlad_geo.raster import Patch, ViewPair, Window
from pcwlad_geo.types import Bool, Float32, Float64, Index


@dataclass(frozen=True, slots=True)
class EdgeParameters:
    """How the two sides are compared, px of the matching grid."""

    side_px: int = 384
    """Largest side of the part that is looked at, around the middle of the tie points."""
    gradient_sigma_px: float = 1.0
    """Sigma of the smoothing before the gradient."""
    margin_px: int = 60
    """Width around the tie points that counts, too: less than matching reads around its candidates."""
    surroundings_px: int = 15
    """Side of the surroundings by whose contrast a gradient is divided."""
    reach_px: int = 2
    """Largest displacement of a side that is looked for."""
    strips: int = 4
    """Parts across the longer side, in which the difference must have one sign; one may tell nothing."""
    least_px: float = 0.25
    """Least error that is told: at most 0.1 px on bands of the same edges, 0.38 px of heights."""
    surface_sigma_px: float = 8.0
    """Sigma of the filter whose result is subtracted from grey values, and that levels their contrast."""
    alike: float = 0.8
    """Least correlation of grey values, in all strips but one, from which they tell a displacement."""
    least_light_px: float = 0.25
    """Least distance of both that counts, px: 0.5 of slopes in other light, up to 0.2 of other sensors."""


@dataclass(frozen=True, slots=True, eq=False)
class SharedErrors:
    """Errors that all tie points share, (2,) view px (col, row) each, 0 where that may be chance."""

    of_sides_px: Float64
    """Half of the distance between rising and falling edges."""
    of_light_px: Float64
    """Half of the distance between what edges and what grey values tell: the truth is one, or between."""


def shared_errors(
    pair: ViewPair, points: TiePoints, parameters: EdgeParameters = EdgeParameters()
) -> SharedErrors:
    """Return the errors that tie points share, see the module.

    The points are of the views of the pair. Raises `InputError` if these cannot be read.
    """
    col, row = np.median(points.reference_xy_px, axis=0).astype(int).tolist()
    half = parameters.side_px // 2
    window = Window(row - half, col - half, parameters.side_px, parameters.side_px).clipped(
        pair.reference.grid.shape
    )
    box = Window.around(points.reference_xy_px.min(axis=0), points.reference_xy_px.max(axis=0))
    window = window.intersection(box.padded(parameters.margin_px))
    shift_px = np.round(np.median(points.displacement_px, axis=0)).astype(int).tolist()
    reference = pair.reference.read(window)
    target = _on_reference(pair.target.read(window.moved(shift_px[1], shift_px[0])), window, shift_px, points)
    valid = reference.valid & target.valid
    valid = cv2.erode(valid.astype(np.uint8), np.ones((parameters.surroundings_px,) * 2), borderValue=0) > 0
    edges = [_gradient(patch, parameters) for patch in (reference, target)]
    values = [_levelled(patch, parameters) for patch in (reference, target)]
    along = int(valid.shape[1] > valid.shape[0])
    parts = np.array_split(np.arange(valid.shape[along]), parameters.strips)
    alike = [
        part
        for part in parts
        if _correlation(*_strip(values[0], values[1], valid, part, along)) >= parameters.alike
    ]
    of_sides_px, of_light_px = np.zeros(2), np.zeros(2)
    for axis in (0, 1):
        first, second = edges[0][axis], edges[1][axis]
        apart_px = [
            _separation_px(*_strip(first, second, valid, part, along), axis, parameters) for part in parts
        ]
        off_px = [
            _displacement(*_strip(values[0], values[1], valid, part, along), axis, parameters)
            for part in alike
        ]
        of_sides_px[axis] = _error_of_sides_px(np.array(apart_px), parameters)
        of_light_px[axis] = _error_of_light_px(np.array(off_px), parameters)
    return SharedErrors(of_sides_px, of_light_px)


def _strip(
    first: Float32, second: Float32, valid: Bool, part: Index, along: int
) -> tuple[Float32, Float32, Bool]:
    return np.take(first, part, along), np.take(second, part, along), np.take(valid, part, along)


def _error_of_sides_px(apart_px: Float64, parameters: EdgeParameters) -> float:
    """Return half of the typical distance of (strips, 2) ones, NaN unknown; 0 where their signs differ."""
    finite = np.isfinite(apart_px)
    same_sign = np.abs(np.sign(apart_px).sum(axis=0, where=finite)) == finite.sum(axis=0)
    if (finite.sum(axis=0) < parameters.strips - 1).any() or not same_sign.all():
        return 0.0
    size_px = np.abs(np.nanmedian(apart_px, axis=0)) / 2
    return float(size_px.mean()) if size_px.min() >= parameters.least_px else 0.0


def _error_of_light_px(off_px: Float64, parameters: EdgeParameters) -> float:
    """Return half of what grey values of strips lie off, an (n,) array, NaN unknown; 0 if too few tell."""
    off_px = off_px[np.isfinite(off_px)]
    if len(off_px) < max(parameters.strips - 1, 2):
        return 0.0
    error_px = float(off_px.std(ddof=1)) / len(off_px) ** 0.5
    middle_px = abs(float(off_px.mean()))
    return middle_px / 2 if middle_px >= max(parameters.least_light_px, 2 * error_px) else 0.0


def _correlation(first: Float32, second: Float32, valid: Bool) -> float:
    """Return the highest correlation of two planes that lie at most a pixel apart along each axis."""
    inner = valid[1:-1, 1:-1]
    if np.count_nonzero(inner) < 2:
        return 0.0
    rows, cols = valid.shape
    fixed = first[1:-1, 1:-1][inner]
    fixed = (fixed - fixed.mean()) / max(float(fixed.std()), 1e-9)
    correlations = []
    for row, col in ((row, col) for row in range(3) for col in range(3)):
        moving = second[row : rows - 2 + row, col : cols - 2 + col][inner]
        correlations.append(float(fixed @ moving) / max(float(moving.std()) * len(moving), 1e-9))
    return max(correlations)


def _on_reference(target: Patch, window: Window, shift_px: list[int], points: TiePoints) -> Patch:
    """Return the target as an affine fit of the points puts it on the pixels of the reference."""
    origin = np.array([window.col, window.row], np.float64) + 0.5  # of array indices
    matrix = AffineTransform.fit(
        points.reference_xy_px - origin, points.target_xy_px - origin - shift_px
    ).rows
    size, inverse = target.valid.shape[::-1], cv2.WARP_INVERSE_MAP
    values = target.values.astype(np.float32)
    values = np.asarray(cv2.warpAffine(values, matrix, size, flags=cv2.INTER_CUBIC | inverse), np.float32)
    valid = cv2.warpAffine(target.valid.astype(np.uint8), matrix, size, flags=cv2.INTER_NEAREST | inverse)
    return Patch(values, np.asarray(valid > 0))


def _gradient(patch: Patch, parameters: EdgeParameters) -> tuple[Float32, Float32]:
    """Return the derivatives (along columns, along rows), divided by the contrast around."""
    smooth = cv2.GaussianBlur(patch.values.astype(np.float32), (0, 0), parameters.gradient_sigma_px)
    across, down = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    size = np.hypot(across, down)
    around = np.sqrt(np.maximum(cv2.blur(size**2, (parameters.surroundings_px,) * 2), 0)) + np.float32(
        np.median(size) / 3 + 1e-9
    )
    return np.asarray(across / around), np.asarray(down / around)


def _levelled(patch: Patch, parameters: EdgeParameters) -> Float32:
    """Return grey values without those of the surroundings, divided by the contrast there."""
    values, wide_px = patch.values.astype(np.float32), parameters.surface_sigma_px
    fine = np.asarray(cv2.GaussianBlur(values, (0, 0), parameters.gradient_sigma_px), np.float32)
    fine -= np.asarray(cv2.GaussianBlur(values, (0, 0), wide_px), np.float32)
    around = np.sqrt(np.maximum(cv2.GaussianBlur(fine**2, (0, 0), wide_px), 0))
    return np.asarray(fine / (around + np.float32(np.median(around) / 3 + 1e-9)), np.float32)


def _separation_px(
    first: Float32, second: Float32, valid: Bool, axis: int, parameters: EdgeParameters
) -> tuple[float, float]:
    """Return how far rising edges of the target, and of the reference, lie from falling ones, or NaN."""
    steep = np.abs(first), np.abs(second)
    rising, falling = (
        _displacement(steep[0], np.maximum(s * second, 0), valid, axis, parameters) for s in (1, -1)
    )
    up, down = (_displacement(np.maximum(s * first, 0), steep[1], valid, axis, parameters) for s in (1, -1))
    return rising - falling, up - down


def _displacement(
    first: Float32, second: Float32, valid: Bool, axis: int, parameters: EdgeParameters
) -> float:
    """Return where the second plane lies along an axis (0: columns), px; NaN where that is out of reach."""
    reach, (rows, cols) = parameters.reach_px, valid.shape
    inner = valid[reach : rows - reach, reach : cols - reach]
    if np.count_nonzero(inner) < 2:
        return float("nan")
    fixed = first[reach : rows - reach, reach : cols - reach][inner]
    fixed -= fixed.mean()
    scores = []
    for step in range(-reach, reach + 1):
        row, col = reach + (axis == 1) * step, reach + (axis == 0) * step
        moving = second[row : rows - 2 * reach + row, col : cols - 2 * reach + col][inner]
        scores.append(float(fixed @ moving) / max(float(moving.std()), 1e-9))
    best = int(np.argmax(scores))
    if not 0 < best < len(scores) - 1:
        return float("nan")
    before, middle, after = scores[best - 1 : best + 2]
    return float(best - parameters.reach_px + (before - after) / (2 * (before - 2 * middle + after)))
