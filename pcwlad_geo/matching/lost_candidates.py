"""Candidates without a match: where their neighbours predict one, and the attempt to match them there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.matching import field
from pcwlad_geo.matching.both_directions import refine_both
from pcwlad_geo.matching.first_pass import on_valid_target, points_at
from pcwlad_geo.matching.guidance import GUIDANCE, FieldGuide, Predictor
from pcwlad_geo.matching.local_correlation import significantly_correlated
from pcwlad_geo.matching.outliers import OUTLIERS
from pcwlad_geo.matching.prepare import ChannelPair
from pcwlad_geo.matching.refinement import InitialEstimate
from pcwlad_geo.matching.second_pass import rematch_with, step_of
from pcwlad_geo.matching.types import TRAITS, MatchSettings, TiePoints
from pcwlad_geo.matching.window import WINDOWS, MatchingWindow
from pcwlad_geo.matching.windows import Scales
from pcwlad_geo.types import Float64, Index


@dataclass(frozen=True, slots=True)
class RetryParameters:
    """How candidates without a match are tried once more."""

    least_window_px: int = 129
    """Least side of the window."""
    least_correlation: float = 1.0
    """Least correlation at the predicted place, in standard deviations of chance: half of a match's."""
    most_difference_px: float = 0.25
    """Largest difference between the two directions."""


RETRY: Final = RetryParameters()
"""Those in use."""


def try_again(
    pair: ChannelPair, candidates: Lost, settings: MatchSettings, scales: Scales
) -> tuple[TiePoints, Index]:
    """Match candidates without a match once more, where their neighbours predict, in a larger window.

    The structure is taken where the match is: one that is led returns to where it was led, right or wrong.
    Both directions must agree with each other and with the prediction. Matches are then measured with the
    `scales` of the second pass. Return them, in pixel coordinates of the arrays and not yet checked against
    one another, and their (m,) index among the candidates.
    """
    widest = max(settings.template, *settings.window.all_px)  # the arrays reach as far
    largest = max(scales.windows_px)
    window_px = widest if largest >= WINDOWS.largest_px else max(min(RETRY.least_window_px, widest), largest)
    corners = np.floor(candidates.reference_xy_px[:, ::-1]).astype(np.intp)
    # what has nothing in common where it is expected would not pass below, and costs most to measure
    likely = np.flatnonzero(
        significantly_correlated(pair, corners, candidates.guide.structure_xy_px, RETRY.least_correlation)
    )
    candidates, corners = candidates.part(likely), corners[likely]
    refined, _, difference_px = refine_both(
        pair,
        corners,
        InitialEstimate(candidates.guide.structure_xy_px, candidates.guide.linear),
        replace(settings, window=MatchingWindow(window_px)),
        "always",
        step_of(window_px),
    )
    off_px = np.linalg.norm(refined.shift_xy_px - candidates.guide.structure_xy_px, axis=1)
    good = refined.converged & (difference_px < RETRY.most_difference_px) & (off_px < candidates.limit_px)
    good &= on_valid_target(pair, corners, refined.shift_xy_px)
    index = np.flatnonzero(good)
    # a window that is so large sees across a cloud, but nothing was measured in the middle of it
    index = index[significantly_correlated(pair, corners[index], refined.shift_xy_px[index])]
    points = points_at(corners[index], refined.part(index), np.zeros(len(index)), difference_px[index])
    guide = replace(candidates.guide, one_way=False).part(index)
    return rematch_with(pair, points, guide, settings, scales), likely[index]


def can_try_again(settings: MatchSettings) -> bool:
    """Return whether candidates without a match are tried once more."""
    traits = TRAITS[settings.method]
    return traits.refined and traits.structure == "local" and settings.consensus != "off"


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
    xy, displacement = points.reference_xy_px, points.displacement_px
    if len(points) < GUIDANCE.least_points:
        xy_px = xy_px[:0]
    surface = guide.surface or field.choose_surface(xy, displacement, settings.window.side_px).surface
    predicted = predict(xy, displacement, xy_px, surface)
    linear = np.tile(guide.linear[:1], (len(xy_px), 1, 1))
    if (guide.linear != guide.linear[:1]).any():
        linear = np.nan_to_num(predicted.slope)
    limit = np.clip(OUTLIERS.scatters * predicted.scatter_px, OUTLIERS.least_narrow_px, OUTLIERS.narrow_px)
    limit[~np.isfinite(predicted.displacement_px).all(axis=1)] = 0.0
    expected = replace(guide, linear=linear, structure_xy_px=np.nan_to_num(predicted.displacement_px))
    return Lost(xy_px, expected, limit)
