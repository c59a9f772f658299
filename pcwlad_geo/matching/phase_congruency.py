"""Phase congruency without noise filter: where the Fourier components of an image agree in phase.

The maps depend on structure, not on brightness: a gain, an offset or an inversion of the image
leaves them unchanged. The filter bank and its parameters are those of the authors' own maps.

References
----------
.. [1] Kovesi, P. (1999), Image features from phase congruency, Videre 1(3).
.. [2] Morrone, M. C. and Owens, R. A. (1987), doi:10.1016/0167-8655(87)90013-4.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pcwlad_geo.matching.filter_bank import ORIENTATIONS, SCALES, filter_bank, wedge
from pcwlad_geo.matching.phase_kernels import combine_orientations, combine_scales, filter_rows

EPSILON_OF_BYTE_RANGE: Final = 1e-4
LEAST_EPSILON: Final = 1e-30
ROWS_AT_ONCE: Final = 16
COLS_AT_ONCE: Final = 32
"""The transforms run on blocks that stay in the processor's cache."""
STRIDE_MARGIN: Final = 8
"""Keeps rows of 2^k elements from falling on the same cache lines."""

Float32 = NDArray[np.float32]
Complex64 = NDArray[np.complex64]


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
    values = image if valid is None or valid.all() else image[valid]
    if values.size == 0:
        return 0.0
    low, high = np.percentile(values, (0.05, 99.95))
    return float(EPSILON_OF_BYTE_RANGE * (high - low) / 255.0)


def oriented_phase_congruency(
    image: NDArray[np.floating], epsilon: float, shape: tuple[int, int] | None = None
) -> Float32:
    """Compute one phase-congruency map per orientation.

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
        filtered = _filtered(centred, axis)
        turned = maps if axis == 0 else maps.transpose(0, 2, 1)
        for orientation, responses in filtered:
            _combine(responses, image.shape[axis], epsilon, turned[orientation])
    return maps


def _filtered(image: Float32, axis: int) -> Iterator[tuple[int, Complex64]]:
    """Yield the orientations whose filters lie in the half plane along an axis, with their responses.

    The responses, (4, n // 2 + 1, m) complex64, are in space along the other axis only; along this one
    they are spectra. Each overwrites the one before.
    """
    turned = image if axis == 0 else image.T
    n, m = turned.shape
    spectrum: Complex64 = scipy.fft.rfft2(turned, axes=(1, 0), workers=1)
    bank = filter_bank(n, m)
    # rows beyond the reach of a scale are never written: they stay zero
    responses = np.zeros((SCALES, len(spectrum), m + STRIDE_MARGIN), np.complex64)[:, :, :m]
    buffer = np.empty(SCALES * ROWS_AT_ONCE * m, np.complex64)
    for orientation in range(ORIENTATIONS):
        direction = wedge(orientation, axis, image.shape)
        if direction is None:
            continue
        for start in range(0, bank.reach[0], ROWS_AT_ONCE):
            rows = min(ROWS_AT_ONCE, len(spectrum) - start)
            scales = sum(start < reach for reach in bank.reach)
            block = buffer[: scales * rows * m].reshape(scales, rows, m)
            filter_rows(spectrum, bank.radial, bank.inverse_radius, *direction, start, block)
            block = scipy.fft.ifft(block, axis=2, overwrite_x=True, workers=1)
            responses[:scales, start : start + rows] = block
        yield orientation, responses


def _combine(responses: Complex64, n: int, epsilon: float, out: Float32) -> None:
    """Transform along the halved axis and fill a map (n or less, m or less)."""
    rows, cols = out.shape
    half = responses.shape[1]
    buffer = np.empty(SCALES * n * COLS_AT_ONCE, np.complex64)
    values = np.empty(n * COLS_AT_ONCE, np.float32)
    for start in range(0, cols, COLS_AT_ONCE):
        width = min(COLS_AT_ONCE, cols - start)
        block = buffer[: SCALES * n * width].reshape(SCALES, n, width)
        block[:, :half] = responses[:, :, start : start + width]
        block[:, half:] = 0.0
        block = scipy.fft.ifft(block, axis=1, overwrite_x=True, workers=1)
        part = values[: n * width]
        combine_scales(block.reshape(SCALES, -1), np.float32(max(epsilon, LEAST_EPSILON)), part)
        out[:, start : start + width] = part.reshape(n, width)[:rows]


def maximum_moment(maps: Float32) -> Float32:
    """Combine oriented maps into the maximum moment M of their covariance: the authors' map.

    Parameters
    ----------
    maps : (6, rows, cols) float32 array

    Returns
    -------
    (rows, cols) float32 array
    """
    theta = np.arange(ORIENTATIONS) * np.pi / ORIENTATIONS
    cosine, sine = np.cos(theta), np.sin(theta)
    coefficients = np.stack([cosine**2, sine**2, 2 * cosine * sine]) / (ORIENTATIONS / 2)
    moment = np.empty(maps.shape[1:], np.float32)
    flat = np.ascontiguousarray(maps).reshape(ORIENTATIONS, -1)
    combine_orientations(flat, coefficients.astype(np.float32), moment.reshape(-1))
    return moment
