"""The filter bank of the phase congruency: log-Gabor in radius, raised cosine in angle.

The angular filters are 120° wide. Each lies in one half of the frequency plane, cut along one of the axes,
so only half a spectrum is ever stored or transformed; and the radial part is the same in all four quadrants.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import scipy.fft
from numpy.typing import NDArray

SCALES: Final = 4
ORIENTATIONS: Final = 6
MIN_WAVELENGTH_PX: Final = 3.0
WAVELENGTH_FACTOR: Final = 1.6
SIGMA_ON_F: Final = 0.75
LOW_PASS_CUT_OFF: Final = 0.45
LOW_PASS_POWER: Final = 30
NEGLIGIBLE: Final = 1e-7
"""Transfer below the rounding of float32."""

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FilterBank:
    """Transfer functions for images of (n, m) pixels, in one quadrant; the first axis is the halved one."""

    radial: Float32
    """(scales, n // 2 + 1, m // 2 + 1)."""
    inverse_radius: Float32
    """(n // 2 + 1, m // 2 + 1) 1 / frequency in cycles per pixel; 1 at zero frequency."""
    reach: tuple[int, ...]
    """First row of the quadrant from which a scale is zero; falls from scale to scale."""


@lru_cache(maxsize=4)
def filter_bank(n: int, m: int) -> FilterBank:
    """Return the radial filters for images of (n, m) pixels."""
    across, along = (np.abs(frequencies(length))[: length // 2 + 1] for length in (n, m))
    radius = np.hypot(across[:, None], along)
    radius[0, 0] = 1.0
    log_radius = np.log(radius)
    low_pass = 1.0 / (1.0 + np.exp(LOW_PASS_POWER * (log_radius - np.log(LOW_PASS_CUT_OFF))))
    radial = np.empty((SCALES, *radius.shape), np.float32)
    for scale in range(SCALES):
        log_centre = -np.log(MIN_WAVELENGTH_PX * WAVELENGTH_FACTOR**scale)
        radial[scale] = low_pass * np.exp(-((log_radius - log_centre) ** 2) / (2 * np.log(SIGMA_ON_F) ** 2))
    radial[:, 0, 0] = 0.0
    reach = tuple(int(np.flatnonzero(rows > NEGLIGIBLE).max(initial=-1)) + 1 for rows in radial.max(axis=2))
    return FilterBank(radial, (1.0 / radius).astype(np.float32), reach)


def frequencies(length: int) -> Float64:
    """Return the frequencies of a transform, cycles per pixel, in the order of the FFT.

    Odd lengths are divided by length - 1, as the authors' filters do.
    """
    half = (length - length % 2) // 2
    steps = np.arange(-half, half + length % 2)
    result: Float64 = scipy.fft.ifftshift(steps) / (2.0 * max(half, 1))
    return result


def wedge(orientation: int, axis: int, shape: tuple[int, int]) -> tuple[Float32, Float32] | None:
    """Describe an angular filter in the half plane of positive frequencies along an image axis.

    Parameters
    ----------
    orientation : int
        Its direction is orientation · π/6 from the column axis towards smaller rows.
    axis : int
        Image axis whose frequencies are halved, 0 or 1.
    shape : (int, int)
        Of the image.

    Returns
    -------
    (n // 2 + 1,) and (m,) float32 arrays, or None
        Parts of the frequency vector along the filter's direction, from the halved axis and from the other:
        their sum over the radius is the cosine of the angle between the two. None where the filter
        does not fit into this half plane.

    Notes
    -----
    A filter that lies in the other half plane is turned by 180°. That turns the sign of the odd response,
    which phase congruency does not see.
    """
    theta = orientation * np.pi / ORIENTATIONS
    direction = -np.sin(theta), np.cos(theta)
    if abs(direction[axis]) < abs(direction[1 - axis]):
        return None
    across, along = frequencies(shape[axis]), frequencies(shape[1 - axis])
    if direction[axis] < 0:
        # element by element, since the Nyquist frequency is its own mirror image
        across, along = across[-np.arange(len(across))], along[-np.arange(len(along))]
    half = len(across) // 2 + 1
    return (
        (direction[axis] * across[:half]).astype(np.float32),
        (direction[1 - axis] * along).astype(np.float32),
    )
