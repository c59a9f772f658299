"""The paper's own ingredients per window: filtered mutual structure, and its acceptance rule."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from pcwlad_geo.matching.keypoints import FULL_SCALE
from pcwlad_geo.matching.mutual_structure import mutual_structure
from pcwlad_geo.matching.prepare import StackPair
from pcwlad_geo.matching.refinement import Refined, Start
from pcwlad_geo.matching.similarity import ssim

CHUNK: Final = 128

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Index = NDArray[np.intp]


def shared_structure(pair: StackPair, corners_rc: Index, start: Start, window_px: int) -> Float32:
    """Return the mutual structure of every corner's windows at the start's position.

    Returns
    -------
    (n, window, window) float32 array
    """
    result = np.empty((len(corners_rc), window_px, window_px), np.float32)
    for begin in range(0, len(corners_rc), CHUNK):
        part = slice(begin, begin + CHUNK)
        reference, target = _windows(
            pair, corners_rc[part], start.shift_xy_px[part], start.linear[part], window_px
        )
        result[part] = mutual_structure(reference / FULL_SCALE, target / FULL_SCALE)[2]
    return result


def passes_paper(
    pair: StackPair, corners_rc: Index, start: Start, refined: Refined, window_px: int, gate: float
) -> NDArray[np.bool_]:
    """Tell which refined windows have an SSIM above the gate and above that of the coarse match."""
    result = np.zeros(len(corners_rc), bool)
    for begin in range(0, len(corners_rc), CHUNK):
        part = slice(begin, begin + CHUNK)
        corners = corners_rc[part]
        reference, before = _windows(pair, corners, start.shift_xy_px[part], start.linear[part], window_px)
        _, after = _windows(pair, corners, refined.shift_xy_px[part], refined.linear[part], window_px)
        initial = ssim(reference / FULL_SCALE, before / FULL_SCALE)
        final = ssim(reference / FULL_SCALE, after / FULL_SCALE)
        result[part] = (final > gate) & (final > initial)
    return result


def _windows(
    pair: StackPair, corners_rc: Index, shift_xy: Float64, linear: Float64, window_px: int
) -> tuple[Float64, Float64]:
    """Return the (k, window, window) reference and sampled target windows of the one map."""
    half = window_px // 2
    step = np.arange(-half, half + 1)
    y, x = np.meshgrid(step, step, indexing="ij")
    rows = corners_rc[:, 0, None, None] + y
    cols = corners_rc[:, 1, None, None] + x
    reference = pair.reference.maps[0][rows, cols].astype(np.float64)
    dx = linear[:, 0, 0, None, None] * x + linear[:, 0, 1, None, None] * y + shift_xy[:, 0, None, None]
    dy = linear[:, 1, 0, None, None] * x + linear[:, 1, 1, None, None] * y + shift_xy[:, 1, None, None]
    target = map_coordinates(
        pair.target.coefficients[0], np.stack([rows + dy, cols + dx]), order=3, prefilter=False, mode="mirror"
    )
    return reference, target.astype(np.float64)
