"""Sub-pixel refinement of matches on maps that are interpolated by a cubic B-spline.

References
----------
.. [1] Unser, M. (1999), Splines: a perfect fit for signal and image processing, doi:10.1109/79.799930.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from pcwlad_geo.matching.kernels import steps as state
from pcwlad_geo.matching.kernels.refinement import PARTS, refine_points
from pcwlad_geo.types import Bool, Float32, Float64, Index

POLE: Final = float(np.sqrt(3.0)) - 2.0
"""Pole of the prefilter of the cubic B-spline [1]_."""
REACH_PX: Final = 12
"""Half length of the prefilter's kernel: its response falls to 1e-7 of the peak within this distance."""


def spline_coefficients(image: Float32, out: Float32) -> None:
    """Prefilter an image for cubic B-spline interpolation [1]_, mirrored about its outermost pixels.

    Parameters
    ----------
    image : (rows, cols) float32 array
        Finite values.
    out : (rows, cols) float32 array
        Filled with what `scipy.ndimage.spline_filter` returns, to 1e-6 of its range.

    Notes
    -----
    The recursive filter, truncated at the precision of float32, is a short symmetric kernel, which is several
    times as fast.
    """
    kernel = POLE ** np.abs(np.arange(-REACH_PX, REACH_PX + 1))
    kernel /= kernel.sum()
    cv2.sepFilter2D(image, -1, kernel, kernel, dst=out, borderType=cv2.BORDER_REFLECT_101)


