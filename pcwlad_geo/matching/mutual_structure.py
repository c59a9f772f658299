"""Mutual-structure filter: keeps the structure that two windows share and smooths the rest.

With I the target and G the reference window, N the pixels of a square neighbourhood and I0, G0 the
input, the filter minimises

    sum_p { sum_{q in N(p)} [(a1_p I_q + a0_p - G_q)^2 + (b1_p G_q + b0_p - I_q)^2]
            + |N(p)| (epsilon_I a1_p^2 + epsilon_G b1_p^2) }
    + lambda_I |I - I0|^2 + lambda_G |G - G0|^2

by alternating exact steps: the local lines a, b for given images, then both images for given lines. So the
energy cannot rise. Neighbourhoods are cut off at the border of the window.

References
----------
.. [1] Shen, X. et al. (2015), Mutual-structure for joint filtering, doi:10.1109/ICCV.2015.389.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.coarse import ssim
from pcwlad_geo.matching.kernels.compiled import compiled, compiled_part
from pcwlad_geo.matching.keypoints import FULL_SCALE
from pcwlad_geo.matching.prepare import ChannelPair
from pcwlad_geo.matching.refinement import InitialEstimate, Refined
from pcwlad_geo.types import Bool, Float32, Float64, Index

ITERATIONS: Final = 20
"""Number of alternating steps of the filter, as published [1]_."""
RADIUS_PX: Final = 3
"""Half side of the square neighbourhood, as published [1]_."""
LAMBDA_REFERENCE: Final = 30.0
"""λ_G, the weight of the filtered reference window's distance from its input, as published [1]_."""
LAMBDA_TARGET: Final = 1.0
"""λ_I, the weight of the filtered target window's distance from its input, as published [1]_."""
EPSILON_REFERENCE: Final = 5e-4
"""ε_G, the variance below which the reference window counts as flat, as published [1]_."""
EPSILON_TARGET: Final = 1e-4
"""ε_I, the variance below which the target window counts as flat, as published [1]_."""
AROUND_PX: Final = 40
"""Half side of what must be alike around a match, about the first window of refinement."""
CHANCE_OFFSET_PX: Final = 24
"""Offset (row and column) of the places that are alike by chance only, beyond the reach of the filters."""
MORE_THAN_CHANCE: Final = 2.0
"""Least correlation of a match, in standard deviations of those by chance."""


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
) -> tuple[Float64, Float64, Float64]:
    """Filter windows jointly and weight each pixel by the structure that both share.

    Raises `ValueError` if the two shapes differ or are neither 2-D nor 3-D.

    Parameters
    ----------
    reference, target : (rows, cols) or (k, rows, cols) float array
        Finite values in a range of about 1, which the published defaults expect.
    iterations : int
        Number of alternating steps; 0 returns the input and its own similarity.
    radius : int
        Half side of the neighbourhood, px.
    lambda_reference, lambda_target : float
        Weight of the distance of each filtered window from its input.
    epsilon_reference, epsilon_target : float
        Contrast (variance) below which a window counts as flat.

    Returns
    -------
    filtered_reference, filtered_target : (rows, cols) or (k, rows, cols) array
        Of the input's shape.
    weight : (rows, cols) or (k, rows, cols) array
        |ρ(filtered reference, target) · ρ(reference, filtered target)|, 0 to 1, from local correlations with
        each variance raised by its epsilon: near 1 where structure is shared, inverted contrast included;
        near 0 where it is not, or where it is flat. A filtered window is compared with the other input,
        because the filter copies structure from the window of large λ into the other: the two filtered
        windows correlate at 0.95 even where only the reference had an edge.
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
    lambdas = float(lambda_reference), float(lambda_target)
    epsilons = float(epsilon_reference), float(epsilon_target)
    _filter_windows(g0, i0, g, i, weight, iterations, radius, *lambdas, *epsilons)
    return g.reshape(shape), i.reshape(shape), weight.reshape(shape)


@compiled()
def _filter_windows(
    g0: Float64,
    i0: Float64,
    g: Float64,
    i: Float64,
    weight: Float64,
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
    products = np.empty((5, rows, cols))
    for k in range(count):
        for _ in range(iterations):
            _local_lines(g[k], i[k], area, radius, epsilon_g, epsilon_i, sums, products)
            _update_images(g0[k], i0[k], area, lambda_g, lambda_i, sums, g[k], i[k])
        for again in (False, True):  # one call: what is inlined twice is compiled twice
            first, second = (g0[k], i[k]) if again else (g[k], i0[k])
            _correlate(first, second, area, radius, epsilon_g, epsilon_i, sums, products, weight[k], again)


@compiled_part(called=True)
def _box_sums(values: Float64, radius: int, out: Float64, column: Float64) -> Float64:
    """Sum over the (2·radius + 1)² neighbourhood of each pixel, cut off at the border, into `out`."""
    rows, cols = values.shape
    for c in range(cols):
        column[c] = 0.0
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
        for c in range(cols):
            out[r, c] = column[c]
        for step in range(1, radius + 1):
            for c in range(step, cols):
                out[r, c] += column[c - step]
            for c in range(cols - step):
                out[r, c] += column[c + step]
    return out


@compiled_part()
def _moments(g: Float64, i: Float64, radius: int, sums: Float64, products: Float64) -> None:
    """Fill sums[0:5] with the neighbourhood sums of g, i, g², i² and gi."""
    rows, cols = g.shape
    column = np.empty(cols)
    for r in range(rows):
        for c in range(cols):
            products[0, r, c] = g[r, c]
            products[1, r, c] = i[r, c]
            products[2, r, c] = g[r, c] * g[r, c]
            products[3, r, c] = i[r, c] * i[r, c]
            products[4, r, c] = g[r, c] * i[r, c]
    for n in range(5):
        _box_sums(products[n], radius, sums[n], column)


@compiled_part()
def _local_lines(
    g: Float64,
    i: Float64,
    area: Float64,
    radius: int,
    epsilon_g: float,
    epsilon_i: float,
    sums: Float64,
    products: Float64,
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
        for r in range(rows):
            for c in range(cols):
                products[0, r, c] = sums[n, r, c]
        _box_sums(products[0], radius, sums[n], column)


@compiled_part()
def _update_images(
    g0: Float64,
    i0: Float64,
    area: Float64,
    lambda_g: float,
    lambda_i: float,
    sums: Float64,
    g: Float64,
    i: Float64,
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


@compiled_part()
def _correlate(
    g: Float64,
    i: Float64,
    area: Float64,
    radius: int,
    epsilon_g: float,
    epsilon_i: float,
    sums: Float64,
    products: Float64,
    weight: Float64,
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


CHUNK: Final = 128
"""Number of windows that are filtered at once, which limits the memory."""


def shared_structure(pair: ChannelPair, corners_rc: Index, start: InitialEstimate, window_px: int) -> Float32:
    """Return the mutual structure of the windows of every corner at the position of the start.

    It is an (n, window_px, window_px) float32 array of weights, 0 to 1, see `mutual_structure`. The (n, 2)
    `corners_rc` are the window centres (row, column) in the reference; `pair` has one map of each image.
    """
    result = np.empty((len(corners_rc), window_px, window_px), np.float32)
    for begin in range(0, len(corners_rc), CHUNK):
        part = slice(begin, begin + CHUNK)
        reference, target = _windows(
            pair, corners_rc[part], start.shift_xy_px[part], start.linear[part], window_px
        )
        result[part] = mutual_structure(reference / FULL_SCALE, target / FULL_SCALE)[2]
    return result


def passes_paper(
    pair: ChannelPair,
    corners_rc: Index,
    start: InitialEstimate,
    refined: Refined,
    window_px: int,
    gate: float,
) -> Bool:
    """Return the (n,) mask of the windows whose SSIM is above the gate and above that of the coarse match.

    Parameters are those of `shared_structure`, with the (n, 2) `corners_rc`; `refined` is what the refinement
    made of the start, `gate` the least SSIM.
    """
    result = np.zeros(len(corners_rc), bool)
    for begin in range(0, len(corners_rc), CHUNK):
        part = slice(begin, begin + CHUNK)
        corners = corners_rc[part]
        reference, before = _windows(pair, corners, start.shift_xy_px[part], start.linear[part], window_px)
        _, after = _windows(pair, corners, refined.shift_xy_px[part], refined.linear[part], window_px)
        initial = ssim(reference / FULL_SCALE, before / FULL_SCALE)
        final = ssim(reference / FULL_SCALE, after / FULL_SCALE)
        result[part] = (final > gate) & (final > initial)
    return result


def alike_beyond_chance(pair: ChannelPair, corners_rc: Index, shift_xy_px: Float64) -> Bool:
    """Return the (n,) mask of the matches around which the two images are more alike than by chance.

    The (n, 2) `corners_rc` are pixels of the reference, `shift_xy_px` where they are in the target beside
    that. The correlation of the maps around each is compared with those that the same places have with places
    beside their matches.
    """
    whole = np.rint(shift_xy_px[:, ::-1]).astype(np.intp)
    right, elsewhere = (
        correlations(pair, corners_rc, corners_rc + whole + offset, AROUND_PX, 2)
        for offset in (0, CHANCE_OFFSET_PX)
    )
    by_chance = float(np.sqrt(np.mean(elsewhere**2))) if len(elsewhere) else 0.0
    return right > MORE_THAN_CHANCE * by_chance


def correlations(
    pair: ChannelPair, reference_rc: Index, target_rc: Index, half_px: int, step_px: int = 1
) -> Float64:
    """Return the (n,) correlations of the maps around pixels of the reference and of the target.

    These are the (n, 2) `reference_rc` and the (n, 2) `target_rc` (row, col). The squares compared reach
    `half_px` from their pixels, and consist of the pixels `step_px` apart.
    """
    steps = np.arange(-half_px, half_px + 1, step_px)
    result = np.zeros(len(reference_rc))
    for begin in range(0, len(reference_rc), CHUNK):
        part = slice(begin, begin + CHUNK)
        centred = []
        for maps, centre_rc in (
            (pair.reference.maps, reference_rc[part]),
            (pair.target.maps, target_rc[part]),
        ):
            rows, cols = (
                np.clip(centre[:, None] + steps, 0, length - 1)
                for centre, length in zip(centre_rc.T, maps.shape[1:], strict=True)
            )
            values = maps[:, rows[:, :, None], cols[:, None, :]]
            centred.append(values - values.mean(axis=(2, 3), keepdims=True))
        reference, target = centred
        both, first, second = (
            np.einsum("knij,knij->n", one, other)
            for one, other in ((reference, target), (reference, reference), (target, target))
        )
        result[part] = both / np.sqrt(np.maximum(first * second, np.finfo(np.float32).tiny))
    return result


def _windows(
    pair: ChannelPair, corners_rc: Index, shift_xy: Float64, linear: Float64, window_px: int
) -> tuple[Float64, Float64]:
    """Return the (k, window, window) reference and sampled target windows of the one map."""
    half = window_px // 2
    step = np.arange(-half, half + 1)
    y, x = np.meshgrid(step, step, indexing="ij")
    rows = corners_rc[:, 0, None, None] + y
    cols = corners_rc[:, 1, None, None] + x
    reference = pair.reference.maps[0][rows, cols].astype(np.float64)
    dx = linear[:, 0, 0, None, None] * x + linear[:, 0, 1, None, None] * y + shift_xy[:, 0, None, None]
    dy = linear[:, 1, 0, None, None] * x + linear[:, 1, 1, None, None] * y + shift_xy[:, 1, None, None]
    from scipy.ndimage import map_coordinates  # slow to load, and seldom needed

    target = map_coordinates(
        pair.target.coefficients[0], np.stack([rows + dy, cols + dx]), order=3, prefilter=False, mode="mirror"
    )
    return reference, target.astype(np.float64)
