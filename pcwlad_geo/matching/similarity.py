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
Statistic = NDArray[np.floating[Any]]


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
    half, side = template_px // 2, 2 * radius_px + 1
    offset_rc = np.zeros((len(corners_rc), 2), np.intp)
    ssim = np.full(len(corners_rc), -1.0)
    distinctness = np.zeros(len(corners_rc))
    at_border = np.zeros(len(corners_rc), bool)
    for index, (row, col) in enumerate(corners_rc):
        surface = _ssim_surface(reference, target, int(row), int(col), half, radius_px, least_valid)
        if surface is None:
            continue
        peak = int(surface.argmax())
        r, c = divmod(peak, side)
        offset_rc[index] = r - radius_px, c - radius_px
        ssim[index] = surface[r, c]
        distinctness[index] = peak_distinctness(surface, r, c)
        at_border[index] = min(r, c, side - 1 - r, side - 1 - c) == 0
    return CoarseMatches(offset_rc, ssim, distinctness, at_border)


def peak_distinctness(surface: Float32, row: int, col: int) -> float:
    """Return (peak - second) / (peak - median), the second peak taken outside a small clearance."""
    peak = float(surface[row, col])
    median = float(np.median(surface))
    others = surface.copy()
    k = PEAK_CLEARANCE_PX
    others[max(row - k, 0) : row + k + 1, max(col - k, 0) : col + k + 1] = -np.inf
    second = max(float(others.max()), median)
    return (peak - second) / (peak - median) if peak > median else 0.0


def _ssim_surface(
    reference: MaskedMap, target: MaskedMap, row: int, col: int, half: int, radius: int, least_valid: float
) -> Float32 | None:
    """Return SSIM at every offset, (2·radius+1)² float32; -1 where too little is valid; None if nowhere."""
    inner = np.s_[row - half : row + half + 1, col - half : col + half + 1]
    outer = np.s_[
        row - half - radius : row + half + radius + 1, col - half - radius : col + half + radius + 1
    ]
    template, template_valid = reference.values[inner] / reference.scale, reference.valid[inner]
    search, search_valid = target.values[outer] / target.scale, target.valid[outer]
    if template_valid.mean() < least_valid:
        return None
    count: Float32 | float
    search_sum: Statistic
    search_square: Statistic
    if template_valid.all() and search_valid.all():
        count = float(template.size)
        template_sum, template_square = template.sum(dtype=np.float64), (template**2).sum(dtype=np.float64)
        search_sum, search_square = _box_sums(search, template.shape[0])
    else:
        count = _correlate(search_valid, template_valid)
        if count.max() < least_valid * template.size:
            return None
        template_sum = _correlate(search_valid, template)
        template_square = _correlate(search_valid, template**2)
        search_sum = _correlate(search, template_valid)
        search_square = _correlate(search**2, template_valid)
    cross = _correlate(search, template)
    n = np.maximum(count, 1.0)
    mean_t, mean_s = template_sum / n, search_sum / n
    var_t = np.maximum(template_square / n - mean_t**2, 0)
    var_s = np.maximum(search_square / n - mean_s**2, 0)
    covariance = cross / n - mean_t * mean_s
    surface = _combine(mean_t, mean_s, var_t, var_s, covariance)
    result: Float32 = np.where(np.asarray(count) >= least_valid * template.size, surface, -1).astype(
        np.float32
    )
    return result


def _correlate(search: Float32, template: Float32) -> Float32:
    return np.asarray(cv2.matchTemplate(search, template, cv2.TM_CCORR), np.float32)


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
