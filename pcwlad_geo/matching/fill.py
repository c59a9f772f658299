"""Smooth filling of invalid pixels, so that filters meet no edge where the data end.

References
----------
.. [1] Gortler, S. J. et al. (1996), The Lumigraph, doi:10.1145/237170.237200 (pull-push pyramid).
.. [2] Knutsson, H. and Westin, C.-F. (1993), doi:10.1109/CVPR.1993.341081 (normalised convolution).
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

RELAXATIONS: Final = 4
"""Averaging steps per level: they make the fill continue the valid values at the seam."""
COARSEST_PX: Final = 2

_NEIGHBOURS: Final = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.float64) / 4

Float32 = NDArray[np.float32]
Floating = NDArray[np.floating[Any]]


def fill_smoothly(image: Floating, valid: NDArray[np.bool_]) -> Floating:
    """Fill invalid pixels with a smooth continuation of the valid ones around them.

    Parameters
    ----------
    image : (rows, cols) float array
        Valid pixels are finite; what the invalid ones hold does not matter (NaN is fine).
    valid : (rows, cols) bool array

    Returns
    -------
    (rows, cols) float array
        A new array, float32 for float32 input and float64 otherwise. Valid pixels are unchanged; zeros
        if none is valid.
    """
    dtype = np.float32 if image.dtype == np.float32 else np.float64
    known: Floating = np.where(valid, image, 0).astype(dtype)
    if valid.all() or not valid.any():
        return known
    # Around zero, so that float32 keeps its digits and the weights' rounding does not show.
    centre = known[valid].mean(dtype=np.float64).astype(dtype)
    filled = _fill_level(np.where(valid, known - centre, 0).astype(np.float32), valid)
    np.copyto(known, filled + centre, where=~valid, casting="same_kind")
    return known


def _fill_level(known: Float32, valid: NDArray[np.bool_]) -> Float32:
    """Fill one level from the next coarser one, then relax what was filled; `known` is 0 where invalid."""
    rows, cols = known.shape
    if valid.all() or max(rows, cols) <= COARSEST_PX:
        mean = known.sum() / max(int(valid.sum()), 1)
        return np.where(valid, known, mean).astype(np.float32)
    # Pull: means of the valid pixels only. Push: the coarse level is used only where this one has nothing.
    weight = cv2.pyrDown(valid.astype(np.float32))
    total = cv2.pyrDown(known)
    coarse_valid = weight > np.finfo(np.float32).eps
    coarse = np.divide(total, weight, out=np.zeros_like(total), where=coarse_valid)
    filled = np.asarray(cv2.pyrUp(_fill_level(coarse, coarse_valid), dstsize=(cols, rows)), np.float32)
    known_mask, unknown_mask = valid.astype(np.uint8), (~valid).astype(np.uint8)
    cv2.copyTo(known, known_mask, filled)
    for _ in range(RELAXATIONS):
        smoothed = cv2.filter2D(filled, -1, _NEIGHBOURS, borderType=cv2.BORDER_REPLICATE)
        cv2.copyTo(smoothed, unknown_mask, filled)
    return filled
