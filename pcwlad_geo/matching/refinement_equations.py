"""The compiled equations of one channel: gain and offset, weighted moments, normal equations, scores."""

from __future__ import annotations

from typing import Final

import numpy as np

from pcwlad_geo.matching.compiled import compiled_part
from pcwlad_geo.matching.refinement_sampling import Float32, Float64

SIGMA_PER_MEAN_DEVIATION: Final = 1.2533
"""σ of a normal distribution over its mean absolute deviation."""
LEAST_CONTRAST: Final = 1e-6
"""A window whose variance is a smaller part of its mean square is flat as far as float32 can tell."""
_ONE: Final = np.float32(1.0)
_ZERO: Final = np.float32(0.0)

# positions of the weighted moments of 1, the sampled value x, the residual r and its gradient p, q
W, WX, WR, WP, WQ, XX, XR, XP, XQ, RR, RP, RQ, PP, PQ, QQ = range(15)
MOMENTS: Final = 15


@compiled_part(fastmath=True)
def fit_gain(weight: Float32, sampled: Float32, reference: Float32, n: int) -> tuple[float, float, float]:
    """Fit reference = h0 + h1 · sampled; returns h0, h1 and the sum of weights, 0 where undetermined."""
    sw, sx, sy, sxx, sxy = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for i in range(n):
        w, x, y = weight[i], sampled[i], reference[i]
        wx = w * x
        sw += w
        sx += wx
        sy += w * y
        sxx += wx * x
        sxy += wx * y
    total, mean_x, mean_y = float(sw), 0.0, 0.0
    if total <= 1e-6:
        return 0.0, 0.0, 0.0
    mean_x, mean_y = float(sx) / total, float(sy) / total
    variance = float(sxx) - float(sx) * mean_x
    if variance <= LEAST_CONTRAST * float(sxx):
        return 0.0, 0.0, 0.0
    h1 = (float(sxy) - float(sx) * mean_y) / variance
    return mean_y - h1 * mean_x, h1, total


@compiled_part(fastmath=True)
def sum_of_deviations(
    weight: Float32, sampled: Float32, reference: Float32, h0: np.float32, h1: np.float32, n: int
) -> float:
    """Return the sum of weight · |residual|."""
    total = _ZERO
    for i in range(n):
        total += weight[i] * abs(reference[i] - h0 - h1 * sampled[i])
    return float(total)


@compiled_part(fastmath=True)
def weighted_moments(
    weight: Float32,
    sampled: Float32,
    reference: Float32,
    slope_x: Float32,
    slope_y: Float32,
    h0: np.float32,
    h1: np.float32,
    per_sigma: np.float32,
    n: int,
    out: Float64,
) -> None:
    """Fill the sums of all products of two of 1, x, r, p, q with weights w / (1 + |r| / σ), eq. 9."""
    sw, swx, swr, swp, swq = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    sxx, sxr, sxp, sxq = _ZERO, _ZERO, _ZERO, _ZERO
    srr, srp, srq = _ZERO, _ZERO, _ZERO
    spp, spq, sqq = _ZERO, _ZERO, _ZERO
    for i in range(n):
        x, p, q = sampled[i], slope_x[i], slope_y[i]
        r = reference[i] - h0 - h1 * x
        w = weight[i] / (_ONE + abs(r) * per_sigma)
        wx, wr, wp, wq = w * x, w * r, w * p, w * q
        sw += w
        swx += wx
        swr += wr
        swp += wp
        swq += wq
        sxx += wx * x
        sxr += wx * r
        sxp += wx * p
        sxq += wx * q
        srr += wr * r
        srp += wr * p
        srq += wr * q
        spp += wp * p
        spq += wp * q
        sqq += wq * q
    out[W], out[WX], out[WR], out[WP], out[WQ] = sw, swx, swr, swp, swq
    out[XX], out[XR], out[XP], out[XQ] = sxx, sxr, sxp, sxq
    out[RR], out[RP], out[RQ] = srr, srp, srq
    out[PP], out[PQ], out[QQ] = spp, spq, sqq


