"""How noisy a pair is, and how much its maps are smoothed for that.

Phase congruency is computed without noise filter and is not band-limited: its finest detail is noise and
aliasing, which pulls sub-pixel positions towards fractions of a pixel and keeps matches from converging.
A slight smoothing removes most of that at little cost in clean images; noisy ones need more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

LEAST_SMOOTHING_PX: Final = 0.6
MOST_SMOOTHING_PX: Final = 1.5
CLEAN: Final = 0.8
"""Ratio up to which an image counts as clean: real scenes show 0.2 to 0.8."""
WHITE: Final = 2.0
"""Ratio of white noise."""
LEAST_PIXELS: Final = 1024
DETAIL_OF_UNIT_NOISE: Final = 6 * 0.7979
"""Mean absolute second difference of white noise of unit variance: its gain, 6, times E|z|."""

_SECOND_DIFFERENCE: Final = ((1.0, -2.0, 1.0), (-2.0, 4.0, -2.0), (1.0, -2.0, 1.0))


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of an image."""

    ratio: float = 0.0
    """Mean absolute second difference at full over half resolution: 2 for white noise, below 1 for scenes."""
    sigma: float = 0.0
    """Standard deviation of the white part, in units of the image."""

    @property
    def share(self) -> float:
        """How much of the finest detail is noise, 0 to 1."""
        return float(np.clip((self.ratio - CLEAN) / (WHITE - CLEAN), 0, 1))


def measure_noise(image: NDArray[np.floating[Any]], valid: NDArray[np.bool_]) -> Noise:
    """Compare the finest detail of an image with that at half the resolution, whose noise is averaged.

    Parameters
    ----------
    image : (rows, cols) array
        At full resolution.
    valid : (rows, cols) bool array

    Returns
    -------
    Noise
        Zeros where there are too few valid pixels to tell.
    """
    rows, cols = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    fine = np.where(valid, image, 0.0)[:rows, :cols].astype(np.float64)
    fine_valid = np.asarray(valid[:rows, :cols])
    half = cols // 2, rows // 2
    if min(half) == 0:
        return Noise()
    coarse = np.asarray(cv2.resize(fine, half, interpolation=cv2.INTER_AREA), np.float64)
    coarse_valid = (
        fine_valid[::2, ::2] & fine_valid[1::2, ::2] & fine_valid[::2, 1::2] & fine_valid[1::2, 1::2]
    )
    detail, coarse_detail = _mean_detail(fine, fine_valid), _mean_detail(coarse, coarse_valid)
    if coarse_detail <= 0:
        return Noise()
    noise = Noise(ratio=detail / coarse_detail)
    return replace(noise, sigma=noise.share * detail / DETAIL_OF_UNIT_NOISE)


def smoothing_px(*noises: Noise) -> float:
    """Return the Gaussian sigma for the maps of a pair from the noise of its images."""
    share = max((noise.share for noise in noises), default=0.0)
    return LEAST_SMOOTHING_PX + (MOST_SMOOTHING_PX - LEAST_SMOOTHING_PX) * share


def _mean_detail(image: NDArray[np.float64], valid: NDArray[np.bool_]) -> float:
    inner = cv2.erode(valid.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    count = cv2.countNonZero(inner)
    if count < LEAST_PIXELS:
        return 0.0
    detail = cv2.filter2D(image, -1, np.array(_SECOND_DIFFERENCE))
    return cv2.norm(detail, cv2.NORM_L1, mask=inner) / count
