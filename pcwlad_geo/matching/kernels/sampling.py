"""The compiled sampling of a cubic B-spline on a window, with its gradient.

Windows are flat: their rows, padded to `width` numbers, follow one another, so that a stage is one long
loop without a remainder, which the compiler turns into vector code. A flat window of s rows is an array of
at least s * width numbers. The padding is finite and has weight 0 later. Indices are unsigned: signed ones
are tested for counting from the end.

A window of `step` 2 consists of every second pixel of its rows and columns, each sampled as sharply as all
of them are. The columns of its planes are sorted by phase, the even ones first (`refinement.ChannelMaps`), so
that what a loop reads lies side by side there, too.
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
Columns = tuple[np.uintp, np.uintp, np.uintp, np.uintp]

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


@compiled_part()
def _column(plane: Float32, col: int, step: int) -> int:
    """Return where a column lies in a plane whose columns are sorted by their phase."""
    # `step` is 1 or 2: shifts, as a division brings branches for signs and 0, and versions of loops for them
    halvings = step - 1
    of_a_phase: int = plane.shape[1] >> halvings
    return (col >> halvings) + (col & halvings) * of_a_phase


@compiled_part(fastmath=True)
def load_window(plane: Float32, row: int, col: int, side: int, step: int, width: int, out: Float32) -> None:
    """Copy `side` × `side` pixels of the (n, m) `plane` into the flat (side * width,) window `out`.

    The first pixel is at `row`, `col`, the others `step` apart; the padding to `width` is left unchanged.
    """
    begin = _column(plane, col, step)
    for r in range(side):
        for c in range(side):
            out[np.uintp(r * width + c)] = plane[np.uintp(row + r * step), np.uintp(begin + c)]


@compiled_part(fastmath=True, inline=True)
def _fraction(position: float) -> np.float32:
    return np.float32(position - np.floor(position))


@compiled_part(fastmath=True)
def _load_coefficients(
    plane: Float32, row: float, col: float, side: int, step: int, width: int, coefficients: Float32
) -> bool:
    """Copy the coefficients for a window whose first pixel is at row, col; False if it leaves the plane.

    Those of columns, and within them of rows, of one phase make one flat window.
    """
    top, left = int(np.floor(row)) - 1, int(np.floor(col)) - 1
    taps = _taps(side, step)
    span = step * taps
    if top < 0 or left < 0 or top + span > plane.shape[0] or left + span > plane.shape[1]:
        return False
    for k in range(step):
        for m in range(step):
            phase = coefficients[(k * step + m) * taps * width :]
            load_window(plane, top + m, left + k, taps, step, width, phase)
    return True


@compiled_part()
def _taps(side: int, step: int) -> int:
    """Return how many coefficients of one phase a window needs per axis."""
    return side + (TAPS_BEYOND >> (step - 1))


@compiled_part()
def _tap(flat: Float32, tap: int, step: int, phase: int, next_one: int) -> Float32:
    """Return what begins with a tap of the first pixel; `flat` holds `phase` numbers of each phase."""
    halvings = step - 1
    return flat[(tap & halvings) * phase + (tap >> halvings) * next_one :]


@compiled_part(fastmath=True)
def sample_shift(
    plane: Float32,
    row: float,
    col: float,
    side: int,
    step: int,
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
        Spline coefficients, the columns sorted by phase.
    row, col : float
        Array index of the first pixel of the window.
    side, step, width : int
        Pixels along a side of the window; their distance, px; numbers in a row of a flat window.
    coefficients : (step² * (side + 3) * width,) float32 array
        Scratch memory.
    along, along_slope : (step * (side + 3) * width,) float32 arrays
        Scratch memory.
    value, slope_x, slope_y : (side * width,) float32 arrays
        Filled with the values and their derivatives by column and row, per px.
    """
    if not _load_coefficients(plane, row, col, side, step, width, coefficients):
        return False
    phase = _taps(side, step) * width
    _across(coefficients, step, _fraction(col), step * phase, along, along_slope)
    _down(along, along_slope, step, _fraction(row), phase, width, side * width, value, slope_x, slope_y)
    return True


@compiled_part(fastmath=True)
def _across(
    coefficients: Float32, step: int, t: np.float32, n: int, along: Float32, along_slope: Float32
) -> None:
    """Interpolate along the rows: value and derivative."""
    w0, w1, w2, w3 = _spline(t)
    d0, d1, d2, d3 = _spline_slope(t)
    first, second = _tap(coefficients, 0, step, n, 1), _tap(coefficients, 1, step, n, 1)
    third, fourth = _tap(coefficients, 2, step, n, 1), _tap(coefficients, 3, step, n, 1)
    for i in range(n):
        a0, a1, a2, a3 = first[i], second[i], third[i], fourth[i]
        along[i] = w0 * a0 + w1 * a1 + w2 * a2 + w3 * a3
        along_slope[i] = d0 * a0 + d1 * a1 + d2 * a2 + d3 * a3


@compiled_part(fastmath=True)
def _down(
    along: Float32,
    along_slope: Float32,
    step: int,
    t: np.float32,
    phase: int,
    width: int,
    n: int,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
) -> None:
    """Interpolate the results of `_across` along the columns."""
    w0, w1, w2, w3 = _spline(t)
    d0, d1, d2, d3 = _spline_slope(t)
    first, second = _tap(along, 0, step, phase, width), _tap(along, 1, step, phase, width)
    third, fourth = _tap(along, 2, step, phase, width), _tap(along, 3, step, phase, width)
    slope_1, slope_2 = _tap(along_slope, 0, step, phase, width), _tap(along_slope, 1, step, phase, width)
    slope_3, slope_4 = _tap(along_slope, 2, step, phase, width), _tap(along_slope, 3, step, phase, width)
    for i in range(n):
        a0, a1, a2, a3 = first[i], second[i], third[i], fourth[i]
        value[i] = w0 * a0 + w1 * a1 + w2 * a2 + w3 * a3
        slope_y[i] = d0 * a0 + d1 * a1 + d2 * a2 + d3 * a3
        slope_x[i] = w0 * slope_1[i] + w1 * slope_2[i] + w2 * slope_3[i] + w3 * slope_4[i]