@compiled_part()
def add_equations(
    moments: Float64, h1: float, inverted_too: bool, total: Float64, total_right: Float64, fit: Float64
) -> tuple[float, float]:
    """Add the normal equations of a channel over its residual variance; offset and gain are eliminated.

    The parameters are (dx, a1, a2, dy, b1, b2), or (dx, dy) for a shift; `moments` has a row for each product
    of two of 1, x, y, in half windows: 1, x, y, x², xy, y². `fit` takes what corrects the residual and what
    projects the gradient: (offset, gain) of the residual, of p and of q.

    Returns
    -------
    gain, variance : float
        Refitted gain; weighted variance of the residual, 0 where nothing was added: singular, or inverted.
    """
    plain = moments[0]
    determinant = plain[W] * plain[XX] - plain[WX] ** 2
    if determinant <= LEAST_CONTRAST * plain[W] * plain[XX]:
        return 0.0, 0.0
    for k in range(3):
        with_one, with_x = plain[WR + k], plain[XR + k]
        fit[k, 0] = (with_one * plain[XX] - with_x * plain[WX]) / determinant
        fit[k, 1] = (with_x * plain[W] - with_one * plain[WX]) / determinant
    gain = h1 + fit[0, 1]
    variance = (plain[RR] - fit[0, 0] * plain[WR] - fit[0, 1] * plain[XR]) / plain[W]
    if variance <= 0.0 or (gain <= 0.0 and not inverted_too):
        return gain, 0.0
    count = len(total_right) // 2
    scale = gain / variance
    for first in range(2 * count):
        axis, k = first // count, first % count
        one, x = moments[k, WP + axis], moments[k, XP + axis]
        e0 = (one * plain[XX] - x * plain[WX]) / determinant
        e1 = (x * plain[W] - one * plain[WX]) / determinant
        total_right[first] += scale * (moments[k, RP + axis] - fit[0, 0] * one - fit[0, 1] * x)
        for second in range(2 * count):
            other, m = second // count, second % count
            product = k + m + (1 if min(k, m) > 0 else 0)
            projected = e0 * moments[m, WP + other] + e1 * moments[m, XP + other]
            total[first, second] += gain * scale * (moments[product, PP + axis + other] - projected)
    return gain, variance


@compiled_part(fastmath=True)
def add_block_scores(
    weight: Float32,
    sampled: Float32,
    reference: Float32,
    slope_x: Float32,
    slope_y: Float32,
    h0: np.float32,
    h1: np.float32,
    per_sigma: np.float32,
    fit: Float64,
    scale: float,
    side: int,
    width: int,
    blocks: int,
    columns: Float32,
    scores: Float64,
) -> None:
    """Add w·residual·gradient·scale, gain and offset projected out, to the (blocks², 2) sums of blocks."""
    sum_x, sum_y = columns[:width], columns[width : 2 * width]
    r0, r1 = np.float32(fit[0, 0]), np.float32(fit[0, 1])
    p0, p1 = np.float32(fit[1, 0]), np.float32(fit[1, 1])
    q0, q1 = np.float32(fit[2, 0]), np.float32(fit[2, 1])
    columns[:] = _ZERO
    for r in range(side):
        for c in range(width):
            i = np.uintp(r * width + c)
            x = sampled[i]
            residual = reference[i] - h0 - h1 * x
            pull = weight[i] / (_ONE + abs(residual) * per_sigma) * (residual - r0 - r1 * x)
            sum_x[c] += pull * (slope_x[i] - p0 - p1 * x)
            sum_y[c] += pull * (slope_y[i] - q0 - q1 * x)
        block = r * blocks // side
        if r + 1 == side or (r + 1) * blocks // side != block:
            for c in range(side):
                scores[block * blocks + c * blocks // side, 0] += scale * float(sum_x[c])
                scores[block * blocks + c * blocks // side, 1] += scale * float(sum_y[c])
            columns[:] = _ZERO
