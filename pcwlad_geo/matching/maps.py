"""Maps that are matched: of structure (phase congruency, oriented gradients), and of grey values.

Where structure tells too little, the grey values of two bands may still depend on each other, whatever their
relation: water is dark in both near infrared and green, fields are bright in one and dark in the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pcwlad_geo.matching.kernels.phase_congruency import (
    ORIENTATIONS,
    combine_orientations,
    filled_up,
    filter_bank,
    oriented_map,
    wedge,
)
from pcwlad_geo.types import Bool, Complex64, Float32, Float64

EPSILON_OF_BYTE_RANGE: Final = 1e-4
"""The ε of the phase congruency for an image of range 255, as in the authors' maps."""
MIN_EPSILON: Final = 1e-30
"""Least ε, which keeps the maps of a constant image finite."""


def scene_epsilon(image: NDArray[np.floating], valid: Bool | None = None) -> float:
    """Return the ε that makes the maps independent of the data's units.

    It is 1e-4 of a 255th of the range that holds 99.9 % of the values; 0 for a constant image. The (rows,
    cols) `image` is the scene, or an overview of it, as one ε serves all tiles; only `valid` pixels count, a
    (rows, cols) bool array.
    """
    values = image if valid is None or valid.all() else image[valid]
    if values.size == 0:
        return 0.0
    low, high = np.percentile(values, (0.05, 99.95))
    return float(EPSILON_OF_BYTE_RANGE * (high - low) / 255.0)


def oriented_phase_congruency(
    image: NDArray[np.floating], epsilon: float, shape: tuple[int, int] | None = None
) -> Float32:
    """Compute one phase-congruency map per orientation, without noise threshold (Kovesi 1999).

    Parameters
    ----------
    image : (rows, cols) array
        Finite values; even sizes are what the filters expect (no padding is done here).
    epsilon : float
        Guards divisions, in units of the image; see `scene_epsilon`.
    shape : (int, int), optional
        Rows and columns wanted, from the first; all by default.

    Returns
    -------
    (6, rows, cols) float32 array
        Values 0 to 1; orientation o is at angle o·π/6.
    """
    centred = (image - image.mean(dtype=np.float64)).astype(np.float32)
    maps = np.empty((ORIENTATIONS, *(shape or image.shape)), np.float32)
    for axis in (0, 1):
        half: Complex64 = scipy.fft.rfft2(centred.T if axis == 0 else centred, workers=1)
        spectrum, bank = (
            (filled_up(half.real), filled_up(half.imag)),
            filter_bank(*image.shape[:: 1 - 2 * axis]),
        )
        turned = maps if axis == 0 else maps.transpose(0, 2, 1)
        for orientation, out in enumerate(turned):
            direction = wedge(orientation, axis, image.shape)
            if direction is not None:
                oriented_map(spectrum, bank, direction, max(epsilon, MIN_EPSILON), out)
    return maps


def maximum_moment(maps: Float32) -> Float32:
    """Combine oriented maps into the maximum moment M of their covariance: the authors' map.

    The (6, rows, cols) float32 `maps` are the phase congruency by orientation (see
    `oriented_phase_congruency`); the result is a (rows, cols) float32 array.
    """
    theta = np.arange(ORIENTATIONS) * np.pi / ORIENTATIONS
    cosine, sine = np.cos(theta), np.sin(theta)
    coefficients = np.stack([cosine**2, sine**2, 2 * cosine * sine]) / (ORIENTATIONS / 2)
    moment = np.empty(maps.shape[1:], np.float32)
    flat = np.ascontiguousarray(maps).reshape(ORIENTATIONS, -1)
    combine_orientations(flat, coefficients.astype(np.float32), moment.reshape(-1))
    return moment


