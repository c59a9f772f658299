"""Guidance of the second pass by the displacement field of the first one, and calibrated sigmas."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from pcwlad_geo.estimation.robust import huber
from pcwlad_geo.estimation.solving import inverse, least_squares
from pcwlad_geo.matching import field
from pcwlad_geo.matching.outliers import MIN_NARROW_PX, NARROW_PX, SCATTERS
from pcwlad_geo.matching.types import TRAITS, MatchSettings, TiePoints
from pcwlad_geo.types import Bool, Float64, Index

DEFAULT_SCALE: Final = 3.0
"""Factor from formal to calibrated sigmas where a scene has too few points to estimate it."""
SCALE_RANGE: Final = (1.5, 12.0)
"""Range to which an estimated factor from formal to calibrated sigmas is clipped."""
MIN_RESIDUALS: Final = 30
"""Least number of points with a known residual from which that factor is estimated."""
MEDIAN_CHI_SQUARE_2: Final = 1.3863
"""Median of the χ² distribution with two degrees of freedom, 2 ln 2."""
MIN_SIGMA_PX: Final = 0.01
"""Sigma per axis that is added to every tie point, in quadrature."""


def sigma_scale(residual_px: Float64, covariance_px2: Float64) -> float:
    """Return the factor from formal to calibrated sigmas.

    The (n, 2) `residual_px` are displacements minus the prediction of independent neighbours (col, row), NaN
    where not known. The (n, 2, 2) `covariance_px2` are formal covariances, px².
    """
    known = np.isfinite(residual_px).all(axis=1)
    if known.sum() < MIN_RESIDUALS:
        return DEFAULT_SCALE
    residual, weight = residual_px[known], inverse(covariance_px2[known] + 1e-8 * np.eye(2))
    squared = np.einsum("ni,nij,nj->n", residual, weight, residual)
    scale = float(np.sqrt(np.median(squared) / MEDIAN_CHI_SQUARE_2))
    return float(np.clip(scale, *SCALE_RANGE))


def shared_variance(xy_px: Float64, residual_px: Float64, window_px: int, neighbours: int) -> float:
    """Return the variance per axis, px², of the error that the guides of a point have in common.

    It is the variance of the mean over the independent windows among them: points whose mutual structure is
    taken where their neighbours predict share the error of that prediction. The (n, 2) `xy_px` are the
    positions of all points, and (n, 2) `residual_px` their displacements minus the prediction of independent
    neighbours (col, row), NaN where not known. So many `neighbours` guide a point; the matching window is
    `window_px` wide.
    """
    radial = np.hypot(residual_px[:, 0], residual_px[:, 1])
    known = radial[np.isfinite(radial)]
    if len(known) < MIN_RESIDUALS:
        return 0.0
    windows = len(np.unique(np.floor(xy_px / window_px).astype(np.intp), axis=0))
    independent = max(1.0, windows * min(1.0, neighbours / len(xy_px)))
    return float(np.median(known) ** 2 / MEDIAN_CHI_SQUARE_2 / independent)


def calibrated(covariance_px2: Float64, scale: float, shared_variance_px2: float | Float64 = 0.0) -> Float64:
    """Return calibrated covariances: scaled formal ones, plus shared variance, plus the least variance.

    The formal (n, 2, 2) `covariance_px2` get the factor `scale` of the sigmas, see `sigma_scale`, and
    `shared_variance_px2`, the variance per axis of errors shared with neighbours, one or (n,), px². The
    result is of shape (n, 2, 2), px².
    """
    common = np.asarray(shared_variance_px2 + MIN_SIGMA_PX**2)
    result: Float64 = covariance_px2 * scale**2 + common[..., None, None] * np.eye(2)
    return result


MIN_DEFORMATION_PX: Final = 0.05
"""Deformations are modelled where they move the corner of a window by more than this."""
MIN_FOR_FIELD: Final = 24
"""Least number of consistent points that a displacement field is fitted to."""
OUTLYING_LIMITS: Final = 5.0
"""A forward-backward error larger than this many times the method's limit counts as outlying."""
MAX_OUTLYING: Final = 0.005
"""Largest share of outlying errors in the sample at which no other point is matched backward."""
LED_ONE_WAY_FROM: Final = 160
"""Number of consistent points from which those with a given structure are not matched backward in the second
pass: the RMSE hardly changes. Of fewer each counts, and their way back takes no time."""
LARGEST_PULL_PX: Final = 1.0
"""A point further than this from the prediction of its neighbours keeps its own structure."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldGuide:
    """What the second pass takes from the displacement field for each of n points."""

    linear: Float64
    """(n, 2, 2) deformation of the windows; zeros where it is negligible."""
    structure_xy_px: Float64
    """(n, 2) shift at which mutual structure is taken; NaN: at the point's own position."""
    surface: field.Surface | None
    """The surface that predicts displacements; None if there are too few points or the field is too rough."""
    shared_variance_px2: float
    """Variance, per axis, of the error that points guided by the same neighbours share."""
    one_way: bool
    """Whether the backward match can be left out, as the forward-backward errors are negligible."""
    led_one_way: bool = False
    """Whether it is left out where the structure is given: the two directions hardly differ there."""

    @property
    def deforms(self) -> bool:
        """Whether windows deform."""
        return bool(self.linear.any())

    @property
    def leads(self) -> Bool:
        """(n,) whether the position at which the structure of a point is taken is given."""
        return np.asarray(np.isfinite(self.structure_xy_px).all(axis=1))

    def part(self, index: Index) -> FieldGuide:
        """Return the guide of the points at the (m,) `index`."""
        return replace(self, linear=self.linear[index], structure_xy_px=self.structure_xy_px[index])

    def moved(self, shift_xy_px: Float64) -> FieldGuide:
        """Return the guide with the constant `shift_xy_px`, (2,) (col, row), added to its shifts."""
        return replace(self, structure_xy_px=self.structure_xy_px + shift_xy_px)


