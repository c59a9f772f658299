"""Speckle of radar images: recognised by its statistics, and averaged and made symmetric before the maps.

The power that returns from even ground to a radar of L looks has a gamma distribution whose standard
deviation is the mean divided by √L. Its cube root is nearly normal, whatever L is, and the root or the
logarithm is not: so the noise itself tells which of them an image holds.

References
----------
.. [1] Goodman, J. W. (1976), doi:10.1364/JOSA.66.001145 (statistics of speckle).
.. [2] Wilson, E. B. and Hilferty, M. M. (1931), doi:10.1073/pnas.17.12.684 (cube root of a gamma variable).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import cv2
import numpy as np

from pcwlad_geo.types import Bool, Float64, Floating

Form = Literal["power", "amplitude", "decibels"]


@dataclass(frozen=True, slots=True)
class SpeckleParameters:
    """How speckle is recognised, and what is done to it."""

    window_px: int = 7
    """Side of the windows whose mean and standard deviation are compared."""
    least_windows: int = 60
    """Least number of windows."""
    most_windows: int = 3000
    """Largest number of windows."""
    least_variation: float = 0.28
    """Least standard deviation over the mean, of power, of the tenth most even windows: about ten looks."""
    least_of_amplitude: float = 0.4
    """The same where values are amplitudes: about five looks."""
    most_spread: float = 1.5
    """Largest ratio of that of the middle of all windows and of these."""
    most_trend: float = 1.5
    """Largest ratio, either way, of the typical one of bright and dark windows: speckle has the same."""
    most_skewness: float = 0.12
    """Largest skewness of the cube root of power within even windows; -0.07 to 0.05 was seen."""
    few_looks: float = 1.6
    """Looks below which power is averaged over neighbours where these are independent."""
    least_power: float = 1e-4
    """What zeros count as in decibels, as a share of the typical power."""
    taps: tuple[float, float, float] = (0.25, 0.5, 0.25)
    """Weights along each axis with which power is averaged: seven times as many looks."""
    decibels: tuple[float, float] = (-100.0, 60.0)
    """Range of the values of backscatter in decibels."""
    largest_of_a_picture: float = 255.0
    """Whole numbers up to this are a picture, of unknown tones and clipped: they are taken as they are."""
    border_px: int = 9
    """A block of zeros as wide as this is no water or shadow if zeros lie along the border, too."""


SPECKLE: Final = SpeckleParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True)
class Speckle:
    """Multiplicative noise of a radar image."""

    form: Form
    """What the values are."""
    looks: float
    """The equivalent number of looks."""
    epsilon: float = 0.0
    """The scene's ε of what `stabilised` returns, see `maps.scene_epsilon`."""
    level: float = 1.0
    """The typical power."""
    scale: Literal["root", "averaged", "logarithm"] = "root"
    """What maps are made of: the cube root of power, that of averaged power, or decibels."""
    empty_border: bool = False
    """Whether blocks of zeros are no data."""

    @property
    def of_independent_pixels(self) -> Speckle:
        """The same where the speckle of neighbours is independent."""
        return replace(self, scale="averaged" if self.looks < SPECKLE.few_looks else "logarithm")

    def known(self, values: Floating, valid: Bool) -> Bool:
        """Return which (rows, cols) `values` count: the (rows, cols) `valid` ones without blocks of zeros."""
        if not self.empty_border:
            return valid
        zero = (valid & (values == 0)).astype(np.uint8)
        solid = cv2.morphologyEx(
            zero, cv2.MORPH_OPEN, np.ones((SPECKLE.border_px, SPECKLE.border_px), np.uint8)
        )
        # what the block's rounded corners left of it
        around = cv2.dilate(solid, np.ones((SPECKLE.border_px, SPECKLE.border_px), np.uint8))
        counted: Bool = valid & ~np.asarray(around & zero, bool)
        return counted

    def stabilised(self, values: Floating, valid: Bool) -> Float64:
        """Return what the maps are made of, see `scale`.

        The (rows, cols) `values` count where the (rows, cols) bool array `valid` says so; the result, of the
        same shape, is 0 elsewhere.
        """
        if (self.scale, self.form) == ("logarithm", "decibels"):
            return np.where(valid, values, 0.0).astype(np.float64)
        power = np.where(valid, _to_power(values, self.form), 0.0)
        if self.scale == "logarithm":
            return np.where(valid, 10 * np.log10(np.maximum(power, SPECKLE.least_power * self.level)), 0.0)
        if self.scale == "averaged":
            taps = np.array(SPECKLE.taps)
            total, weight = (
                cv2.sepFilter2D(plane, cv2.CV_64F, taps, taps, borderType=cv2.BORDER_REFLECT)
                for plane in (power, valid.astype(np.float64))
            )
            power = np.where(valid, total / np.maximum(weight, SPECKLE.taps[0] ** 2), 0.0)
        return np.cbrt(power)


