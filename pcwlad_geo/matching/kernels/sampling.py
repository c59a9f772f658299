"""The compiled sampling of a cubic B-spline on a window, with its gradient.

Windows are flat: their rows, padded to `width` numbers, follow one another, so that a stage is one long
loop without a remainder, which the compiler turns into vector code. A flat window of s rows is an array of
at least s * width numbers. The padding is finite and has weight 0 later. Indices are unsigned: signed ones
are tested for counting from the end.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from pcwlad_geo.matching.kernels.compiled import compiled_part
from pcwlad_geo.types import Float32, Float64

LANES: Final = 16
"""Number of float32 values in the widest vectors of current processors."""
TAPS_BEYOND: Final = 3
"""Number of spline coefficients that a window needs beyond its side, per axis."""

Taps = tuple[np.float32, np.float32, np.float32, np.float32]

_NEXT: Final = np.uintp(1)
_ONE: Final = np.float32(1.0)
_TWO: Final = np.float32(2.0)
_THREE: Final = np.float32(3.0)
_FOUR: Final = np.float32(4.0)
_HALF: Final = np.float32(0.5)
_SIXTH: Final = np.float32(1.0 / 6.0)
_TWO_THIRDS: Final = np.float32(2.0 / 3.0)


@compiled_part(fastmath=True, inline=True)
def _spline(t: np.float32) -> Taps:
    """Return the four weights of the cubic B-spline at fraction t."""
    s = _ONE - t
    return (
        s * s * s * _SIXTH,
        _TWO_THIRDS - t * t * (_TWO - t) * _HALF,
        _TWO_THIRDS - s * s * (_TWO - s) * _HALF,
        t * t * t * _SIXTH,
    )


@compiled_part(fastmath=True, inline=True)
def _spline_slope(t: np.float32) -> Taps:
    """Return the four weights of the spline's derivative at fraction t."""
    s = _ONE - t
    return (
        -s * s * _HALF,
        t * (_THREE * t - _FOUR) * _HALF,
        -s * (_THREE * s - _FOUR) * _HALF,
        t * t * _HALF,
    )


@compiled_part(fastmath=True)
def load_window(plane: Float32, row: int, col: int, rows: int, cols: int, width: int, out: Float32) -> None:
    """Copy `rows` × `cols` pixels of the (n, m) `plane` into the flat (rows * width,) window `out`.

    The first pixel is at `row`, `col`; the padding to `width` is left unchanged.
    """
    for r in range(rows):
        for c in range(cols):
            out[np.uintp(r * width + c)] = plane[np.uintp(row + r), np.uintp(col + c)]


@compiled_part(fastmath=True, inline=True)
def _fraction(position: float) -> np.float32:
    return np.float32(position - np.floor(position))


@compiled_part(fastmath=True)
def _load_coefficients(
    plane: Float32, row: float, col: float, side: int, width: int, coefficients: Float32
) -> bool:
    """Copy the coefficients for a window whose first pixel is at row, col; False if it leaves the plane."""
    top, left = int(np.floor(row)) - 1, int(np.floor(col)) - 1
    taps = side + TAPS_BEYOND
    if top < 0 or left < 0 or top + taps > plane.shape[0] or left + taps > plane.shape[1]:
        return False
    load_window(plane, top, left, taps, taps, width, coefficients)
    return True


@compiled_part(fastmath=True)
def sample_shift(
    plane: Float32,
    row: float,
    col: float,
    side: int,
    width: int,
    coefficients: Float32,
    along: Float32,
    along_slope: Float32,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
) -> bool:
    """Sample a spline and its gradient on a shifted window; return False if the window leaves the plane.

    Parameters
    ----------
    plane : (n, m) float32 array
        Spline coefficients.
    row, col : float
        Array index of the first pixel of the window.
    side, width : int
        Side of the window; numbers in a row of a flat window.
    coefficients, along, along_slope : ((side + 3) * width,) float32 arrays
        Scratch memory.
    value, slope_x, slope_y : (side * width,) float32 arrays
        Filled with the values and their derivatives by column and row, per px.
    """
    if not _load_coefficients(plane, row, col, side, width, coefficients):
        return False
    n = (side + TAPS_BEYOND) * width
    _across(coefficients, _fraction(col), n, along, along_slope)
    _down(along, along_slope, _fraction(row), width, side * width, value, slope_x, slope_y)
    return True


