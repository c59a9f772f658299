"""Preparation of the images: invalid pixels are filled, noise is measured, and the maps are computed.

The filling is smooth, so that filters find no edge where the data end.

References
----------
.. [1] Gortler, S. J. et al. (1996), The Lumigraph, doi:10.1145/237170.237200 (pull-push pyramid).
.. [2] Knutsson, H. and Westin, C.-F. (1993), doi:10.1109/CVPR.1993.341081 (normalised convolution).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.coarse import MaskedMap
from pcwlad_geo.matching.kernels.library import fast_even, in_threads
from pcwlad_geo.matching.keypoints import FULL_SCALE, contrast_weight
from pcwlad_geo.matching.maps import (
    Tones,
    maximum_moment,
    oriented_gradients,
    oriented_phase_congruency,
    scene_epsilon,
)
from pcwlad_geo.matching.refinement import ChannelMaps
from pcwlad_geo.matching.speckle import Speckle, find_speckle, has_empty_border
from pcwlad_geo.matching.types import Channels
from pcwlad_geo.types import Bool, Float32, Float64

_NEIGHBOURS: Final = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.float64) / 4

Floating = NDArray[np.floating[Any]]


def fill_smoothly(image: Floating, valid: Bool) -> Floating:
    """Fill invalid pixels with a smooth continuation of the valid ones around them.

    The values of the (rows, cols) `image` are ignored, and may be NaN, where the (rows, cols) bool array
    `valid` is False. The result is a new (rows, cols) array, float32 for float32 input and float64 otherwise,
    with the valid pixels unchanged; zeros if none is valid.
    """
    dtype = np.float32 if image.dtype == np.float32 else np.float64
    known: Floating = np.where(valid, image, 0).astype(dtype)
    if valid.all() or not valid.any():
        return known
    # Around zero, so that float32 keeps its digits and the weights' rounding does not show.
    centre = known[valid].mean(dtype=np.float64).astype(dtype)
    filled = _fill_level(np.where(valid, known - centre, 0).astype(np.float32), valid)
    np.copyto(known, filled + centre, where=~valid, casting="same_kind")
    return known


def _fill_level(known: Float32, valid: Bool) -> Float32:
    """Fill one level from the next coarser one, then relax what was filled; `known` is 0 where invalid."""
    rows, cols = known.shape
    if valid.all() or max(rows, cols) <= 2:
        mean = known.sum() / max(int(valid.sum()), 1)
        return np.where(valid, known, mean).astype(np.float32)
    # Pull: means of the valid pixels only. Push: the coarse level is used only where this one has nothing.
    weight = cv2.pyrDown(valid.astype(np.float32))
    total = cv2.pyrDown(known)
    coarse_valid = weight > np.finfo(np.float32).eps
    coarse = np.divide(total, weight, out=np.zeros_like(total), where=coarse_valid)
    filled = np.asarray(cv2.pyrUp(_fill_level(coarse, coarse_valid), dstsize=(cols, rows)), np.float32)
    known_mask, unknown_mask = valid.astype(np.uint8), (~valid).astype(np.uint8)
    cv2.copyTo(known, known_mask, filled)
    for _ in range(4):
        smoothed = cv2.filter2D(filled, -1, _NEIGHBOURS, borderType=cv2.BORDER_REPLICATE)
        cv2.copyTo(smoothed, unknown_mask, filled)
    return filled


MIN_SMOOTHING_PX: Final = 0.6
"""Sigma of the Gaussian that smooths the maps of images without noise, enough against aliasing."""
MAX_SMOOTHING_PX: Final = 1.5
"""Sigma of the Gaussian that smooths the maps of the noisiest images."""
CLEAN_RATIO: Final = 0.8
"""Noise ratio up to which an image counts as free of noise; real scenes show 0.2 to 0.8."""
WHITE_RATIO: Final = 2.0
"""Noise ratio of white noise."""
MIN_PIXELS: Final = 1024
"""Least number of valid pixels from which noise is measured."""
INDEPENDENT: Final = 0.5
"""Share of noise in the finest detail of a radar image from which speckle of neighbours is independent: it
hangs together, and the share is 0, in terrain-corrected tiles of Sentinel-1."""
DETAIL_OF_UNIT_NOISE: Final = 6 * 0.7979
"""Mean absolute second difference of white noise of unit variance: its gain, 6, times E|z|."""

WHOLE_NUMBERS_RMS: Final = 0.6
"""RMS of the detail up to which an image of whole numbers may show nothing: twice that of rounding."""
COMPRESSED_RMS: Final = 1.0
"""The same of an image of 8 bits in which the blocks of compression show."""

_SECOND_DIFFERENCE: Final = ((1.0, -2.0, 1.0), (-2.0, 4.0, -2.0), (1.0, -2.0, 1.0))


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of an image."""

    ratio: float = 0.0
    """Mean absolute second difference at full over half resolution: 2 for white noise, below 1 for scenes."""
    sigma: float = 0.0
    """Standard deviation of the white part, in units of the image."""
    rounding: float = 0.0
    """RMS of the local detail that whole numbers, or lossy compression, may leave of nothing, in units of the
    image."""
    speckle: Speckle | None = None
    """The multiplicative noise of a radar image; the rest is then that of `Speckle.stabilised` values."""

    @property
    def share(self) -> float:
        """How much of the finest detail is noise, 0 to 1."""
        return float(np.clip((self.ratio - CLEAN_RATIO) / (WHITE_RATIO - CLEAN_RATIO), 0, 1))


