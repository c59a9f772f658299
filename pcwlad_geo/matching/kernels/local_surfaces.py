"""The compiled fit of robust local surfaces through neighbours."""

from __future__ import annotations

from typing import Final

import numpy as np

from pcwlad_geo.matching.kernels.compiled import compiled, compiled_part
from pcwlad_geo.matching.kernels.steps import invert
from pcwlad_geo.types import Bool, Float64, Index

ROUNDS: Final = 4
"""Number of reweighted fits of a surface."""
RIDGE: Final = 1e-6
"""Relative ridge on all terms but the constant: neighbours on a line do not determine the slope across it."""
TINY: Final = 1e-12
"""Ridge on all terms, which keeps the normal matrix invertible."""
MIN_SCALE_PX: Final = 1e-6
"""Least scale of the residuals, which keeps the weights finite where the fit is exact."""


@compiled(fastmath=True)
def fit_surfaces(
    xy_px: Float64,
    displacement_px: Float64,
    at_xy_px: Float64,
    neighbours: Index,
    usable: Bool,
    order: int,
    value: Float64,
    slope: Float64,
    scale: Float64,
    leverage: Float64,
) -> None:
    """Fit a robust surface to the displacements of the usable neighbours of each place.

    Parameters
    ----------
    xy_px, displacement_px : (m, 2) float64 arrays
        Positions and displacements (col, row) of the points.
    at_xy_px : (n, 2) float64 array
        Places (col, row).
    neighbours, usable : (n, k) intp and bool arrays
        Indices of points near each place, and which of them take part.
    order : int
        1: a plane, 2: a quadratic surface.
    value, slope, scale, leverage : (n, 2), (n, 2, 2), (n,), (n,) float64 arrays
        Filled with the surface at the place, its derivatives (component, by x and y), the median distance
        from it, and the variance of the value over that of one neighbour. Unchanged where there are fewer
        than two neighbours for each term.
    """
    terms = 3 if order == 1 else 6
    most = neighbours.shape[1]
    design = np.empty((terms, most))
    moved = np.empty((2, most))
    residual = np.empty(most)
    work = np.empty(most)
    normal = np.empty((terms, terms))
    right = np.empty((terms, 2))
    solution = np.empty((terms, 2))
    for p in range(len(at_xy_px)):
        count = int(
            neighbours.shape[0] * 0
        )  # a literal 0 is a type of its own: parts would be compiled for it, too
        reach = 0.0
        for j in range(most):
            k = neighbours[p, j]
            x = xy_px[k, 0] - at_xy_px[p, 0]
            y = xy_px[k, 1] - at_xy_px[p, 1]
            reach = max(reach, x * x + y * y)
            if usable[p, j]:
                design[1, count], design[2, count] = x, y
                moved[0, count], moved[1, count] = displacement_px[k, 0], displacement_px[k, 1]
                count += 1
        if count < 2 * terms:
            continue
        extent = max(np.sqrt(reach), 1e-9)
        _fill_design(design, count, extent)
        solution[:] = 0.0
        for axis in range(2):
            for j in range(count):
                work[j] = moved[axis, j]
            solution[0, axis] = _median(work[:count])
        for _ in range(ROUNDS):
            _distances(design, moved, solution, count, residual)
            for j in range(count):
                work[j] = residual[j]
            scale[p] = max(_median(work[:count]), MIN_SCALE_PX)
            _weights(residual, 2 * scale[p], count, work)
            _normal_equations(design, moved, work, count, normal, right)
            invert(normal)
            _multiply(normal, right, solution)
        for j in range(count):  # all alike
            work[j] = 1.0
        _normal_equations(design, moved, work, count, normal, right)
        invert(normal)
        leverage[p] = normal[0, 0]
        for axis in range(2):
            value[p, axis] = solution[0, axis]
            slope[p, axis, 0], slope[p, axis, 1] = solution[1, axis] / extent, solution[2, axis] / extent


@compiled_part(fastmath=True)
def _fill_design(design: Float64, count: int, reach: float) -> None:
    """Fill the (terms, k) terms of a surface; the second and third hold the offsets, px, on input."""
    quadratic = len(design) > 3
    for j in range(count):
        x, y = design[1, j] / reach, design[2, j] / reach
        design[0, j], design[1, j], design[2, j] = 1.0, x, y
        if quadratic:
            design[3, j], design[4, j], design[5, j] = x * x, x * y, y * y


@compiled_part(fastmath=True)
def _distances(design: Float64, moved: Float64, solution: Float64, count: int, out: Float64) -> None:
    if len(design) == 3:
        for j in range(count):
            x = moved[0, j] - solution[0, 0] - design[1, j] * solution[1, 0] - design[2, j] * solution[2, 0]
            y = moved[1, j] - solution[0, 1] - design[1, j] * solution[1, 1] - design[2, j] * solution[2, 1]
            out[j] = np.sqrt(x * x + y * y)
        return
    for j in range(count):
        x, y = moved[0, j] - solution[0, 0], moved[1, j] - solution[0, 1]
        for a in range(1, 6):
            x -= design[a, j] * solution[a, 0]
            y -= design[a, j] * solution[a, 1]
        out[j] = np.sqrt(x * x + y * y)


@compiled_part(fastmath=True)
def _weights(residual: Float64, width: float, count: int, out: Float64) -> None:
    for j in range(count):
        ratio = residual[j] / width
        out[j] = 1.0 / (1.0 + ratio * ratio)


@compiled_part(fastmath=True)
def _normal_equations(
    design: Float64, moved: Float64, weight: Float64, count: int, normal: Float64, right: Float64
) -> None:
    """Fill the weighted normal equations."""
    terms = len(design)
    for a in range(terms):
        for b in range(a, terms):
            total = 0.0
            for j in range(count):
                total += weight[j] * design[a, j] * design[b, j]
            normal[a, b] = normal[b, a] = total
        x, y = 0.0, 0.0
        for j in range(count):
            x += weight[j] * design[a, j] * moved[0, j]
            y += weight[j] * design[a, j] * moved[1, j]
        right[a, 0], right[a, 1] = x, y
    ridge = RIDGE * normal[0, 0] + TINY
    normal[0, 0] += TINY
    for a in range(1, terms):
        normal[a, a] += ridge


@compiled_part()
def _multiply(matrix: Float64, right: Float64, product: Float64) -> None:
    for a in range(len(matrix)):
        for axis in range(2):
            total = 0.0
            for b in range(len(matrix)):
                total += matrix[a, b] * right[b, axis]
            product[a, axis] = total


@compiled_part()
def _median(values: Float64) -> float:
    """Return the median; the values are reordered."""
    middle = len(values) // 2
    upper = _select(values, middle)
    if len(values) % 2:
        return upper
    lower = values[0]
    for j in range(1, middle):
        lower = max(lower, values[j])
    return float(0.5 * (lower + upper))


@compiled_part()
def _select(values: Float64, rank: int) -> float:
    """Return the value of a rank and reorder: smaller ones precede it afterwards (Hoare's selection)."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot = values[rank]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if j < rank:
            low = i
        if i > rank:
            high = j
    return float(values[rank])