NEIGHBOURHOOD_PX: Final = 4.0
"""Sigma of the Gaussian over which the strength of the gradient is averaged, little more than an edge."""
MIN_STRENGTH: Final = 0.4
"""Strength, in ranges of the scene, that limits the normalisation: weaker gradients stay weak."""
CHANNEL_SCALE: Final = 0.4
"""Factor that brings gradient channels to the range of phase congruency, which the other stages expect."""
STRENGTH_SCALE: Final = 0.15
"""Factor that brings the gradient strength to the range of the maximum moment of phase congruency."""


def oriented_gradients(
    image: NDArray[np.floating[Any]], epsilon: float, smooth_px: float
) -> tuple[Float32, Float32]:
    """Compute one gradient map per orientation, and the gradient strength in which corners are found.

    Parameters
    ----------
    image : (rows, cols) array
        Finite values.
    epsilon : float
        The scene's ε, which stands for its range; see `scene_epsilon`.
    smooth_px : float
        Sigma of the Gaussian that smooths the rectified maps.

    Returns
    -------
    maps : (6, rows, cols) float32 array
        |∂x cos θ - ∂y sin θ| over the local strength; orientation o is at angle θ = o·π/6.
    strength : (rows, cols) float32 array
        The gradient's length over the local strength.
    """
    scale = max(epsilon, MIN_EPSILON) * 255.0 / EPSILON_OF_BYTE_RANGE
    centred = ((image - image.mean(dtype=np.float64)) / scale).astype(np.float32)
    dx, dy = cv2.Sobel(centred, cv2.CV_32F, 1, 0), cv2.Sobel(centred, cv2.CV_32F, 0, 1)
    square = cv2.GaussianBlur((dx * dx + dy * dy) / 2, (0, 0), NEIGHBOURHOOD_PX)
    local = np.sqrt(square) + np.float32(MIN_STRENGTH)
    dx /= local
    dy /= local
    maps = np.empty((ORIENTATIONS, *image.shape), np.float32)
    for orientation, out in enumerate(maps):
        theta = orientation * np.pi / ORIENTATIONS
        cv2.addWeighted(dx, CHANNEL_SCALE * np.cos(theta), dy, -CHANNEL_SCALE * np.sin(theta), 0.0, dst=out)
        np.abs(out, out=out)
        cv2.GaussianBlur(out, (0, 0), smooth_px, dst=out)
    length = cv2.magnitude(dx, dy) * np.float32(STRENGTH_SCALE * np.sqrt(0.5))
    return maps, np.asarray(cv2.GaussianBlur(length, (0, 0), smooth_px), np.float32)


GREY_BLUR_PX: Final = 0.7
"""Sigma of the Gaussian that smooths grey values before they are ranked."""
GREY_REACH_PX: Final = 16.0
"""Sigma of the Gaussian whose mean is taken from the grey values that are matched: what is wider is light,
haze or a slope, which any two images may share."""
GREY_DEVIATIONS: Final = 4.0
"""Distance from 0, in standard deviations, beyond which grey values have the same rank."""
GREY_TONES: Final = 256
"""Number of equal steps in which they are ranked, between which the rank is linear."""
GREY_SCALE: Final = 0.1
"""Factor that brings channels of grey values to the range of phase congruency, as `CHANNEL_SCALE`."""
GREY_MOMENT: Final = 0.2
"""The same for the map in which corners are found, in ranges of the maximum moment."""
MIN_GREY_PIXELS: Final = 4096
"""Least number of pixels that tell how the grey values of two images depend on each other."""


def local_deviation(image: NDArray[np.floating[Any]], valid: Bool, reach_px: float) -> Float32:
    """Return the smoothed grey values of an image less their local mean, of sigma `reach_px`.

    The (rows, cols) bool array `valid` says which pixels of the (rows, cols) `image` count; the result is of
    the same shape, and of any value elsewhere.
    """
    smooth = np.asarray(cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), GREY_BLUR_PX), np.float32)
    weight = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), reach_px)
    mean = cv2.GaussianBlur(np.where(valid, smooth, np.float32(0)), (0, 0), reach_px)
    return np.asarray(smooth - mean / np.maximum(weight, np.float32(1e-3)), np.float32)


