"""Mutual-structure filter: keeps the structure that two windows share, smooths away what only one has.

With I the target and G the reference window, N the pixels of a square neighbourhood and I0, G0 the
input, the filter minimises

    sum_p { sum_{q in N(p)} [(a1_p I_q + a0_p - G_q)^2 + (b1_p G_q + b0_p - I_q)^2]
            + |N(p)| (epsilon_I a1_p^2 + epsilon_G b1_p^2) }
    + lambda_I |I - I0|^2 + lambda_G |G - G0|^2

by exact steps in turn: the local lines a, b for given images, then both images for given lines. So the
energy cannot rise. Neighbourhoods are cut off at the border of the window.

References
----------
.. [1] Shen, X. et al. (2015), Mutual-structure for joint filtering, doi:10.1109/ICCV.2015.389.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

ITERATIONS: Final = 20
RADIUS_PX: Final = 3
LAMBDA_REFERENCE: Final = 30.0
LAMBDA_TARGET: Final = 1.0
EPSILON_REFERENCE: Final = 5e-4
EPSILON_TARGET: Final = 1e-4

Windows = NDArray[np.float64]


def mutual_structure(
    reference: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    *,
    iterations: int = ITERATIONS,
    radius: int = RADIUS_PX,
    lambda_reference: float = LAMBDA_REFERENCE,
    lambda_target: float = LAMBDA_TARGET,
    epsilon_reference: float = EPSILON_REFERENCE,
    epsilon_target: float = EPSILON_TARGET,
) -> tuple[Windows, Windows, Windows]:
    """Filter windows jointly and weigh each pixel by the structure that both share.

    Parameters
    ----------
    reference, target : (rows, cols) or (k, rows, cols) float array
        Finite values in a range of about 1, which is what the published defaults expect.
    iterations : int
        Alternating steps; 0 returns the input and its own similarity.
    radius : int
        Half side of the neighbourhood, px.
    lambda_reference, lambda_target : float
        How firmly each filtered window holds to its input.
    epsilon_reference, epsilon_target : float
        Contrast (variance) below which a window counts as flat.

    Returns
    -------
    filtered_reference, filtered_target : float64 arrays of the input's shape
    weight : float64 array of the input's shape, 0 to 1
        |ρ(filtered reference, target) · ρ(reference, filtered target)|, local correlations with each
        variance raised by its epsilon: near 1 where structure is shared, inverted contrast included; near
        0 where it is not, or where it is flat. A filtered window is compared with the other one as it
        came in, because the filter copies structure from the firmly held window into the other: the two
        filtered windows correlate at 0.95 even where only the reference had an edge.

    Raises
    ------
    ValueError
        If the two shapes differ or are neither 2-D nor 3-D.
    """
    if reference.shape != target.shape or reference.ndim not in (2, 3):
        raise ValueError(
            f"mutual structure needs equal 2-D or 3-D windows, got shapes {reference.shape}, {target.shape}"
        )
    shape = reference.shape
    stack = (-1, *shape[-2:])
    g0 = np.ascontiguousarray(reference, np.float64).reshape(stack)
    i0 = np.ascontiguousarray(target, np.float64).reshape(stack)
    g, i, weight = g0.copy(), i0.copy(), np.empty_like(g0)
    _filter_windows(
        g0,
        i0,
        g,
        i,
        weight,
        iterations,
        radius,
        float(lambda_reference),
        float(lambda_target),
        float(epsilon_reference),
        float(epsilon_target),
    )
    return g.reshape(shape), i.reshape(shape), weight.reshape(shape)


@njit(cache=True, nogil=True)
def _filter_windows(
    g0: Windows,
    i0: Windows,
    g: Windows,
    i: Windows,
    weight: Windows,
    iterations: int,
    radius: int,
    lambda_g: float,
    lambda_i: float,
    epsilon_g: float,
    epsilon_i: float,
) -> None:
    """Filter every window of the stacks in place; one window at a time stays in the cache."""
    count, rows, cols = g.shape
    area = _box_sums(np.ones((rows, cols)), radius, np.empty((rows, cols)), np.empty(cols))
    sums = np.empty((8, rows, cols))
    products = np.empty((3, rows, cols))
    for k in range(count):
        for _ in range(iterations):
            _local_lines(g[k], i[k], area, radius, epsilon_g, epsilon_i, sums, products)
            _update_images(g0[k], i0[k], area, lambda_g, lambda_i, sums, g[k], i[k])
        _correlate(g[k], i0[k], area, radius, epsilon_g, epsilon_i, sums, products, weight[k], False)
        _correlate(g0[k], i[k], area, radius, epsilon_g, epsilon_i, sums, products, weight[k], True)


@njit(cache=True, nogil=True)
def _box_sums(values: Windows, radius: int, out: Windows, column: Windows) -> Windows:
    """Sum over the (2·radius + 1)² neighbourhood of each pixel, cut off at the border, into `out`."""
    rows, cols = values.shape
    column[:] = 0.0
    for r in range(min(radius, rows)):
        for c in range(cols):
            column[c] += values[r, c]
    for r in range(rows):
        if r + radius < rows:
            for c in range(cols):
                column[c] += values[r + radius, c]
        if r - radius > 0:
            for c in range(cols):
                column[c] -= values[r - radius - 1, c]
        out[r, :] = column
        for step in range(1, radius + 1):
            for c in range(step, cols):
                out[r, c] += column[c - step]
            for c in range(cols - step):
                out[r, c] += column[c + step]
    return out


@njit(cache=True, nogil=True)
def _moments(g: Windows, i: Windows, radius: int, sums: Windows, products: Windows) -> None:
    """Fill sums[0:5] with the neighbourhood sums of g, i, g², i² and gi."""
    rows, cols = g.shape
    column = np.empty(cols)
    for r in range(rows):
        for c in range(cols):
            products[0, r, c] = g[r, c] * g[r, c]
            products[1, r, c] = i[r, c] * i[r, c]
            products[2, r, c] = g[r, c] * i[r, c]
    _box_sums(g, radius, sums[0], column)
    _box_sums(i, radius, sums[1], column)
    for n in range(3):
        _box_sums(products[n], radius, sums[2 + n], column)


@njit(cache=True, nogil=True)
def _local_lines(
    g: Windows,
    i: Windows,
    area: Windows,
    radius: int,
    epsilon_g: float,
    epsilon_i: float,
    sums: Windows,
    products: Windows,
) -> None:
    """Put the neighbourhood sums of a1, a0, b1, b0, a1², a1·a0, b1², b1·b0 into `sums`."""
    rows, cols = g.shape
    column = np.empty(cols)
    _moments(g, i, radius, sums, products)
    for r in range(rows):
        for c in range(cols):
            n = 1.0 / area[r, c]
            mean_g, mean_i = sums[0, r, c] * n, sums[1, r, c] * n
            covariance = sums[4, r, c] * n - mean_g * mean_i
            a1 = covariance / (max(sums[3, r, c] * n - mean_i * mean_i, 0.0) + epsilon_i)
            b1 = covariance / (max(sums[2, r, c] * n - mean_g * mean_g, 0.0) + epsilon_g)
            sums[0, r, c] = a1
            sums[1, r, c] = mean_g - a1 * mean_i
            sums[2, r, c] = b1
            sums[3, r, c] = mean_i - b1 * mean_g
            sums[4, r, c] = a1 * a1
            sums[5, r, c] = a1 * sums[1, r, c]
            sums[6, r, c] = b1 * b1
            sums[7, r, c] = b1 * sums[3, r, c]
    for n in range(8):
        products[0] = sums[n]
        _box_sums(products[0], radius, sums[n], column)


@njit(cache=True, nogil=True)
def _update_images(
    g0: Windows,
    i0: Windows,
    area: Windows,
    lambda_g: float,
    lambda_i: float,
    sums: Windows,
    g: Windows,
    i: Windows,
) -> None:
    """Solve the 2×2 system of each pixel for g and i, the local lines given by their sums."""
    rows, cols = g.shape
    for r in range(rows):
        for c in range(cols):
            n = area[r, c]
            a11 = sums[4, r, c] + n + lambda_i
            a22 = sums[6, r, c] + n + lambda_g
            a12 = -(sums[0, r, c] + sums[2, r, c])
            r1 = lambda_i * i0[r, c] + sums[3, r, c] - sums[5, r, c]
            r2 = lambda_g * g0[r, c] + sums[1, r, c] - sums[7, r, c]
            determinant = a11 * a22 - a12 * a12
            i[r, c] = (r1 * a22 - a12 * r2) / determinant
            g[r, c] = (a11 * r2 - a12 * r1) / determinant


@njit(cache=True, nogil=True)
def _correlate(
    g: Windows,
    i: Windows,
    area: Windows,
    radius: int,
    epsilon_g: float,
    epsilon_i: float,
    sums: Windows,
    products: Windows,
    weight: Windows,
    multiply: bool,
) -> None:
    """Put |ρ| of the neighbourhoods into `weight`, or multiply it by them."""
    rows, cols = g.shape
    _moments(g, i, radius, sums, products)
    for r in range(rows):
        for c in range(cols):
            n = 1.0 / area[r, c]
            mean_g, mean_i = sums[0, r, c] * n, sums[1, r, c] * n
            covariance = sums[4, r, c] * n - mean_g * mean_i
            variance_g = max(sums[2, r, c] * n - mean_g * mean_g, 0.0) + epsilon_g
            variance_i = max(sums[3, r, c] * n - mean_i * mean_i, 0.0) + epsilon_i
            rho = min(abs(covariance) / np.sqrt(variance_g * variance_i), 1.0)
            weight[r, c] = weight[r, c] * rho if multiply else rho
