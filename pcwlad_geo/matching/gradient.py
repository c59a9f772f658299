"""Oriented gradients, locally normalised: a stand-in for phase congruency at a fraction of its cost.

Like phase congruency they depend on structure, not on brightness: the gradient of an image is divided by
its own strength around, so that weak and strong edges count alike, and edges lose their sign.
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.filter_bank import ORIENTATIONS
from pcwlad_geo.matching.phase_congruency import EPSILON_OF_BYTE_RANGE, LEAST_EPSILON

NEIGHBOURHOOD_PX: Final = 4.0
"""Sigma of the Gaussian over which the strength of the gradient is taken: little more than an edge."""
LEAST_STRENGTH: Final = 0.4
"""Strength, in ranges of the scene, below which gradients are no longer brought to one height."""
CHANNEL_SCALE: Final = 0.4
STRENGTH_SCALE: Final = 0.15
"""They bring the maps to the height of those of phase congruency, which the other stages are made for."""

Float32 = NDArray[np.float32]


def oriented_gradients(
    image: NDArray[np.floating[Any]], epsilon: float, smooth_px: float
) -> tuple[Float32, Float32]:
    """Compute one gradient map per orientation, and the strength that corners are looked for in.

    Parameters
    ----------
    image : (rows, cols) array
        Finite values.
    epsilon : float
        The scene's ε, which stands for its range; see `phase_congruency.scene_epsilon`.
    smooth_px : float
        Sigma of the Gaussian that smooths the rectified maps.

    Returns
    -------
    maps : (6, rows, cols) float32 array
        |∂x cos θ - ∂y sin θ| over the local strength; orientation o is at angle θ = o·π/6.
    strength : (rows, cols) float32 array
        The gradient's length over the local strength.
    """
    scale = max(epsilon, LEAST_EPSILON) * 255.0 / EPSILON_OF_BYTE_RANGE
    centred = ((image - image.mean(dtype=np.float64)) / scale).astype(np.float32)
    dx, dy = cv2.Sobel(centred, cv2.CV_32F, 1, 0), cv2.Sobel(centred, cv2.CV_32F, 0, 1)
    square = cv2.GaussianBlur((dx * dx + dy * dy) / 2, (0, 0), NEIGHBOURHOOD_PX)
    local = np.sqrt(square) + np.float32(LEAST_STRENGTH)
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
