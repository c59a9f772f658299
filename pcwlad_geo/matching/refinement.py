"""Sub-pixel refinement of matches on maps that are interpolated by a cubic B-spline.

References
----------
.. [1] Unser, M. (1999), Splines: a perfect fit for signal and image processing, doi:10.1109/79.799930.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import Final

import cv2
import numpy as np

from pcwlad_geo.matching.gaps import least_share
from pcwlad_geo.matching.kernels import refinement as kernel
from pcwlad_geo.matching.kernels.library import in_threads, shares
from pcwlad_geo.types import Bool, Float32, Float64, Index


@dataclass(frozen=True, slots=True)
class RefinementParameters:
    """When the iteration of a match ends; further limits are in `kernels.refinement`."""

    tolerance_px: float = 0.004
    """The iteration ends when the next move is expected to be shorter than this."""
    reached_by_px: float = 0.05
    """A start that is already a match counts as reached by a move of this length."""
    relaxation_robust: float = 1.4
    """Factor on the first step where weights follow the residual: a plain step falls short by a third."""
    relaxation_structure: float = 1.4
    """Further factor where the mutual structure follows the position."""
    most_move_px: float = 3.0
    """Points that move farther than this from their start are dropped."""
    windows_per_correlation: int = 12
    """Side of the window over that of the local correlation."""
    block_px: int = 16
    """Side of the blocks whose scores are taken as independent in the covariance."""


REFINEMENT: Final = RefinementParameters()
"""Those in use."""
SPARSE_STEP_PX: Final = 2
"""Distance of the pixels of windows that every second pixel of the rows and columns is enough for."""
POLE: Final = float(np.sqrt(3.0)) - 2.0
"""Pole of the prefilter of the cubic B-spline [1]_."""
REACH_PX: Final = 12
"""Half length of the prefilter's kernel: its response falls to 1e-7 of the peak within this distance."""


def spline_coefficients(image: Float32, out: Float32) -> None:
    """Prefilter an image for cubic B-spline interpolation [1]_, mirrored about its outermost pixels.

    The (rows, cols) float32 `image` is finite. Filled is `out`, (rows, cols) float32, with what
    `scipy.ndimage.spline_filter` returns, to 1e-6 of its range: the recursive filter, truncated at the
    precision of float32, is a short symmetric kernel, which is several times as fast.
    """
    kernel = POLE ** np.abs(np.arange(-REACH_PX, REACH_PX + 1))
    kernel /= kernel.sum()
    cv2.sepFilter2D(image, -1, kernel, kernel, dst=out, borderType=cv2.BORDER_REFLECT_101)


