"""Orientation channels of an image, normalised by those around them: what is compared across modalities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.gaps import fill_smoothly, narrow_gaps, usable
from pcwlad_geo.matching.kernels.library import fast_even
from pcwlad_geo.matching.kernels.phase_congruency import ORIENTATIONS
from pcwlad_geo.matching.maps import oriented_phase_congruency, scene_epsilon
from pcwlad_geo.types import Bool, Float32


@dataclass(frozen=True, slots=True)
class ChannelParameters:
    """How channels are computed and normalised, px."""

    padding_px: int = 16
    """Width of the mirrored border that the filters need, their longest wavelength."""
    edge_px: int = 4
    """Channels are not used this close to the border of the image."""
    nodata_edge_px: int = 8
    """Channels are not used this close to invalid pixels."""
    window_px: int = 33
    """Side of the window whose mean and deviation normalise the channels."""
    blur_px: float = 1.0
    """Sigma of the Gaussian that smooths the channels."""


CHANNELS: Final = ChannelParameters()
"""Those that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """Orientation channels of one image at one level, zero where not valid."""

    values: Float32
    """(rows, cols, 6)."""
    valid: Float32
    """(rows, cols) 1 or 0."""


def channels_at(image: NDArray[np.floating[Any]], valid: Bool, factor: int) -> Channels:
    """Decimate the (rows, cols) `image`, and its mask `valid`, and compute its normalised channels."""
    return Channels(*normalised_channels(*_decimate(image, valid, factor)))


def normalised_channels(
    values: Float32, valid: NDArray[np.bool_], by: ChannelParameters = CHANNELS
) -> tuple[Float32, Float32]:
    """Compute the orientation channels of an image, normalised by those around them.

    For the (rows, cols) float32 `values`, of which those in the (rows, cols) bool array `valid` are valid,
    return the (rows, cols, 6) float32 channels, zero where not usable, and a (rows, cols) float32 array that
    is 1 where a channel is not disturbed by the border or by invalid pixels, else 0.
    """
    rows, cols = values.shape
    epsilon = scene_epsilon(values, valid)
    if epsilon == 0.0:
        return np.zeros((rows, cols, ORIENTATIONS), np.float32), np.zeros((rows, cols), np.float32)
    pad = by.padding_px
    sides = [fast_even(n + 2 * pad) for n in (rows, cols)]
    below, right = sides[0] - rows - pad, sides[1] - cols - pad
    filled = np.asarray(fill_smoothly(values, valid), np.float32)
    bordered = cv2.copyMakeBorder(filled, pad, below, pad, right, cv2.BORDER_REFLECT_101)
    padded: Float32 = np.asarray(bordered, np.float32)
    maps = oriented_phase_congruency(padded, epsilon)[:, pad:-below, pad:-right]
    inside = _usable(valid, by)
    return _normalise(np.ascontiguousarray(maps.transpose(1, 2, 0)), inside, by), inside


def _decimate(image: NDArray[np.floating[Any]], valid: Bool, factor: int) -> tuple[Float32, Bool]:
    """Average the valid pixels of every block; a block counts if half of it is valid."""
    rows, cols = (max(n // factor, 1) for n in image.shape)
    inside = np.s_[: rows * factor, : cols * factor]
    blocks = (rows, -1, cols, min(factor, image.shape[1]))
    weight = valid[inside].reshape(blocks).sum(axis=(1, 3))
    total = np.where(valid[inside], image[inside], 0).reshape(blocks).sum(axis=(1, 3), dtype=np.float64)
    half_valid = 2 * weight >= factor**2
    return (total / np.maximum(weight, 1)).astype(np.float32), half_valid


def _usable(valid: Bool, by: ChannelParameters) -> Float32:
    """Return the pixels, 1 or 0, whose filters do not reach over the edge of the valid area or the image."""
    counts = usable(valid, narrow_gaps(valid), by.nodata_edge_px)
    result = np.zeros(valid.shape, np.float32)
    inner = np.s_[by.edge_px : -by.edge_px, by.edge_px : -by.edge_px]
    result[inner] = counts[inner]
    return result


def _normalise(maps: Float32, usable: Float32, by: ChannelParameters) -> Float32:
    """Blur, subtract the local mean of each channel and divide all by the common local deviation.

    So large differences of texture, brightness or vignetting do not correlate, and every part of the image
    has the same weight.
    """
    maps = np.asarray(cv2.GaussianBlur(maps, (0, 0), by.blur_px), np.float32)
    box = (by.window_px, by.window_px)
    weight = np.maximum(cv2.blur(usable, box, borderType=cv2.BORDER_CONSTANT), 1e-6)[..., None]
    mean = cv2.blur(maps * usable[..., None], box, borderType=cv2.BORDER_CONSTANT) / weight
    centred = (maps - mean) * usable[..., None]
    square = (centred**2).sum(axis=2)
    local = cv2.blur(square, box, borderType=cv2.BORDER_CONSTANT) / weight[..., 0]
    floor = square.sum() / max(float(usable.sum()), 1.0)
    deviation = np.sqrt(local + np.float32(0.1 * floor + 1e-12))
    return np.asarray(centred / deviation[..., None], np.float32)
