"""Phase congruency without noise filter: where the Fourier components of an image agree in phase.

The maps depend on structure, not on brightness: a gain, an offset or an inversion of the image
leaves them unchanged. The filter bank and its parameters are those of the authors' own maps.

References
----------
.. [1] Kovesi, P. (1999), Image features from phase congruency, Videre 1(3).
.. [2] Morrone, M. C. and Owens, R. A. (1987), doi:10.1016/0167-8655(87)90013-4.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

SCALES: Final = 4
ORIENTATIONS: Final = 6
MIN_WAVELENGTH_PX: Final = 3.0
WAVELENGTH_FACTOR: Final = 1.6
SIGMA_ON_F: Final = 0.75
SPREAD_CUT_OFF: Final = 0.5
SPREAD_GAIN: Final = 3.0
LOW_PASS_CUT_OFF: Final = 0.45
LOW_PASS_POWER: Final = 30
EPSILON_OF_BYTE_RANGE: Final = 1e-4

Float32 = NDArray[np.float32]


def scene_epsilon(image: NDArray[np.floating], valid: NDArray[np.bool_] | None = None) -> float:
    """Return the ε that makes the maps independent of the data's units.

    Parameters
    ----------
    image : (rows, cols) array
        The scene, or an overview of it; one ε serves all its tiles.
    valid : (rows, cols) bool array, optional
        Pixels that count.

    Returns
    -------
    float
        1e-4 of a 255th of the range that holds 99.9 % of the values; 0 for a constant image.
    """
    values = image if valid is None else image[valid]
    if values.size == 0:
        return 0.0
    low, high = np.percentile(values, (0.05, 99.95))
    return float(EPSILON_OF_BYTE_RANGE * (high - low) / 255.0)


def oriented_phase_congruency(image: NDArray[np.floating], epsilon: float) -> Float32:
    """Compute one phase-congruency map per orientation.

    Parameters
    ----------
    image : (rows, cols) array
        Finite values; even sizes are what the filters expect (no padding is done here).
    epsilon : float
        Guards divisions, in units of the image; see `scene_epsilon`.

    Returns
    -------
    (6, rows, cols) float32 array
        Values 0 to 1; orientation o is at angle o·π/6.
    """
    spectrum = scipy.fft.fft2((image - image.mean(dtype=np.float64)).astype(np.float32), workers=1)
    radial, angular = _filter_bank(image.shape[0], image.shape[1])
    maps = np.empty((ORIENTATIONS, *image.shape), np.float32)
    for orientation in range(ORIENTATIONS):
        filtered = spectrum * angular[orientation]
        responses = scipy.fft.ifft2(filtered * radial, axes=(1, 2), workers=1, overwrite_x=True)
        combine_scales(responses, np.float32(epsilon), maps[orientation])
    return maps


def maximum_moment(maps: Float32) -> Float32:
    """Combine oriented maps into the maximum moment M of their covariance: the authors' map.

    Parameters
    ----------
    maps : (6, rows, cols) float32 array

    Returns
    -------
    (rows, cols) float32 array
    """
    half = ORIENTATIONS / 2
    theta = np.arange(ORIENTATIONS) * np.pi / ORIENTATIONS
    square = maps**2
    cosine, sine = np.cos(theta), np.sin(theta)
    c = np.tensordot((cosine**2 / half).astype(np.float32), square, 1)
    s = np.tensordot((sine**2 / half).astype(np.float32), square, 1)
    cs = np.tensordot((2 * cosine * sine / half).astype(np.float32), square, 1)
    moment = (c + s + np.sqrt(cs**2 + (c - s) ** 2) + np.float32(EPSILON_OF_BYTE_RANGE)) / 2
    return np.asarray(moment, np.float32)


@lru_cache(maxsize=4)
def _filter_bank(rows: int, cols: int) -> tuple[Float32, Float32]:
    """Return the (4, rows, cols) radial and (6, rows, cols) angular transfer functions."""
    y, x = np.meshgrid(_frequencies(rows), _frequencies(cols), indexing="ij")
    radius = scipy.fft.ifftshift(np.hypot(x, y))
    theta = scipy.fft.ifftshift(np.arctan2(-y, x))
    radius[0, 0] = 1.0
    low_pass = 1.0 / (1.0 + (radius / LOW_PASS_CUT_OFF) ** LOW_PASS_POWER)
    radial = np.empty((SCALES, rows, cols), np.float32)
    for scale in range(SCALES):
        centre = 1.0 / (MIN_WAVELENGTH_PX * WAVELENGTH_FACTOR**scale)
        radial[scale] = low_pass * np.exp(-(np.log(radius / centre) ** 2) / (2 * np.log(SIGMA_ON_F) ** 2))
    radial[:, 0, 0] = 0.0
    angular = np.empty((ORIENTATIONS, rows, cols), np.float32)
    for orientation in range(ORIENTATIONS):
        turned = theta - orientation * np.pi / ORIENTATIONS
        distance = np.abs(np.arctan2(np.sin(turned), np.cos(turned)))
        angular[orientation] = (np.cos(np.minimum(distance * ORIENTATIONS / 2, np.pi)) + 1) / 2
    return radial, angular


def _frequencies(n: int) -> NDArray[np.float64]:
    if n % 2:
        return np.arange(-(n - 1) / 2, (n - 1) / 2 + 1) / (n - 1)
    return np.arange(-n / 2, n / 2) / n


@njit(cache=True, nogil=True, fastmath=True)
def combine_scales(responses: NDArray[np.complex64], epsilon: np.float32, out: Float32) -> None:
    """Fuse the filter responses of one orientation, (4, rows, cols) complex64, into its map.

    The plain twin is `combine_scales_plain`.
    """
    scales, rows, cols = responses.shape
    one = np.float32(1.0)
    for row in range(rows):
        for col in range(cols):
            even_sum = np.float32(0.0)
            odd_sum = np.float32(0.0)
            amplitude_sum = np.float32(0.0)
            amplitude_max = np.float32(0.0)
            for scale in range(scales):
                response = responses[scale, row, col]
                amplitude = np.sqrt(response.real * response.real + response.imag * response.imag)
                even_sum += response.real
                odd_sum += response.imag
                amplitude_sum += amplitude
                amplitude_max = max(amplitude_max, amplitude)
            norm = one / (np.sqrt(even_sum * even_sum + odd_sum * odd_sum) + epsilon)
            even_mean = even_sum * norm
            odd_mean = odd_sum * norm
            energy = np.float32(0.0)
            for scale in range(scales):
                response = responses[scale, row, col]
                energy += response.real * even_mean + response.imag * odd_mean
                energy -= abs(response.real * odd_mean - response.imag * even_mean)
            energy = max(energy, np.float32(0.0))
            width = (amplitude_sum / (amplitude_max + epsilon) - one) / np.float32(scales - 1)
            spread = one / (one + np.exp(np.float32(SPREAD_GAIN) * (np.float32(SPREAD_CUT_OFF) - width)))
            out[row, col] = spread * energy / (amplitude_sum + epsilon)


def combine_scales_plain(responses: NDArray[np.complex64], epsilon: float) -> Float32:
    """Return what `combine_scales` computes, in plain numpy: its oracle."""
    even, odd = responses.real, responses.imag
    amplitude = np.abs(responses)
    norm = np.hypot(even.sum(0), odd.sum(0)) + epsilon
    even_mean, odd_mean = even.sum(0) / norm, odd.sum(0) / norm
    energy = (even * even_mean + odd * odd_mean - np.abs(even * odd_mean - odd * even_mean)).sum(0)
    width = (amplitude.sum(0) / (amplitude.max(0) + epsilon) - 1) / (len(responses) - 1)
    spread = 1 / (1 + np.exp(SPREAD_GAIN * (SPREAD_CUT_OFF - width)))
    result: Float32 = spread * np.maximum(energy, 0) / (amplitude.sum(0) + epsilon)
    return result
