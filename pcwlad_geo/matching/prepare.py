"""From two images to what the matcher works on: phase-congruency maps with validity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pcwlad_geo.matching.fill import fill_smoothly
from pcwlad_geo.matching.keypoints import FULL_SCALE, contrast_weight
from pcwlad_geo.matching.noise import Noise, smoothing_px
from pcwlad_geo.matching.phase_congruency import maximum_moment, oriented_phase_congruency
from pcwlad_geo.matching.refinement import ChannelStack
from pcwlad_geo.matching.similarity import MaskedMap

Bool = NDArray[np.bool_]
Floating = NDArray[np.floating[Any]]

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
class PreparedPair:
    """Maps of two images of the same shape."""

    reference: ChannelStack
    target: ChannelStack
    reference_map: MaskedMap
    target_map: MaskedMap
    contrast: NDArray[np.float32]
    """(rows, cols) contrast weight of the reference, see `keypoints.contrast_weight`."""

    @property
    def turned(self) -> PreparedPair:
        """The same pair seen from the target."""
        return PreparedPair(self.target, self.reference, self.target_map, self.reference_map, self.contrast)

    @property
    def reference_moment(self) -> NDArray[np.float32]:
        """(rows, cols) maximum moment of the reference."""
        return self.reference_map.values


def prepare(reference: Image, target: Image, *, oriented: bool) -> PreparedPair:
    """Compute the maps of both images.

    Parameters
    ----------
    reference, target : Image
        Of the same shape.
    oriented : bool
        Channels are the six oriented maps; else the one map M.
    """
    smooth = smoothing_px(reference.noise, target.noise) if oriented else 0.0
    filled = fill_smoothly(reference.values, reference.valid)
    contrast = contrast_weight(filled, reference.epsilon, reference.noise.sigma)
    ref_stack, ref_map = _maps(filled, reference, oriented, smooth)
    filled = fill_smoothly(target.values, target.valid)
    tgt_stack, tgt_map = _maps(filled, target, oriented, smooth)
    return PreparedPair(ref_stack, tgt_stack, ref_map, tgt_map, contrast)


def _maps(filled: Floating, image: Image, oriented: bool, smooth_px: float) -> tuple[ChannelStack, MaskedMap]:
    extra = [fast_even(n) - n for n in filled.shape]
    padded = np.pad(filled, [(0, extra[0]), (0, extra[1])], mode="reflect") if any(extra) else filled
    channels = oriented_phase_congruency(padded, image.epsilon, (filled.shape[0], filled.shape[1]))
    if smooth_px > 0:
        for channel in channels:
            cv2.GaussianBlur(channel, (0, 0), smooth_px, dst=channel)
    moment = maximum_moment(channels)
    valid = _eroded(image.valid)
    stack = ChannelStack.of(channels if oriented else moment[None], valid)
    weight = valid.astype(np.float32)
    return stack, MaskedMap(moment * weight, weight, np.float32(FULL_SCALE))


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
