"""Mutual-structure filter: keeps the structure that two windows share and smooths the rest.

With I the target and G the reference window, N the pixels of a square neighbourhood and I0, G0 the
input, the filter minimises

    sum_p { sum_{q in N(p)} [(a1_p I_q + a0_p - G_q)^2 + (b1_p G_q + b0_p - I_q)^2]
            + |N(p)| (epsilon_I a1_p^2 + epsilon_G b1_p^2) }
    + lambda_I |I - I0|^2 + lambda_G |G - G0|^2

by alternating exact steps: the local lines a, b for given images, then both images for given lines. So the
energy cannot rise. Neighbourhoods are cut off at the border of the window.
It is that of Shen et al. (2015), see `paper`.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from pcwlad_geo.matching.coarse import ssim
from pcwlad_geo.matching.kernels.library import POINTER, REAL, WHOLE, address, function
from pcwlad_geo.matching.keypoints import CORNERS
from pcwlad_geo.matching.paper import PAPER, PaperParameters
from pcwlad_geo.matching.prepare import ChannelPair
from pcwlad_geo.matching.refinement import InitialEstimate, Refined
from pcwlad_geo.types import Bool, Float32, Float64, Floating, Index

CHUNK: Final = 128
"""Number of windows that are filtered at once, which limits the memory."""


def mutual_structure(
    reference: Floating, target: Floating, paper: PaperParameters = PAPER
) -> tuple[Float64, Float64, Float64]:
    """Filter windows jointly and weight each pixel by the structure that both share.

    The windows `reference` and `target` are finite, (rows, cols) or (k, rows, cols), in a range of about 1,
    which the numbers of the `paper` expect. Raises `ValueError` if the two shapes differ or are neither 2-D
    nor 3-D.

    Returned are both filtered windows and a weight, of the input's shape, (rows, cols) or (k, rows, cols).
    The weight is |ρ(filtered reference, target) · ρ(reference, filtered target)|, 0 to 1, from local
    correlations with each variance raised by its epsilon: near 1 where structure is shared, inverted contrast
    included. A filtered window is compared with the other input, because the filter copies structure from the
    window of large λ into the other: two filtered windows correlate at 0.95 even where only the reference had
    an edge.
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
        *(count, rows, cols, paper.filter_iterations, paper.filter_radius_px),
        *(paper.lambda_reference, paper.lambda_target, paper.epsilon_reference, paper.epsilon_target),
        address(memory, np.float64),
    )
    return g.reshape(shape), i.reshape(shape), weight.reshape(shape)


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
        result[part] = mutual_structure(reference / CORNERS.full_scale, target / CORNERS.full_scale)[2]
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
        initial = ssim(reference / CORNERS.full_scale, before / CORNERS.full_scale)
        final = ssim(reference / CORNERS.full_scale, after / CORNERS.full_scale)
        result[part] = (final > gate) & (final > initial)
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
