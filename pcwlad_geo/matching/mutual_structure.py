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
from pcwlad_geo.matching.kernels.library import POINTER, REAL, WHOLE, address, function
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
    count, rows, cols = g0.shape
    memory = np.empty(14 * rows * cols + cols)
    function("filter_windows", *5 * [POINTER], *5 * [WHOLE], *4 * [REAL], POINTER)(
        *(address(windows, np.float64) for windows in (g0, i0, g, i, weight)),
        *(count, rows, cols, iterations, radius),
        *(lambda_reference, lambda_target, epsilon_reference, epsilon_target),
        address(memory, np.float64),
    )
    return g.reshape(shape), i.reshape(shape), weight.reshape(shape)


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


def significantly_correlated(pair: ChannelPair, corners_rc: Index, shift_xy_px: Float64) -> Bool:
    """Return the (n,) mask of the matches around which the two images correlate more than by chance.

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
