"""The compiled loops of the phase congruency; `phase_congruency_plain` has their numpy twins."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.compiled import compiled, compiled_part
from pcwlad_geo.matching.filter_bank import ORIENTATIONS, SCALES

SPREAD_CUT_OFF: Final = 0.5
SPREAD_GAIN: Final = 3.0
MOMENT_EPSILON: Final = 1e-4

Float32 = NDArray[np.float32]
Complex64 = NDArray[np.complex64]


@compiled(fastmath=True)
def filter_rows(
    spectrum: Complex64,
    radial: Float32,
    inverse_radius: Float32,
    across: Float32,
    along: Float32,
    start: int,
    out: Complex64,
) -> None:
    """Multiply rows of half a spectrum with one angular filter and with the radial ones.

    Parameters
    ----------
    spectrum : (n, m) complex64 array
    radial : (scales, n, m // 2 + 1) float32 array
    inverse_radius : (n, m // 2 + 1) float32 array
    across, along : (n,), (m,) float32 arrays
        See `filter_bank.wedge`.
    start : int
        First row.
    out : (scales or less, rows, m) complex64 array
        Filled.
    """
    m = along.size
    angular = np.empty(m, np.float32)
    mirrored = np.empty(m, np.float32)
    for row in range(out.shape[1]):
        _mirror(inverse_radius[start + row], mirrored)
        for col in range(m):
            cosine = (across[start + row] + along[col]) * mirrored[col]
            # (1 + cos 3Δ) / 2 up to Δ = 60°, as a polynomial in cos Δ
            beyond = max(np.float32(2.0) * cosine - np.float32(1.0), np.float32(0.0))
            angular[col] = np.float32(0.5) * (np.float32(1.0) + cosine) * beyond * beyond
        for scale in range(out.shape[0]):
            _mirror(radial[scale, start + row], mirrored)
            source = spectrum[start + row]
            target = out[scale, row]
            for col in range(m):
                target[col] = source[col] * (angular[col] * mirrored[col])


@compiled_part(fastmath=True)
def _mirror(half: Float32, full: Float32) -> None:
    """Unfold what is the same at positive and negative frequencies."""
    for col in range(half.size):
        full[col] = half[col]
    for col in range(1, full.size - half.size + 1):
        full[full.size - col] = half[col]


@compiled(fastmath=True)
def combine_scales(responses: Complex64, epsilon: np.float32, out: Float32) -> None:
    """Fuse the filter responses of one orientation, (4, n) complex64, into n values of its map.

    `epsilon` must be positive.
    """
    one = np.float32(1.0)
    for i in range(out.size):
        even = np.float32(0.0)
        odd = np.float32(0.0)
        amplitude_sum = np.float32(0.0)
        amplitude_max = np.float32(0.0)
        for scale in range(SCALES):
            response = responses[scale, i]
            amplitude = np.sqrt(response.real * response.real + response.imag * response.imag)
            even += response.real
            odd += response.imag
            amplitude_sum += amplitude
            amplitude_max = max(amplitude_max, amplitude)
        across = np.float32(0.0)
        for scale in range(SCALES):
            response = responses[scale, i]
            across += abs(response.real * odd - response.imag * even)
        square = even * even + odd * odd
        energy = max((square - across) / (np.sqrt(square) + epsilon), np.float32(0.0))
        width = (amplitude_sum / (amplitude_max + epsilon) - one) / np.float32(SCALES - 1)
        out[i] = _sigmoid(width) * energy / (amplitude_sum + epsilon)


@compiled_part(fastmath=True)
def _sigmoid(width: np.float32) -> np.float32:
    """Return 1 / (1 + exp(gain · (cut-off - width))): by the continued fraction of tanh, good to 1e-7.

    A call of exp in the loop would keep it from the vector units.
    """
    t = np.float32(SPREAD_GAIN / 2) * (width - np.float32(SPREAD_CUT_OFF))
    square = t * t
    above = np.float32(135135.0) + square * (np.float32(17325.0) + square * (np.float32(378.0) + square))
    below = np.float32(135135.0) + square * (
        np.float32(62370.0) + square * (np.float32(3150.0) + np.float32(28.0) * square)
    )
    return np.float32(0.5) + np.float32(0.5) * t * above / below


@compiled(fastmath=True)
def combine_orientations(maps: Float32, coefficients: Float32, out: Float32) -> None:
    """Fill out, (n,), with the maximum moment of the maps, (6, n).

    The coefficients, (3, 6), make the covariance of the squared maps: c, s and cs of Kovesi.
    """
    for i in range(out.size):
        c = np.float32(0.0)
        s = np.float32(0.0)
        cs = np.float32(0.0)
        for orientation in range(ORIENTATIONS):
            square = maps[orientation, i] * maps[orientation, i]
            c += coefficients[0, orientation] * square
            s += coefficients[1, orientation] * square
            cs += coefficients[2, orientation] * square
        root = np.sqrt(cs * cs + (c - s) * (c - s))
        out[i] = np.float32(0.5) * (c + s + root + np.float32(MOMENT_EPSILON))
