"""The compiled fit of robust local surfaces through neighbours; its plain twin is in `field_plain`."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.compiled import compiled, compiled_part
from pcwlad_geo.matching.refinement_steps import invert

Float64 = NDArray[np.float64]
Index = NDArray[np.intp]

ROUNDS: Final = 4
"""Reweighted fits of a surface."""
RIDGE: Final = 1e-6
"""On all terms but the constant: neighbours on a line leave the slope across it undetermined."""
TINY: Final = 1e-12
LEAST_SCALE_PX: Final = 1e-6


@compiled()
def fit_surfaces(
    xy_px: Float64,
    displacement_px: Float64,
    at_xy_px: Float64,
    neighbours: Index,
    usable: NDArray[np.bool_],
    order: int,
    value: Float64,
    slope: Float64,
    scale: Float64,
    leverage: Float64,
) -> None:
    """Lay a robust surface through the usable neighbours of each place.

    Parameters
    ----------
    xy_px, displacement_px : (m, 2) float64 arrays
        Points.
    at_xy_px : (n, 2) float64 array
        Places.
    neighbours, usable : (n, k) arrays
        Points near each place, and which of them take part.
    order : int
        1: a plane, 2: a quadratic surface.
    value, slope, scale, leverage : (n, 2), (n, 2, 2), (n,), (n,) float64 arrays
        Filled: the surface at the place, its derivatives (component, by x and y), the median distance from
        it, and the variance of the value over that of one neighbour. NaN where there are fewer than two
        neighbours to a term.
    """
    terms = 3 if order == 1 else 6
    most = neighbours.shape[1]
    design = np.empty((most, terms))
    moved = np.empty((most, 2))
    residual = np.empty(most)
    work = np.empty(most)
    normal = np.empty((terms, terms))
    right = np.empty((terms, 2))
    solution = np.empty((terms, 2))
    for p in range(len(at_xy_px)):
        count = 0
        reach = 0.0
        for j in range(most):
            k = neighbours[p, j]
            x = xy_px[k, 0] - at_xy_px[p, 0]
            y = xy_px[k, 1] - at_xy_px[p, 1]
            reach = max(reach, x * x + y * y)
            if usable[p, j]:
                design[count, 1], design[count, 2] = x, y
                moved[count, 0], moved[count, 1] = displacement_px[k, 0], displacement_px[k, 1]
                count += 1
        value[p] = scale[p] = leverage[p] = np.nan
        slope[p] = np.nan
        if count < 2 * terms:
            continue
        extent = max(np.sqrt(reach), 1e-9)
        _fill_design(design[:count], extent)
        for axis in range(2):
            work[:count] = moved[:count, axis]
            solution[0, axis] = _median(work[:count])
            solution[1:, axis] = 0.0
        for round_ in range(ROUNDS + 1):
            width = np.inf  # all alike in the last round, for the leverage
            if round_ < ROUNDS:
                for j in range(count):
                    residual[j] = _distance(design[j], moved[j], solution)
                work[:count] = residual[:count]
                scale[p] = max(_median(work[:count]), LEAST_SCALE_PX)
                width = 2 * scale[p]
            _normal_equations(design[:count], moved[:count], residual[:count], width, normal, right)
            invert(normal)
            if round_ < ROUNDS:
                _multiply(normal, right, solution)
        leverage[p] = normal[0, 0]
        for axis in range(2):
            value[p, axis] = solution[0, axis]
            slope[p, axis, 0], slope[p, axis, 1] = solution[1, axis] / extent, solution[2, axis] / extent


@compiled_part()
def _fill_design(design: Float64, reach: float) -> None:
    quadratic = design.shape[1] > 3
    for j in range(len(design)):
        x, y = design[j, 1] / reach, design[j, 2] / reach
        design[j, 0], design[j, 1], design[j, 2] = 1.0, x, y
        if quadratic:
            design[j, 3], design[j, 4], design[j, 5] = x * x, x * y, y * y


@compiled_part()
def _normal_equations(
    design: Float64, moved: Float64, residual: Float64, width: float, normal: Float64, right: Float64
) -> None:
    """Fill the weighted normal equations; an infinite width weighs all neighbours alike."""
    terms = design.shape[1]
    normal[:] = 0.0
    right[:] = 0.0
    for j in range(len(design)):
        ratio = residual[j] / width
        weight = 1.0 / (1.0 + ratio * ratio)
        for a in range(terms):
            term = weight * design[j, a]
            right[a, 0] += term * moved[j, 0]
            right[a, 1] += term * moved[j, 1]
            for b in range(a, terms):
                normal[a, b] += term * design[j, b]
    ridge = RIDGE * normal[0, 0] + TINY
    for a in range(terms):
        normal[a, a] += ridge if a > 0 else TINY
        for b in range(a):
            normal[a, b] = normal[b, a]


@compiled_part()
def _multiply(matrix: Float64, right: Float64, product: Float64) -> None:
    for a in range(len(matrix)):
        for axis in range(2):
            total = 0.0
            for b in range(len(matrix)):
                total += matrix[a, b] * right[b, axis]
            product[a, axis] = total


@compiled_part()
def _distance(terms: Float64, moved: Float64, solution: Float64) -> float:
    x, y = moved[0], moved[1]
    for a in range(len(terms)):
        x -= terms[a] * solution[a, 0]
        y -= terms[a] * solution[a, 1]
    return float(np.sqrt(x * x + y * y))


@compiled_part()
def _median(values: Float64) -> float:
    """Return the median; the values are put in another order."""
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
    """Return the value of a rank; smaller ones stand before it afterwards (Hoare's selection)."""
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