def rounding_of(dtype: str, *, compressed: bool = False) -> float:
    """Return the `Noise.rounding` of values of a `dtype`, and of compression with loss.

    Whole numbers are off by 0.29 RMS, and the edges between the steps of a ramp of them are as sharp as any:
    two images of bare walls or of still water agreed on those of theirs.
    """
    return 0.0 if np.dtype(dtype).kind not in "uib" else COMPRESSED_RMS if compressed else WHOLE_NUMBERS_RMS


def measure_noise(image: NDArray[np.floating[Any]], valid: Bool) -> Noise:
    """Measure noise by comparing the finest detail with that at half the resolution, where noise is averaged.

    The (rows, cols) `image` is at full resolution, and the (rows, cols) bool array `valid` says which pixels
    count. All is zero where these are too few.
    """
    return of_whole_image(noise_of_samples([(image, valid)]), image, valid)


def of_whole_image(noise: Noise, image: NDArray[np.floating[Any]], valid: Bool) -> Noise:
    """Return the noise of samples with what only the whole (rows, cols) `image`, or an overview of it, tells.

    The (rows, cols) bool array `valid` says which pixels count.
    """
    if noise.speckle is None:
        return noise
    speckle = replace(noise.speckle, empty_border=has_empty_border(image, valid))
    known = speckle.known(image, valid)
    epsilon = scene_epsilon(speckle.stabilised(image, known), known)
    return replace(noise, speckle=replace(speckle, epsilon=epsilon))


def noise_of_samples(
    samples: Sequence[tuple[NDArray[np.floating[Any]], Bool]], *, may_be_radar: bool = True
) -> Noise:
    """Return the typical noise of an image, of which (rows, cols) `samples` are given with their validity.

    Sums of bands and pictures are not asked whether they `may_be_radar`.
    """
    speckle = find_speckle(samples) if may_be_radar else None
    noise = _typical_noise(samples, speckle)
    if speckle is None or noise.share < INDEPENDENT:
        return noise
    noise_of_it = _typical_noise(samples, speckle.of_independent_pixels)
    return replace(noise_of_it, ratio=noise.ratio)  # what averaging leaves of speckle is as rough as a scene


def _typical_noise(
    samples: Sequence[tuple[NDArray[np.floating[Any]], Bool]], speckle: Speckle | None
) -> Noise:
    found = []
    for image, valid in samples:
        noise = _white_noise(image if speckle is None else speckle.stabilised(image, valid), valid)
        found += [noise] if noise.ratio > 0 else []
    ratio, sigma = np.median([(noise.ratio, noise.sigma) for noise in found or [Noise()]], axis=0)
    return Noise(float(ratio), float(sigma), speckle=speckle)


def _white_noise(image: NDArray[np.floating[Any]], valid: Bool) -> Noise:
    rows, cols = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    fine = np.where(valid, image, 0.0)[:rows, :cols].astype(np.float64)
    fine_valid = np.asarray(valid[:rows, :cols])
    half = cols // 2, rows // 2
    if min(half) == 0:
        return Noise()
    coarse = np.asarray(cv2.resize(fine, half, interpolation=cv2.INTER_AREA), np.float64)
    coarse_valid = (
        fine_valid[::2, ::2] & fine_valid[1::2, ::2] & fine_valid[::2, 1::2] & fine_valid[1::2, 1::2]
    )
    detail, coarse_detail = _mean_detail(fine, fine_valid), _mean_detail(coarse, coarse_valid)
    if coarse_detail <= 0:
        return Noise()
    noise = Noise(ratio=detail / coarse_detail)
    return replace(noise, sigma=noise.share * detail / DETAIL_OF_UNIT_NOISE)


