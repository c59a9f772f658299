"""What the displacement field of the first pass tells the second one, and the sigmas.

The first pass finds every point on its own. All of them together show how windows deform, where the
neighbours of a point agree, and how far the formal sigmas are from the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching import calibration, field
from pcwlad_geo.matching.settings import TRAITS, MatchSettings
from pcwlad_geo.matching.tie_points import TiePoints

Float64 = NDArray[np.float64]
Index = NDArray[np.intp]

LEAST_DEFORMATION_PX: Final = 0.05
"""Deformations are modelled where they move the corner of a window by more than this."""
LEAST_FOR_FIELD: Final = 24
OUTLYING: Final = 5.0
"""A way back so many times its limit is no chance;"""
MOST_OUTLYING: Final = 0.005
"""where there is a larger share of them in the sample, there are others outside."""
LARGEST_PULL_PX: Final = 1.0
"""A point further than this from what its neighbours say keeps its own structure."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldGuide:
    """What the displacement field tells the second pass about each point."""

    linear: Float64
    """(n, 2, 2) deformation of the windows; zeros where it is negligible."""
    structure_xy_px: Float64
    """(n, 2) shift at which mutual structure is taken; NaN: at the point's own position."""
    surface: field.Surface | None
    """What predicts a displacement; None where there are too few points, or the field is too rough."""
    shared_variance_px2: float
    """Variance, per axis, of the error that points guided by the same neighbours share."""
    one_way: bool
    """Whether the way back from target to reference can be left out: it ends where it began."""

    @property
    def deforms(self) -> bool:
        """Whether windows deform."""
        return bool(self.linear.any())

    @property
    def leads(self) -> NDArray[np.bool_]:
        """(n,) whether it tells where the structure of a point is taken."""
        return np.asarray(np.isfinite(self.structure_xy_px).all(axis=1))

    def part(self, index: Index) -> FieldGuide:
        """Return the guide of some of the points."""
        return replace(self, linear=self.linear[index], structure_xy_px=self.structure_xy_px[index])

    def moved(self, shift_xy_px: Float64) -> FieldGuide:
        """Return the guide with a constant (col, row) added to its shifts."""
        return replace(self, structure_xy_px=self.structure_xy_px + shift_xy_px)


Predictor = Callable[[Float64, Float64, Float64, field.Surface], field.Prediction]
"""`field.predict`, or what gives the same elsewhere."""


def guide_by_field(
    points: TiePoints, settings: MatchSettings, predict: Predictor = field.predict
) -> FieldGuide:
    """Learn from all consistent points what the second pass needs.

    Parameters
    ----------
    points : TiePoints
        Consistent points of the first pass, of the whole scene.
    settings : MatchSettings
    predict : callable
        What takes most of the time.
    """
    nowhere = np.full((len(points), 2), np.nan)
    if len(points) < LEAST_FOR_FIELD:
        return FieldGuide(np.zeros((len(points), 2, 2)), nowhere, None, 0.0, one_way=False)
    xy, moved = points.reference_xy_px, points.displacement_px
    linear, linear_sigma = field.global_affine(xy, moved)
    reach = settings.window / 2 * np.sqrt(2)
    if np.abs(linear).max() * reach < LEAST_DEFORMATION_PX or (np.abs(linear) < 3 * linear_sigma).all():
        linear = np.zeros((2, 2))
    everywhere = np.tile(linear, (len(points), 1, 1))
    one_way = one_way_is_enough(points.way_back_px, settings)
    choice = field.choose_surface(xy, moved, settings.window)
    surface = choice.surface if choice.smooth else None
    if settings.consensus == "off" or surface is None:
        return FieldGuide(everywhere, nowhere, surface, 0.0, one_way)
    predicted = predict(xy, moved, xy, surface)
    rough = predicted.scatter_px > 3 * np.nanmedian(predicted.scatter_px)
    apart = np.linalg.norm(moved - predicted.displacement_px, axis=1) > LARGEST_PULL_PX
    structure = np.where((rough | apart)[:, None], np.nan, predicted.displacement_px)
    shared = calibration.shared_variance(xy, choice.residual_px, settings.window, surface.count)
    return FieldGuide(_local(everywhere, predicted, reach), structure, surface, shared, one_way)


def one_way_is_enough(way_back_px: Float64, settings: MatchSettings) -> bool:
    """Tell whether points, (n,), of which NaN have not been matched back, come back to where they began."""
    walked, limit_px = way_back_px[~np.isnan(way_back_px)], TRAITS[settings.method].one_way_px
    if len(walked) == 0 or (walked > OUTLYING * limit_px).mean() > MOST_OUTLYING:
        return False
    return bool(np.sqrt(np.mean(walked**2)) <= limit_px)


def _local(linear: Float64, predicted: field.Prediction, reach_px: float) -> Float64:
    """Return the deformation at every point by the slopes of the field there, where these matter.

    A window that is not modelled so finds the displacement of where its structure lies, not of its middle: at
    the edge of the image, where half of it is missing, that is many pixels off.
    """
    size = np.abs(predicted.slope - linear).max(axis=(1, 2)) * reach_px
    by_chance = predicted.scatter_px * np.sqrt(2 * predicted.leverage)
    if not np.nanmedian(size) > max(LEAST_DEFORMATION_PX, 5 * float(np.nanmedian(by_chance))):
        return linear
    known = np.isfinite(predicted.slope).all(axis=(1, 2), keepdims=True)
    return np.where(known, predicted.slope, linear)


def calibrate(
    points: TiePoints,
    surface: field.Surface | None,
    shared_variance_px2: float | Float64,
    settings: MatchSettings,
) -> TiePoints:
    """Return consistent points of the whole scene with calibrated covariances.

    Parameters
    ----------
    points : TiePoints
    surface : Surface, optional
        Of the guide; None where there was no field.
    shared_variance_px2 : float or (n,) array
        Of the guide.
    settings : MatchSettings
    """
    residual = np.full((len(points), 2), np.nan)
    if surface is not None:
        residual = field.independent_residual(
            points.reference_xy_px, points.displacement_px, settings.window, surface
        )
    scale = calibration.sigma_scale(residual, points.covariance_px2)
    covariance = calibration.calibrated(points.covariance_px2, scale, shared_variance_px2)
    return replace(points, covariance_px2=covariance)
