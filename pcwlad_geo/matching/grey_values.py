"""Grey values that are matched: channels of two bands whose values depend on each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from pcwlad_geo.matching.maps import LARGEST_RANGE
from pcwlad_geo.types import Bool, Float32, Float64, Floating


@dataclass(frozen=True, slots=True)
class GreyParameters:
    """How grey values become channels that are matched."""

    blur_px: float = 0.7
    """Sigma of the Gaussian before they are ranked."""
    reach_px: float = 16.0
    """Sigma of the Gaussian whose mean is taken from them: what is wider is light, haze or a slope."""
    deviations: float = 4.0
    """Distance from 0, in standard deviations, beyond which all have the same rank."""
    tones: int = 256
    """Number of equal steps in which they are ranked, between which the rank is linear."""
    scale: float = 0.1
    """Factor that brings the channels to the range of phase congruency."""
    moment: float = 0.2
    """The same for the map in which corners are detected."""
    least_pixels: int = 4096
    """Least number of pixels that show how two images depend on each other."""


GREY: Final = GreyParameters()
"""Those in use."""


def local_deviation(image: Floating, valid: Bool, reach_px: float) -> Float32:
    """Return the smoothed grey values of an image less their local mean, of sigma `reach_px`.

    The (rows, cols) bool array `valid` says which pixels of the (rows, cols) `image` count; the result is of
    the same shape, and of any value elsewhere.
    """
    smooth = np.asarray(cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), GREY.blur_px), np.float32)
    weight = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), reach_px)
    mean = cv2.GaussianBlur(np.where(valid, smooth, np.float32(0)), (0, 0), reach_px)
    return np.asarray(smooth - mean / np.maximum(weight, np.float32(1e-3)), np.float32)


@dataclass(frozen=True, slots=True)
class Ranks:
    """The ranks of the local deviations of an image, -1 to 1."""

    largest: float
    """Deviation beyond which all have the same rank, in units of the image."""
    at_tones: tuple[float, ...]
    """Ranks of `GreyParameters.tones` + 1 equidistant deviations, from the smallest to the largest."""

    @staticmethod
    def of(deviations: Float32) -> Ranks:
        """Measure the ranks of the (n,) `deviations`."""
        squares = np.float64 if np.ptp(deviations) > LARGEST_RANGE else np.float32
        largest = GREY.deviations * max(float(deviations.std(dtype=squares)), 1e-9)
        counts, _ = np.histogram(deviations.clip(-largest, largest), GREY.tones, (-largest, largest))
        below = np.concatenate([[0], np.cumsum(counts)]) / max(len(deviations), 1)
        return Ranks(largest, tuple((2 * below - 1).tolist()))

    def polynomials(self, deviations: Float32) -> Float32:
        """Return the Legendre polynomials of first and second order of the ranks of (…,) `deviations`.

        The result is of shape (…, 2).
        """
        tones = np.linspace(-self.largest, self.largest, GREY.tones + 1)
        rank = np.interp(deviations, tones, self.at_tones).astype(np.float32)
        return np.stack([rank, 1.5 * rank**2 - 0.5], axis=-1)


@dataclass(frozen=True, slots=True)
class Tones:
    """Turns the grey values of one of two images into channels that correlate with those of the other.

    These are the canonical variates of both images' rank polynomials (Hotelling 1936, doi:10.2307/2333955),
    each weighted by the root of its correlation: so the sum of the products of the channels is how far the
    grey values depend on each other.
    """

    ranks: Ranks
    mean: tuple[float, float]
    """Means of the polynomials."""
    weights: tuple[tuple[float, float], tuple[float, float]]
    """Channels are (polynomials - mean) · weights."""

    @staticmethod
    def of_pair(
        images: tuple[Floating, Floating], valid: Bool, reach_px: float
    ) -> tuple[Tones, Tones] | None:
        """Measure how the grey values of two images depend on each other where they lie over each other.

        The two `images` are (rows, cols) arrays, the (rows, cols) bool array `valid` has the pixels that
        count in both, and `reach_px` is the sigma of the local mean, px of these arrays. None where too few
        pixels count.
        """
        if np.count_nonzero(valid) < GREY.least_pixels:
            return None
        local = [local_deviation(image, valid, reach_px)[valid] for image in images]
        ranks = [Ranks.of(item) for item in local]
        planes = [
            item.polynomials(deviations).astype(np.float64)
            for item, deviations in zip(ranks, local, strict=True)
        ]
        means = [item.mean(axis=0) for item in planes]
        whitened = [_whitening(item - mean) for item, mean in zip(planes, means, strict=True)]
        centred = [(item - mean) @ by for item, mean, by in zip(planes, means, whitened, strict=True)]
        first_axes, correlation, second_axes = np.linalg.svd(centred[0].T @ centred[1] / len(centred[0]))
        root = np.sqrt(correlation)
        tones = [
            Tones(rank, _pair(mean), (_pair(weights[0]), _pair(weights[1])))
            for rank, mean, weights in zip(
                ranks,
                means,
                (whitened[0] @ first_axes * root, whitened[1] @ second_axes.T * root),
                strict=True,
            )
        ]
        return tones[0], tones[1]

    def maps(self, image: Floating, valid: Bool) -> tuple[Float32, Float32]:
        """Return the (2, rows, cols) channels of a (rows, cols) `image`, and the map for its corners, 0 to 1.

        The (rows, cols) bool array `valid` says which pixels count.
        """
        planes = self.ranks.polynomials(local_deviation(image, valid, GREY.reach_px))
        channels = (planes - np.array(self.mean, np.float32)) @ np.array(self.weights, np.float32)
        whole = np.clip(0.5 + GREY.moment * channels[..., 0], 0, 1)
        return np.ascontiguousarray(np.moveaxis(GREY.scale * channels, 2, 0)), whole


def _whitening(centred: Float64) -> Float64:
    """Return the (2, 2) matrix that makes the columns of (n, 2) values uncorrelated, of unit variance."""
    variance, axes = np.linalg.eigh(centred.T @ centred / len(centred))
    return np.asarray(axes / np.sqrt(np.maximum(variance, 1e-6)))


def _pair(values: Float64) -> tuple[float, float]:
    first, second = values.tolist()
    return first, second
