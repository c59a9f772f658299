"""Compiled normal equations of one channel, and the local correlation of two windows.

Windows are flat float32 arrays, see `sampling`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from pcwlad_geo.matching.kernels.compiled import compiled_part
from pcwlad_geo.types import Float32, Float64

VARIANCE_FLOOR: Final = np.float32(1e-5)
"""Variance added to that of each window, so that local correlation is near 0 where a map is flat."""
_ONE: Final = np.float32(1.0)
_ZERO: Final = np.float32(0.0)

Moments = Callable[[Float32, Float32, Float32, Float32, int], None]
Correlation = Callable[[Float32, Float32, Float32, Float32, Float32, Float32, Float32, int], None]


@compiled_part(fastmath=True)
def column_sums(
    first: Float32,
    second: Float32,
    rows: int,
    width: int,
    size: int,
    columns: Float32,
    sum_1: Float32,
    sum_11: Float32,
    sum_12: Float32,
) -> None:
    """Fill the sums of first, first² and first · second over `size` rows.

    Parameters
    ----------
    first, second : (rows * width,) float32 arrays
        Flat windows.
    rows, width, size : int
        Rows of the windows, numbers in a row, and rows of a sum.
    columns : (3 * width,) float32 array
        Scratch memory.
    sum_1, sum_11, sum_12 : ((rows - size + 1) * width,) float32 arrays
        Filled.
    """
    one, square, product = columns[:width], columns[width : 2 * width], columns[2 * width : 3 * width]
    columns[:] = _ZERO
    for r in range(size - 1):
        for c in range(width):
            a, b = first[np.uintp(r * width + c)], second[np.uintp(r * width + c)]
            one[c] += a
            square[c] += a * a
            product[c] += a * b
    for r in range(rows - size + 1):
        top, bottom = r * width, (r + size - 1) * width
        for c in range(width):
            a, b = first[np.uintp(bottom + c)], second[np.uintp(bottom + c)]
            s, ss, sp = one[c] + a, square[c] + a * a, product[c] + a * b
            sum_1[np.uintp(top + c)], sum_11[np.uintp(top + c)], sum_12[np.uintp(top + c)] = s, ss, sp
            a, b = first[np.uintp(top + c)], second[np.uintp(top + c)]
            one[c], square[c], product[c] = s - a, ss - a * a, sp - a * b


@compiled_part(fastmath=True, inline=True)
def _precision(mean_1: np.float32, mean_11: np.float32) -> np.float32:
    """Return the inverse of the variance plus the floor."""
    return _ONE / (max(mean_11 - mean_1 * mean_1, _ZERO) + VARIANCE_FLOOR)


@compiled_part(fastmath=True, inline=True)
def _squared_correlation(
    mean_1: np.float32, mean_11: np.float32, mean_12: np.float32, mean_2: np.float32, precision_2: np.float32
) -> np.float32:
    """Return the squared correlation where it is positive, else 0."""
    covariance = max(mean_12 - mean_1 * mean_2, _ZERO)
    variance = max(mean_11 - mean_1 * mean_1, _ZERO) + VARIANCE_FLOOR
    return covariance * covariance * precision_2 / variance


def _row_kernels(size: int) -> tuple[Moments, Correlation]:
    """Make `local_moments` and `correlate` for one size: sums of a constant number of terms are unrolled."""
    scale = np.float32(1.0 / (size * size))

    @compiled_part(fastmath=True)
    def moments(sum_1: Float32, sum_11: Float32, mean: Float32, precision: Float32, n: int) -> None:
        for i in range(n):
            s, ss = sum_1[i], sum_11[i]
            for k in range(1, size):
                s += sum_1[i + k]
                ss += sum_11[i + k]
            mean[i] = s * scale
            precision[i] = _precision(s * scale, ss * scale)

    @compiled_part(fastmath=True)
    def correlation(
        sum_1: Float32,
        sum_11: Float32,
        sum_12: Float32,
        mean_2: Float32,
        precision_2: Float32,
        valid: Float32,
        weight: Float32,
        n: int,
    ) -> None:
        for i in range(n):
            s, ss, sp = sum_1[i], sum_11[i], sum_12[i]
            for k in range(1, size):
                s += sum_1[i + k]
                ss += sum_11[i + k]
                sp += sum_12[i + k]
            rho = _squared_correlation(s * scale, ss * scale, sp * scale, mean_2[i], precision_2[i])
            weight[i] = valid[i] * rho

    return moments, correlation


# the correlation windows of refinement windows of 81 and 129 px
_moments_7, _correlation_7 = _row_kernels(7)
_moments_11, _correlation_11 = _row_kernels(11)


@compiled_part(fastmath=True)
def _row_means(source: Float32, n: int, size: int, out: Float32) -> None:
    """Fill the sums of `size` (odd) consecutive numbers, from each one on, divided by size²."""
    for i in range(n):
        out[i] = source[i]
    for k in range(1, size, 2):
        next_1, next_2 = source[k:], source[k + 1 :]
        for i in range(n):
            out[i] += next_1[i] + next_2[i]
    scale = np.float32(1.0 / (size * size))
    for i in range(n):
        out[i] *= scale


@compiled_part(fastmath=True)
def local_moments(
    sum_1: Float32, sum_11: Float32, n: int, size: int, means: Float32, mean: Float32, precision: Float32
) -> None:
    """Fill the local mean and inverse variance over size × size pixels from the sums of columns.

    Parameters
    ----------
    sum_1, sum_11 : (n + size,) float32 arrays
        See `column_sums`.
    n, size : int
        Numbers to fill; side of the neighbourhood, odd.
    means : (n,) float32 array
        Scratch memory.
    mean, precision : (n,) float32 arrays
        Filled; `VARIANCE_FLOOR` is added to the variance.
    """
    if size == 7:
        _moments_7(sum_1, sum_11, mean, precision, n)
    elif size == 11:
        _moments_11(sum_1, sum_11, mean, precision, n)
    else:
        _row_means(sum_1, n, size, mean)
        _row_means(sum_11, n, size, means)
        for i in range(n):
            precision[i] = _precision(mean[i], means[i])


@compiled_part(fastmath=True)
def correlate(
    sum_1: Float32,
    sum_11: Float32,
    sum_12: Float32,
    mean_2: Float32,
    precision_2: Float32,
    valid: Float32,
    weight: Float32,
    n: int,
    size: int,
    means: Float32,
) -> None:
    """Fill the mutual structure: validity times the squared positive local correlation of two windows.

    Parameters
    ----------
    sum_1, sum_11, sum_12 : (n + size,) float32 arrays
        See `column_sums`; the first of its windows is the one sampled here.
    mean_2, precision_2 : (n,) float32 arrays
        Local mean and inverse variance of the second window, see `local_moments`.
    valid : (n,) float32 array
        1 or 0.
    weight : (n,) float32 array
        Filled, 0 to 1.
    n, size : int
        See `local_moments`.
    means : (3 * n,) float32 array
        Scratch memory.
    """
    if size == 7:
        _correlation_7(sum_1, sum_11, sum_12, mean_2, precision_2, valid, weight, n)
    elif size == 11:
        _correlation_11(sum_1, sum_11, sum_12, mean_2, precision_2, valid, weight, n)
    else:
        mean_1, mean_11, mean_12 = means[:n], means[n : 2 * n], means[2 * n : 3 * n]
        _row_means(sum_1, n, size, mean_1)
        _row_means(sum_11, n, size, mean_11)
        _row_means(sum_12, n, size, mean_12)
        for i in range(n):
            rho = _squared_correlation(mean_1[i], mean_11[i], mean_12[i], mean_2[i], precision_2[i])
            weight[i] = valid[i] * rho


SIGMA_PER_MEAN_DEVIATION: Final = 1.2533
"""Standard deviation of a normal distribution over its mean absolute deviation, √(π / 2)."""
MIN_CONTRAST: Final = 1e-6
"""A window whose variance is a smaller share of its mean square is flat at the precision of float32."""

# positions of the weighted moments of 1, the sampled value x, the residual r and its gradient p, q
W, WX, WR, WP, WQ, XX, XR, XP, XQ, RR, RP, RQ, PP, PQ, QQ = range(15)
MOMENTS: Final = 15
"""Number of the weighted moments."""


@compiled_part(fastmath=True)
def fit_gain(weight: Float32, sampled: Float32, reference: Float32, n: int) -> tuple[float, float, float]:
    """Fit reference = h0 + h1 · sampled by weighted least squares; return h0, h1 and the sum of the weights.

    The first `n` numbers count of the flat windows `weight`, `sampled` and `reference`, (n,) float32 arrays
    each. All three results are 0 where the weights do not determine them.
    """
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
    if variance <= MIN_CONTRAST * float(sxx):
        return 0.0, 0.0, 0.0
    h1 = (float(sxy) - float(sx) * mean_y) / variance
    return mean_y - h1 * mean_x, h1, total


@compiled_part(fastmath=True)
def sum_of_deviations(
    weight: Float32, sampled: Float32, reference: Float32, h0: np.float32, h1: np.float32, n: int
) -> float:
    """Return the sum of weight · |reference - h0 - h1 · sampled|.

    The flat windows `weight`, `sampled` and `reference` are (n,) float32 arrays; see `fit_gain`.
    """
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
    """Fill the sums of all products of two of 1, x, r, p, q with weights w / (1 + |r| / σ) (paper, eq. 9).

    Here x is the sampled value, r the residual, and p, q are the derivatives of x by column and row.

    Parameters
    ----------
    weight, sampled, reference, slope_x, slope_y : (n,) float32 arrays
        Flat windows.
    h0, h1, n
        See `fit_gain`.
    per_sigma : float32
        1 / σ; 0 for plain least squares.
    out : (15,) array
        Filled in the order of the names W to QQ.
    """
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

    Parameters
    ----------
    moments : (6, 15) or (1, 15) array
        Weighted moments (see `weighted_moments`) with each of 1, x, y, x², xy, y² as further weight, x and y
        in half windows; the first alone for a shift.
    h1 : float
        Gain with which the residual was computed.
    inverted_too : bool
        Whether a channel of negative gain is added.
    total, total_right : (k, k) and (k,) arrays
        Normal matrix and right side, to which the channel is added; the k parameters are
        (dx, a1, a2, dy, b1, b2), or (dx, dy) for a shift, px.
    fit : (3, 2) array
        Filled with the (offset, gain) that correct the residual, and that are projected out of p and of q.

    Returns
    -------
    gain, variance : float
        Refitted gain; weighted variance of the residual, 0 where nothing was added: singular, or inverted.
    """
    plain = moments[0]
    determinant = plain[W] * plain[XX] - plain[WX] ** 2
    if determinant <= MIN_CONTRAST * plain[W] * plain[XX]:
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
    """Add the scores w · residual · gradient · scale, gain and offset projected out, to the sums of blocks.

    Parameters
    ----------
    weight, sampled, reference, slope_x, slope_y : (side * width,) float32 arrays
        Flat windows.
    h0, h1, per_sigma
        See `weighted_moments`.
    fit : (3, 2) array
        See `add_equations`.
    scale : float
        Gain over residual variance of the channel.
    side, width, blocks : int
        Side of the window, numbers in a row, and blocks along a side.
    columns : (2 * width,) float32 array
        Scratch memory.
    scores : (blocks * blocks, 2) array
        Sums by block (row by row) of the scores (col, row), to which is added.
    """
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
