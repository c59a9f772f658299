"""The filter bank of the phase congruency, and its compiled loops (`kernels/phase_congruency.c`).

The filters and their parameters are those of the paper's authors (log-Gabor filters of Kovesi 1999).
"""

from __future__ import annotations

from ctypes import Structure, byref
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import scipy.fft

from pcwlad_geo.matching.kernels.library import POINTER, SINGLE, WHOLE, address, function, roots_of_unity
from pcwlad_geo.matching.paper import PAPER
from pcwlad_geo.types import Complex64, Float32, Float64, Index

SCALES: Final = 4
"""Number of scales of the filters."""
ORIENTATIONS: Final = 6
"""Number of orientations of the filters, π / 6 apart."""
NEGLIGIBLE: Final = 1e-7
"""Transfer that counts as zero, below the rounding of float32."""
ROWS_AT_ONCE: Final = 8
"""Number of rows that are transformed at once, as many as a vector holds; `LANES` of the C."""


@dataclass(frozen=True, slots=True, eq=False)
class FilterBank:
    """Transfer functions for images of (n, m) pixels, without negative frequencies along either axis.

    The last axis is that of n, filled up with zeros to a multiple of `ROWS_AT_ONCE`.
    """

    radial: Float32
    """(scales, m // 2 + 1, width)."""
    inverse_radius: Float32
    """(m // 2 + 1, width) 1 / frequency in cycles per pixel; 1 at zero frequency."""
    reach: Index
    """(scales,) first frequency along n from which a scale is zero; falls from scale to scale."""
    roots: Complex64
    """(n + m,) roots of unity, clockwise, of n and then of m."""


@lru_cache(maxsize=4)
def filter_bank(n: int, m: int) -> FilterBank:
    """Return the radial filters for images of (`n`, `m`) pixels, the first axis being the halved one."""
    across, along = (np.abs(frequencies(length))[: length // 2 + 1] for length in (n, m))
    radius = np.hypot(along[:, None], across)
    radius[0, 0] = 1.0
    log_radius = np.log(radius)
    low_pass = 1.0 / (1.0 + np.exp(PAPER.low_pass_power * (log_radius - np.log(PAPER.low_pass_cut_off))))
    radial = np.empty((SCALES, *radius.shape), np.float32)
    for scale in range(SCALES):
        log_centre = -np.log(PAPER.least_wavelength_px * PAPER.wavelength_factor**scale)
        radial[scale] = low_pass * np.exp(
            -((log_radius - log_centre) ** 2) / (2 * np.log(PAPER.sigma_on_f) ** 2)
        )
    radial[:, 0, 0] = 0.0
    reach = [int(np.flatnonzero(cols > NEGLIGIBLE).max(initial=-1)) + 1 for cols in radial.max(axis=1)]
    return FilterBank(
        filled_up(radial),
        filled_up((1.0 / radius).astype(np.float32)),
        np.array(reach, np.int64),
        np.concatenate([roots_of_unity(n), roots_of_unity(m)]),
    )


def filled_up(values: Float32) -> Float32:
    """Return (…, n) `values` as (…, width), filled up with zeros to a multiple of `ROWS_AT_ONCE`."""
    width = -(-values.shape[-1] // ROWS_AT_ONCE) * ROWS_AT_ONCE
    filled = np.zeros((*values.shape[:-1], width), np.float32)
    filled[..., : values.shape[-1]] = values
    return filled


def frequencies(length: int) -> Float64:
    """Return the (length,) frequencies of a transform, cycles per pixel, in the order of the FFT.

    Odd lengths are divided by length - 1, as the authors' filters do.
    """
    half = (length - length % 2) // 2
    steps = np.arange(-half, half + length % 2)
    result: Float64 = scipy.fft.ifftshift(steps) / (2.0 * max(half, 1))
    return result


def wedge(orientation: int, axis: int, shape: tuple[int, int]) -> tuple[Float32, Float32] | None:
    """Describe an angular filter in the half plane of positive frequencies along an image axis.

    The filter of index `orientation` points orientation · π/6 from the column axis towards smaller rows. In
    the image of `shape` (rows, columns) the frequencies along `axis` are halved, 0 or 1. Returned are two
    float32 arrays, (n // 2 + 1,) and (m,), parts of the frequency vector along the filter's direction from
    the halved axis and from the other: their sum over the radius is the cosine of the angle between the two.
    None where the filter does not fit into this half plane. One that lies in the other half plane is turned
    by 180°: that changes the sign of the odd response, on which phase congruency does not depend.
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


class _Filtered(Structure):
    _fields_ = (*((f"array_{number}", POINTER) for number in range(7)), *((name, WHOLE) for name in "nmw"))


def oriented_map(
    spectrum: tuple[Float32, Float32],
    bank: FilterBank,
    direction: tuple[Float32, Float32],
    epsilon: float,
    out: Float32,
) -> None:
    """Compute the phase congruency of one orientation (Kovesi 1999), 0 to 1.

    The `spectrum` of an image of (n, m) pixels is two (m, width) float32 arrays, real and imaginary part, by
    frequency along m, and along n without the negative ones (see `filled_up`); `bank` is for (n, m), and the
    `direction`, two float32 arrays (n // 2 + 1,) and (m,), from `wedge`. The `epsilon` is positive, in units
    of the image (see `maps.scene_epsilon`). The (rows, cols) float32 array `out` is filled; it is at most (n,
    m), of any strides.
    """
    across, along = filled_up(direction[0]), direction[1]
    m, width = spectrum[0].shape
    n = len(bank.roots) - m
    arrays = [*spectrum, bank.radial, bank.inverse_radius, across, along]
    places = [*(address(array, np.float32) for array in arrays), address(bank.reach, np.int64)]
    numbers = ROWS_AT_ONCE * max(n, m) * (2 * SCALES + 3) + 2 * (m + 2 * ROWS_AT_ONCE) * int(bank.reach.sum())
    memory = np.empty(numbers, np.float32)
    function("oriented_map", *2 * [POINTER], *3 * [SINGLE], POINTER, *4 * [WHOLE], POINTER)(
        byref(_Filtered(*places, n, m, width)),
        address(bank.roots, np.complex64),
        epsilon,
        PAPER.spread_cut_off,
        PAPER.spread_gain,
        address(memory, np.float32),
        *out.shape,
        *(stride // out.itemsize for stride in out.strides),
        out.ctypes.data,
    )


def combine_orientations(maps: Float32, coefficients: Float32, out: Float32) -> None:
    """Fill `out`, an (n,) float32 array, with the maximum moment of oriented maps (Kovesi 1999).

    The (6, n) float32 `maps` are phase congruency by orientation; the (3, 6) float32 `coefficients` are
    factors of their squares in the terms c, s and cs of the covariance.
    """
    function("combine_orientations", POINTER, POINTER, SINGLE, WHOLE, POINTER)(
        address(maps, np.float32),
        address(coefficients, np.float32),
        PAPER.moment_epsilon,
        out.size,
        address(out, np.float32),
    )