def _to_power(values: Floating, form: Form) -> Float64:
    numbers = np.asarray(values, np.float64)
    if form == "decibels":
        return np.asarray(10.0 ** (np.clip(numbers, *SPECKLE.decibels) / 10.0))
    positive = np.maximum(numbers, 0.0)
    return positive if form == "power" else np.square(positive)


def find_speckle(samples: Sequence[tuple[Floating, Bool]]) -> Speckle | None:
    """Return the speckle of an image, of which (rows, cols) `samples` are given with their validity.

    None where the noise is not multiplicative, or of too many looks to matter.
    """
    windows = _windows(samples)
    if len(windows) < SPECKLE.least_windows:
        return None
    low, high = float(windows.min()), float(windows.max())
    forms: tuple[Form, ...] = ("power", "amplitude")
    if low < 0:
        if low < SPECKLE.decibels[0] or high > SPECKLE.decibels[1]:
            return None
        forms = ("decibels",)
    elif high <= SPECKLE.largest_of_a_picture and bool((windows == np.rint(windows)).all()):
        return None
    looks_by_form = [(_looks_and_skewness(windows, form), form) for form in forms]
    good = [(abs(skewness), looks, form) for (looks, skewness), form in looks_by_form if looks > 0]
    if not good:
        return None
    skewness, looks, form = min(good)
    level = float(np.median(_to_power(windows, form)))
    return Speckle(form, looks, level=level) if skewness <= SPECKLE.most_skewness else None


def _windows(samples: Sequence[tuple[Floating, Bool]]) -> Float64:
    """Return (n, pixels) windows in which all pixels count, and differ."""
    parts = [np.zeros((0, SPECKLE.window_px**2))]
    for values, valid in samples:
        rows, cols = (side // SPECKLE.window_px for side in values.shape)
        shape = rows, SPECKLE.window_px, cols, SPECKLE.window_px
        inside = np.s_[: rows * SPECKLE.window_px, : cols * SPECKLE.window_px]
        whole = valid[inside].reshape(shape).all(axis=(1, 3)).ravel()
        index = np.flatnonzero(whole)[:: max(1, -(-int(whole.sum()) * len(samples) // SPECKLE.most_windows))]
        row, col = np.divmod(index, max(cols, 1))
        pixels = values[inside].reshape(shape)[row, :, col].astype(np.float64)
        parts.append(pixels.reshape(len(index), SPECKLE.window_px**2))
    windows = np.concatenate(parts)
    textured: Float64 = windows[(np.ptp(windows, axis=1) > 0) & (windows != 0).all(axis=1)]
    return textured


def _looks_and_skewness(windows: Float64, form: Form) -> tuple[float, float]:
    """Return the looks of (n, pixels) windows, and the skewness of the cube root of their power.

    Looks are 0 where their standard deviation is not proportional to their mean, or too small.
    """
    power, least_variation = _to_power(windows, form), SPECKLE.least_variation
    if form == "amplitude":
        least_variation = SPECKLE.least_of_amplitude
    mean = power.mean(axis=1)
    variation = power.std(axis=1, ddof=1) / mean
    least, even, middle = np.percentile(variation, (10, 25, 50)).tolist()
    if least < least_variation or middle > SPECKLE.most_spread * least:
        return 0.0, 0.0
    bright = mean > np.median(mean)
    trend = float(np.median(variation[bright]) / np.median(variation[~bright]))
    if not 1 / SPECKLE.most_trend <= trend <= SPECKLE.most_trend:
        return 0.0, 0.0
    root = np.cbrt(power[variation <= middle])
    centred = root - root.mean(axis=1, keepdims=True)
    skewness = (centred**3).mean(axis=1) / (centred**2).mean(axis=1) ** 1.5
    return 1 / even**2, float(np.median(skewness))


def has_empty_border(values: Floating, valid: Bool) -> bool:
    """Return whether blocks of zeros lie along the border of (rows, cols) `values`, (rows, cols) `valid`."""
    zero = (valid & (values == 0)).astype(np.uint8)
    solid = cv2.erode(zero, np.ones((SPECKLE.border_px, SPECKLE.border_px), np.uint8), borderValue=1)
    return bool(solid[0].any() or solid[-1].any() or solid[:, 0].any() or solid[:, -1].any())
