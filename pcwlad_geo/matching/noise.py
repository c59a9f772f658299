"""Noise of an image: its share in the finest detail, its standard deviation, and what rounding leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.speckle import Speckle, find_speckle, has_empty_border
from pcwlad_geo.types import Bool, Float64, Floating


@dataclass(frozen=True, slots=True)
class NoiseParameters:
    """How noise is measured, and how far the maps are smoothed for it."""

    least_smoothing_px: float = 0.6
    """Sigma of the Gaussian over maps of images without noise, enough against aliasing."""
    most_smoothing_px: float = 1.5
    """The same for the noisiest images."""
    clean_ratio: float = 0.8
    """Noise ratio up to which an image is free of noise; real scenes have 0.2 to 0.8."""
    white_ratio: float = 2.0
    """Noise ratio of white noise."""
    least_pixels: int = 1024
    """Least number of valid pixels that give the noise."""
    independent_share: float = 0.5
    """Share of noise from which the speckle of neighbours is independent: 0 in tiles of Sentinel-1."""
    unit_detail: float = 6 * 0.7979
    """Mean absolute second difference of white noise of unit variance: its gain, 6, times E|z|."""
    whole_numbers_rms: float = 0.6
    """RMS of the detail up to which whole numbers may show nothing: twice that of rounding."""
    compressed_rms: float = 1.0
    """The same of 8 bits in which the blocks of compression show."""
    patch_px: int = 8
    """Side of the patches whose covariance gives the noise."""
    block_patches: int = 8
    """Side of the blocks of patches in which two images are compared: contrasts may differ in sign."""


NOISE: Final = NoiseParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of an image."""

    ratio: float = 0.0
    """Mean absolute second difference at full over half resolution: 2 for white noise, below 1 for scenes."""
    sigma: float = 0.0
    """Standard deviation of the white part, in units of the image."""
    rounding: float = 0.0
    """RMS of the detail that rounding or lossy compression may leave of nothing, in units of the image."""
    speckle: Speckle | None = None
    """The multiplicative noise of a radar image; the rest is then that of `Speckle.stabilised` values."""

    @property
    def share(self) -> float:
        """How much of the finest detail is noise, 0 to 1."""
        clean, white = NOISE.clean_ratio, NOISE.white_ratio
        return float(np.clip((self.ratio - clean) / (white - clean), 0, 1))


def rounding_of(dtype: str, *, compressed: bool = False) -> float:
    """Return the `Noise.rounding` of values of a `dtype`, and of compression with loss.

    Whole numbers are off by 0.29 RMS, and the edges between the steps of a ramp of them are as sharp as any:
    two images of bare walls or of still water agreed on those of theirs.
    """
    rms = NOISE.compressed_rms if compressed else NOISE.whole_numbers_rms
    return rms if np.dtype(dtype).kind in "uib" else 0.0


def measure_noise(image: Floating, valid: Bool) -> Noise:
    """Measure noise by comparing the finest detail with that at half the resolution, where noise is averaged.

    The (rows, cols) `image` is at full resolution, and the (rows, cols) bool array `valid` says which pixels
    count. All is zero where these are too few.
    """
    return of_whole_image(noise_of_samples([(image, valid)]), image, valid)


def of_whole_image(noise: Noise, image: Floating, valid: Bool) -> Noise:
    """Return the noise of samples with what only the whole (rows, cols) `image`, or an overview of it, tells.

    The (rows, cols) bool array `valid` says which pixels count.
    """
    if noise.speckle is None:
        return noise
    speckle = replace(noise.speckle, empty_border=has_empty_border(image, valid))
    counted = speckle.known(image, valid)
    epsilon = scene_epsilon(speckle.stabilised(image, counted), counted)
    return replace(noise, speckle=replace(speckle, epsilon=epsilon))


def noise_of_samples(samples: Sequence[tuple[Floating, Bool]], *, may_be_radar: bool = True) -> Noise:
    """Return the typical noise of an image, of which (rows, cols) `samples` are given with their validity.

    Sums of bands and pictures are not asked whether they `may_be_radar`.
    """
    speckle = find_speckle(samples) if may_be_radar else None
    noise = _typical_noise(samples, speckle)
    if speckle is None or noise.share < NOISE.independent_share:
        return noise
    noise_of_it = _typical_noise(samples, speckle.of_independent_pixels)
    return replace(noise_of_it, ratio=noise.ratio)  # what averaging leaves of speckle is as rough as a scene