@compiled_part(fastmath=True)
def sample_values(
    plane: Float32,
    row: float,
    col: float,
    side: int,
    width: int,
    coefficients: Float32,
    along: Float32,
    value: Float32,
) -> bool:
    """Sample a spline on a shifted window, as `sample_shift` does, without the gradient.

    Parameters
    ----------
    plane : (n, m) float32 array
        Spline coefficients.
    row, col, side, width
        See `sample_shift`.
    coefficients, along : ((side + 3) * width,) float32 arrays
        Scratch memory.
    value : (side * width,) float32 array
        Filled with the values.
    """
    if not _load_coefficients(plane, row, col, side, width, coefficients):
        return False
    w0, w1, w2, w3 = _spline(_fraction(col))
    for i in range((side + TAPS_BEYOND) * width):
        a0, a1, a2, a3 = coefficients[i], coefficients[i + 1], coefficients[i + 2], coefficients[i + 3]
        along[i] = w0 * a0 + w1 * a1 + w2 * a2 + w3 * a3
    w0, w1, w2, w3 = _spline(_fraction(row))
    along_1, along_2, along_3 = along[width:], along[2 * width :], along[3 * width :]
    for i in range(side * width):
        value[i] = w0 * along[i] + w1 * along_1[i] + w2 * along_2[i] + w3 * along_3[i]
    return True


@compiled_part(fastmath=True)
def _across(coefficients: Float32, t: np.float32, n: int, along: Float32, along_slope: Float32) -> None:
    """Interpolate along the rows: value and derivative."""
    w0, w1, w2, w3 = _spline(t)
    d0, d1, d2, d3 = _spline_slope(t)
    for i in range(n):
        a0, a1, a2, a3 = coefficients[i], coefficients[i + 1], coefficients[i + 2], coefficients[i + 3]
        along[i] = w0 * a0 + w1 * a1 + w2 * a2 + w3 * a3
        along_slope[i] = d0 * a0 + d1 * a1 + d2 * a2 + d3 * a3


@compiled_part(fastmath=True)
def _down(
    along: Float32,
    along_slope: Float32,
    t: np.float32,
    width: int,
    n: int,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
) -> None:
    """Interpolate the results of `_across` along the columns."""
    w0, w1, w2, w3 = _spline(t)
    d0, d1, d2, d3 = _spline_slope(t)
    along_1, along_2, along_3 = along[width:], along[2 * width :], along[3 * width :]
    slope_1, slope_2, slope_3 = along_slope[width:], along_slope[2 * width :], along_slope[3 * width :]
    for i in range(n):
        a0, a1, a2, a3 = along[i], along_1[i], along_2[i], along_3[i]
        value[i] = w0 * a0 + w1 * a1 + w2 * a2 + w3 * a3
        slope_y[i] = d0 * a0 + d1 * a1 + d2 * a2 + d3 * a3
        slope_x[i] = w0 * along_slope[i] + w1 * slope_1[i] + w2 * slope_2[i] + w3 * slope_3[i]


