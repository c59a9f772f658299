"""Images that are reduced, or warped onto other pixels, with their validity."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from pcwlad_geo.estimation.transforms import affine_matrix, shift
from pcwlad_geo.types import Bool, Float32, Float64


def shrunk(values: Float32, valid: Bool, factor: float) -> tuple[Float32, Bool, Float64]:
    """Return an image averaged to a share of its size, its validity, and the (3, 3) matrix from its px.

    The (rows, cols) bool array `valid` says which pixels of the (rows, cols) `values` count.
    """
    rows, cols = (max(16, round(n * factor)) for n in values.shape)
    across, down = cols / values.shape[1], rows / values.shape[0]
    matrix = affine_matrix(np.diag([across, down]), np.array([across - 1, down - 1]) / 2)
    if (rows, cols) == values.shape:
        return np.where(valid, values, np.float32(0)), valid, matrix
    weight = cv2.resize(valid.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA)
    total = cv2.resize(np.where(valid, values, np.float32(0)), (cols, rows), interpolation=cv2.INTER_AREA)
    usable = np.asarray(weight >= 0.5)
    return np.where(usable, total / np.maximum(weight, np.float32(1e-3)), np.float32(0)), usable, matrix


def warped(planes: Float32, matrix: Float64, shape: tuple[int, int]) -> Float32:
    """Return `planes`, (rows, cols, n) or (rows, cols), warped by a (3, 3) affine `matrix` onto a `shape`.

    The result has that shape, and n planes, (rows, cols, n), or one, (rows, cols); it is linear between px.
    """
    return np.asarray(cv2.warpAffine(planes, matrix[:2], shape[::-1], flags=cv2.INTER_LINEAR), np.float32)


def warped_image(
    values: Float32, valid: Bool, frame_to_image: Float64, shape: tuple[int, int], margin_px: int
) -> tuple[Float32, Bool]:
    """Resample an image onto a frame of a `shape` with a margin; return values, and which are valid.

    The image is (rows, cols) `values` and their validity, a (rows, cols) bool array `valid`; the matrix
    `frame_to_image` (3, 3) may be a homography.
    """
    to_image = frame_to_image @ shift(np.full(2, -float(margin_px)))
    size = (shape[1] + 2 * margin_px, shape[0] + 2 * margin_px)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warp: Any = cv2.warpPerspective if to_image[2, :2].any() else cv2.warpAffine
    to_image = to_image if to_image[2, :2].any() else to_image[:2]
    total = warp(values, to_image, size, flags=flags)
    weight = warp(valid.astype(np.float32), to_image, size, flags=flags)
    return np.asarray(total / np.maximum(weight, 1e-3), np.float32), np.asarray(weight > 0.9)