def _typical_noise(samples: Sequence[tuple[Floating, Bool]], speckle: Speckle | None) -> Noise:
    measured = []
    for image, valid in samples:
        noise = _white_noise(image if speckle is None else speckle.stabilised(image, valid), valid)
        measured += [noise] if noise.ratio > 0 else []
    ratio, sigma = np.median([(noise.ratio, noise.sigma) for noise in measured or [Noise()]], axis=0)
    return Noise(float(ratio), float(sigma), speckle=speckle)


def _white_noise(image: Floating, valid: Bool) -> Noise:
    rows, cols = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    fine = np.where(valid, image, 0.0)[:rows, :cols].astype(np.float64)
    fine_valid = np.asarray(valid[:rows, :cols])
    half = cols // 2, rows // 2
    if min(half) == 0:
        return Noise()
    coarse = np.asarray(cv2.resize(fine, half, interpolation=cv2.INTER_AREA), np.float64)
    coarse_valid = np.asarray(fine_valid.reshape(rows // 2, 2, cols // 2, 2).all(axis=(1, 3)))
    detail, coarse_detail = _mean_detail(fine, fine_valid), _mean_detail(coarse, coarse_valid)
    if coarse_detail <= 0:
        return Noise()
    noise = Noise(ratio=detail / coarse_detail)
    return replace(noise, sigma=noise.share * detail / NOISE.unit_detail)


def smoothing_px(*noises: Noise) -> float:
    """Return the Gaussian sigma for the maps of a pair from the noise of its images."""
    share = max((noise.share for noise in noises), default=0.0)
    return NOISE.least_smoothing_px + (NOISE.most_smoothing_px - NOISE.least_smoothing_px) * share


def _mean_detail(image: Float64, valid: Bool) -> float:
    inner = cv2.erode(valid.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    count = cv2.countNonZero(inner)
    if count < NOISE.least_pixels:
        return 0.0
    second_difference = np.array([1.0, -2.0, 1.0])
    detail = cv2.filter2D(image, -1, np.outer(second_difference, second_difference))
    return cv2.norm(detail, cv2.NORM_L1, mask=inner) / count


def noise_level(values: Float64, other: Float64, valid: Bool) -> float:
    """Return the standard deviation of the white noise of an image, in its units; 0 where that is not known.

    Along the axes of the smallest eigenvalues of their covariance, as many as have their mean and median
    alike, patches vary by noise and the finest texture only (Chen, Zhu and Heng 2015,
    doi:10.1109/ICCV.2015.62). What `other`, another band in the same place, varies alike there is texture.
    The (rows, cols) `values` and (rows, cols) `other` are finite where both count, in the (rows, cols) mask
    `valid`.
    """
    whole = np.asarray(_patches(valid).all(axis=2))
    images = (np.where(valid, image, 0.0) for image in (values, other))
    patches, other_patches = (_patches(image).astype(np.float64) for image in images)
    if np.count_nonzero(whole) < 200:
        return 0.0
    variance, axes = np.linalg.eigh(np.cov(patches[whole], rowvar=False))
    count = len(variance)
    while count > 1 and (variance[:count] > variance[:count].mean()).sum() * 2 < count:
        count -= 1
    shared_share = _alike(patches @ axes[:, :count], other_patches @ axes[:, :count], whole)
    return float(np.sqrt(max(float(variance[:count].mean()), 0.0) * (1 - shared_share)))


def _patches(image: NDArray[Any]) -> NDArray[Any]:
    """Return the (m, k, pixels) patches of an image, each half a patch from the next."""
    side = NOISE.patch_px
    views = np.lib.stride_tricks.sliding_window_view(image, (side, side))[:: side // 2, :: side // 2]
    return views.reshape(*views.shape[:2], side**2)


def _alike(values: Float64, other: Float64, whole: Bool) -> float:
    """Return the share of the variance of (m, k, c) values that another image has too, 0 to 1.

    Of each image it is taken to be the same, so that their correlation is that share.
    """
    squares = []
    side = NOISE.block_patches
    for row in range(0, whole.shape[0], side):
        for col in range(0, whole.shape[1], side):
            block = (slice(row, row + side), slice(col, col + side))
            first, second = (array[block][whole[block]].ravel() for array in (values, other))
            energy = float((first**2).sum() * (second**2).sum())
            if energy > 0:
                by_chance = 4 / first.size  # every pixel is in four patches
                squares.append(float(first @ second) ** 2 / energy - by_chance)
    return float(np.sqrt(np.clip(np.mean(squares), 0.0, 1.0))) if squares else 0.0