@dataclass(frozen=True, slots=True, eq=False)
class Lost:
    """n candidates without a match, and where their neighbours predict one."""

    reference_xy_px: Float64
    """(n, 2) positions (col, row)."""
    guide: FieldGuide
    """Deformation of their windows, and the shift that is predicted."""
    limit_px: Float64
    """(n,) largest distance of a match from the prediction."""

    def part(self, index: Index) -> Lost:
        """Return those at the (m,) `index`."""
        return Lost(self.reference_xy_px[index], self.guide.part(index), self.limit_px[index])

    def moved(self, reference_xy_px: Float64, target_xy_px: Float64) -> Lost:
        """Return them with constants added to positions in either image.

        The (2,) `reference_xy_px` and `target_xy_px` are (col, row).
        """
        guide = self.guide.moved(target_xy_px - reference_xy_px)
        return replace(self, reference_xy_px=self.reference_xy_px + reference_xy_px, guide=guide)


Predictor = Callable[[Float64, Float64, Float64, field.Surface], field.Prediction]
"""Type of `field.predict`, and of functions that compute the same in other processes."""


def guide_by_field(
    points: TiePoints, settings: MatchSettings, predict: Predictor = field.predict, threads: int = 1
) -> FieldGuide:
    """Fit the displacement field to all consistent points and derive the guidance of the second pass.

    The points are those of the first pass, of the whole scene. What takes most of the time is `predict`,
    which does as `field.predict`, and the choice of the surface, which the `threads` share.
    """
    nowhere = np.full((len(points), 2), np.nan)
    if len(points) < MIN_FOR_FIELD:
        return FieldGuide(np.zeros((len(points), 2, 2)), nowhere, None, 0.0, one_way=False)
    xy, moved = points.reference_xy_px, points.displacement_px
    linear, linear_sigma = field.global_affine(xy, moved)
    reach = max(settings.windows) / 2 * np.sqrt(2)
    if np.abs(linear).max() * reach < MIN_DEFORMATION_PX or (np.abs(linear) < 3 * linear_sigma).all():
        linear = np.zeros((2, 2))
    everywhere = np.tile(linear, (len(points), 1, 1))
    one_way = forward_is_enough(points.forward_backward_px, settings)
    choice = field.choose_surface(xy, moved, settings.window, threads)
    surface = choice.surface if choice.smooth else None
    if settings.consensus == "off" or surface is None:
        return FieldGuide(everywhere, nowhere, surface, 0.0, one_way)
    predicted = predict(xy, moved, xy, surface)
    rough = predicted.scatter_px > 3 * np.nanmedian(predicted.scatter_px)
    pulled = np.linalg.norm(moved - predicted.displacement_px, axis=1) > LARGEST_PULL_PX
    structure = np.where((rough | pulled)[:, None], np.nan, predicted.displacement_px)
    shared = shared_variance(xy, choice.residual_px, settings.window, surface.count)
    linear = _local(everywhere, predicted, reach)
    led_one_way = one_way or len(points) >= LED_ONE_WAY_FROM
    return FieldGuide(linear, structure, surface, shared, one_way, led_one_way)


