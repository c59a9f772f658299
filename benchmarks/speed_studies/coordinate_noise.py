"""Random numbers and smooth noise as functions of position, compiled: rows of a scene of any size.

The same idea as `sample_data/coordinate_noise.py`, twenty times as fast at displaced positions.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

FIELDS: Final = 4
"""Independent fields that one lattice of 64-bit hashes gives."""
UNIT: Final = np.float32(2 * 3**0.5 / 65536 / 0.55)
"""Makes the spread 1: sqrt(12) for uniform numbers, 0.55 for what the quadratic spline leaves of it."""


@njit(cache=True, nogil=True)
def hash_position(i: int, j: int, key: int) -> np.uint64:
    """Hash an integer position to 64 random bits (the finaliser of splitmix64)."""
    z = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
    z += np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    z += np.uint64(key) * np.uint64(0xD6E8FEB86659FD93)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True, nogil=True)
def part(bits: np.uint64, index: int) -> float:
    """Return one of the four 16-bit parts of a hash as a number from 0 to 1."""
    return float((bits >> np.uint64(16 * index)) & np.uint64(0xFFFF)) / 65536.0


@njit(cache=True, nogil=True, fastmath=True)
def add_noise(
    x_px: Float64, y_px: Float64, wavelength_px: float, key: int, gain: Float32, out: Float32
) -> None:
    """Add one octave of smooth noise, quadratic B-splines on a random lattice, to a row of positions.

    Parameters
    ----------
    x_px, y_px : (n,) float64 arrays
        Positions; neighbours should be near each other, as the lattice is looked up once a cell.
    wavelength_px : float
        Twice the spacing of the lattice.
    key : int
        Selects the lattice; it is also shifted by it, so that octaves share no lines.
    gain : (4,) float32 array
        Amplitude in each of the four fields.
    out : (6, n) float32 array
        Added to: the four fields, and the slopes of the first along x and y, per px.
    """
    nodes = np.empty((FIELDS, 3, 3), np.float32)
    per_px = 2.0 / wavelength_px
    scale = np.float32(per_px)
    shift = hash_position(0, 0, key)
    last_i, last_j = 1 << 60, 1 << 60
    for n in range(len(x_px)):
        u, v = x_px[n] * per_px + 8 * part(shift, 0), y_px[n] * per_px + 8 * part(shift, 1)
        i, j = int(np.floor(u)), int(np.floor(v))
        if i != last_i or j != last_j:
            last_i, last_j = i, j
            for b in range(3):
                for a in range(3):
                    bits = hash_position(i + a, j + b, key)
                    for field in range(FIELDS):
                        value = np.float32((bits >> np.uint64(16 * field)) & np.uint64(0xFFFF))
                        nodes[field, b, a] = (value - np.float32(32767.5)) * UNIT * gain[field]
        s, t = np.float32(u - i), np.float32(v - j)
        x0, x1, x2 = _weights(s)
        y0, y1, y2 = _weights(t)
        for field in range(FIELDS):
            if gain[field] != 0.0:
                row0 = x0 * nodes[field, 0, 0] + x1 * nodes[field, 0, 1] + x2 * nodes[field, 0, 2]
                row1 = x0 * nodes[field, 1, 0] + x1 * nodes[field, 1, 1] + x2 * nodes[field, 1, 2]
                row2 = x0 * nodes[field, 2, 0] + x1 * nodes[field, 2, 1] + x2 * nodes[field, 2, 2]
                out[field, n] += y0 * row0 + y1 * row1 + y2 * row2
                if field == 0:
                    d0, d1, d2 = _slopes(t)
                    out[5, n] += scale * (d0 * row0 + d1 * row1 + d2 * row2)
        if gain[0] != 0.0:
            d0, d1, d2 = _slopes(s)
            col0 = y0 * nodes[0, 0, 0] + y1 * nodes[0, 1, 0] + y2 * nodes[0, 2, 0]
            col1 = y0 * nodes[0, 0, 1] + y1 * nodes[0, 1, 1] + y2 * nodes[0, 2, 1]
            col2 = y0 * nodes[0, 0, 2] + y1 * nodes[0, 1, 2] + y2 * nodes[0, 2, 2]
            out[4, n] += scale * (d0 * col0 + d1 * col1 + d2 * col2)


@njit(cache=True, nogil=True)
def _weights(t: np.float32) -> tuple[np.float32, np.float32, np.float32]:
    half, one = np.float32(0.5), np.float32(1.0)
    return half * (one - t) * (one - t), half + t - t * t, half * t * t


@njit(cache=True, nogil=True)
def _slopes(t: np.float32) -> tuple[np.float32, np.float32, np.float32]:
    one = np.float32(1.0)
    return t - one, one - np.float32(2.0) * t, t


@njit(cache=True, nogil=True)
def normal(col: int, row: int, key: int) -> float:
    """Return a random number of a pixel: zero mean, unit spread, close to Gaussian."""
    bits = hash_position(col, row, key)
    total = part(bits, 0) + part(bits, 1) + part(bits, 2) + part(bits, 3)
    return (total - 2.0) * 3.0**0.5


@njit(cache=True, nogil=True)
def smoothstep(value: float, low: float, high: float) -> float:
    """Rise from 0 at `low` to 1 at `high` with zero slope at both ends."""
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@njit(cache=True, nogil=True)
def add_pixel_noise(values: Float64, row: int, key: int, sigma: float) -> None:
    """Add a sensor's noise to a row of pixels that begins in column 0."""
    for col in range(len(values)):
        values[col] += sigma * normal(col, row, key)
