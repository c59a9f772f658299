"""Guidance of the second pass by the displacement field of the first one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.matching import field
from pcwlad_geo.matching.both_directions import forward_is_enough
from pcwlad_geo.matching.calibration import shared_variance
from pcwlad_geo.matching.types import MatchSettings, TiePoints
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class GuidanceParameters:
    """How the displacement field guides the second pass."""

    least_points: int = 24
    """Least number of consistent points that a field is fitted to."""
    least_deformation_px: float = 0.05
    """Least deformation, at the corner of a window, that is modelled."""
    most_pull_px: float = 1.0
    """A point farther than this from the prediction of its neighbours keeps its own structure."""
    one_way_from: int = 160
    """Number of points from which those with a predicted structure are matched forward only."""


GUIDANCE: Final = GuidanceParameters()
"""Those in use."""


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
    if len(points) < GUIDANCE.least_points:
        return FieldGuide(np.zeros((len(points), 2, 2)), nowhere, None, 0.0, one_way=False)
    xy, displacement = points.reference_xy_px, points.displacement_px
    linear, linear_sigma = field.global_affine(xy, displacement)
    reach = max(settings.window.all_px) / 2 * np.sqrt(2)
    size = np.abs(linear)
    if size.max() * reach < GUIDANCE.least_deformation_px or (size < 3 * linear_sigma).all():
        linear = np.zeros((2, 2))
    everywhere = np.tile(linear, (len(points), 1, 1))
    one_way = forward_is_enough(points.forward_backward_px, settings)
    choice = field.choose_surface(xy, displacement, settings.window.side_px, threads)
    surface = choice.surface if choice.smooth else None
    if settings.consensus == "off" or surface is None:
        return FieldGuide(everywhere, nowhere, surface, 0.0, one_way)
    predicted = predict(xy, displacement, xy, surface)
    rough = predicted.scatter_px > 3 * np.nanmedian(predicted.scatter_px)
    pulled = np.linalg.norm(displacement - predicted.displacement_px, axis=1) > GUIDANCE.most_pull_px
    structure = np.where((rough | pulled)[:, None], np.nan, predicted.displacement_px)
    shared = shared_variance(xy, choice.residual_px, settings.window.side_px, surface.count)
    linear = _local(everywhere, predicted, reach)
    led_one_way = one_way or len(points) >= GUIDANCE.one_way_from
    return FieldGuide(linear, structure, surface, shared, one_way, led_one_way)


def _local(linear: Float64, predicted: field.Prediction, reach_px: float) -> Float64:
    """Return the deformation at every point from the slopes of the field there, where these matter.

    Without it a window measures the displacement where its structure lies, not at its middle: at the edge of
    the image, where half of it is missing, that is many pixels away.
    """
    size = np.abs(predicted.slope - linear).max(axis=(1, 2)) * reach_px
    by_chance = predicted.scatter_px * np.sqrt(2 * predicted.leverage)
    if not np.nanmedian(size) > max(GUIDANCE.least_deformation_px, 5 * float(np.nanmedian(by_chance))):
        return linear
    finite = np.isfinite(predicted.slope).all(axis=(1, 2), keepdims=True)
    return np.where(finite, predicted.slope, linear)
