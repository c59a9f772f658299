"""The windows of the second pass: the error that each leaves, and the choice of the best one or two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from pcwlad_geo.estimation.solving import inverse, least_squares
from pcwlad_geo.matching.calibration import MEDIAN_CHI_SQUARE_2
from pcwlad_geo.matching.window import WINDOWS, MatchingWindow
from pcwlad_geo.types import Float64, Index


def sample_size(xy_px: Float64, window: MatchingWindow) -> int:
    """Return how many of the points at (n, 2) `xy_px` tell which side of `window` is best.

    It is 0 where there is one side only, or the points are too few.
    """
    if len(xy_px) < WINDOWS.least_sample or len(window.all_px) == 1:
        return 0
    squares = len(np.unique(np.floor(xy_px / window.side_px), axis=0))
    return min(WINDOWS.sample, WINDOWS.sample_per_window * squares, len(xy_px))


def window_sample(xy_px: Float64, window: MatchingWindow) -> Index:
    """Return the (m,) of the points at (n, 2) `xy_px` that `sample_size` counts, in even steps."""
    count = sample_size(xy_px, window)
    return np.unique(np.linspace(0, len(xy_px) - 1, count).astype(np.intp))


def choose_scales(
    measured: Callable[[Sequence[int]], Float64], window: MatchingWindow
) -> tuple[Scales, WindowErrors | None]:
    """Choose the windows of the second pass, where they are open, and tell the errors of all that were tried.

    Larger windows are tried one after the other, as long as the last one seems good. `measured` gives the (k,
    n, 2) displacements of n points by k windows, as `displacement_by_windows` does.
    """
    windows = window.all_px[: WINDOWS.tried_first]
    displacement = measured(windows)
    larger = [side_px for side_px in window.all_px[WINDOWS.tried_first :] if side_px <= WINDOWS.largest_px]
    while True:
        errors = window_errors(displacement, windows)
        if errors is None or not window.is_open:
            return Scales.of(window.side_px), errors
        scales = errors.best(windows, window.side_px)
        grows = scales.windows_px[-1] == windows[-1] and scales.weights[-1] > WINDOWS.growing_weight
        if not larger or not grows:
            return scales, errors
        windows = (*windows, larger.pop(0))
        displacement = np.concatenate([displacement, measured(windows[-1:])])


@dataclass(frozen=True, slots=True)
class Scales:
    """The windows that points are matched with, and the weight of each in the position."""

    windows_px: tuple[int, ...]
    """One or two sides, the smaller first."""
    weights: tuple[float, ...]
    """Their sum is 1. A negative one extrapolates: what the field bends in the larger window tells how much
    it bends in the smaller."""

    @staticmethod
    def of(window_px: int) -> Scales:
        """Return a single window."""
        return Scales((window_px,), (1.0,))

    @property
    def window_px(self) -> int:
        """Side of the window of most weight."""
        return max(zip(self.weights, self.windows_px, strict=True))[1]


@dataclass(frozen=True, slots=True)
class WindowErrors:
    """The error that windows of any side leave, as their differences at the same points tell."""

    noise: float
    """Variance per axis of independent errors times the power `noise_power` of the side of the window."""
    bend: float
    """Variance per axis of what the window averages away of a displacement that bends, over side⁴, 1/px²."""
    points: int
    """Number of points that tell."""
    bend_sigmas: float
    """Standard errors by which the noise alone fails to explain them."""

    def covariance_px2(self, windows_px: Sequence[int]) -> Float64:
        """Return the (k, k) covariance per axis of the errors of k windows at the same point.

        A window knows what those within it do, so that two share the noise of the larger, and what they
        average away has the same sign.
        """
        sides = np.asarray(windows_px, np.float64)
        shared = np.maximum.outer(sides, sides) ** -WINDOWS.noise_power
        return self.noise * shared + self.bend * np.outer(sides**2, sides**2)

    def variance_px2(self, scales: Scales) -> float:
        """Return the variance per axis of the error that the windows leave together."""
        weights = np.asarray(scales.weights)
        return float(weights @ self.covariance_px2(scales.windows_px) @ weights)

    def bend_px(self, scales: Scales) -> float:
        """Return what the windows together average away of the displacement, RMS of its length, px.

        It is 0 where noise alone explains the differences of the windows.
        """
        if self.bend_sigmas < WINDOWS.least_bend_sigmas:
            return 0.0
        sides = np.asarray(scales.windows_px, np.float64)
        return float(np.sqrt(2 * self.bend) * abs(np.asarray(scales.weights) @ sides**2))

    def best(self, windows_px: Sequence[int], first_px: int) -> Scales:
        """Return one or two windows that leave the least error, `first_px` unless others are clearly better.

        Two are weighted by the inverse of their covariance (Gauss-Markov): where the field bends, the smaller
        one gets more than 1, and the larger less than 0.
        """
        first = Scales.of(first_px)
        if self.points < WINDOWS.least_to_choose:
            return first
        single = min(map(Scales.of, windows_px), key=self.variance_px2)
        best = single if self.variance_px2(single) < WINDOWS.gain * self.variance_px2(first) else first
        pairs = [self._weighted(pair) for pair in combinations(sorted(windows_px), 2)]
        usable = [pair for pair in pairs if max(pair.weights) <= WINDOWS.most_weight]
        both = min(usable, key=self.variance_px2, default=best)
        return both if self.variance_px2(both) < WINDOWS.gain * self.variance_px2(best) else best

    def _weighted(self, windows_px: tuple[int, ...]) -> Scales:
        covariance = self.covariance_px2(windows_px)
        size = float(np.trace(covariance))
        if size <= 0:
            return Scales.of(windows_px[-1])
        # without noise the two errors are proportional, and their covariance is singular
        weight = inverse(covariance / size + 1e-6 * np.eye(len(windows_px)))
        weights = weight.sum(axis=0) / weight.sum()
        return Scales(windows_px, tuple(float(weight) for weight in weights))


def window_errors(displacement_px: Float64, windows_px: Sequence[int]) -> WindowErrors | None:
    """Estimate the errors of windows from the displacements that they give at the same points.

    Of two windows, one inside the other, the variance of the difference is a (w₁⁻ᵖ - w₂⁻ᵖ) + c (w₂² - w₁²)²,
    with p = 1.1: the differences of three or more windows give the noise a and the bend c. The (k, n, 2)
    `displacement_px` (col, row) are those of n points by each of the `windows_px`, the smallest first, NaN
    where one failed. None for fewer than three windows or too few points.
    """
    sides = np.asarray(windows_px, np.float64)
    finite = np.isfinite(displacement_px).all(axis=(0, 2))
    if len(sides) < 3 or finite.sum() < WINDOWS.least_sample:
        return None
    difference = np.diff(displacement_px[:, finite], axis=0)
    variance = np.median((difference**2).sum(axis=2), axis=1) / MEDIAN_CHI_SQUARE_2
    design = np.stack([-np.diff(sides**-WINDOWS.noise_power), np.diff(sides**2) ** 2], axis=1)
    scale = design.max(axis=0)
    noise, bend = _not_negative(design / scale, variance) / scale
    points = int(finite.sum())
    # the median of n exponential values scatters by this share of itself
    standard_error = np.maximum(variance, 1e-12) / (np.log(2) * np.sqrt(points))
    by_noise, seen = design[:, :1] / standard_error[:, None], variance / standard_error
    misfit = float(np.linalg.norm(seen - by_noise @ least_squares(by_noise, seen)))
    return WindowErrors(float(noise), float(bend), points, misfit)


def _not_negative(design: Float64, values: Float64) -> Float64:
    """Return the two factors, not negative, of the columns of `design` whose sum is nearest to `values`."""
    both = least_squares(design, values)
    if both.min() >= 0.0:
        return both
    single = np.diag(np.maximum(design.T @ values, 0.0) / (design**2).sum(axis=0))
    return np.asarray(single[((single @ design.T - values) ** 2).sum(axis=1).argmin()])
