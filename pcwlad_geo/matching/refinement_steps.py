"""The compiled steps of the refinement: from normal equations to moves of the right length, and covariance.

The weights follow the position, so the step that the equations ask for falls short by a factor that hardly
changes on the way but differs between windows: each move shows it to the next one, axis by axis.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from pcwlad_geo.matching.compiled import compiled_part
from pcwlad_geo.matching.refinement_sampling import Float64

LONGEST_STEP_PX: Final = 1.0
LARGEST_RELAXATION: Final = 20.0
"""No move is longer than this many plain steps."""
LEAST_SLOPE: Final = 0.08
"""Where plain steps shrink more slowly on the way, the weights follow the window wherever it goes."""
PATIENCE: Final = 6
"""Evaluations after which a window is given up whose slope is below half of that."""


@compiled_part()
def invert(matrix: Float64) -> bool:
    """Invert a positive definite matrix in place (Gauss-Jordan; no pivoting needed); False if it is not."""
    n = matrix.shape[0]
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > 0.0:
            return False
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] /= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]
    return True


@compiled_part(inline=True)
def plain_step(inverse: Float64, right: Float64, half: int, step: Float64, linear: Float64) -> None:
    """Fill the shift's plain step; the deformation moves in place."""
    count = len(right) // 2
    for axis in range(2):
        step[axis] = _dot(inverse[axis * count], right)
        for k in range(1, count):
            linear[axis, k - 1] += _dot(inverse[axis * count + k], right) / half


@compiled_part(inline=True)
def learn_slopes(step: Float64, before: Float64, moved: Float64, first: bool, slopes: Float64) -> None:
    """Correct how much the plain step shrinks on the way by what the last move has shown (Broyden's update).

    `slopes` is minus the derivative of the plain step by the shift, (2, 2). The first move tells it for all
    directions alike, later ones for their own.
    """
    length2 = moved[0] ** 2 + moved[1] ** 2
    if length2 == 0.0:
        return
    if first:
        slope = ((before[0] - step[0]) * moved[0] + (before[1] - step[1]) * moved[1]) / length2
        slopes[0, 0] = slopes[1, 1] = min(max(slope, 1.0 / LARGEST_RELAXATION), 1.0)
    for axis in range(2):
        error = before[axis] - step[axis] - slopes[axis, 0] * moved[0] - slopes[axis, 1] * moved[1]
        slopes[axis, 0] += error * moved[0] / length2
        slopes[axis, 1] += error * moved[1] / length2


@compiled_part(inline=True)
def move(step: Float64, slopes: Float64, moved: Float64, shift: Float64) -> float:
    """Move the shift in place to where no step is left; returns the length before the move is limited."""
    determinant = slopes[0, 0] * slopes[1, 1] - slopes[0, 1] * slopes[1, 0]
    x, y = step[0], step[1]
    if determinant > 0.0:
        x = (slopes[1, 1] * step[0] - slopes[0, 1] * step[1]) / determinant
        y = (slopes[0, 0] * step[1] - slopes[1, 0] * step[0]) / determinant
    if x * step[0] + y * step[1] <= 0.0:
        x, y = step[0], step[1]
    length = float(np.hypot(x, y))
    longest = LARGEST_RELAXATION * float(np.hypot(step[0], step[1]))
    if length > longest:
        x, y, length = x * longest / length, y * longest / length, longest
    limit = max(length / LONGEST_STEP_PX, 1.0)
    moved[0], moved[1] = x / limit, y / limit
    shift[0] += moved[0]
    shift[1] += moved[1]
    return length


@compiled_part()
def is_determined(slopes: Float64, least: float) -> bool:
    """Tell whether plain steps shrink in every direction: the smaller eigenvalue of the symmetric part."""
    mean, half_difference = (slopes[0, 0] + slopes[1, 1]) / 2.0, (slopes[0, 0] - slopes[1, 1]) / 2.0
    smaller = mean - np.hypot(half_difference, (slopes[0, 1] + slopes[1, 0]) / 2.0)
    return bool(smaller >= least)


@compiled_part()
def _dot(first: Float64, second: Float64) -> float:
    total = 0.0
    for k in range(len(first)):
        total += first[k] * second[k]
    return total


@compiled_part()
def sandwich(inverse: Float64, scores: Float64, covariance: Float64) -> None:
    """Fill the covariance of the shift: the scatter of the blocks' scores between two inverse matrices."""
    other = inverse.shape[0] // 2
    covariance[:] = 0.0
    for block in range(scores.shape[0]):
        x = inverse[0, 0] * scores[block, 0] + inverse[0, other] * scores[block, 1]
        y = inverse[other, 0] * scores[block, 0] + inverse[other, other] * scores[block, 1]
        covariance[0, 0] += x * x
        covariance[0, 1] += x * y
        covariance[1, 0] += x * y
        covariance[1, 1] += y * y
