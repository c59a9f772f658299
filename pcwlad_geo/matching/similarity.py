"""Coarse match: the integer offset of highest structural similarity (SSIM), and how it stands out.

References
----------
.. [1] Wang, Z. et al. (2004), doi:10.1109/TIP.2003.819861: luminance, contrast and structure; the
   exponents are those of the PCWLAD paper (eq. 3-4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

LUMINANCE_EXPONENT: Final = 0.5
CONTRAST_EXPONENT: Final = 0.8
STRUCTURE_EXPONENT: Final = 1.3
C_LUMINANCE: Final = 0.01**2
C_CONTRAST: Final = 0.03**2
PEAK_CLEARANCE_PX: Final = 3

Float32 = NDArray[np.float32]
Index = NDArray[np.intp]
Statistic = NDArray[np.floating[Any]] | np.floating[Any]


@dataclass(frozen=True, slots=True, eq=False)
class CoarseMatches:
    """The best integer offset of each corner."""

    offset_rc: Index
    """(n, 2) row, column offset from reference to target index."""
    ssim: NDArray[np.float64]
    """(n,) SSIM at the peak; -1 where nothing could be compared."""
    distinctness: NDArray[np.float64]
    """(n,) how far the peak stands above the second one, 0 (not at all) to 1."""
    at_border: NDArray[np.bool_]
    """(n,) the peak lies on the edge of the search window: the true one may lie beyond."""
    shift_xy_px: NDArray[np.float64]
    """(n, 2) the offset as (col, row), to a fraction of a pixel: top of a parabola through the peak."""


@dataclass(frozen=True, slots=True, eq=False)
class MaskedMap:
    """A map with its validity; the values are 0 where it is not valid."""

    values: Float32
    valid: Float32
    """1 or 0."""
    scale: np.float32
    """Divides the values: SSIM's constants expect a range of 1."""


def match_coarsely(
    reference: MaskedMap,
    target: MaskedMap,
    corners_rc: Index,
    template_px: int,
    radius_px: int,
    least_valid: float,
) -> CoarseMatches:
    """Find the offset of highest SSIM within a radius for each corner.

    Parameters
    ----------
    reference, target : MaskedMap
        Maps of the same shape.
    corners_rc : (n, 2) intp array
        Corners whose template window lies inside the reference.
    template_px : int
        Side of the template, odd.
    radius_px : int
        Largest offset per axis.
    least_valid : float
        Share of the template that must be valid in both maps.
    """
    side = 2 * radius_px + 1
    n = len(corners_rc)
    found = CoarseMatches(
        np.zeros((n, 2), np.intp), np.full(n, -1.0), np.zeros(n), np.zeros(n, bool), np.zeros((n, 2))
    )
    search = _Search(reference, target, template_px, radius_px, least_valid)
    for index, (row, col) in enumerate(corners_rc):
        surface = search.surface(int(row), int(col))
        if surface is None:
            continue
        r, c = divmod(int(surface.argmax()), side)
        found.offset_rc[index] = r - radius_px, c - radius_px
        found.ssim[index] = surface[r, c]
        found.distinctness[index] = peak_distinctness(surface, r, c)
        found.at_border[index] = min(r, c, side - 1 - r, side - 1 - c) == 0
        found.shift_xy_px[index] = c - radius_px, r - radius_px
        if not found.at_border[index]:
            across, down = surface[r, c - 1 : c + 2], surface[r - 1 : r + 2, c]
            found.shift_xy_px[index] += parabola_top(across), parabola_top(down)
    return found


def parabola_top(values: NDArray[np.floating[Any]]) -> float:
    """Return where the parabola through three values, the middle one the largest, is highest: -0.5 to 0.5."""
    before, peak, after = values.tolist()
    if min(before, after) < 0.0:  # not comparable, or a ridge beside a gap
        return 0.0
    curvature = before - 2.0 * peak + after
    return (before - after) / (2.0 * curvature) if curvature < 0.0 else 0.0