@dataclass(frozen=True, eq=False)
class ChannelMaps:
    """Maps of one image; what interpolates them is computed when it is first needed, and kept."""

    maps: Float32
    """(channels, rows, cols)."""
    valid: Bool
    """(rows, cols) pixels that count."""
    open_share: float = 1.0
    """Share of the pixels that narrow gaps leave where they are."""

    @cached_property
    def coefficients(self) -> Float32:
        """(channels, rows, cols) cubic B-spline coefficients of the maps."""
        coefficients = np.empty_like(self.maps)
        for plane, out in zip(self.maps, coefficients, strict=True):
            spline_coefficients(plane, out)
        return coefficients

    @cached_property
    def maps_by_phase(self) -> Float32:
        """(channels, rows, cols) the maps with their columns sorted by phase, as `sampling` reads them."""
        channels, rows, cols = self.maps.shape
        sorted_planes = np.empty((channels, rows, cols // SPARSE_STEP_PX * SPARSE_STEP_PX), np.float32)
        for plane, out in zip(self.maps, sorted_planes, strict=True):
            _sort_by_phase(plane, out)
        return sorted_planes

    @cached_property
    def coefficients_by_phase(self) -> Float32:
        """(channels, rows, cols) the coefficients in the same order."""
        sorted_planes, plane = np.empty_like(self.maps_by_phase), np.empty_like(self.maps[0])
        coefficients = self.__dict__.get("coefficients")
        for index, out in enumerate(sorted_planes):
            if coefficients is None:
                spline_coefficients(self.maps[index], plane)
            _sort_by_phase(plane if coefficients is None else coefficients[index], out)
        return sorted_planes


def _sort_by_phase(plane: Float32, out: Float32) -> None:
    """Copy a plane with its even columns before its odd ones; an odd last column is left out."""
    cols = out.shape[1]
    for phase in range(SPARSE_STEP_PX):
        out[:, phase * cols // SPARSE_STEP_PX : (phase + 1) * cols // SPARSE_STEP_PX] = plane[
            :, phase:cols:SPARSE_STEP_PX
        ]


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

    def part(self, index: Index) -> Refined:
        """Return the points at the (m,) `index`."""
        return Refined(*(getattr(self, column.name)[index] for column in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class InitialEstimate:
    """Where the refinement of n points begins."""

    shift_xy_px: Float64
    """(n, 2) target minus reference index, (col, row)."""
    linear: Float64
    """(n, 2, 2) deformation of the window."""
    structure_xy_px: Float64 | None = None
    """(n, 2) shift at which the mutual structure is taken; None: wherever the iteration is."""
    structure: Float32 | None = None
    """(n, rows, cols) of the window: mutual structure computed beforehand, 0 to 1; None: computed here."""
    is_match: bool = False
    """Whether the shifts were refined before, from nearly the same pixels, with fixed structure."""

    def part(self, part: slice) -> InitialEstimate:
        """Return the start of some of the points."""
        return replace(
            self,
            shift_xy_px=self.shift_xy_px[part],
            linear=self.linear[part],
            structure_xy_px=None if self.structure_xy_px is None else self.structure_xy_px[part],
            structure=None if self.structure is None else self.structure[part],
        )

    @property
    def reached_by_px(self) -> float:
        """Length of the move that led to the start."""
        return REFINEMENT.reached_by_px if self.is_match else np.inf


def refine(
    reference: ChannelMaps,
    target: ChannelMaps,
    corners_rc: Index,
    start: InitialEstimate,
    *,
    window_px: int | tuple[int, int],
    step_px: int = 1,
    use_structure: bool = True,
    robust: bool = True,
    affine: bool = False,
    iterations: int = 20,
    least_valid: float = 0.6,
    threads: int = 1,
) -> Refined:
    """Refine the match of every corner.

    The maps are of `reference` and `target`, and the windows lie at the (n, 2) intp `corners_rc` (row,
    column) of the reference, with initial shifts and deformations in `start`. `window_px` is the side of the
    window, or its rows and columns, odd; of its pixels every one or every second is taken (`step_px`).
    `use_structure` weights them by mutual structure, and `robust` by the residual (paper, eq. 9). `affine`
    estimates the deformation of each window, which otherwise stays. There are at most so many Gauss-Newton
    `iterations`. A share of `least_valid` of the window must be valid in both images where they have no gaps.
    The `threads` share the points; the result does not depend on them.
    """
    n = len(corners_rc)
    structure_mode = _structure_mode(start, use_structure)
    sides_px = np.broadcast_to(window_px, 2)
    half_rows, half_cols = (sides_px // 2 // step_px).tolist()
    correlation_half = correlation_half_px(2 * min(half_rows, half_cols) + 1)
    options = kernel.RefinementOptions(
        half_rows=half_rows,
        half_cols=half_cols,
        step=step_px,
        correlation_half=correlation_half,
        width=kernel.flat_width(2 * (half_cols + correlation_half) + 1),
        structure_mode=structure_mode,
        robust=robust,
        affine=affine,
        iterations=iterations,
        reached_by_px=start.reached_by_px,
        tolerance_px=REFINEMENT.tolerance_px,
        relaxation=first_relaxation(robust, structure_mode == kernel.StructureMode.FOLLOWS),
        least_valid=least_share(float(least_valid), reference.open_share, target.open_share),
        largest_move_px=REFINEMENT.most_move_px,
        blocks=max(4, round(max(sides_px) / REFINEMENT.block_px)),
    )
    images = _images(reference, target, step_px)

    def refine_some(part: slice) -> kernel.Results:
        return kernel.refine_points(images, _starts(corners_rc[part], start.part(part)), options)

    results = in_threads([partial(refine_some, part) for part in shares(n, threads)], threads)
    shift, linear, covariance, status = map(np.concatenate, zip(*results, strict=True))
    return Refined(shift, linear, covariance, status == kernel.Status.CONVERGED)


def _images(reference: ChannelMaps, target: ChannelMaps, step_px: int) -> kernel.Images:
    """Return the arrays of both images as the compiled loop takes them."""
    by_phase = step_px == SPARSE_STEP_PX
    return kernel.Images(
        np.ascontiguousarray(reference.maps_by_phase if by_phase else reference.maps, np.float32),
        np.ascontiguousarray(target.coefficients_by_phase if by_phase else target.coefficients, np.float32),
        np.ascontiguousarray(reference.valid, np.bool_),
        np.ascontiguousarray(target.valid, np.bool_),
    )


def _starts(corners_rc: Index, start: InitialEstimate) -> kernel.Starts:
    """Return the start as the compiled loop takes it."""
    structure_xy = np.zeros((len(corners_rc), 2)) if start.structure_xy_px is None else start.structure_xy_px
    structure = np.zeros((1, 1, 1)) if start.structure is None else start.structure
    return kernel.Starts(
        np.ascontiguousarray(corners_rc, np.int64),
        np.ascontiguousarray(start.shift_xy_px, np.float64),
        np.ascontiguousarray(start.linear, np.float64),
        np.ascontiguousarray(structure_xy, np.float64),
        np.ascontiguousarray(structure, np.float32),
    )


def correlation_half_px(window_px: int) -> int:
    """Return the half side of the local correlation window: 3 (7 × 7) at 81, 5 (11 × 11) at 129."""
    return max(1, round(window_px / REFINEMENT.windows_per_correlation - 0.5) // 2)


def first_relaxation(robust: bool, structure_follows: bool) -> float:
    """Return the factor on the first step for `robust` weights and where `structure_follows` the shift."""
    return (REFINEMENT.relaxation_robust if robust else 1.0) * (
        REFINEMENT.relaxation_structure if structure_follows else 1.0
    )


def _structure_mode(start: InitialEstimate, use_structure: bool) -> kernel.StructureMode:
    if start.structure is not None:
        return kernel.StructureMode.GIVEN
    if not use_structure:
        return kernel.StructureMode.NONE
    return kernel.StructureMode.FOLLOWS if start.structure_xy_px is None else kernel.StructureMode.FIXED
