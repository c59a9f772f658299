"""Phase congruency in plain numpy, as the equations have it: the oracle of the compiled loops.

Slow, and needs the whole plane of complex responses at once.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pcwlad_geo.matching.kernels import phase_congruency as bank
from pcwlad_geo.matching.paper import PAPER

Array = NDArray[np.float64]


def oriented_phase_congruency_plain(image: NDArray[np.floating], epsilon: float) -> Array:
    """Return what `phase_congruency.oriented_phase_congruency` computes, (6, rows, cols)."""
    spectrum = scipy.fft.fft2(image - image.mean())
    radial, angular = transfer_functions(image.shape[0], image.shape[1])
    return np.stack(
        [
            combine_scales_plain(scipy.fft.ifft2(spectrum * wedge * radial, axes=(1, 2)), epsilon)
            for wedge in angular
        ]
    )


def transfer_functions(rows: int, cols: int) -> tuple[Array, Array]:
    """Return the (4, rows, cols) radial and (6, rows, cols) angular transfer functions in the FFT's order."""
    y, x = bank.frequencies(rows)[:, None], bank.frequencies(cols)
    radius, theta = np.hypot(x, y), np.arctan2(-y, x)
    radius[0, 0] = 1.0
    low_pass = 1.0 / (1.0 + (radius / PAPER.low_pass_cut_off) ** PAPER.low_pass_power)
    centre = 1.0 / (PAPER.least_wavelength_px * PAPER.wavelength_factor ** np.arange(bank.SCALES))
    deviation = np.log(radius / centre[:, None, None]) / np.log(PAPER.sigma_on_f)
    radial = low_pass * np.exp(-(deviation**2) / 2)
    radial[:, 0, 0] = 0.0
    turned = theta - np.arange(bank.ORIENTATIONS)[:, None, None] * np.pi / bank.ORIENTATIONS
    distance = np.abs(np.arctan2(np.sin(turned), np.cos(turned)))
    angular = (np.cos(np.minimum(distance * bank.ORIENTATIONS / 2, np.pi)) + 1) / 2
    return radial, angular


def combine_scales_plain(responses: NDArray[np.complexfloating], epsilon: float) -> Array:
    """Return the phase congruency of one orientation from its (scales, rows, cols) complex responses."""
    even, odd = responses.real, responses.imag
    amplitude = np.abs(responses)
    norm = np.hypot(even.sum(0), odd.sum(0)) + epsilon
    even_mean, odd_mean = even.sum(0) / norm, odd.sum(0) / norm
    energy = (even * even_mean + odd * odd_mean - np.abs(even * odd_mean - odd * even_mean)).sum(0)
    width = (amplitude.sum(0) / (amplitude.max(0) + epsilon) - 1) / (len(responses) - 1)
    spread = 1 / (1 + np.exp(PAPER.spread_gain * (PAPER.spread_cut_off - width)))
    result: Array = spread * np.maximum(energy, 0) / (amplitude.sum(0) + epsilon)
    return result


def maximum_moment_plain(maps: NDArray[np.floating]) -> Array:
    """Return what `phase_congruency.maximum_moment` computes."""
    half = bank.ORIENTATIONS / 2
    theta = np.arange(bank.ORIENTATIONS) * np.pi / bank.ORIENTATIONS
    square = maps.astype(np.float64) ** 2
    c = np.tensordot(np.cos(theta) ** 2 / half, square, 1)
    s = np.tensordot(np.sin(theta) ** 2 / half, square, 1)
    cs = np.tensordot(2 * np.cos(theta) * np.sin(theta) / half, square, 1)
    result: Array = (c + s + np.hypot(cs, c - s) + PAPER.moment_epsilon) / 2
    return result