WINDOW_SAMPLE: Final = 160
"""Number of points that are matched with every window, to choose among them."""
MIN_WINDOW_SAMPLE: Final = 12
"""With fewer points than this the errors of windows are not known."""
MIN_TO_CHOOSE: Final = 60
"""With fewer points than this the window of the first pass is kept."""
WINDOW_GAIN: Final = 0.95
"""Others than the first window are taken where they are expected to leave less than this share of the mean
squared error; so are two instead of one."""
NOISE_POWER: Final = 1.1
"""Power of the side with which the variance of a window's noise falls: windows share noise, so that it is not
the 2 of the area. Measured: 1 to 1.4."""
LARGEST_WEIGHT: Final = 2.0
"""Largest weight of one of two windows: beyond it the difference of the two is mostly noise."""
LARGEST_WINDOW_WEIGHT: Final = 0.3
"""Where the largest window that was tried gets more weight than this, the next larger one is tried."""
TRIED_FIRST: Final = 3
"""Number of windows that are always tried, the smallest."""


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
    """Variance per axis of independent errors times the power `NOISE_POWER` of the side of the window."""
    bend: float
    """Variance per axis of what the window averages away of a displacement that bends, over side⁴, 1/px²."""
    points: int
    """Number of points that tell."""

    def covariance_px2(self, windows_px: Sequence[int]) -> Float64:
        """Return the (k, k) covariance per axis of the errors of k windows at the same point.

        A window knows what those within it do, so that two share the noise of the larger, and what they
        average away has the same sign.
        """
        sides = np.asarray(windows_px, np.float64)
        shared = np.maximum.outer(sides, sides) ** -NOISE_POWER
        return self.noise * shared + self.bend * np.outer(sides**2, sides**2)

    def variance_px2(self, scales: Scales) -> float:
        """Return the variance per axis of the error that the windows leave together."""
        weights = np.asarray(scales.weights)
        return float(weights @ self.covariance_px2(scales.windows_px) @ weights)

    def best(self, windows_px: Sequence[int], first_px: int) -> Scales:
        """Return one or two windows that leave the least error, `first_px` unless others are clearly better.

        Two are weighted by the inverse of their covariance (Gauss-Markov): where the field bends, the smaller
        one gets more than 1, and the larger less than 0.
        """
        first = Scales.of(first_px)
        if self.points < MIN_TO_CHOOSE:
            return first
        single = min(map(Scales.of, windows_px), key=self.variance_px2)
        best = single if self.variance_px2(single) < WINDOW_GAIN * self.variance_px2(first) else first
        pairs = [self._weighted(pair) for pair in combinations(sorted(windows_px), 2)]
        usable = [pair for pair in pairs if max(pair.weights) <= LARGEST_WEIGHT]
        both = min(usable, key=self.variance_px2, default=best)
        return both if self.variance_px2(both) < WINDOW_GAIN * self.variance_px2(best) else best

    def _weighted(self, windows_px: tuple[int, ...]) -> Scales:
        covariance = self.covariance_px2(windows_px)
        size = float(np.trace(covariance))
        if size <= 0:
            return Scales.of(windows_px[-1])
        # without noise the two errors are proportional, and their covariance is singular
        weight = inverse(covariance / size + 1e-6 * np.eye(len(windows_px)))
        weights = weight.sum(axis=0) / weight.sum()
        return Scales(windows_px, tuple(float(weight) for weight in weights))