def smoothing_px(*noises: Noise) -> float:
    """Return the Gaussian sigma for the maps of a pair from the noise of its images."""
    share = max((noise.share for noise in noises), default=0.0)
    return MIN_SMOOTHING_PX + (MAX_SMOOTHING_PX - MIN_SMOOTHING_PX) * share


def _mean_detail(image: Float64, valid: Bool) -> float:
    inner = cv2.erode(valid.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    count = cv2.countNonZero(inner)
    if count < MIN_PIXELS:
        return 0.0
    detail = cv2.filter2D(image, -1, np.array(_SECOND_DIFFERENCE))
    return cv2.norm(detail, cv2.NORM_L1, mask=inner) / count


PATCH_PX: Final = 8
"""Side of the patches whose covariance tells the noise."""
BLOCK_PATCHES: Final = 8
"""Side of the blocks of patches in which two images are compared, as their contrasts may differ in sign."""


def noise_level(values: Float64, other: Float64, valid: Bool) -> float:
    """Return the standard deviation of the white noise of an image, in its units; 0 where that is not known.

    Patches vary by nothing but noise and the finest texture along the axes of the smallest eigenvalues of
    their covariance, as many as have their mean and their median alike (Chen, Zhu and Heng 2015,
    doi:10.1109/ICCV.2015.62). What `other`, another band in the same place, varies alike there is texture.
    The (rows, cols) `values` and `other` are finite where `valid`, a (rows, cols) mask of the pixels that
    count in both.
    """
    known = np.asarray(_patches(valid).all(axis=2))
    own, others = (_patches(np.where(valid, image, 0.0)).astype(np.float64) for image in (values, other))
    if np.count_nonzero(known) < 200:
        return 0.0
    variance, axes = np.linalg.eigh(np.cov(own[known], rowvar=False))
    count = len(variance)
    while count > 1 and (variance[:count] > variance[:count].mean()).sum() * 2 < count:
        count -= 1
    alike = _alike(own @ axes[:, :count], others @ axes[:, :count], known)
    return float(np.sqrt(max(float(variance[:count].mean()), 0.0) * (1 - alike)))


def _patches(image: NDArray[Any]) -> NDArray[Any]:
    """Return the (m, k, pixels) patches of an image, each half a patch from the next."""
    side = (PATCH_PX, PATCH_PX)
    views = np.lib.stride_tricks.sliding_window_view(image, side)[:: PATCH_PX // 2, :: PATCH_PX // 2]
    return views.reshape(*views.shape[:2], PATCH_PX**2)


def _alike(own: Float64, other: Float64, known: Bool) -> float:
    """Return the share of the variance of (m, k, c) values that another image has too, 0 to 1.

    Of each image it is taken to be the same, so that their correlation is that share.
    """
    squares = []
    for row in range(0, known.shape[0], BLOCK_PATCHES):
        for col in range(0, known.shape[1], BLOCK_PATCHES):
            block = (slice(row, row + BLOCK_PATCHES), slice(col, col + BLOCK_PATCHES))
            first, second = (each[block][known[block]].ravel() for each in (own, other))
            energy = float((first**2).sum() * (second**2).sum())
            if energy > 0:
                by_chance = 4 / first.size  # every pixel is in four patches
                squares.append(float(first @ second) ** 2 / energy - by_chance)
    return float(np.sqrt(np.clip(np.mean(squares), 0.0, 1.0))) if squares else 0.0


Scalar = TypeVar("Scalar", bound=np.generic)

NO_NOISE: Final = Noise()
"""The noise of an image without noise."""
FILTERS_REACH_PX: Final = 64
"""Beyond this distance a pixel changes the maps of phase congruency by less than 4e-4."""
EDGE_PX: Final = 4
"""Maps count as invalid this near to nodata and image edges, as the filled values influence them."""


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One image, or a window of one."""

    values: Floating
    """(rows, cols)."""
    valid: Bool
    """(rows, cols)."""
    epsilon: float
    """The scene's ε, see `maps.scene_epsilon`."""
    noise: Noise = NO_NOISE
    """The scene's noise."""
    tones: Tones | None = None
    """What the scene's grey values are matched by; None where structure is."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelPair:
    """The channels of two images of the same shape, on which matches are refined."""

    reference: ChannelMaps
    target: ChannelMaps
    threads: int = 1
    """Number of threads that may refine points of this pair."""

    @property
    def turned(self) -> ChannelPair:
        """The same pair with the images exchanged."""
        return ChannelPair(self.target, self.reference, self.threads)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedPair:
    """Maps of two images of the same shape."""

    channels: ChannelPair
    reference_map: MaskedMap
    target_map: MaskedMap
    contrast: Float32
    """(rows, cols) contrast weight of the reference, see `keypoints.contrast_weight`."""


def prepare(
    reference: Image, target: Image, *, channels: Channels, halo_px: int = 0, threads: int = 1
) -> PreparedPair:
    """Compute the maps of both images, of the same shape.

    The `channels` that are matched are six oriented maps of phase congruency, six oriented gradients, or the
    one map M of the paper; of images with tones they are those of their grey values. The filters need
    `halo_px` rows and columns along all four edges, which the result leaves out; `threads` may compute the
    maps, and refine points on them.
    """
    smooth = 0.0 if channels == "moment" else smoothing_px(reference.noise, target.noise)
    reference, target = without_speckle(reference), without_speckle(target)

    def fill(image: Image) -> tuple[Floating, ChannelMaps, MaskedMap]:
        filled = fill_smoothly(image.values, image.valid)
        return filled, *_maps(filled, image, channels, smooth, halo_px)

    both = in_threads([partial(fill, reference), partial(fill, target)], threads)
    (filled, reference_channels, ref_map), (_, target_channels, tgt_map) = both
    contrast = contrast_weight(filled, reference.epsilon, reference.noise.sigma, reference.noise.rounding)
    return PreparedPair(
        ChannelPair(reference_channels, target_channels, threads),
        ref_map,
        tgt_map,
        _inside(contrast, halo_px),
    )


def without_speckle(image: Image) -> Image:
    """Return an image as its maps are made of it: radar stabilised, all others as they are."""
    speckle = image.noise.speckle
    if speckle is None:
        return image
    valid = speckle.known(image.values, image.valid)
    noise = replace(image.noise, rounding=0.0)
    values = speckle.stabilised(image.values, valid).astype(np.float32)
    return Image(values, valid, speckle.epsilon, noise, image.tones)


def _maps(
    filled: Floating, image: Image, channels: Channels, smooth_px: float, halo_px: int
) -> tuple[ChannelMaps, MaskedMap]:
    if image.tones is not None:
        maps, whole = image.tones.maps(filled, image.valid)
        whole *= np.float32(FULL_SCALE)
    elif channels == "gradients":
        maps, whole = oriented_gradients(filled, image.epsilon, smooth_px)
    else:
        rows, cols = _used(image.valid)
        maps = _phase_congruency(filled[rows, cols], image.epsilon, smooth_px)
        if maps.shape[1:] != filled.shape:
            used, maps = maps, np.zeros((len(maps), *filled.shape), np.float32)
            maps[:, rows, cols] = used
        whole = maximum_moment(maps)
    maps, whole = _inside(maps, halo_px), _inside(whole, halo_px)
    kernel = np.ones((2 * EDGE_PX + 1, 2 * EDGE_PX + 1), np.uint8)
    eroded = cv2.erode(image.valid.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    valid = _inside(np.asarray(eroded, bool), halo_px)
    stack = ChannelMaps(whole[None] if channels == "moment" else maps, valid)
    weight = valid.astype(np.float32)
    return stack, MaskedMap(whole * weight, weight, np.float32(FULL_SCALE))


def _used(valid: Bool) -> tuple[slice, slice]:
    """Return the rows and columns that hold valid pixels, and around them what the filters reach."""
    rows, cols = (np.flatnonzero(valid.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return slice(None), slice(None)
    top, left = max(0, rows[0] - FILTERS_REACH_PX), max(0, cols[0] - FILTERS_REACH_PX)
    return slice(top, rows[-1] + 1 + FILTERS_REACH_PX), slice(left, cols[-1] + 1 + FILTERS_REACH_PX)


def _inside(plane: NDArray[Scalar], halo_px: int) -> NDArray[Scalar]:
    """Crop the last two axes by `halo_px` on all sides; the result is a copy, so that the rest is freed."""
    if halo_px == 0:
        return plane
    return plane[..., halo_px : plane.shape[-2] - halo_px, halo_px : plane.shape[-1] - halo_px].copy()


def _phase_congruency(filled: Floating, epsilon: float, smooth_px: float) -> Float32:
    rows, cols = filled.shape
    extra = fast_even(rows) - rows, fast_even(cols) - cols
    padded = np.pad(filled, [(0, extra[0]), (0, extra[1])], mode="reflect") if any(extra) else filled
    maps = oriented_phase_congruency(padded, epsilon, (rows, cols))
    if smooth_px > 0:
        for plane in maps:
            cv2.GaussianBlur(plane, (0, 0), smooth_px, dst=plane)
    return maps
