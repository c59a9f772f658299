"""Fitted corrections: their precision, where tie points support them, and where they extrapolate."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from pcwlad_geo.correction.dense import in_chunks
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import Estimate
from pcwlad_geo.estimation.shared_errors import SharedErrors, parameter_covariance
from pcwlad_geo.estimation.solving import check_observations, solve
from pcwlad_geo.types import Bool, Float64

SPACINGS = 3.0
"""A place this many typical spacings, or a window if that is more, from all tie points is extrapolated."""


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """The tie points of a fit, and the distance up to which they support it."""

    points_px: Float64
    """(n, 2) predicted position (col, row) of the points that count, px."""
    reach_px: float
    """Distance up to which a point supports the correction: half a matching window, or three times the
    typical spacing of the points if that is more, px."""

    @classmethod
    def of(cls, points_px: Float64, footprint_px: float) -> Support:
        """Return the support of the (n, 2) `points_px` (col, row) with windows of side `footprint_px`."""
        spacing = np.sqrt(_hull_area(points_px) / max(len(points_px), 1))
        if spacing == 0 and len(points_px):
            spacing = float(np.hypot(*np.ptp(points_px, axis=0))) / len(points_px)
        return cls(points_px, max(footprint_px / 2, SPACINGS * float(spacing)))

    def extrapolated(self, at_px: Float64) -> Bool:
        """Return the (n,) mask of the (n, 2) `at_px` (col, row) outside the tie points or in a wide hole."""
        distance, _ = cKDTree(self.points_px).query(at_px, distance_upper_bound=self.reach_px)
        return np.asarray(distance > self.reach_px)


def _hull_area(points_px: Float64) -> float:
    try:
        return float(ConvexHull(points_px).volume)  # of a plane figure, scipy's volume is the area
    except (QhullError, ValueError):
        return 0.0  # fewer than three points, or all on a line


@dataclass(frozen=True, slots=True, eq=False)
class Fit(ABC):
    """A correction, and how well the tie points determine it."""

    correction: Correction
    freedom: float
    """Number of parameters, both axes; of a smoothed model the effective number."""
    predicted_px: Float64
    """(n, 2) positions of the tie points (col, row)."""
    remainder_px: Float64
    """(n, 2) part of the displacements to which cross-validation applies `predictions`, px."""
    estimate: Estimate
    errors: SharedErrors
    """How far the points' errors are shared."""
    support: Support
    """Where the tie points support the correction, and where it extrapolates."""

    @property
    def inlier(self) -> Bool:
        """(n,) False where the point has no weight."""
        return self.estimate.weight > 0

    @property
    def variance_floor_px2(self) -> float:
        """Variance per axis of real displacements about the model, beyond the points' covariance, px²."""
        return self.estimate.variance_floor_px2

    @property
    def whitener(self) -> Float64:
        """(n, 2, 2) matrices, 1/px, that make the covariance of a point's residual the identity."""
        return self.estimate.whitener

    @abstractmethod
    def covariance(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance, px², of the correction at the (n, 2) predicted `at_px`."""

    @abstractmethod
    def predictions(self, training: Bool, test: Bool, values_px: Float64) -> Float64:
        """Return the prediction of the model, fitted to the training points alone, at the test points.

        Weights are those of the fit to all points, so this is linear in the values. Raises `InputError` if
        the training points do not determine the model. The (n,) masks `training` and `test` select points, k
        of them for the test; `values_px` are m sets of (n, 2, m) values (col, row) at all points, px. The
        result is of shape (k, 2, m).
        """


class FitFunction(Protocol):
    """Type of the functions that fit a model; see `fit.fit_polynomial` for their parameters."""

    def __call__(
        self,
        predicted_px: Float64,
        observed_px: Float64,
        covariance_px2: Float64,
        *,
        footprint_px: float = 0.0,
    ) -> Fit:
        """Fit the model."""


@dataclass(frozen=True, slots=True, eq=False)
class ParametricFit(Fit):
    """Fit of a model with few parameters; its remainder are the residuals, observed minus model.

    Its `predictions` are one Gauss-Newton step from the fit to all points.
    """

    parameter_covariance: Float64
    """(p, p) covariance of the parameters of `jacobian`, px². Shift: (col, row). Affine: the displacement at
    the points' centre (col, row), then its change over one RMS radius of the points along col (col, row)
    and along row (col, row). Overlapping windows are allowed for."""
    jacobian: Callable[[Float64], Float64]
    """Maps (n, 2) predicted px to the (n, 2, p) derivative of the observed px by the parameters."""

    @classmethod
    def of(
        cls,
        correction: Correction,
        jacobian: Callable[[Float64], Float64],
        predicted_px: Float64,
        observed_px: Float64,
        estimate: Estimate,
        footprint_px: float,
    ) -> ParametricFit:
        """Complete a robust estimate by its precision.

        The (n, 2) arrays `predicted_px` and `observed_px` are target positions (col, row), px. The matching
        window is `footprint_px` wide, 0 for independent errors.
        """
        residual = observed_px - correction.forward(predicted_px)
        covariance, errors = parameter_covariance(
            estimate.whitener @ jacobian(predicted_px),
            estimate.weight,
            np.einsum("iab,ib->ia", estimate.whitener, residual),
            predicted_px,
            footprint_px,
        )
        freedom, support = float(len(covariance)), Support.of(predicted_px[estimate.weight > 0], footprint_px)
        given = (correction, freedom, predicted_px, residual, estimate, errors, support)
        return cls(*given, covariance, jacobian)

    def covariance(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance, px², of the correction at the (n, 2) predicted `at_px`."""

        def propagated(part_px: Float64) -> Float64:
            jacobian = self.jacobian(part_px)
            return jacobian @ self.parameter_covariance @ jacobian.transpose(0, 2, 1)

        return in_chunks(propagated, at_px)

    def predictions(self, training: Bool, test: Bool, values_px: Float64) -> Float64:
        """Return the (k, 2, m) predictions from the (n,) masks `training`, `test` and (n, 2, m) `values_px`.

        See `Fit.predictions`.
        """
        root = np.sqrt(self.estimate.weight[training])[:, None, None] * self.estimate.whitener[training]
        rows = (root @ self.jacobian(self.predicted_px[training])).reshape(-1, len(self.parameter_covariance))
        values = (root @ values_px[training]).reshape(len(rows), -1)
        needs = f"the {self.correction.name} model needs tie points in other parts of the image as well"
        found = solve(rows.T @ rows, rows.T @ values, needs, least=1e-12)
        return self.jacobian(self.predicted_px[test]) @ found


def checked(
    name: str, least: int, predicted_px: Float64, observed_px: Float64, covariance_px2: Float64
) -> tuple[Float64, Float64, Float64]:
    """Return the arrays that every model is fitted to, (n, 2), (n, 2) and (n, 2, 2), as float64.

    They are the (n, 2) `predicted_px` and `observed_px` and the (n, 2, 2) `covariance_px2` of
    `fit.fit_polynomial`, of any real dtype. Raises `InputError`, with the `name` of the model, if there are
    fewer points than `least`, or an array has a wrong shape or values that are not finite.
    """
    arrays = tuple(np.asarray(a, dtype=np.float64) for a in (predicted_px, observed_px, covariance_px2))
    n = len(arrays[0])
    shapes = tuple(a.shape for a in arrays)
    if shapes != ((n, 2), (n, 2), (n, 2, 2)):
        raise InputError(f"tie points of shapes {shapes}: give (n, 2), (n, 2) and (n, 2, 2) arrays")
    if n < least:
        raise InputError(
            f"{n} tie point{'' if n == 1 else 's'} for the {name} model, which needs at least {least}; "
            "use a simpler model, or more tie points"
        )
    check_observations(f"the {n} tie points", *arrays)
    return arrays[0], arrays[1], arrays[2]
