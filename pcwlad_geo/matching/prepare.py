"""Preparation of a pair: the maps of both images that are matched."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.coarse import MaskedMap
from pcwlad_geo.matching.gaps import fill_smoothly, narrow_gaps, open_share, usable
from pcwlad_geo.matching.grey_values import Tones
from pcwlad_geo.matching.kernels.library import fast_even, in_threads
from pcwlad_geo.matching.keypoints import CORNERS, contrast_weight
from pcwlad_geo.matching.maps import maximum_moment, oriented_gradients, oriented_phase_congruency
from pcwlad_geo.matching.noise import Noise, smoothing_px
from pcwlad_geo.matching.refinement import ChannelMaps
from pcwlad_geo.matching.types import Channels
from pcwlad_geo.types import Bool, Float32, Floating


@dataclass(frozen=True, slots=True)
class MapParameters:
    """How far pixels influence the maps around them."""

    filters_reach_px: int = 64
    """Beyond this distance a pixel changes the maps of phase congruency by less than 4e-4."""
    edge_px: int = 4
    """Maps count as invalid this near to nodata and image edges, as the filled values influence them."""


MAPS: Final = MapParameters()
"""Those in use."""


Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One image, or a window of one."""

    values: Floating
    """(rows, cols)."""
    valid: Bool
    """(rows, cols)."""
    epsilon: float
    """The scene's ε, see `maps.scene_epsilon`."""
    noise: Noise = field(default_factory=Noise)
    """The scene's noise."""
    tones: Tones | None = None
    """What the scene's grey values are matched by; None where structure is."""
    masked: bool = False
    """Whether a mask hides pixels, as of clouds, whose surroundings are doubtful, too: it has no gaps."""


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

    Matched are the `channels`, and of images with tones those of their grey values. The filters need
    `halo_px` rows and columns along all four edges, which the result leaves out. The `threads` may compute
    the maps, and refine points on them.
    """
    smooth = 0.0 if channels == "moment" else smoothing_px(reference.noise, target.noise)
    reference, target = without_speckle(reference), without_speckle(target)

    def fill(image: Image) -> tuple[Floating, ChannelMaps, MaskedMap]:
        filled = fill_smoothly(image.values, image.valid)
        return filled, *_maps(filled, image, channels, smooth, halo_px)

    both = in_threads([partial(fill, reference), partial(fill, target)], threads)
    (filled, reference_channels, ref_map), (_, target_channels, tgt_map) = both
    contrast = contrast_weight(filled, reference.epsilon, reference.noise.sigma, reference.noise.rounding)
    pair = ChannelPair(reference_channels, target_channels, threads)
    return PreparedPair(pair, ref_map, tgt_map, _inside(contrast, halo_px))


def without_speckle(image: Image) -> Image:
    """Return an image as its maps are made of it: radar stabilised, all others as they are."""
    speckle = image.noise.speckle
    if speckle is None:
        return image
    valid = speckle.known(image.values, image.valid)
    noise = replace(image.noise, rounding=0.0)
    values = speckle.stabilised(image.values, valid).astype(np.float32)
    return replace(image, values=values, valid=valid, epsilon=speckle.epsilon, noise=noise)


def _maps(
    filled: Floating, image: Image, channels: Channels, smooth_px: float, halo_px: int
) -> tuple[ChannelMaps, MaskedMap]:
    if image.tones is not None:
        maps, whole = image.tones.maps(filled, image.valid)
        whole *= np.float32(CORNERS.full_scale)
    elif channels == "gradients":
        maps, whole = oriented_gradients(filled, image.epsilon, smooth_px)
    else:
        rows, cols = _used(image.valid)
        maps = _phase_congruency(filled[rows, cols], image.epsilon, smooth_px)
        if maps.shape[1:] != filled.shape:
            part_maps, maps = maps, np.zeros((len(maps), *filled.shape), np.float32)
            maps[:, rows, cols] = part_maps
        whole = maximum_moment(maps)
    maps, whole = _inside(maps, halo_px), _inside(whole, halo_px)
    gaps = narrow_gaps(image.valid | image.masked)
    valid, gaps = (_inside(mask, halo_px) for mask in (usable(image.valid, gaps, MAPS.edge_px), gaps))
    share = open_share(valid, gaps, MAPS.filters_reach_px)
    stack = ChannelMaps(whole[None] if channels == "moment" else maps, valid, share)
    weight = valid.astype(np.float32)
    return stack, MaskedMap(whole * weight, weight, np.float32(CORNERS.full_scale))


def _used(valid: Bool) -> tuple[slice, slice]:
    """Return the rows and columns that hold valid pixels, and around them what the filters reach."""
    rows, cols = (np.flatnonzero(valid.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return slice(None), slice(None)
    reach = MAPS.filters_reach_px
    top, first_col = max(0, rows[0] - reach), max(0, cols[0] - reach)
    return slice(top, rows[-1] + 1 + reach), slice(first_col, cols[-1] + 1 + reach)


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