def tries_larger(scales: Scales, tried_px: Sequence[int]) -> bool:
    """Return whether a larger window than those tried may be better, as the largest of them has weight."""
    return scales.windows_px[-1] == max(tried_px) and scales.weights[-1] > LARGEST_WINDOW_WEIGHT


def window_errors(displacement_px: Float64, windows_px: Sequence[int]) -> WindowErrors | None:
    """Estimate the errors of windows from the displacements that they give at the same points.

    Of two windows, one inside the other, the larger knows what the smaller does: the variance of the
    difference of their results is a (w₁⁻ᵖ - w₂⁻ᵖ) + c (w₂² - w₁²)², with p = 1.1, the noise a and the bend c,
    for which the differences of three or more windows are solved. The (k, n, 2) `displacement_px` (col, row)
    are those of n points by each window, the smallest of the sides `windows_px` first, NaN where one failed.
    None for fewer than three windows or too few points.
    """
    sides = np.asarray(windows_px, np.float64)
    known = np.isfinite(displacement_px).all(axis=(0, 2))
    if len(sides) < 3 or known.sum() < MIN_WINDOW_SAMPLE:
        return None
    difference = np.diff(displacement_px[:, known], axis=0)
    variance = np.median((difference**2).sum(axis=2), axis=1) / MEDIAN_CHI_SQUARE_2
    design = np.stack([-np.diff(sides**-NOISE_POWER), np.diff(sides**2) ** 2], axis=1)
    scale = design.max(axis=0)
    noise, bend = _not_negative(design / scale, variance) / scale
    return WindowErrors(float(noise), float(bend), int(known.sum()))


def _not_negative(design: Float64, wanted: Float64) -> Float64:
    """Return the two factors, not negative, of the columns of `design` whose sum is nearest to `wanted`."""
    both = least_squares(design, wanted)
    if both.min() >= 0.0:
        return both
    alone = np.diag(np.maximum(design.T @ wanted, 0.0) / (design**2).sum(axis=0))
    return np.asarray(alone[((alone @ design.T - wanted) ** 2).sum(axis=1).argmin()])


def forward_is_enough(forward_backward_px: Float64, settings: MatchSettings) -> bool:
    """Return whether the forward-backward errors are small enough for matching in one direction only.

    The (n,) `forward_backward_px` are NaN for points that were not matched backward. The method of the
    settings sets the limit.
    """
    known, limit_px = forward_backward_px[~np.isnan(forward_backward_px)], TRAITS[settings.method].one_way_px
    if len(known) == 0 or (known > OUTLYING_LIMITS * limit_px).mean() > MAX_OUTLYING:
        return False
    return bool(np.sqrt(np.mean(known**2)) <= limit_px)


def expect_lost(
    xy_px: Float64,
    points: TiePoints,
    guide: FieldGuide,
    settings: MatchSettings,
    predict: Predictor = field.predict,
) -> Lost:
    """Predict where the (n, 2) candidates `xy_px` (col, row) without a match lie, from the consistent points.

    The `guide` is what these points make; `predict` does as `field.predict`.
    """
    xy, moved = points.reference_xy_px, points.displacement_px
    if len(points) < MIN_FOR_FIELD:
        xy_px = xy_px[:0]
    surface = guide.surface or field.choose_surface(xy, moved, settings.window).surface
    predicted = predict(xy, moved, xy_px, surface)
    linear = np.tile(guide.linear[:1], (len(xy_px), 1, 1))
    if (guide.linear != guide.linear[:1]).any():
        linear = np.nan_to_num(predicted.slope)
    limit = np.clip(SCATTERS * predicted.scatter_px, MIN_NARROW_PX, NARROW_PX)
    limit[~np.isfinite(predicted.displacement_px).all(axis=1)] = 0.0
    there = replace(guide, linear=linear, structure_xy_px=np.nan_to_num(predicted.displacement_px))
    return Lost(xy_px, there, limit)


