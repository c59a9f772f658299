"""What both images of a pair have at the same pixels and is no ground: masks, specks, writing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from pcwlad_geo.types import Bool, Float32


@dataclass(frozen=True, slots=True)
class SpeckParameters:
    """How specks are found that lie on the same pixels of both frames: dust, drops, dead pixels, ships."""

    outlying: float = 3.0
    """Least deviation of a pixel from its surroundings in both images, to the same side, robust sigmas."""
    surroundings_px: float = 12.0
    """Standard deviation of the filter that gives the surroundings."""
    rounds: int = 3
    """How often they are found, each time beside surroundings, and a scatter, without those of the last."""
    grow_px: int = 3
    """By how much specks are grown, for their blurred edges."""
    largest_px: int = 40
    """Largest extent of a speck; larger ones are ground, such as an island, but for writing and lines."""
    stroke_px: float = 4.0
    """Largest mean distance from the edge of the strokes of writing and of lines, of any extent: half of
    their half width."""
    same_outline: float = 0.9
    """Least share of the pixels at an end of the range, where they touch, that are there in both images."""
    most: float = 0.35
    """Largest share of the image that is specks; beyond it, it is texture."""
    fill_px: tuple[float, ...] = (2.0, 4.0, 8.0, 16.0)
    """Standard deviations of the filters that fill specks from around them, in turn."""
    structured: float = 2.0
    """Least ratio of the structure to that of white noise from which the rest of an image can tell: 1.3 of
    noise, 9 and more of ground, however faint."""


class Frames(NamedTuple):
    """Two images of one size that lie on the same pixels."""

    one: Float32
    """(rows, cols) grey values, the invalid ones as the median."""
    other: Float32
    """(rows, cols) grey values of the other image."""
    valid: Bool
    """(rows, cols) pixels that count in both."""


def structure_band(values: Float32, smooth_px: float) -> Float32:
    """Return (rows, cols) `values` without pattern of single pixels, shading, and what whole lines have."""
    band = cv2.GaussianBlur(values, (0, 0), smooth_px) - cv2.GaussianBlur(values, (0, 0), 3 * smooth_px)
    band -= np.median(band, axis=0)
    band -= np.median(band, axis=1)[:, None]
    return np.asarray(band, np.float32)


def without_marked(frames: Frames, parameters: SpeckParameters) -> Frames:
    """Return the frames without the pixels at the same end of both ranges, as of text and masks burnt in.

    What does not count is filled from around it, so that no outline remains.
    """
    one, other, valid = frames
    for low_or_high in _at_ends(frames):
        valid = valid & ~np.logical_and(*low_or_high)
    if not valid.any():
        return frames._replace(valid=valid)
    return Frames(filled(one, ~valid, parameters), filled(other, ~valid, parameters), valid)


def strokes(frames: Frames, parameters: SpeckParameters, least_share: float = 0.0) -> Bool:
    """Return the (rows, cols) pixels at the same end of both ranges that are strokes of writing or lines.

    They have the same outline in both images, as bright and dark ground of two bands or dates has not. Where
    less than the `least_share` of the pixels lie at the same ends, none are asked for.
    """
    marks, ends = np.zeros(frames.valid.shape, bool), _at_ends(frames)
    together = [one & other for one, other in ends]
    if sum(map(np.count_nonzero, together)) < max(least_share * marks.size, 1):
        return marks
    for (one, other), both in zip(ends, together, strict=True):
        if not both.any():
            continue
        count, labels = cv2.connectedComponents((one | other).astype(np.uint8))
        shared = np.bincount(labels[both], None, count) / np.maximum(np.bincount(labels.ravel()), 1)
        marks |= both & (shared >= parameters.same_outline)[labels]
    return _thin(marks, parameters) & marks


def _at_ends(frames: Frames) -> list[tuple[Bool, Bool]]:
    """Return the (rows, cols) pixels at the lower end of the range of each image, then at the upper one."""
    one, other, valid = frames
    if not valid.any():
        return []
    ends = [cv2.minMaxLoc(values, valid.view(np.uint8))[:2] for values in (one, other)]
    return [(valid & (one == ours), valid & (other == theirs)) for ours, theirs in zip(*ends, strict=True)]


def without_specks(frames: Frames, parameters: SpeckParameters, smooth_px: float) -> Frames | None:
    """Return the frames with specks that both have filled; None if there are none, or the rest tells nothing.

    Dust on a sensor or a window, and writing, change both frames alike at the same pixels. The structure of
    the rest is what filters of `smooth_px`, a standard deviation, and of three times that pass.
    """
    one, other, valid = frames
    specks = _specks(one, other, valid, parameters)
    if not 0 < specks.mean() <= parameters.most:
        return None
    rest = Frames(filled(one, specks, parameters), filled(other, specks, parameters), valid & ~specks)
    structure = min(_structure_by_noise(values, rest.valid, smooth_px) for values in rest[:2])
    return None if structure < parameters.structured else rest


def _specks(one: Float32, other: Float32, valid: Bool, parameters: SpeckParameters) -> Bool:
    """Return the pixels of small specks that are much brighter, or much darker, in both images."""
    outliers = np.zeros(one.shape, bool)
    for _ in range(parameters.rounds):  # without those there are, surroundings and scatter are the ground's
        rest = valid & ~outliers
        first, second = (_outlying(values, rest, parameters) for values in (one, other))
        outliers = valid & (
            (np.minimum(first, second) > parameters.outlying)
            | (np.maximum(first, second) < -parameters.outlying)
        )
    return _thin(outliers, parameters)


def _thin(outliers: Bool, parameters: SpeckParameters) -> Bool:
    """Return the pixels of small specks and of strokes, grown."""
    kernel = np.ones((2 * parameters.grow_px + 1,) * 2)
    grown = cv2.dilate(outliers.astype(np.uint8), kernel)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(grown)
    at, to_edge_px = labels[outliers], cv2.distanceTransform(outliers.astype(np.uint8), cv2.DIST_L2, 3)
    depth_px = np.bincount(at, to_edge_px[outliers], count) / np.maximum(np.bincount(at, None, count), 1)
    small = boxes[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) <= parameters.largest_px
    small |= depth_px <= parameters.stroke_px
    return np.asarray(small[labels] & (labels > 0))


def _outlying(values: Float32, valid: Bool, parameters: SpeckParameters) -> Float32:
    """Return the deviations of pixels from their surroundings, robust sigmas."""
    around_px = parameters.surroundings_px
    weight = valid.astype(np.float32)
    counted = np.maximum(cv2.GaussianBlur(weight, (0, 0), around_px), 1e-3)
    around = cv2.GaussianBlur(values * weight, (0, 0), around_px) / counted
    away = cv2.GaussianBlur(values - around, (0, 0), 1.0)
    middle = np.median(away[valid])
    sigma = 1.4826 * float(np.median(np.abs(away[valid] - middle)))
    return np.asarray((away - middle) / max(sigma, 1e-6), np.float32)


def filled(values: Float32, holes: Bool, parameters: SpeckParameters) -> Float32:
    """Return (rows, cols) `values` with their (rows, cols) `holes` filled smoothly from around them."""
    filled, filled_pixels = values.copy(), np.asarray(~holes)
    weight = filled_pixels.astype(np.float32)
    for sigma_px in parameters.fill_px:
        if filled_pixels.all():
            return filled
        around = cv2.GaussianBlur(values * weight, (0, 0), sigma_px)
        reached = cv2.GaussianBlur(weight, (0, 0), sigma_px)
        new = ~filled_pixels & np.asarray(reached > 0.05)
        filled[new] = around[new] / reached[new]
        filled_pixels |= new
    filled[~filled_pixels] = np.median(values[~holes])
    return filled


def _structure_by_noise(values: Float32, valid: Bool, smooth_px: float) -> float:
    """Return the ratio of the structure to that of white noise as strong as the finest differences."""
    fine = values - cv2.blur(values, (3, 3))
    inner, outer = smooth_px, 3 * smooth_px
    passed = (1 / inner**2 + 1 / outer**2 - 4 / (inner**2 + outer**2)) / (4 * np.pi)  # of its variance
    structure, noise = (
        float(np.median(np.abs(image[valid]))) for image in (structure_band(values, inner), fine)
    )
    return float(structure / max(noise * np.sqrt(9 / 8 * passed), 1e-12))
