"""From two images to what the matcher works on: maps of their structure, with validity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, TypeVar

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pcwlad_geo.matching.fill import fill_smoothly
from pcwlad_geo.matching.gradient import oriented_gradients
from pcwlad_geo.matching.keypoints import FULL_SCALE, contrast_weight
from pcwlad_geo.matching.noise import Noise, smoothing_px
from pcwlad_geo.matching.phase_congruency import maximum_moment, oriented_phase_congruency
from pcwlad_geo.matching.refinement import ChannelStack
from pcwlad_geo.matching.settings import Channels
from pcwlad_geo.matching.similarity import MaskedMap

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Floating = NDArray[np.floating[Any]]
Scalar = TypeVar("Scalar", bound=np.generic)

NO_NOISE: Final = Noise()
EDGE_PX: Final = 4
"""Maps are not trusted this near to nodata and image edges: the filling shows through."""


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One image, or a window of one."""

    values: Floating
    """(rows, cols)."""
    valid: Bool
    """(rows, cols)."""
    epsilon: float
    """The scene's ε, see `phase_congruency.scene_epsilon`."""
    noise: Noise = NO_NOISE
    """The scene's noise."""


@dataclass(frozen=True, slots=True, eq=False)
class StackPair:
    """What is refined: the channels of two images of the same shape."""

    reference: ChannelStack
    target: ChannelStack

    @property
    def turned(self) -> StackPair:
        """The same pair seen from the target."""
        return StackPair(self.target, self.reference)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedPair:
    """Maps of two images of the same shape."""

    stacks: StackPair
    reference_map: MaskedMap
    target_map: MaskedMap
    contrast: NDArray[np.float32]
    """(rows, cols) contrast weight of the reference, see `keypoints.contrast_weight`."""

    @property
    def reference_moment(self) -> NDArray[np.float32]:
        """(rows, cols) map of the reference that corners are found in."""
        return self.reference_map.values


def prepare(reference: Image, target: Image, *, channels: Channels, halo_px: int = 0) -> PreparedPair:
    """Compute the maps of both images.

    Parameters
    ----------
    reference, target : Image
        Of the same shape.
    channels : {"orientations", "gradients", "moment"}
        What is matched: the six oriented maps of phase congruency, six oriented gradients, or the one
        map M of the paper.
    halo_px : int
        Rows and columns along all four edges that the filters need and the result leaves out.
    """
    smooth = 0.0 if channels == "moment" else smoothing_px(reference.noise, target.noise)
    filled = fill_smoothly(reference.values, reference.valid)
    contrast = contrast_weight(filled, reference.epsilon, reference.noise.sigma)
    ref_stack, ref_map = _maps(filled, reference, channels, smooth, halo_px)
    filled = fill_smoothly(target.values, target.valid)
    tgt_stack, tgt_map = _maps(filled, target, channels, smooth, halo_px)
    return PreparedPair(StackPair(ref_stack, tgt_stack), ref_map, tgt_map, _inside(contrast, halo_px))


def _maps(
    filled: Floating, image: Image, channels: Channels, smooth_px: float, halo_px: int
) -> tuple[ChannelStack, MaskedMap]:
    if channels == "gradients":
        maps, whole = oriented_gradients(filled, image.epsilon, smooth_px)
    else:
        maps = _phase_congruency(filled, image.epsilon, smooth_px)
        whole = maximum_moment(maps)
    maps, whole = _inside(maps, halo_px), _inside(whole, halo_px)
    valid = _inside(_eroded(image.valid), halo_px)
    stack = ChannelStack.of(whole[None] if channels == "moment" else maps, valid)
    weight = valid.astype(np.float32)
    return stack, MaskedMap(whole * weight, weight, np.float32(FULL_SCALE))


def _inside(plane: NDArray[Scalar], halo_px: int) -> NDArray[Scalar]:
    """Return the last two axes without so many pixels on all sides; a copy, so that the rest is freed."""
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


def fast_even(n: int) -> int:
    """Return the least even length from n that transforms fast."""
    length = int(scipy.fft.next_fast_len(n, real=False))
    while length % 2:
        length = int(scipy.fft.next_fast_len(length + 1, real=False))
    return length


def _eroded(valid: Bool) -> Bool:
    kernel = np.ones((2 * EDGE_PX + 1, 2 * EDGE_PX + 1), np.uint8)
    result = cv2.erode(valid.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    return np.asarray(result, bool)