def _local(linear: Float64, predicted: field.Prediction, reach_px: float) -> Float64:
    """Return the deformation at every point from the slopes of the field there, where these matter.

    Without it a window measures the displacement where its structure lies, not at its middle: at the edge of
    the image, where half of it is missing, that is many pixels away.
    """
    size = np.abs(predicted.slope - linear).max(axis=(1, 2)) * reach_px
    by_chance = predicted.scatter_px * np.sqrt(2 * predicted.leverage)
    if not np.nanmedian(size) > max(MIN_DEFORMATION_PX, 5 * float(np.nanmedian(by_chance))):
        return linear
    known = np.isfinite(predicted.slope).all(axis=(1, 2), keepdims=True)
    return np.where(known, predicted.slope, linear)


def calibrate(
    points: TiePoints,
    surface: field.Surface | None,
    shared_variance_px2: float | Float64,
    settings: MatchSettings,
    window_variance_px2: float | None = None,
) -> TiePoints:
    """Return consistent points of the whole scene with calibrated covariances.

    The surface is that of the guide, None without a field; so is `shared_variance_px2`, a float or (n,)
    array, the variance per axis of the error that guided points share, px². The prediction of independent
    neighbours tells the more, the more of its residual is the point's own error; `window_variance_px2`, the
    variance per axis that the differences of windows tell, tells the rest, if it is known.
    """
    residual, own = np.full((len(points), 2), np.nan), 0.0
    if surface is not None:
        residual, own = field.independent_residual(
            points.reference_xy_px, points.displacement_px, settings.window, surface
        )
    scale = sigma_scale(residual, points.covariance_px2)
    if window_variance_px2 is not None and len(points):
        formal_px2 = float(np.median(np.trace(points.covariance_px2, axis1=1, axis2=2))) / 2
        by_windows = window_variance_px2 / max(formal_px2, 1e-8)
        known = own if np.isfinite(residual).all(axis=1).sum() >= MIN_RESIDUALS else 0.0
        scale = float(np.clip(np.sqrt(known * scale**2 + (1 - known) * by_windows), *SCALE_RANGE))
    covariance = calibrated(points.covariance_px2, scale, shared_variance_px2)
    return replace(points, covariance_px2=covariance)


SAME_ROWS_PX: Final = 4.0
"""Windows whose rows are less apart lie on the same rows."""
DISJOINT_PX: Final = 90.0
"""Windows of 61 px that are farther apart along the rows share no pixel."""
RESIDUAL_LIMIT_MEDIANS: Final = 4.0
"""Longer residuals, in the median of all, are cut to that."""
MIN_JITTER_PAIRS: Final = 50
"""Least number of pairs of windows of the same rows that tell."""
CLEAR_JITTER: Final = 5.0
"""What they share is jitter beyond so many standard errors; without any it was 3 at most."""


def jitter_px(xy_px: Float64, difference_px: Float64) -> float:
    """Return by how much rows and columns move within a window, RMS, px; 0 where that may be chance.

    The n points have (n, 2) positions `xy_px` (col, row); the (2, n, 2) `difference_px` are their
    displacements by windows of few rows, then of few columns, less those by whole windows; NaN for failures.
    Errors of windows are their own, except for what those of the same rows, far along them, share.
    """
    return float(np.hypot(_shared(xy_px, difference_px[0], 1), _shared(xy_px, difference_px[1], 0)))


def _shared(xy_px: Float64, difference_px: Float64, across: int) -> float:
    known = np.isfinite(difference_px).all(axis=1)
    if np.count_nonzero(known) < 2:
        return 0.0
    left = difference_px[known] - np.median(difference_px[known], axis=0)
    size = np.linalg.norm(left, axis=1)
    left *= huber(np.maximum(size, 1e-9), RESIDUAL_LIMIT_MEDIANS * np.median(size))[:, None]
    distance = np.abs(xy_px[known, None] - xy_px[known])
    first, second = np.nonzero(
        np.triu((distance[..., across] < SAME_ROWS_PX) & (distance[..., 1 - across] > DISJOINT_PX))
    )
    if len(first) < MIN_JITTER_PAIRS:
        return 0.0
    product = (left[first] * left[second]).sum(axis=1)
    error = float(np.sqrt((product**2).mean() / len(product)))
    return float(np.sqrt(product.mean())) if product.mean() > CLEAR_JITTER * error else 0.0
