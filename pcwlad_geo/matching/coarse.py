"""Coarse match: the integer offset of highest structural similarity (SSIM), and how it stands out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from pcwlad_geo.matching.kernels.library import (
    POINTER,
    REAL,
    WHOLE,
    address,
    fast_even,
    function,
    in_threads,
    roots_of_unity,
)
from pcwlad_geo.matching.paper import PAPER
from pcwlad_geo.types import Bool, Float32, Float64, Floating, Index


@dataclass(frozen=True, slots=True)
class CoarseParameters:
    """How the peak of a search is told from others."""

    peak_clearance_px: int = 3
    """Offsets within this distance of the peak, per axis, belong to it and are not the second peak."""


COARSE: Final = CoarseParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class CoarseMatches:
    """The best integer offset of each corner."""

    offset_rc: Index
    """(n, 2) row, column offset from reference to target index."""
    ssim: Float64
    """(n,) SSIM at the peak; -1 where nothing could be compared."""
    distinctness: Float64
    """(n,) how far the peak stands above the second one, 0 (not at all) to 1."""
    at_border: Bool
    """(n,) the peak lies on the edge of the search window: the true one may lie beyond."""
    shift_xy_px: Float64
    """(n, 2) the offset as (col, row), to a fraction of a pixel: top of a parabola through the peak."""


@dataclass(frozen=True, slots=True, eq=False)
class MaskedMap:
    """A map with its validity mask; the values are 0 where it is not valid."""

    values: Float32
    """(rows, cols)."""
    valid: Float32
    """(rows, cols) 1 or 0."""
    scale: np.float32
    """Divides the values: the constants of the SSIM expect a range of 1."""


def match_coarsely(
    reference: MaskedMap,
    target: MaskedMap,
    corners_rc: Index,
    template_px: int,
    radius_px: int,
    least_valid: float,
    threads: int = 1,
) -> CoarseMatches:
    """Find the offset of highest SSIM within a radius for each corner.

    The maps have the same shape; the (n, 2) intp `corners_rc` (row, col) have templates of an odd number of
    px, of which a share of `least_valid` must be valid in both maps. The offset is at most `radius_px` per
    axis. The `threads` do not change the result. Raises `ValueError` if a search leaves the maps.
    """
    n, reach = len(corners_rc), template_px // 2 + radius_px
    if ((corners_rc < reach) | (corners_rc >= np.array(reference.values.shape) - reach)).any():
        raise ValueError(f"a corner lies less than {reach} px from the edge of the maps")
    matches = CoarseMatches(
        np.zeros((n, 2), np.intp), np.full(n, -1.0), np.zeros(n), np.zeros(n, bool), np.zeros((n, 2))
    )
    at_once = max(1, min(16, 10_000 // (2 * radius_px + 1) ** 2))  # values that stay in the processor's cache

    def match_some(first: int) -> None:
        search = _SsimSearch(reference, target, template_px, radius_px, least_valid)
        for begin in range(first * at_once, n, threads * at_once):
            index = np.arange(begin, min(begin + at_once, n))
            surfaces = search.surfaces(corners_rc[index])
            compared = surfaces.max(axis=(1, 2)) > -1.0
            if compared.any():
                _fill_peaks(surfaces[compared], index[compared], matches)

    in_threads([partial(match_some, first) for first in range(threads)], threads)
    return matches


def _fill_peaks(surfaces: Float32, index: Index, matches: CoarseMatches) -> None:
    """Fill in the peaks of (n, side, side) surfaces at the indices of their corners."""
    side = surfaces.shape[1]
    row, col = np.divmod(surfaces.reshape(len(surfaces), -1).argmax(axis=1), side)
    matches.offset_rc[index] = np.stack([row, col], axis=1) - side // 2
    matches.shift_xy_px[index] = matches.offset_rc[index, ::-1]
    matches.ssim[index] = surfaces[np.arange(len(surfaces)), row, col]
    matches.at_border[index] = np.minimum.reduce([row, col, side - 1 - row, side - 1 - col]) == 0
    for place, surface, r, c in zip(index, surfaces, row, col, strict=True):
        if not matches.at_border[place]:
            across, down = surface[r, c - 1 : c + 2], surface[r - 1 : r + 2, c]
            matches.shift_xy_px[place] += parabola_top(across), parabola_top(down)
    matches.distinctness[index] = peak_distinctness(surfaces, row, col)


def parabola_top(values: Floating) -> float:
    """Return the offset of the top of the parabola through the (3,) `values`, middle one largest: ±0.5."""
    before, peak, after = values.tolist()
    if min(before, after) < 0.0:  # not comparable, or a ridge beside a gap
        return 0.0
    return parabola_offset(before, peak, after)


def parabola_offset(before: float, peak: float, after: float) -> float:
    """Return where the parabola through three equidistant values is highest, -0.5 to 0.5."""
    curvature = before - 2.0 * peak + after
    return float((before - after) / (2.0 * curvature)) if curvature < 0.0 else 0.0


def peak_distinctness(surfaces: Float32, row: Index, col: Index) -> Float64:
    """Return how far each peak stands out, 0 to 1: (peak - second peak) / (peak - median).

    The (n, side, side) float32 `surfaces` are the SSIM at every offset (row, column); the (n,) indices `row`
    and `col` are those of their highest values. The result is of shape (n,).
    """
    n, size = len(surfaces), surfaces[0].size
    peak = surfaces[np.arange(n), row, col].astype(np.float64)
    # of an odd number of values, as a search window has; np.median takes six times as long
    median = np.partition(surfaces.reshape(n, size), size // 2, axis=1)[:, size // 2].astype(np.float64)
    cleared = surfaces.copy()
    k = COARSE.peak_clearance_px
    for plane, r, c in zip(cleared, row, col, strict=True):
        plane[max(r - k, 0) : r + k + 1, max(c - k, 0) : c + k + 1] = -np.inf
    second = np.maximum(cleared.max(axis=(1, 2)), median)
    height = peak - median
    return np.where(height > 0, (peak - second) / np.where(height > 0, height, 1.0), 0.0)


class _SsimSearch:
    """Computes the SSIM of templates at all offsets; holds what this needs."""

    def __init__(
        self, reference: MaskedMap, target: MaskedMap, template_px: int, radius_px: int, least_valid: float
    ) -> None:
        self.reference, self.target = reference, target
        self.template_px, self.radius = template_px, radius_px
        self.least = least_valid * template_px**2
        length = fast_even(template_px + 2 * radius_px)
        self.roots = roots_of_unity(length)
        memory = function("coarse_memory", *3 * [WHOLE], returns=WHOLE)(template_px, radius_px, length)
        self.memory = np.empty(memory or 0)

    def surfaces(self, corners_rc: Index) -> Float32:
        """Return the SSIM at every offset, (n, 2·radius+1, 2·radius+1), -1 where too little is valid."""
        sums = self._sums(corners_rc)
        comparable = sums[:, 0] >= max(self.least, 1.0)
        return np.where(comparable, self._ssim(sums), -1.0).astype(np.float32)

    def _ssim(self, sums: Float64) -> Float64:
        n = np.maximum(sums[:, 0], 1.0)
        to_t, to_s = n * self.reference.scale, n * self.target.scale
        mean_t, mean_s = sums[:, 1] / to_t, sums[:, 3] / to_s
        var_t = np.maximum(sums[:, 2] / (to_t * self.reference.scale) - mean_t**2, 0)
        var_s = np.maximum(sums[:, 4] / (to_s * self.target.scale) - mean_s**2, 0)
        covariance = sums[:, 5] / (to_t * self.target.scale) - mean_t * mean_s
        return _combine(mean_t, mean_s, var_t, var_s, covariance)

    def _sums(self, corners_rc: Index) -> Float64:
        """Return the number of pixels valid in both and their sums of t, t², s, s² and t·s at every offset.

        They are of shape (n, 6, 2·radius+1, 2·radius+1); t is the template, s the window at an offset. All
        are 0 where too little of the template is valid.
        """
        side = 2 * self.radius + 1
        corners, sums = np.ascontiguousarray(corners_rc, np.int64), np.empty((len(corners_rc), 6, side, side))
        maps = [part for plane in (self.reference, self.target) for part in (plane.values, plane.valid)]
        types = (*4 * [POINTER], WHOLE, POINTER, *4 * [WHOLE], POINTER, REAL, POINTER, POINTER)
        function("correlation_sums", *types)(
            *(address(plane, np.float32) for plane in maps),
            maps[0].shape[1],
            address(corners, np.int64),
            len(corners),
            self.template_px,
            self.radius,
            len(self.roots),
            address(self.roots, np.complex64),
            self.least,
            address(self.memory, np.float64),
            address(sums, np.float64),
        )
        return sums


def ssim(first: Float64, second: Float64) -> Float64:
    """Return the (n,) SSIM (paper, eq. 3-4) of the (n, rows, cols) windows `first` and `second`, range 1."""
    axes = (1, 2)
    mean_f, mean_s = first.mean(axes), second.mean(axes)
    var_f, var_s = first.var(axes), second.var(axes)
    covariance = ((first - mean_f[:, None, None]) * (second - mean_s[:, None, None])).mean(axes)
    return _combine(mean_f, mean_s, var_f, var_s, covariance)


def _combine(
    mean_f: Float64, mean_s: Float64, var_f: Float64, var_s: Float64, covariance: Float64
) -> Float64:
    """Return luminance^α · contrast^β · structure^γ, the sign of the structure kept."""
    deviation = np.sqrt(var_f * var_s)
    luminance = (2 * mean_f * mean_s + PAPER.c_luminance) / (mean_f**2 + mean_s**2 + PAPER.c_luminance)
    contrast = (2 * deviation + PAPER.c_contrast) / (var_f + var_s + PAPER.c_contrast)
    structure = (covariance + PAPER.c_contrast / 2) / (deviation + PAPER.c_contrast / 2)
    result: Float64 = (
        luminance**PAPER.luminance_exponent
        * contrast**PAPER.contrast_exponent
        * np.sign(structure)
        * np.abs(structure) ** PAPER.structure_exponent
    )
    return result
