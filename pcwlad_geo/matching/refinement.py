"""Sub-pixel refinement: weighted least absolute deviation with mutual-structure weights.

The model of a channel is G = h0 + h1 · I(x + shift), with I the target's map on a cubic B-spline;
all channels share one shift and their normal equations are added, each over its residual variance.
The weights are MS / (1 + |residual| / σ) (eq. 9 of the PCWLAD paper), MS being the squared positive
local correlation at the current sub-pixel position: where both maps hold the same structure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching import refinement_state as state
from pcwlad_geo.matching.refinement_loop import refine_points
from pcwlad_geo.matching.spline import spline_coefficients

TOLERANCE_PX: Final = 0.004
"""The move that would follow the last one is expected to be shorter."""
REACHED_BY_PX: Final = 0.05
"""A start that is a match already counts as reached by a move of this length."""
RELAXATION_ROBUST: Final = 1.4
"""The weights follow the residual, so a plain step falls short by a third; the first is made longer."""
RELAXATION_STRUCTURE: Final = 1.4
"""The same once more where the structure follows the position."""
LARGEST_MOVE_PX: Final = 3.0
WINDOW_PER_CORRELATION_SIDE: Final = 12
BLOCK_PX: Final = 16
"""Side of the blocks whose scores are taken as independent in the covariance."""

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class ChannelStack:
    """Maps of one image, with the spline coefficients that interpolate them."""

    maps: Float32
    """(channels, rows, cols)."""
    coefficients: Float32
    """(channels, rows, cols) cubic B-spline coefficients of the maps."""
    valid: NDArray[np.bool_]
    """(rows, cols) pixels that count."""

    @staticmethod
    def of(maps: Float32, valid: NDArray[np.bool_]) -> ChannelStack:
        """Prefilter the maps for interpolation."""
        coefficients = np.empty_like(maps)
        for plane, out in zip(maps, coefficients, strict=True):
            spline_coefficients(plane, out)
        return ChannelStack(maps, coefficients, valid)


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Sub-pixel positions of n points."""

    shift_xy_px: Float64
    """(n, 2) target minus reference index, (col, row)."""
    linear: Float64
    """(n, 2, 2) deformation of the window: target offset = (1 + linear) · reference offset."""
    covariance_px2: Float64
    """(n, 2, 2) sandwich covariance of the shift from block scores, before calibration."""
    converged: NDArray[np.bool_]
    """(n,)."""


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
    """(n, window, window) mutual structure given from outside."""
    is_match: bool = False
    """The shifts were refined before, from nearly the same pixels: one short move confirms them.

    Not where the structure follows the position: there a short move may be the first of many.
    """

    @property
    def reached_by_px(self) -> float:
        """Return the length of the move that has led here."""
        return REACHED_BY_PX if self.is_match else np.inf


def refine(
    reference: ChannelStack,
    target: ChannelStack,
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
    reference, target : ChannelStack
        Maps of both images.
    corners_rc : (n, 2) intp array
        Row, column of the window centres in the reference.
    start : Start
        Initial shifts and deformations.
    window_px : int
        Side of the window, odd.
    use_structure : bool
        Weight by mutual structure.
    robust : bool
        Weight by the residual (eq. 9); plain least squares otherwise.
    affine : bool
        Also estimate the deformation of every window; kept as given otherwise.
    iterations : int
        Most Gauss-Newton steps.
    least_valid : float
        Least share of the window that is valid in both images.

    Returns
    -------
    Refined
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
    # one kind of array, so that the loop is compiled once: a read-only one would be another
    images = state.Images(
        np.require(reference.maps, np.float32, ("C", "W")),
        np.require(target.coefficients, np.float32, ("C", "W")),
        np.require(reference.valid, np.bool_, ("C", "W")),
        np.require(target.valid, np.bool_, ("C", "W")),
    )
    work = state.make_workspace(len(reference.maps), options)
    refine_points(images, _starts(corners_rc, start), options, work, results)
    return Refined(results.shift_xy, results.linear, results.covariance, results.status == state.CONVERGED)


def _starts(corners_rc: Index, start: Start) -> state.Starts:
    """Return the start in the types that the compiled loop knows."""
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
    """Return how many times as long as a plain one the first step is."""
    return (RELAXATION_ROBUST if robust else 1.0) * (RELAXATION_STRUCTURE if structure_follows else 1.0)


def _structure_mode(start: Start, use_structure: bool) -> int:
    if start.structure is not None:
        return state.STRUCTURE_GIVEN
    if not use_structure:
        return state.STRUCTURE_NONE
    return state.STRUCTURE_FOLLOWS if start.structure_xy_px is None else state.STRUCTURE_FIXED
