"""The compiled pieces of the refinement: interpolation, local correlation, gain and robust weights.

All work on one window of one channel, float32; `reference` and `sampled` are larger than the window by
`pad` pixels on each side, which the local correlation needs. `refinement_plain` is the numpy twin.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

VARIANCE_FLOOR: Final = 1e-5
"""Keeps local correlation from seeing structure where a map is flat."""

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@njit(cache=True, nogil=True, inline="always")
def _spline(t: np.float32, weights: Float32, slopes: Float32) -> None:
    """Fill the four weights of the cubic B-spline and of its derivative at fraction t."""
    s = 1.0 - t
    weights[0] = s * s * s / 6.0
    weights[1] = 2.0 / 3.0 - t * t * (2.0 - t) / 2.0
    weights[2] = 2.0 / 3.0 - s * s * (2.0 - s) / 2.0
    weights[3] = t * t * t / 6.0
    slopes[0] = -s * s / 2.0
    slopes[1] = t * (3.0 * t - 4.0) / 2.0
    slopes[2] = -s * (3.0 * s - 4.0) / 2.0
    slopes[3] = t * t / 2.0


@njit(cache=True, nogil=True, fastmath=True)
def sample_shift(
    plane: Float32,
    row: float,
    col: float,
    side: int,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
    along: Float32,
    along_slope: Float32,
) -> bool:
    """Sample a spline plane and its gradient on a shifted window: separable. False if it sticks out."""
    row0 = int(np.floor(row))
    col0 = int(np.floor(col))
    if row0 < 1 or col0 < 1 or row0 + side + 2 > plane.shape[0] or col0 + side + 2 > plane.shape[1]:
        return False
    wy = np.empty(4, np.float32)
    dy = np.empty(4, np.float32)
    wx = np.empty(4, np.float32)
    dx = np.empty(4, np.float32)
    _spline(np.float32(row - row0), wy, dy)
    _spline(np.float32(col - col0), wx, dx)
    w0, w1, w2, w3 = wx[0], wx[1], wx[2], wx[3]
    d0, d1, d2, d3 = dx[0], dx[1], dx[2], dx[3]
    for r in range(side + 3):
        line = plane[row0 - 1 + r]
        base = col0 - 1
        for c in range(side):
            a0 = line[base + c]
            a1 = line[base + c + 1]
            a2 = line[base + c + 2]
            a3 = line[base + c + 3]
            along[r, c] = w0 * a0 + w1 * a1 + w2 * a2 + w3 * a3
            along_slope[r, c] = d0 * a0 + d1 * a1 + d2 * a2 + d3 * a3
    v0, v1, v2, v3 = wy[0], wy[1], wy[2], wy[3]
    e0, e1, e2, e3 = dy[0], dy[1], dy[2], dy[3]
    for r in range(side):
        for c in range(side):
            a0 = along[r, c]
            a1 = along[r + 1, c]
            a2 = along[r + 2, c]
            a3 = along[r + 3, c]
            value[r, c] = v0 * a0 + v1 * a1 + v2 * a2 + v3 * a3
            slope_y[r, c] = e0 * a0 + e1 * a1 + e2 * a2 + e3 * a3
            slope_x[r, c] = (
                v0 * along_slope[r, c]
                + v1 * along_slope[r + 1, c]
                + v2 * along_slope[r + 2, c]
                + v3 * along_slope[r + 3, c]
            )
    return True


@njit(cache=True, nogil=True, fastmath=True)
def sample_affine(
    plane: Float32,
    row: float,
    col: float,
    linear: Float64,
    side: int,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
) -> bool:
    """Sample a spline plane and its gradient on a deformed window centred at row, col."""
    half = side // 2
    wy = np.empty(4, np.float32)
    dy = np.empty(4, np.float32)
    wx = np.empty(4, np.float32)
    dx = np.empty(4, np.float32)
    for r in range(side):
        for c in range(side):
            x = col + (c - half) * (1.0 + linear[0, 0]) + (r - half) * linear[0, 1]
            y = row + (c - half) * linear[1, 0] + (r - half) * (1.0 + linear[1, 1])
            row0 = int(np.floor(y))
            col0 = int(np.floor(x))
            if row0 < 1 or col0 < 1 or row0 + 3 > plane.shape[0] or col0 + 3 > plane.shape[1]:
                return False
            _spline(np.float32(y - row0), wy, dy)
            _spline(np.float32(x - col0), wx, dx)
            v = np.float32(0.0)
            gx = np.float32(0.0)
            gy = np.float32(0.0)
            for i in range(4):
                s = np.float32(0.0)
                d = np.float32(0.0)
                for j in range(4):
                    a = plane[row0 - 1 + i, col0 - 1 + j]
                    s += wx[j] * a
                    d += dx[j] * a
                v += wy[i] * s
                gy += dy[i] * s
                gx += wy[i] * d
            value[r, c] = v
            slope_x[r, c] = gx
            slope_y[r, c] = gy
    return True


@njit(cache=True, nogil=True, fastmath=True)
def box_mean(source: Float32, size: int, out: Float32, columns: Float32) -> None:
    """Mean over size × size; out is smaller than source by size - 1 per axis."""
    rows, cols = source.shape
    scale = np.float32(1.0 / (size * size))
    for c in range(cols):
        columns[c] = 0.0
    for r in range(rows):
        if r >= size:
            for c in range(cols):
                columns[c] += source[r, c] - source[r - size, c]
        else:
            for c in range(cols):
                columns[c] += source[r, c]
        if r >= size - 1:
            total = np.float32(0.0)
            for c in range(size - 1):
                total += columns[c]
            for c in range(size - 1, cols):
                total += columns[c]
                out[r - size + 1, c - size + 1] = total * scale
                total -= columns[c - size + 1]


@njit(cache=True, nogil=True, fastmath=True)
def local_correlation(
    reference: Float32,
    sampled: Float32,
    size: int,
    weight: Float32,
    work: Float32,
    mean_r: Float32,
    var_r: Float32,
    mean_s: Float32,
    mean_ss: Float32,
    mean_rs: Float32,
    columns: Float32,
) -> None:
    """Fill weight with the squared positive local correlation of two extended windows."""
    box_mean(sampled, size, mean_s, columns)
    for r in range(sampled.shape[0]):
        for c in range(sampled.shape[1]):
            work[r, c] = sampled[r, c] * sampled[r, c]
    box_mean(work, size, mean_ss, columns)
    for r in range(sampled.shape[0]):
        for c in range(sampled.shape[1]):
            work[r, c] = sampled[r, c] * reference[r, c]
    box_mean(work, size, mean_rs, columns)
    floor = np.float32(VARIANCE_FLOOR)
    for r in range(weight.shape[0]):
        for c in range(weight.shape[1]):
            covariance = max(mean_rs[r, c] - mean_r[r, c] * mean_s[r, c], np.float32(0.0))
            var_s = max(mean_ss[r, c] - mean_s[r, c] * mean_s[r, c], np.float32(0.0))
            weight[r, c] = covariance * covariance / ((var_r[r, c] + floor) * (var_s + floor))


@njit(cache=True, nogil=True, fastmath=True)
def fit_gain(
    reference: Float32, sampled: Float32, pad: int, weight: Float32
) -> tuple[float, float, float, float]:
    """Fit reference = h0 + h1 · sampled with weights; returns h0, h1, mean |residual|, sum of weights."""
    sw = 0.0
    sx = 0.0
    sy = 0.0
    side = weight.shape[0]
    for r in range(side):
        lw = np.float32(0.0)
        lx = np.float32(0.0)
        ly = np.float32(0.0)
        for c in range(side):
            w = weight[r, c]
            lw += w
            lx += w * sampled[r + pad, c + pad]
            ly += w * reference[r + pad, c + pad]
        sw += float(lw)
        sx += float(lx)
        sy += float(ly)
    if sw <= 1e-6:
        return 0.0, 0.0, 0.0, 0.0
    mx = np.float32(sx / sw)
    my = np.float32(sy / sw)
    sxx = 0.0
    sxy = 0.0
    for r in range(side):
        lxx = np.float32(0.0)
        lxy = np.float32(0.0)
        for c in range(side):
            w = weight[r, c]
            x = sampled[r + pad, c + pad] - mx
            lxx += w * x * x
            lxy += w * x * (reference[r + pad, c + pad] - my)
        sxx += float(lxx)
        sxy += float(lxy)
    h1 = sxy / max(sxx, 1e-12)
    h0 = float(my - h1 * mx)
    g = np.float32(h1)
    o = np.float32(h0)
    total = 0.0
    for r in range(side):
        line = np.float32(0.0)
        for c in range(side):
            line += weight[r, c] * abs(reference[r + pad, c + pad] - o - g * sampled[r + pad, c + pad])
        total += float(line)
    return h0, h1, total / sw, sw


@njit(cache=True, nogil=True, fastmath=True)
def robust_weights(
    reference: Float32,
    sampled: Float32,
    pad: int,
    structure: Float32,
    h0: float,
    h1: float,
    scale: float,
    out: Float32,
) -> None:
    """Fill out = structure / (1 + |residual| / scale), eq. 9."""
    side = structure.shape[0]
    g = np.float32(h1)
    o = np.float32(h0)
    inverse = np.float32(1.0 / max(scale, 1e-9))
    for r in range(side):
        for c in range(side):
            residual = abs(reference[r + pad, c + pad] - o - g * sampled[r + pad, c + pad]) * inverse
            out[r, c] = structure[r, c] / (np.float32(1.0) + residual)
