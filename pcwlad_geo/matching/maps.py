"""Maps of structure: phase congruency and oriented gradients."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pcwlad_geo.matching.kernels.phase_congruency import (
    ORIENTATIONS,
    combine_orientations,
    filled_up,
    filter_bank,
    oriented_map,
    wedge,
)
from pcwlad_geo.types import Bool, Complex64, Float32

EPSILON_OF_BYTE_RANGE: Final = 1e-4
"""The ε of the phase congruency for an image of range 255, as in the authors' maps."""
MIN_EPSILON: Final = 1e-30
"""Least ε, which keeps the maps of a constant image finite."""


def scene_epsilon(image: NDArray[np.floating], valid: Bool | None = None) -> float:
    """Return the ε that makes the maps independent of the data's units.

    It is 1e-4 of a 255th of the range that holds 99.9 % of the values; 0 for a constant image. The (rows,
    cols) `image` is the scene, or an overview of it, as one ε serves all tiles; only `valid` pixels count, a
    (rows, cols) bool array.
    """
    values = image if valid is None or valid.all() else image[valid]
    if values.size == 0:
        return 0.0
    low, high = np.percentile(values, (0.05, 99.95))
    return float(EPSILON_OF_BYTE_RANGE * (high - low) / 255.0)


def oriented_phase_congruency(
    image: NDArray[np.floating], epsilon: float, shape: tuple[int, int] | None = None
) -> Float32:
    """Compute one phase-congruency map per orientation, without noise threshold (Kovesi 1999).

    Parameters
    ----------
    image : (rows, cols) array
        Finite values; even sizes are what the filters expect (no padding is done here).
    epsilon : float
        Guards divisions, in units of the image; see `scene_epsilon`.
    shape : (int, int), optional
        Rows and columns wanted, from the first; all by default.

    Returns
    -------
    (6, rows, cols) float32 array
        Values 0 to 1; orientation o is at angle o·π/6.
    """
    centred = (image - image.mean(dtype=np.float64)).astype(np.float32)
    maps = np.empty((ORIENTATIONS, *(shape or image.shape)), np.float32)
    for axis in (0, 1):
        half: Complex64 = scipy.fft.rfft2(centred.T if axis == 0 else centred, workers=1)
        spectrum, bank = (
            (filled_up(half.real), filled_up(half.imag)),
            filter_bank(*image.shape[:: 1 - 2 * axis]),
        )
        turned = maps if axis == 0 else maps.transpose(0, 2, 1)
        for orientation, out in enumerate(turned):
            direction = wedge(orientation, axis, image.shape)
            if direction is not None:
                oriented_map(spectrum, bank, direction, max(epsilon, MIN_EPSILON), out)
    return maps


def maximum_moment(maps: Float32) -> Float32:
    """Combine oriented maps into the maximum moment M of their covariance: the authors' map.

    The (6, rows, cols) float32 `maps` are the phase congruency by orientation (see
    `oriented_phase_congruency`); the result is a (rows, cols) float32 array.
    """
    theta = np.arange(ORIENTATIONS) * np.pi / ORIENTATIONS
    cosine, sine = np.cos(theta), np.sin(theta)
    coefficients = np.stack([cosine**2, sine**2, 2 * cosine * sine]) / (ORIENTATIONS / 2)
    moment = np.empty(maps.shape[1:], np.float32)
    flat = np.ascontiguousarray(maps).reshape(ORIENTATIONS, -1)
    combine_orientations(flat, coefficients.astype(np.float32), moment.reshape(-1))
    return moment


NEIGHBOURHOOD_PX: Final = 4.0
"""Sigma of the Gaussian over which the strength of the gradient is averaged, little more than an edge."""
MIN_STRENGTH: Final = 0.4
"""Strength, in ranges of the scene, that limits the normalisation: weaker gradients stay weak."""
CHANNEL_SCALE: Final = 0.4
"""Factor that brings gradient channels to the range of phase congruency, which the other stages expect."""
STRENGTH_SCALE: Final = 0.15
"""Factor that brings the gradient strength to the range of the maximum moment of phase congruency."""


def oriented_gradients(
    image: NDArray[np.floating[Any]], epsilon: float, smooth_px: float
) -> tuple[Float32, Float32]:
    """Compute one gradient map per orientation, and the gradient strength in which corners are found.

    Parameters
    ----------
    image : (rows, cols) array
        Finite values.
    epsilon : float
        The scene's ε, which stands for its range; see `scene_epsilon`.
    smooth_px : float
        Sigma of the Gaussian that smooths the rectified maps.

    Returns
    -------
    maps : (6, rows, cols) float32 array
        |∂x cos θ - ∂y sin θ| over the local strength; orientation o is at angle θ = o·π/6.
    strength : (rows, cols) float32 array
        The gradient's length over the local strength.
    """
    scale = max(epsilon, MIN_EPSILON) * 255.0 / EPSILON_OF_BYTE_RANGE
    centred = ((image - image.mean(dtype=np.float64)) / scale).astype(np.float32)
    dx, dy = cv2.Sobel(centred, cv2.CV_32F, 1, 0), cv2.Sobel(centred, cv2.CV_32F, 0, 1)
    square = cv2.GaussianBlur((dx * dx + dy * dy) / 2, (0, 0), NEIGHBOURHOOD_PX)
    local = np.sqrt(square) + np.float32(MIN_STRENGTH)
    dx /= local
    dy /= local
    maps = np.empty((ORIENTATIONS, *image.shape), np.float32)
    for orientation, out in enumerate(maps):
        theta = orientation * np.pi / ORIENTATIONS
        cv2.addWeighted(dx, CHANNEL_SCALE * np.cos(theta), dy, -CHANNEL_SCALE * np.sin(theta), 0.0, dst=out)
        np.abs(out, out=out)
        cv2.GaussianBlur(out, (0, 0), smooth_px, dst=out)
    length = cv2.magnitude(dx, dy) * np.float32(STRENGTH_SCALE * np.sqrt(0.5))
    return maps, np.asarray(cv2.GaussianBlur(length, (0, 0), smooth_px), np.float32)
