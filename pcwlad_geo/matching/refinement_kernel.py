"""The compiled local correlation of two flat windows: the mutual structure of a channel.

Box means come from running sums down the columns and plain sums along the rows. For how windows are laid
out see `refinement_sampling`; `refinement_plain` is the numpy twin.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from pcwlad_geo.matching.compiled import compiled_part
from pcwlad_geo.matching.refinement_sampling import Float32

VARIANCE_FLOOR: Final = np.float32(1e-5)
"""Keeps local correlation from seeing structure where a map is flat."""
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
    """Fill the sums of first, first² and first · second over `size` rows, (rows - size + 1, width) each."""
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
    """Return the inverse of the variance, floored."""
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
    """Make `local_moments` and `correlate` for one size: sums of a number of terms that is known unroll."""
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


# the sizes of windows of 81 and 129 px
_moments_7, _correlation_7 = _row_kernels(7)
_moments_11, _correlation_11 = _row_kernels(11)


@compiled_part(fastmath=True)
def _row_means(source: Float32, n: int, size: int, out: Float32) -> None:
    """Fill the sums of `size` numbers, an odd number, from each one on, over size²."""
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
    """Fill the mean and the inverse of the (floored) variance over size × size from sums of columns."""
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
    """Fill weight with valid times the squared positive local correlation, from sums of columns."""
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