@compiled_part(fastmath=True)
def sample_deformed(
    plane: Float32,
    row: float,
    col: float,
    linear: Float64,
    side: int,
    width: int,
    steps: Float32,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
) -> bool:
    """Sample a spline and its gradient on a deformed window; return False if the window leaves the plane.

    Along a row of the window the four by four coefficients advance by one column per pixel, except in a few
    places: each run between two of them is one loop.

    Parameters
    ----------
    plane : (n, m) float32 array
        Spline coefficients.
    row, col : float
        Array index of the centre of the window.
    linear : (2, 2) array
        Deformation (component, by x and y), px per px.
    side, width : int
        Side of the window; numbers in a row of a flat window.
    steps : (width,) float32 array
        0, 1, 2, …
    value, slope_x, slope_y : (side * width,) float32 arrays
        Filled with the values and their derivatives by column and row, per px.
    """
    half = side // 2
    for r in range(side):
        x0 = col - half * (1.0 + linear[0, 0]) + (r - half) * linear[0, 1]
        y0 = row - half * linear[1, 0] + (r - half) * (1.0 + linear[1, 1])
        c = 0
        while c < side:
            x, y = x0 + c * (1.0 + linear[0, 0]), y0 + c * linear[1, 0]
            row0, col0 = int(np.floor(y)), int(np.floor(x))
            run = min(side - c, _run(x - col0, linear[0, 0]), _run(y - row0, linear[1, 0]))
            if row0 < 1 or col0 < 1 or row0 + 3 > plane.shape[0] or col0 + run + 2 > plane.shape[1]:
                return False
            # whole vectors where the plane is wide enough: the excess is overwritten by the next run
            vectors = min(-(-run // LANES) * LANES, plane.shape[1] - 2 - col0)
            begin = r * width + c
            _sample_run(
                plane,
                row0 - 1,
                col0 - 1,
                np.float32(x - col0),
                np.float32(y - row0),
                np.float32(linear[0, 0]),
                np.float32(linear[1, 0]),
                max(run, vectors),
                steps,
                begin,
                value,
                slope_x,
                slope_y,
            )
            c += run
    return True


@compiled_part()
def _run(t: float, step: float) -> int:
    """Return how many fractions t, t + step, t + 2 · step, … lie within 0 to 1."""
    if step > 0.0:
        return int(min((1.0 - t) / step, 1e6)) + 1
    if step < 0.0:
        return int(min(-t / step, 1e6)) + 1
    return 1000000


@compiled_part(fastmath=True)
def _sample_run(
    plane: Float32,
    row: int,
    col: int,
    tx: np.float32,
    ty: np.float32,
    step_x: np.float32,
    step_y: np.float32,
    run: int,
    steps: Float32,
    begin: int,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
) -> None:
    """Sample pixels whose coefficients begin at row, col and advance by one column per pixel."""
    first, second, third, fourth = np.uintp(row), np.uintp(row + 1), np.uintp(row + 2), np.uintp(row + 3)
    for i in range(run):
        x, y = tx + steps[i] * step_x, ty + steps[i] * step_y
        w, d = _spline(x), _spline_slope(x)
        v0, s0 = _interpolate(plane, first, np.uintp(col + i), w, d)
        v1, s1 = _interpolate(plane, second, np.uintp(col + i), w, d)
        v2, s2 = _interpolate(plane, third, np.uintp(col + i), w, d)
        v3, s3 = _interpolate(plane, fourth, np.uintp(col + i), w, d)
        w, d = _spline(y), _spline_slope(y)
        out = np.uintp(begin + i)
        value[out] = w[0] * v0 + w[1] * v1 + w[2] * v2 + w[3] * v3
        slope_x[out] = w[0] * s0 + w[1] * s1 + w[2] * s2 + w[3] * s3
        slope_y[out] = d[0] * v0 + d[1] * v1 + d[2] * v2 + d[3] * v3


@compiled_part(fastmath=True, inline=True)
def _interpolate(
    plane: Float32, row: np.uintp, col: np.uintp, weights: Taps, slopes: Taps
) -> tuple[np.float32, np.float32]:
    """Return value and derivative along a row of coefficients."""
    a0, a1 = plane[row, col], plane[row, col + _NEXT]
    a2, a3 = plane[row, col + _NEXT + _NEXT], plane[row, col + _NEXT + _NEXT + _NEXT]
    value = weights[0] * a0 + weights[1] * a1 + weights[2] * a2 + weights[3] * a3
    slope = slopes[0] * a0 + slopes[1] * a1 + slopes[2] * a2 + slopes[3] * a3
    return value, slope