TOLERANCE_PX: Final = 0.004
"""The iteration ends when the next move is expected to be shorter than this."""
REACHED_BY_PX: Final = 0.05
"""A start that is already a match counts as reached by a move of this length."""
RELAXATION_ROBUST: Final = 1.4
"""Factor on the first step where weights follow the residual, as a plain step falls short by a third."""
RELAXATION_STRUCTURE: Final = 1.4
"""Further factor on the first step where the mutual structure follows the position."""
LARGEST_MOVE_PX: Final = 3.0
"""Points that move further than this from their start are dropped."""
WINDOW_PER_CORRELATION_SIDE: Final = 12
"""Side of the refinement window over the side of the window of the local correlation."""
HALVING: Final = np.array([-1.0, 4.0, 10.0, 4.0, -1.0]) / 16
"""Filter along rows and columns before every second pixel is left out; symmetric, so that nothing moves."""
BLOCK_PX: Final = 16
"""Side of the blocks whose scores are taken as independent in the covariance."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelMaps:
    """Maps of one image, with the spline coefficients that interpolate them."""

    maps: Float32
    """(channels, rows, cols)."""
    coefficients: Float32
    """(channels, rows, cols) cubic B-spline coefficients of the maps."""
    valid: Bool
    """(rows, cols) pixels that count."""

    @staticmethod
    def of(maps: Float32, valid: Bool) -> ChannelMaps:
        """Prefilter the (channels, rows, cols) `maps` with their (rows, cols) mask `valid`."""
        coefficients = np.empty_like(maps)
        for plane, out in zip(maps, coefficients, strict=True):
            spline_coefficients(plane, out)
        return ChannelMaps(maps, coefficients, valid)

    def half(self) -> ChannelMaps:
        """Return every second pixel of the maps, smoothed before, the first included."""
        smooth = [cv2.sepFilter2D(plane, -1, HALVING, HALVING)[::2, ::2] for plane in self.maps]
        return ChannelMaps.of(np.stack(smooth), np.ascontiguousarray(self.valid[::2, ::2]))


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Sub-pixel positions of n points."""

    shift_xy_px: Float64
    """(n, 2) target minus reference index, (col, row)."""
    linear: Float64
    """(n, 2, 2) deformation of the window: target offset = (1 + linear) · reference offset."""
    covariance_px2: Float64
    """(n, 2, 2) sandwich covariance of the shift from block scores, before calibration."""
    converged: Bool
    """(n,) whether the iteration converged."""


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where the refinement of n points begins."""

    shift_xy_px: Float64
    """(n, 2) target minus reference index, (col, row)."""
    linear: Float64
    """(n, 2, 2) deformation of the window."""
    structure_xy_px: Float64 | None = None
    """(n, 2) shift at which the mutual structure is taken; None: wherever the iteration is."""
    structure: Float32 | None = None
    """(n, window, window) mutual structure computed beforehand, 0 to 1; None: computed here."""
    is_match: bool = False
    """Whether the shifts were refined before, from nearly the same pixels: one short move confirms them.

    This does not hold where the structure follows the position: there many short moves may follow.
    """

    @property
    def reached_by_px(self) -> float:
        """Length of the move that led to the start."""
        return REACHED_BY_PX if self.is_match else np.inf


def refine(
    reference: ChannelMaps,
    target: ChannelMaps,
    corners_rc: Index,
    start: Start,
    *,
    window_px: int,
    use_structure: bool = True,
    robust: bool = True,
    affine: bool = False,
    iterations: int = 20,
    least_valid: float = 0.6,
) -> Refined:
    """Refine the match of every corner.

    Parameters
    ----------
    reference, target : ChannelMaps
        Maps of both images.
    corners_rc : (n, 2) intp array
        Row, column of the window centres in the reference.
    start : Start
        Initial shifts and deformations.
    window_px : int
        Side of the window, odd.
    use_structure : bool
        Whether to weight by mutual structure.
    robust : bool
        Whether to weight by the residual (paper, eq. 9); plain least squares otherwise.
    affine : bool
        Whether to estimate the deformation of every window; it is kept as given otherwise.
    iterations : int
        Largest number of Gauss-Newton steps.
    least_valid : float
        Least share of the window that must be valid in both images.
    """
    n = len(corners_rc)
    results = state.Results(np.zeros((n, 2)), np.zeros((n, 2, 2)), np.zeros((n, 2, 2)), np.zeros(n, np.int64))
    structure_mode = _structure_mode(start, use_structure)
    options = state.Options(
        half=window_px // 2,
        correlation_half=correlation_half_px(window_px),
        width=state.flat_width(2 * (window_px // 2 + correlation_half_px(window_px)) + 1),
        structure_mode=structure_mode,
        robust=robust,
        affine=affine,
        iterations=iterations,
        reached_by_px=start.reached_by_px,
        tolerance_px=TOLERANCE_PX,
        relaxation=first_relaxation(robust, structure_mode == state.STRUCTURE_FOLLOWS),
        least_valid=float(least_valid),
        largest_move_px=LARGEST_MOVE_PX,
        blocks=max(4, round(window_px / BLOCK_PX)),
    )
    # one array type, so that the loop is compiled once: a read-only array is another type
    images = state.Images(
        np.require(reference.maps, np.float32, ("C", "W")),
        np.require(target.coefficients, np.float32, ("C", "W")),
        np.require(reference.valid, np.bool_, ("C", "W")),
        np.require(target.valid, np.bool_, ("C", "W")),
    )
    work = state.make_workspace(len(reference.maps), options)
    refine_points(images, _starts(corners_rc, start), options, work, results, PARTS)
    return Refined(results.shift_xy, results.linear, results.covariance, results.status == state.CONVERGED)


def _starts(corners_rc: Index, start: Start) -> state.Starts:
    """Return the start in the types that the compiled loop takes."""
    unused = np.zeros((len(corners_rc), 2)), np.zeros((1, 1, 1), np.float32)
    return state.Starts(
        corners_rc.astype(np.int64),
        np.ascontiguousarray(start.shift_xy_px, np.float64),
        np.ascontiguousarray(start.linear, np.float64),
        unused[0]
        if start.structure_xy_px is None
        else np.ascontiguousarray(start.structure_xy_px, np.float64),
        unused[1] if start.structure is None else start.structure,
    )


def correlation_half_px(window_px: int) -> int:
    """Return the half side of the local correlation window: 3 (7 × 7) at 81, 5 (11 × 11) at 129."""
    return max(1, round(window_px / WINDOW_PER_CORRELATION_SIDE - 0.5) // 2)


def first_relaxation(robust: bool, structure_follows: bool) -> float:
    """Return the factor on the first step for `robust` weights and where `structure_follows` the shift."""
    return (RELAXATION_ROBUST if robust else 1.0) * (RELAXATION_STRUCTURE if structure_follows else 1.0)


def _structure_mode(start: Start, use_structure: bool) -> int:
    if start.structure is not None:
        return state.STRUCTURE_GIVEN
    if not use_structure:
        return state.STRUCTURE_NONE
    return state.STRUCTURE_FOLLOWS if start.structure_xy_px is None else state.STRUCTURE_FIXED