@dataclass(frozen=True, slots=True)
class Ranks:
    """The ranks of the local deviations of an image, -1 to 1."""

    largest: float
    """Deviation beyond which all have the same rank, in units of the image."""
    at_tones: tuple[float, ...]
    """Ranks of `GREY_TONES` + 1 equidistant deviations, from the smallest to the largest."""

    @staticmethod
    def of(deviations: Float32) -> Ranks:
        """Measure the ranks of the (n,) `deviations`."""
        largest = GREY_DEVIATIONS * max(float(deviations.std()), 1e-9)
        counts, _ = np.histogram(deviations.clip(-largest, largest), GREY_TONES, (-largest, largest))
        below = np.concatenate([[0], np.cumsum(counts)]) / max(len(deviations), 1)
        return Ranks(largest, tuple((2 * below - 1).tolist()))

    def polynomials(self, deviations: Float32) -> Float32:
        """Return the Legendre polynomials of first and second order of the ranks of (…,) `deviations`.

        The result is of shape (…, 2).
        """
        tones = np.linspace(-self.largest, self.largest, GREY_TONES + 1)
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
        images: tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]], valid: Bool, reach_px: float
    ) -> tuple[Tones, Tones] | None:
        """Measure how the grey values of two images depend on each other where they lie over each other.

        Parameters
        ----------
        images : two (rows, cols) arrays
            In units of the images.
        valid : (rows, cols) bool array
            Pixels that count in both.
        reach_px : float
            Sigma of the local mean, px of these arrays.

        Returns
        -------
        two Tones, or None where too few pixels tell.
        """
        if np.count_nonzero(valid) < MIN_GREY_PIXELS:
            return None
        local = [local_deviation(image, valid, reach_px)[valid] for image in images]
        ranks = [Ranks.of(each) for each in local]
        planes = [each.polynomials(of).astype(np.float64) for each, of in zip(ranks, local, strict=True)]
        means = [each.mean(axis=0) for each in planes]
        whitened = [_whitening(each - mean) for each, mean in zip(planes, means, strict=True)]
        centred = [(each - mean) @ by for each, mean, by in zip(planes, means, whitened, strict=True)]
        left, correlation, right = np.linalg.svd(centred[0].T @ centred[1] / len(centred[0]))
        root = np.sqrt(correlation)
        found = [
            Tones(rank, _pair(mean), (_pair(weights[0]), _pair(weights[1])))
            for rank, mean, weights in zip(
                ranks, means, (whitened[0] @ left * root, whitened[1] @ right.T * root), strict=True
            )
        ]
        return found[0], found[1]

    def maps(self, image: NDArray[np.floating[Any]], valid: Bool) -> tuple[Float32, Float32]:
        """Return the (2, rows, cols) channels of a (rows, cols) `image`, and the map for its corners, 0 to 1.

        The (rows, cols) bool array `valid` says which pixels count.
        """
        planes = self.ranks.polynomials(local_deviation(image, valid, GREY_REACH_PX))
        channels = (planes - np.array(self.mean, np.float32)) @ np.array(self.weights, np.float32)
        whole = np.clip(0.5 + GREY_MOMENT * channels[..., 0], 0, 1)
        return np.ascontiguousarray(np.moveaxis(GREY_SCALE * channels, 2, 0)), whole


def _whitening(centred: Float64) -> Float64:
    """Return the (2, 2) matrix that makes the columns of (n, 2) values uncorrelated, of unit variance."""
    variance, axes = np.linalg.eigh(centred.T @ centred / len(centred))
    return np.asarray(axes / np.sqrt(np.maximum(variance, 1e-6)))


def _pair(values: Float64) -> tuple[float, float]:
    first, second = values.tolist()
    return first, second
