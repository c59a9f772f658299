"""Ground that repeats: displacements at which a whole scene fits nearly as well as at one, or better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import scipy.fft

from pcwlad_geo.matching.channels import Channels, channels_at
from pcwlad_geo.matching.masked_correlation import correlation_at, masked_correlation
from pcwlad_geo.types import Bool, Float32, Float64

Image = tuple[Float32, Bool]
"""(rows, cols) values and the mask of the valid ones."""


@dataclass(frozen=True, slots=True)
class RepeatParameters:
    """Numbers of the comparison with rivals, from ten kinds of repeating ground and pairs of other ground."""

    side_px: int = 448
    """Approximate longer side of the images compared, px."""
    near_px: int = 2
    """How far the peak of a displacement may lie from where tie points say, px of the images compared."""
    apart_px: float = 5.0
    """Least distance of a rival, px: nearer ones are no peaks of their own."""
    least_z: float = 20.0
    """Least correlation of a repeat, times the root of the number of pixels: chance reaches 12."""
    least_repeat: float = 0.4
    """Least autocorrelation at the distance of a rival, as a share of the lower of both correlations."""
    least_overlap: float = 0.5
    """Least overlap of a rival, as a share of that of the displacement."""
    clear_ratio: float = 1.15
    """The better of two is clear if its correlation is so many times as high: where the two have nothing but
    the repeat in common, noise and the edges of the scene change it by up to a tenth."""
    clear_z: float = 10.0
    """Least difference of both, times the root of the number of pixels: five sigmas of chance."""


REPEATS: Final = RepeatParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True)
class Rival:
    """Another displacement at which ground that repeats looks alike."""

    shift_xy: Float64
    """(2,) (col, row) target minus reference array index, px."""
    is_better: bool
    """Whether the whole scene fits clearly better there than at the displacement that it rivals."""


def rivals_of(reference: Image, target: Image, shift_xy: Float64) -> list[Rival]:
    """Return the rivals of a shift that the whole scene does not clearly exclude, the best first.

    The (2,) `shift_xy` (col, row) is target minus reference array index, px. There are none where the
    reference does not repeat.
    """
    by = REPEATS
    step = max(1, round(max(reference[1].shape) / by.side_px))
    first = channels_at(*reference, step)
    repeat, rows_cols = _autocorrelation(first), np.array(first.valid.shape)
    rows_away, cols_away = np.ogrid[tuple(slice(1 - n, n) for n in first.valid.shape)]
    is_apart = rows_away**2 + cols_away**2 > by.apart_px**2
    highest = repeat[_is_peak(repeat) & is_apart].max(initial=0.0)
    if highest * np.sqrt(first.valid.sum()) < by.least_z:
        return []
    second, near_repeat = channels_at(*target, step), cv2.dilate(repeat, np.ones((5, 5)))
    least_fit = correlation_at(first, second, np.rint(shift_xy / step).astype(int).tolist())
    strongest = near_repeat[is_apart].max(initial=0.0)
    if strongest <= by.least_repeat * least_fit / by.clear_ratio:
        return []  # a rival fits that well at least, and no repeat reaches its share of that
    fit, overlap = masked_correlation(first, second)
    origin = rows_cols - 1
    at = np.clip(np.rint(shift_xy[::-1] / step).astype(int) + origin, 0, np.array(fit.shape) - 1)
    row, col = at.tolist()
    fit[overlap < by.least_overlap * overlap[row, col]] = -1.0
    around = (slice(max(n - by.near_px, 0), n + by.near_px + 1) for n in (row, col))
    own_fit = float(fit[tuple(around)].max())
    peaks = np.argwhere(_is_peak(fit) & (fit > own_fit / by.clear_ratio))
    height, offset = fit[tuple(peaks.T)], peaks - at
    root = np.sqrt(np.minimum(overlap[tuple(peaks.T)], overlap[row, col]))
    place = np.clip(offset + origin, 0, 2 * origin)
    is_rival = (
        (np.hypot(*offset.T) > by.apart_px)
        & (height * root > by.least_z)
        & ((height - own_fit) * root > -by.clear_z)
        & (near_repeat[tuple(place.T)] > by.least_repeat * np.minimum(height, own_fit))
    )
    is_better = (height > by.clear_ratio * own_fit) & ((height - own_fit) * root > by.clear_z)
    order = np.argsort(-height, kind="stable")
    shifts = (peaks - origin)[:, ::-1] * float(step)
    return [Rival(shifts[k], bool(is_better[k])) for k in order[is_rival[order]]]


def _is_peak(surface: Float32) -> Bool:
    return np.asarray(surface >= cv2.dilate(surface, np.ones((7, 7))))


def _autocorrelation(image: Channels) -> Float32:
    """Return the correlation of an image with itself, as large as `masked_correlation`.

    The channels have no local mean and the same deviation everywhere, so that the overlap alone norms them.
    """
    rows, cols = image.valid.shape
    fast = [scipy.fft.next_fast_len(2 * n - 1, real=True) for n in (rows, cols)]

    def surface(*planes: Float32) -> Float32:
        power = sum(np.abs(scipy.fft.rfft2(plane, fast)) ** 2 for plane in planes)
        full = np.roll(scipy.fft.irfft2(power, fast), (rows - 1, cols - 1), axis=(0, 1))
        return np.asarray(full[: 2 * rows - 1, : 2 * cols - 1], np.float32)

    overlap = np.maximum(surface(image.valid), 1.0)
    mean = surface(*np.moveaxis(image.values, 2, 0)) / overlap
    is_large = overlap >= REPEATS.least_overlap * image.valid.sum()
    return np.where(is_large, mean / max(float(mean[rows - 1, cols - 1]), 1e-12), 0.0).astype(np.float32)
