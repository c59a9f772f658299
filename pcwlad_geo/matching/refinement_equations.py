"""The compiled normal equations of one channel, gain and offset eliminated, and the scores of its blocks."""

from __future__ import annotations

import numpy as np
from numba import njit

from pcwlad_geo.matching.refinement_kernel import Float32, Float64


@njit(cache=True, nogil=True, fastmath=True)
def normal_equations(
    reference: Float32,
    sampled: Float32,
    pad: int,
    slope_x: Float32,
    slope_y: Float32,
    weight: Float32,
    h0: float,
    h1: float,
    affine: bool,
    matrix: Float64,
    right: Float64,
) -> float:
    """Fill the normal matrix and right side of one channel, gain and offset eliminated (Schur complement).

    The parameters are (dx, a1, a2, dy, b1, b2), or (dx, dy) for a shift; x, y count in half windows.
    Returns the weighted residual variance, -1 where gain and offset are undetermined.
    """
    sw, si, sii, sr, sri, srr = _radiometric_sums(reference, sampled, pad, weight, h0, h1)
    determinant = sw * sii - si * si
    if determinant <= 1e-12 * sw * max(sii, 1e-30):
        return -1.0
    squares = np.zeros((3, 3, 3))
    links = np.zeros((6, 2, 2))
    _gradient_sums(
        reference, sampled, pad, slope_x, slope_y, weight, h0, h1, 3 if affine else 1, squares, links
    )
    count = 3 if affine else 1
    px = np.array([0, 1, 0])
    py = np.array([0, 0, 1])
    border = np.zeros((2 * count, 2))
    for k in range(count):
        for m in range(count):
            a = px[k] + px[m]
            b = py[k] + py[m]
            matrix[k, m] = squares[0, a, b]
            matrix[k, count + m] = squares[1, a, b]
            matrix[count + m, k] = squares[1, a, b]
            matrix[count + k, count + m] = squares[2, a, b]
        for axis in range(2):
            border[axis * count + k, 0] = links[axis, px[k], py[k]]
            border[axis * count + k, 1] = links[2 + axis, px[k], py[k]]
            right[axis * count + k] = links[4 + axis, px[k], py[k]]
    for k in range(2 * count):
        e0 = (border[k, 0] * sii - border[k, 1] * si) / determinant
        e1 = (border[k, 1] * sw - border[k, 0] * si) / determinant
        for m in range(2 * count):
            matrix[k, m] -= e0 * border[m, 0] + e1 * border[m, 1]
        right[k] -= e0 * sr + e1 * sri
    return srr / sw


@njit(cache=True, nogil=True, fastmath=True)
def _radiometric_sums(
    reference: Float32, sampled: Float32, pad: int, weight: Float32, h0: float, h1: float
) -> tuple[float, float, float, float, float, float]:
    """Return the weighted sums of 1, I, I², r, r·I and r², with r the residual."""
    side = weight.shape[0]
    g = np.float32(h1)
    o = np.float32(h0)
    sw = 0.0
    si = 0.0
    sii = 0.0
    sr = 0.0
    sri = 0.0
    srr = 0.0
    for r in range(side):
        lw = np.float32(0.0)
        li = np.float32(0.0)
        lii = np.float32(0.0)
        lr = np.float32(0.0)
        lri = np.float32(0.0)
        lrr = np.float32(0.0)
        for c in range(side):
            w = weight[r, c]
            i = sampled[r + pad, c + pad]
            res = reference[r + pad, c + pad] - o - g * i
            lw += w
            li += w * i
            lii += w * i * i
            lr += w * res
            lri += w * res * i
            lrr += w * res * res
        sw += float(lw)
        si += float(li)
        sii += float(lii)
        sr += float(lr)
        sri += float(lri)
        srr += float(lrr)
    return sw, si, sii, sr, sri, srr


