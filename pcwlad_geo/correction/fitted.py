"""Fitted corrections: their precision, where tie points support them, and where they extrapolate."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from pcwlad_geo.correction.dense import in_chunks
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import ROBUST, Estimate, estimate
from pcwlad_geo.estimation.shared_errors import SharedErrors, parameter_covariance
from pcwlad_geo.estimation.solving import check_observations, solve
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class FitParameters:
    """How models with few parameters are fitted."""

    redundancy: int = 2
    """Number of points needed beyond those that determine a model, without which no outlier shows."""
    max_steps: int = 30
    """Largest number of Gauss–Newton steps."""
    step_px: float = 1e-6
    """A smaller step is the last: the next would be its square over the radius of the points."""


FIT: Final = FitParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """The tie points of a fit, and the distance up to which they support it."""

    points_px: Float64
    """(n, 2) predicted position (col, row) of the points that count, px."""
    reach_px: float
    """Distance up to which a point supports the correction: half a matching window, or three times the
    typical spacing of the points if that is more, px."""

    @classmethod
    def of(cls, points_px: Float64, footprint_px: float, spacings: float = 3.0) -> Support:
        """Return the support of the (n, 2) `points_px` (col, row) with windows of side `footprint_px`.

        A place that is as many typical spacings from all points, or half a window if that is more, is
        extrapolated.
        """
        spacing = np.sqrt(_hull_area(points_px) / max(len(points_px), 1))
        if spacing == 0 and len(points_px):
            spacing = float(np.hypot(*np.ptp(points_px, axis=0))) / len(points_px)
        return cls(points_px, max(footprint_px / 2, spacings * float(spacing)))

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
    """(n, 2) part of the displacements to which cross-validation applies `left_out`, px."""
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
    def left_out(self, folds: Sequence[Bool], values_px: Sequence[Float64]) -> list[Float64]:
        """Return the predictions for each fold of points by the model fitted to the points of the others.

        Weights are those of the fit to all points, so this is linear in the values. Raises `InputError` if
        the points of the others do not determine the model. The `folds` are (n,) masks, and every point is
        in one. For each there are m sets of (n, 2, m) `values_px` (col, row) at all points, px, and a result
        of shape (k, 2, m) for its k points.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """The robust affine of tie points, from which flexible models start."""

    centre_px: Float64
    """(2,) mean predicted position (col, row)."""
    radius_px: float
    """Root mean square distance of the predicted positions from that."""
    estimate: Estimate
    """Its parameters are of `terms`."""

    @staticmethod
    def of(predicted_px: Float64, observed_px: Float64, covariance_px2: Float64) -> Trend:
        """Return the trend of points; raise `InputError` if they do not determine an affine.

        The (n, 2) `predicted_px` and `observed_px` and the (n, 2, 2) `covariance_px2` are those of
        `fit.fit_polynomial`.
        """
        predicted, observed, covariance = checked("affine", 3, predicted_px, observed_px, covariance_px2)
        centre, radius = centre_and_radius(predicted)
        terms = np.column_stack([np.ones(len(predicted)), (predicted - centre) / radius])
        return Trend(centre, radius, estimate(terms, observed - predicted, covariance))

    def terms(self, at_px: Float64) -> Float64:
        """Return the (n, 3) terms 1, col and row, centred and scaled, at the (n, 2) `at_px`."""
        return np.column_stack([np.ones(len(at_px)), (at_px - self.centre_px) / self.radius_px])


def centre_and_radius(at_px: Float64) -> tuple[Float64, float]:
    """Return the (2,) mean of the (n, 2) `at_px`, and their root mean square distance from it or 1."""
    centre = at_px.mean(axis=0)
    return centre, float(np.sqrt(((at_px - centre) ** 2).sum(axis=1).mean())) or 1.0


def gauss_newton(
    start: Float64,
    image: Callable[[Float64], Float64],
    jacobian: Callable[[Float64], Float64],
    needs: str,
    observed_px: Float64,
    root: Float64,
    parameters: FitParameters,
) -> Float64:
    """Return the (p,) values of weighted least squares, by steps from those of the (p,) `start`.

    Of values, `image` gives the (n, 2) places that they expect, px, and `jacobian` the (n, 2, p) derivatives
    of these. The (n, 2) `observed_px` have weights, whose root is the (n, 2, 2) `root`. `needs` says, of "the
    n", why points determine no values.
    """
    values = start
    message = needs.format(f"the {np.count_nonzero(root.any(axis=(1, 2)))}")
    for _ in range(parameters.max_steps):
        rows = (root @ jacobian(values)).reshape(-1, len(values))
        residuals = np.einsum("iab,ib->ia", root, observed_px - image(values)).ravel()
        step = solve(rows.T @ rows, rows.T @ residuals, message, least=ROBUST.collinear**2)
        values = values + step
        if np.abs(step).max() < parameters.step_px:
            break
    return values


class FitFunction(Protocol):
    """Type of the functions that fit a model; see `fit.fit_polynomial` for their parameters."""

    def __call__(
        self,
        predicted_px: Float64,
        observed_px: Float64,
        covariance_px2: Float64,
        *,
        footprint_px: float = 0.0,
        trend: Trend | None = None,
    ) -> Fit:
        """Fit the model."""


@dataclass(frozen=True, slots=True, eq=False)
class ParametricFit(Fit):
    """Fit of a model with few parameters; its remainder are the residuals, observed minus model.

    Its predictions of points left out are one Gauss-Newton step from the fit to all points.
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
        return cls(
            correction=correction,
            freedom=float(len(covariance)),
            predicted_px=predicted_px,
            remainder_px=residual,
            estimate=estimate,
            errors=errors,
            support=Support.of(predicted_px[estimate.weight > 0], footprint_px),
            parameter_covariance=covariance,
            jacobian=jacobian,
        )

    def covariance(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance, px², of the correction at the (n, 2) predicted `at_px`."""

        def propagated(part_px: Float64) -> Float64:
            jacobian = self.jacobian(part_px)
            return jacobian @ self.parameter_covariance @ jacobian.transpose(0, 2, 1)

        return in_chunks(propagated, at_px)

    def left_out(self, folds: Sequence[Bool], values_px: Sequence[Float64]) -> list[Float64]:
        """Return the (k, 2, m) predictions for each of (n,) `folds` from (n, 2, m) `values_px`.

        See `Fit.left_out`.
        """
        jacobian = self.jacobian(self.predicted_px)
        root = np.sqrt(self.estimate.weight)[:, None, None] * self.estimate.whitener
        rows = root @ jacobian
        weighted = (root.transpose(0, 2, 1) @ rows).reshape(-1, rows.shape[2])
        of_folds = np.stack([_inner(rows[fold].reshape(-1, rows.shape[2])) for fold in folds])
        of_others = np.tensordot(1 - np.eye(len(folds)), of_folds, axes=1)  # sums, so that none stays zero
        right = np.stack(
            [
                weighted.T @ np.where(fold[:, None, None], 0.0, values).reshape(len(weighted), -1)
                for fold, values in zip(folds, values_px, strict=True)
            ]
        )
        needs = f"the {self.correction.name} model needs tie points in other parts of the image as well"
        solutions = solve(of_others, right, needs, least=1e-12)
        return [jacobian[fold] @ parameters for fold, parameters in zip(folds, solutions, strict=True)]


def _inner(rows: Float64) -> Float64:
    return np.asarray(rows.T @ rows)


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
