"""The one resampling of a frame, by positions computed exactly on a lattice."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from pcwlad_geo.matching.kernels.library import POINTER, WHOLE, address, function
from pcwlad_geo.matching.refinement import spline_coefficients
from pcwlad_geo.types import Float32, Float64

MAP_STEP_PX: Final = 8
"""Spacing of the exact positions of a warp; between them it is linear, to about 0.002 px."""


def coefficients_of(values: Float32) -> Float32:
    """Return the (rows, cols) coefficients of the cubic B-spline through (rows, cols) `values`."""
    out = np.empty_like(values)
    spline_coefficients(values, out)
    return out


def measured_side(shape: tuple[int, int]) -> int:
    """Return the longer side to which frames of a `shape` are reduced for matching, px.

    Frames of many px are averaged by two: their finest detail shows the asymmetric blur of the lens more than
    the ground, and is displaced by up to 0.1 px.
    """
    side = max(shape)
    return round(min(side, 1300, max(640, side / 2)))


def map_places(shape: tuple[int, int], origin: tuple[float, float], step_px: float) -> Float64:
    """Return the (n, 2) places (col, row) where a warp is computed exactly, in the order of its rows.

    `shape` is that of the output, `origin` the column and row of its top-left corner in the plane of the
    places, and `step_px` the size of its px in that plane.
    """
    row, col = (np.arange(count) * MAP_STEP_PX + 0.5 for count in map_shape(shape))
    cols, rows = np.meshgrid(origin[0] + step_px * col, origin[1] + step_px * row)
    return np.column_stack([cols.ravel(), rows.ravel()])


def map_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the numbers of rows and columns of `map_places` for an output of a `shape`."""
    return math.ceil(shape[0] / MAP_STEP_PX) + 1, math.ceil(shape[1] / MAP_STEP_PX) + 1


def resampled(values: Float32, lens_px: Float64, shape: tuple[int, int], reduction: float = 1.0) -> Float32:
    """Return a frame resampled once to a `shape`, by a cubic B-spline; NaN outside the frame.

    Given are its (rows, cols) `values`, and the (n, 2) px, `lens_px`, at the places of `map_places`. The
    frame is averaged first where the output is distinctly coarser: `reduction` is how many of its px one px
    of the output spans.
    """
    if reduction > 1.2:
        rows, cols = (max(16, round(n / reduction)) for n in values.shape)
        lens_px = lens_px * (np.array([cols, rows]) / np.array(values.shape[::-1]))
        values = np.asarray(cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)
    grid = np.nan_to_num(lens_px, nan=-1e9).reshape(*map_shape(shape), 2)
    out = np.empty(shape, np.float32)
    resample(coefficients_of(values), grid, MAP_STEP_PX, out)
    return out


def resample(coefficients: Float32, grid: Float64, step: int, out: Float32) -> None:
    """Evaluate the spline of (rows, cols) float32 `coefficients` and fill the float32 image `out`.

    The (n, m, 2) float64 `grid` holds the places (col, row) of every `step`-th pixel of its rows and columns,
    and of one beyond the last; between these it is interpolated linearly. Outside the frame `out` is NaN.
    """
    function("resample", POINTER, *2 * [WHOLE], POINTER, *4 * [WHOLE], POINTER)(
        address(coefficients, np.float32),
        *coefficients.shape,
        address(grid, np.float64),
        grid.shape[1],
        step,
        *out.shape,
        address(out, np.float32),
    )
