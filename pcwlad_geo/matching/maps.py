"""Maps that are matched: of structure (phase congruency, oriented gradients), and of grey values.

Where structure tells too little, the grey values of two bands may still depend on each other, whatever their
relation: water is dark in both near infrared and green, fields are bright in one and dark in the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import scipy.fft

from pcwlad_geo.matching.kernels.phase_congruency import (
    ORIENTATIONS,
    combine_orientations,
    filled_up,
    filter_bank,
    oriented_map,
    wedge,
)
from pcwlad_geo.matching.paper import PAPER
from pcwlad_geo.types import Bool, Complex64, Float32, Floating


@dataclass(frozen=True, slots=True)
class GradientParameters:
    """How gradients become channels that are matched."""

    neighbourhood_px: float = 4.0
    """Sigma of the Gaussian over which their strength is averaged, little more than an edge."""
    least_strength: float = 0.4
    """Strength, in ranges of the scene, that limits the normalisation: weaker ones stay weak."""
    scale: float = 0.4
    """Factor that brings channels to the range of phase congruency."""
    strength_scale: float = 0.15
    """Factor that brings the strength to the range of the maximum moment."""


GRADIENTS: Final = GradientParameters()
"""Those in use."""
MIN_EPSILON: Final = 1e-30
"""Least ε, which keeps the maps of a constant image finite."""
LARGEST_RANGE: Final = 1e12
"""Range of an image, in its units, up to which squares of its values are finite in numbers of 32 bits."""


def scene_epsilon(image: Floating, valid: Bool | None = None) -> float:
    """Return the ε that makes the maps independent of the data's units.

    It is 1e-4 of a 255th of the range that holds 99.9 % of the values; 0 for a constant image. The (rows,
    cols) `image` is the scene, or an overview of it, as one ε serves all tiles; only `valid` pixels count, a
    (rows, cols) bool array.
    """
    values = image if valid is None or valid.all() else image[valid]
    if values.size == 0:
        return 0.0
    low, high = np.percentile(values, (0.05, 99.95))
    return float(PAPER.byte_epsilon * (high - low) / 255.0)


def oriented_phase_congruency(
    image: Floating, epsilon: float, shape: tuple[int, int] | None = None
) -> Float32:
    """Compute one phase-congruency map per orientation, without noise threshold (Kovesi 1999).

    The (rows, cols) `image` is finite, best of even sizes: no padding is done here. The `epsilon` guards
    divisions, in units of the image, see `scene_epsilon`; `shape` is the rows and columns wanted, all by
    default. The result is a (6, rows, cols) float32 array, 0 to 1; orientation o is at angle o·π/6.
    """
    unit = max(1.0, epsilon * 255.0 / PAPER.byte_epsilon / LARGEST_RANGE)
    epsilon = max(epsilon, MIN_EPSILON) / unit
    centred = (image - image.mean(dtype=np.float64)).astype(np.float32)
    centred /= np.float32(unit)
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
                oriented_map(spectrum, bank, direction, epsilon, out)
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


def oriented_gradients(image: Floating, epsilon: float, smooth_px: float) -> tuple[Float32, Float32]:
    """Compute one gradient map per orientation, and the gradient strength in which corners are found.

    The (rows, cols) `image` is finite, `epsilon` stands for the scene's range (see `scene_epsilon`), and
    `smooth_px` is the sigma of the Gaussian that smooths the rectified maps. These are |∂x cos θ - ∂y sin θ|
    over the local strength, a (6, rows, cols) float32 array with orientation o at angle θ = o·π/6. The (rows,
    cols) float32 strength is the gradient's length over the local strength.
    """
    scale = max(epsilon, MIN_EPSILON) * 255.0 / PAPER.byte_epsilon
    centred = ((image - image.mean(dtype=np.float64)) / scale).astype(np.float32)
    dx, dy = cv2.Sobel(centred, cv2.CV_32F, 1, 0), cv2.Sobel(centred, cv2.CV_32F, 0, 1)
    square = cv2.GaussianBlur((dx * dx + dy * dy) / 2, (0, 0), GRADIENTS.neighbourhood_px)
    local = np.sqrt(square) + np.float32(GRADIENTS.least_strength)
    dx /= local
    dy /= local
    maps = np.empty((ORIENTATIONS, *image.shape), np.float32)
    for orientation, out in enumerate(maps):
        theta = orientation * np.pi / ORIENTATIONS
        cv2.addWeighted(
            dx, GRADIENTS.scale * np.cos(theta), dy, -GRADIENTS.scale * np.sin(theta), 0.0, dst=out
        )
        np.abs(out, out=out)
        cv2.GaussianBlur(out, (0, 0), smooth_px, dst=out)
    length = cv2.magnitude(dx, dy) * np.float32(GRADIENTS.strength_scale * np.sqrt(0.5))
    return maps, np.asarray(cv2.GaussianBlur(length, (0, 0), smooth_px), np.float32)