@compiled_part(fastmath=True)
def sample_deformed(
    plane: Float32,
    row: float,
    col: float,
    linear: Float64,
    side: int,
    step: int,
    width: int,
    steps: Float32,
    value: Float32,
    slope_x: Float32,
    slope_y: Float32,
) -> bool:
    """Sample a spline and its gradient on a deformed window; return False if the window leaves the plane.

    Along a row of the window the four by four coefficients advance by `step` columns per pixel, except in a
    few places: each run between two of them is one loop.

    Parameters
    ----------
    plane : (n, m) float32 array
        Spline coefficients, the columns sorted by phase.
    row, col : float
        Array index of the centre of the window.
    linear : (2, 2) array
        Deformation (component, by x and y), px per px.
    side, step, width : int
        See `sample_shift`.
    steps : (width,) float32 array
        0, 1, 2, …
    value, slope_x, slope_y : (side * width,) float32 arrays
        Filled with the values and their derivatives by column and row, per px.
    """
    half = side // 2
    x_by_x, y_by_x = step * linear[0, 0], step * linear[1, 0]
    x_edge, x_pace, y_edge, y_pace = *_edge_and_pace(x_by_x), *_edge_and_pace(y_by_x)
    for r in range(side):
        x0 = col - half * (step + x_by_x) + (r - half) * step * linear[0, 1]
        y0 = row - half * y_by_x + (r - half) * step * (1.0 + linear[1, 1])
        c = 0
        while c < side:
            x, y = x0 + c * (step + x_by_x), y0 + c * y_by_x
            row0, col0 = int(np.floor(y)), int(np.floor(x))
            run = min(side - c, _run(x - col0, x_edge, x_pace), _run(y - row0, y_edge, y_pace))
            last = col0 + step * (run - 1)
            if row0 < 1 or col0 < 1 or row0 + 3 > plane.shape[0] or last + 3 > plane.shape[1]:
                return False
            first, second = _column(plane, col0 - 1, step), _column(plane, col0, step)
            third, fourth = _column(plane, col0 + 1, step), _column(plane, col0 + 2, step)
            # whole vectors where the plane is wide enough: the excess is overwritten by the next run
            vectors = min(-(-run // LANES) * LANES, plane.shape[1] - max(third, fourth))
            begin = r * width + c
            _sample_run(
                plane,
                row0 - 1,
                (np.uintp(first), np.uintp(second), np.uintp(third), np.uintp(fourth)),
                np.float32(x - col0),
                np.float32(y - row0),
                np.float32(x_by_x),
                np.float32(y_by_x),
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
def _edge_and_pace(step: float) -> tuple[float, float]:
    """Return which end of 0 to 1 a fraction moves towards, and how fast; a step of 0 counts as a tiny one.

    Told once for a window: a branch in its loops would have them compiled in a version for each sign.
    """
    return (0.0 if step < 0.0 else 1.0), (1e-300 if step == 0.0 else step)


@compiled_part()
def _run(t: float, edge: float, step: float) -> int:
    """Return how many fractions t, t + step, t + 2 · step, … lie within 0 to 1."""
    return int(min((edge - t) / step, 1e6)) + 1


@compiled_part(fastmath=True)
def _sample_run(
    plane: Float32,
    row: int,
    columns: Columns,
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
    """Sample pixels whose coefficients begin at a row and four columns, and advance by one number a pixel."""
    first, second, third, fourth = np.uintp(row), np.uintp(row + 1), np.uintp(row + 2), np.uintp(row + 3)
    for i in range(run):
        x, y = tx + steps[i] * step_x, ty + steps[i] * step_y
        w, d = _spline(x), _spline_slope(x)
        v0, s0 = _interpolate(plane, first, columns, np.uintp(i), w, d)
        v1, s1 = _interpolate(plane, second, columns, np.uintp(i), w, d)
        v2, s2 = _interpolate(plane, third, columns, np.uintp(i), w, d)
        v3, s3 = _interpolate(plane, fourth, columns, np.uintp(i), w, d)
        w, d = _spline(y), _spline_slope(y)
        out = np.uintp(begin + i)
        value[out] = w[0] * v0 + w[1] * v1 + w[2] * v2 + w[3] * v3
        slope_x[out] = w[0] * s0 + w[1] * s1 + w[2] * s2 + w[3] * s3
        slope_y[out] = d[0] * v0 + d[1] * v1 + d[2] * v2 + d[3] * v3


@compiled_part(fastmath=True, inline=True)
def _interpolate(
    plane: Float32, row: np.uintp, columns: Columns, i: np.uintp, weights: Taps, slopes: Taps
) -> tuple[np.float32, np.float32]:
    """Return value and derivative along a row of coefficients."""
    a0, a1 = plane[row, columns[0] + i], plane[row, columns[1] + i]
    a2, a3 = plane[row, columns[2] + i], plane[row, columns[3] + i]
    value = weights[0] * a0 + weights[1] * a1 + weights[2] * a2 + weights[3] * a3
    slope = slopes[0] * a0 + slopes[1] * a1 + slopes[2] * a2 + slopes[3] * a3
    return value, slope
