"""Narrow gaps in an image: lines that a scanner missed, specks without data.

Filters see little of a narrow gap that is filled smoothly: the pixels beside it count, as they do not beside
a wide hole. What is missing has no weight itself, and windows with gaps need fewer valid pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.types import Bool, Float32, Floating


def fill_smoothly(image: Floating, valid: Bool) -> Floating:
    """Fill invalid pixels with a smooth continuation of the valid ones around them.

    The values of the (rows, cols) `image` are ignored, and may be NaN, where the (rows, cols) bool array
    `valid` is False. The result is a new (rows, cols) array, float32 for float32 input and float64 otherwise,
    with the valid pixels unchanged; zeros if none is valid.
    """
    dtype = np.float32 if image.dtype == np.float32 else np.float64
    values: Floating = np.where(valid, image, 0).astype(dtype)
    if valid.all() or not valid.any():
        return values
    # Around zero, so that float32 keeps its digits and the weights' rounding does not show.
    centre = values[valid].mean(dtype=np.float64).astype(dtype)
    filled = _fill_level(np.where(valid, values - centre, 0).astype(np.float32), valid)
    np.copyto(values, filled + centre, where=~valid, casting="same_kind")
    return values


def _fill_level(values: Float32, valid: Bool) -> Float32:
    """Fill one level from the next coarser one, then relax what was filled; `values` is 0 where invalid."""
    rows, cols = values.shape
    if valid.all() or max(rows, cols) <= 2:
        mean = values.sum() / max(int(valid.sum()), 1)
        return np.where(valid, values, mean).astype(np.float32)
    # Pull: means of the valid pixels only. Push: the coarse level is used only where this one has nothing.
    weight = cv2.pyrDown(valid.astype(np.float32))
    total = cv2.pyrDown(values)
    coarse_valid = weight > np.finfo(np.float32).eps
    coarse = np.divide(total, weight, out=np.zeros_like(total), where=coarse_valid)
    filled = np.asarray(cv2.pyrUp(_fill_level(coarse, coarse_valid), dstsize=(cols, rows)), np.float32)
    known_mask, unknown_mask = valid.astype(np.uint8), (~valid).astype(np.uint8)
    cv2.copyTo(values, known_mask, filled)
    for _ in range(4):
        smoothed = cv2.filter2D(filled, -1, _NEIGHBOURS, borderType=cv2.BORDER_REPLICATE)
        cv2.copyTo(smoothed, unknown_mask, filled)
    return filled


@dataclass(frozen=True, slots=True)
class GapParameters:
    """What a gap is, and how much of a window gaps may take."""

    widest_px: int = 14
    """Width up to which a hole is a gap, px, even: that of the widest gaps of Landsat 7."""
    hole_reach_px: int = 64
    """Distance from a wide hole up to which narrow ones are no gaps: clouds have small ones beside them."""
    least_share: float = 0.3
    """Least share of a window with gaps that is valid in both images; with less, some err by 0.4 px."""


GAPS: Final = GapParameters()
"""The parameters in use."""
_NEIGHBOURS: Final = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.float64) / 4


def narrow_gaps(valid: Bool, factor: float = 1.0) -> Bool:
    """Return which pixels that are not (rows, cols) `valid` lie in narrow holes, (rows, cols) bool.

    Nothing is valid beyond the image, which may be an overview, with `factor` px along one of its own.
    """
    side = 2 * round(GAPS.widest_px / factor / 2) + 1
    missing = np.pad((~valid).astype(np.uint8), side, constant_values=1)
    opened = cv2.morphologyEx(missing, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    wide = np.asarray(opened, np.uint8)[side:-side, side:-side]
    # beside a hole within the image, such as a cloud, small ones are part of it; beyond a border they are not
    _, label = cv2.connectedComponents(wide)
    inner = wide * ~np.isin(label, np.concatenate([label[[0, -1]].ravel(), label[:, [0, -1]].ravel()]))
    around = [_dilated(wide, side - 1), _dilated(inner, round(GAPS.hole_reach_px / factor))]
    return np.asarray(~valid & (np.maximum(*around) == 0))


def _dilated(mask: NDArray[np.uint8], by_px: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.dilate(mask, np.ones((2 * by_px + 1, 2 * by_px + 1), np.uint8)), np.uint8)


def usable(valid: Bool, gaps: Bool, edge_px: int) -> Bool:
    """Return the (rows, cols) `valid` pixels farther than `edge_px` from holes that are no `gaps`.

    The edge of the image is no hole.
    """
    square = np.ones((2 * edge_px + 1, 2 * edge_px + 1), np.uint8)
    counts = cv2.erode((valid | gaps).astype(np.uint8), square, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    return np.asarray(counts > 0) & valid


def open_share(usable: Bool, gaps: Bool, around_px: int) -> float:
    """Return the share of pixels that gaps leave within `around_px` of them; 1 without any.

    The (rows, cols) masks `usable` and `gaps` are of one image.
    """
    around = cv2.blur(gaps.astype(np.float32), (2 * around_px + 1, 2 * around_px + 1)) > 0
    count = np.count_nonzero(around & (usable | gaps))
    return float(np.count_nonzero(around & usable)) / count if count else 1.0


def least_share(share: float, *open_shares: float) -> float:
    """Return the least share of a window that must be valid, `share` where the `open_shares` are 1."""
    return min(share, max(GAPS.least_share, share * math.prod(open_shares)))