def peak_distinctness(surface: Float32, row: int, col: int) -> float:
    """Return (peak - second) / (peak - median), the second peak taken outside a small clearance."""
    peak = float(surface[row, col])
    # of an odd number of values, as a search window has; np.median takes six times as long
    median = float(np.partition(surface, surface.size // 2, axis=None)[surface.size // 2])
    others = surface.copy()
    k = PEAK_CLEARANCE_PX
    others[max(row - k, 0) : row + k + 1, max(col - k, 0) : col + k + 1] = -np.inf
    second = max(float(others.max()), median)
    return (peak - second) / (peak - median) if peak > median else 0.0


class _Search:
    """Compares the template of one corner after the other with all its offsets; keeps the memory for it."""

    def __init__(
        self, reference: MaskedMap, target: MaskedMap, template_px: int, radius_px: int, least_valid: float
    ) -> None:
        self.reference, self.target = reference, target
        self.half, self.radius = template_px // 2, radius_px
        self.least = least_valid * template_px**2
        search_px = template_px + 2 * radius_px
        # multiples of 16 are the quick ones: 128 takes a third of 125
        side = cv2.getOptimalDFTSize(-(-search_px // 16) * 16)
        self.padded = np.zeros((2, side, side), np.float32)

    def surface(self, row: int, col: int) -> Float32 | None:
        """Return SSIM at every offset, (2·radius+1)², -1 where too little is valid; None if nowhere."""
        inner, outer = self._window(row, col, self.half), self._window(row, col, self.half + self.radius)
        template, template_valid = self.reference.values[inner], self.reference.valid[inner]
        search, search_valid = self.target.values[outer], self.target.valid[outer]
        if cv2.countNonZero(template_valid) < self.least:
            return None
        whole = cv2.countNonZero(template_valid) == template.size
        if whole and cv2.countNonZero(search_valid) == search.size:
            count, sums = self._sums(search, template)
        else:
            count, sums = self._masked_sums(search, search_valid, template, template_valid)
        surface = self._ssim(count, sums)
        comparable = count >= self.least
        if not comparable.any():
            return None
        result: Float32 = np.where(comparable, surface, -1).astype(np.float32)
        return result

    def _ssim(self, count: Statistic, sums: tuple[Statistic, ...]) -> Statistic:
        n = np.maximum(count, 1.0)
        to_t, to_s = n * self.reference.scale, n * self.target.scale
        mean_t, mean_s = sums[0] / to_t, sums[2] / to_s
        var_t = np.maximum(sums[1] / (to_t * self.reference.scale) - mean_t**2, 0)
        var_s = np.maximum(sums[3] / (to_s * self.target.scale) - mean_s**2, 0)
        covariance = sums[4] / (to_t * self.target.scale) - mean_t * mean_s
        return _combine(mean_t, mean_s, var_t, var_s, covariance)

    def _sums(self, search: Float32, template: Float32) -> tuple[Statistic, tuple[Statistic, ...]]:
        """Return the number of pixels and the sums of t, t², s, s² and t·s at every offset."""
        template_sum = np.float64(cv2.sumElems(template)[0])
        template_square = np.float64(cv2.norm(template, cv2.NORM_L2SQR))
        cross = self._cross(self._spectrum(search, 0), self._spectrum(template, 1))
        search_sums = _box_sums(search, template.shape[0])
        return np.float64(template.size), (template_sum, template_square, *search_sums, cross)

    def _masked_sums(
        self, search: Float32, search_valid: Float32, template: Float32, template_valid: Float32
    ) -> tuple[Statistic, tuple[Statistic, ...]]:
        """Return the same over the pixels that are valid in both."""
        of_search = [self._spectrum(a, 0) for a in (search_valid, search, search**2)]
        of_template = [self._spectrum(a, 1) for a in (template_valid, template, template**2)]
        pairs = ((0, 0), (0, 1), (0, 2), (1, 0), (2, 0), (1, 1))
        count, *sums = (self._cross(of_search[s], of_template[t]) for s, t in pairs)
        return np.round(count), tuple(sums)

    def _spectrum(self, window: Float32, which: int) -> Float32:
        """Return the packed Fourier transform of a padded window; `which` of the two sizes it has."""
        padded = self.padded[which]
        padded[: window.shape[0], : window.shape[1]] = window
        return np.asarray(cv2.dft(padded), np.float32)

    def _cross(self, search: Float32, template: Float32) -> Float32:
        """Return the correlation of two windows from their spectra at every offset."""
        side = 2 * self.radius + 1
        product = cv2.mulSpectrums(search, template, 0, conjB=True)
        plane = cv2.idft(product, flags=cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT)
        return np.asarray(plane[:side, :side], np.float32)

    @staticmethod
    def _window(row: int, col: int, reach: int) -> tuple[slice, slice]:
        return slice(row - reach, row + reach + 1), slice(col - reach, col + reach + 1)


def _box_sums(search: Float32, side: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    plain, square = cv2.integral2(search, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    return _corners(np.asarray(plain, np.float64), side), _corners(np.asarray(square, np.float64), side)


def _corners(integral: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    result: NDArray[np.float64] = (
        integral[side:, side:] - integral[:-side, side:] - integral[side:, :-side] + integral[:-side, :-side]
    )
    return result


def ssim(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the SSIM of (n, rows, cols) stacks of windows, (n,)."""
    axes = (1, 2)
    mean_f, mean_s = first.mean(axes), second.mean(axes)
    var_f, var_s = first.var(axes), second.var(axes)
    covariance = ((first - mean_f[:, None, None]) * (second - mean_s[:, None, None])).mean(axes)
    return _combine(mean_f, mean_s, var_f, var_s, covariance)


def _combine(
    mean_f: Statistic, mean_s: Statistic, var_f: Statistic, var_s: Statistic, covariance: Statistic
) -> NDArray[np.float64]:
    """Return luminance^α · contrast^β · structure^γ, the sign of the structure kept."""
    deviation = np.sqrt(var_f * var_s)
    luminance = (2 * mean_f * mean_s + C_LUMINANCE) / (mean_f**2 + mean_s**2 + C_LUMINANCE)
    contrast = (2 * deviation + C_CONTRAST) / (var_f + var_s + C_CONTRAST)
    structure = (covariance + C_CONTRAST / 2) / (deviation + C_CONTRAST / 2)
    result: NDArray[np.float64] = (
        luminance**LUMINANCE_EXPONENT
        * contrast**CONTRAST_EXPONENT
        * np.sign(structure)
        * np.abs(structure) ** STRUCTURE_EXPONENT
    )
    return result