@njit(cache=True, nogil=True, fastmath=True)
def _gradient_sums(
    reference: Float32,
    sampled: Float32,
    pad: int,
    slope_x: Float32,
    slope_y: Float32,
    weight: Float32,
    h0: float,
    h1: float,
    powers: int,
    squares: Float64,
    links: Float64,
) -> None:
    """Add up the weighted products of the gradient with itself and with 1, I and the residual.

    `squares` takes gx², gx·gy, gy² and `links` gx, gy, gx·I, gy·I, gx·r, gy·r, each by power of x and of y.
    """
    side = weight.shape[0]
    half = side // 2
    g = np.float32(h1)
    o = np.float32(h0)
    xs = ((np.arange(side) - half) / half).astype(np.float32)
    for r in range(side):
        for a in range(powers):
            xx = np.float32(0.0)
            xy = np.float32(0.0)
            yy = np.float32(0.0)
            x1 = np.float32(0.0)
            y1 = np.float32(0.0)
            xi = np.float32(0.0)
            yi = np.float32(0.0)
            xr = np.float32(0.0)
            yr = np.float32(0.0)
            for c in range(side):
                i = sampled[r + pad, c + pad]
                res = reference[r + pad, c + pad] - o - g * i
                w = weight[r, c]
                if a == 1:
                    w *= xs[c]
                elif a == 2:
                    w *= xs[c] * xs[c]
                gx = slope_x[r + pad, c + pad] * g
                gy = slope_y[r + pad, c + pad] * g
                xx += w * gx * gx
                xy += w * gx * gy
                yy += w * gy * gy
                x1 += w * gx
                y1 += w * gy
                xi += w * gx * i
                yi += w * gy * i
                xr += w * gx * res
                yr += w * gy * res
            y = 1.0
            for b in range(powers):
                squares[0, a, b] += xx * y
                squares[1, a, b] += xy * y
                squares[2, a, b] += yy * y
                if a < 2 and b < 2:
                    links[0, a, b] += x1 * y
                    links[1, a, b] += y1 * y
                    links[2, a, b] += xi * y
                    links[3, a, b] += yi * y
                    links[4, a, b] += xr * y
                    links[5, a, b] += yr * y
                y *= (r - half) / half


@njit(cache=True, nogil=True, fastmath=True)
def add_block_scores(
    reference: Float32,
    sampled: Float32,
    pad: int,
    slope_x: Float32,
    slope_y: Float32,
    weight: Float32,
    h0: float,
    h1: float,
    variance: float,
    blocks: int,
    scores: Float64,
) -> None:
    """Add w·residual·gradient/σ², gain and offset projected out, to the (blocks², 2) sums of the blocks."""
    side = weight.shape[0]
    g = np.float32(h1)
    o = np.float32(h0)
    sw, si, sii, _, _, _ = _radiometric_sums(reference, sampled, pad, weight, h0, h1)
    bx0 = 0.0
    bx1 = 0.0
    by0 = 0.0
    by1 = 0.0
    for r in range(side):
        for c in range(side):
            w = weight[r, c]
            i = sampled[r + pad, c + pad]
            bx0 += w * slope_x[r + pad, c + pad] * g
            bx1 += w * slope_x[r + pad, c + pad] * g * i
            by0 += w * slope_y[r + pad, c + pad] * g
            by1 += w * slope_y[r + pad, c + pad] * g * i
    determinant = sw * sii - si * si
    ax = np.float32((bx0 * sii - bx1 * si) / determinant)
    cx = np.float32((bx1 * sw - bx0 * si) / determinant)
    ay = np.float32((by0 * sii - by1 * si) / determinant)
    cy = np.float32((by1 * sw - by0 * si) / determinant)
    for r in range(side):
        block_r = r * blocks // side
        for c in range(side):
            block = block_r * blocks + c * blocks // side
            i = sampled[r + pad, c + pad]
            pull = weight[r, c] * (reference[r + pad, c + pad] - o - g * i) / variance
            scores[block, 0] += pull * (slope_x[r + pad, c + pad] * g - ax - cx * i)
            scores[block, 1] += pull * (slope_y[r + pad, c + pad] * g - ay - cy * i)
