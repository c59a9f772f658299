"""What a fit is: a correction, how well the tie points determine it, and how it predicts points left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.inversion import in_chunks
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.overlap import SharedErrors, parameter_covariance
from pcwlad_geo.correction.robust_linear import Estimate
from pcwlad_geo.correction.support import Support
from pcwlad_geo.errors import InputError

Array = NDArray[np.float64]

DETERMINED = 1e-12
"""Least over largest eigenvalue of normal equations that determine the parameters."""


class Fit(Protocol):
    """A correction, and how well the tie points determine it."""

    @property
    def correction(self) -> Correction:
        """The model with its parameters."""

    @property
    def freedom(self) -> float:
        """Number of parameters, both axes; of a smoothed model the effective number."""

    @property
    def inlier(self) -> NDArray[np.bool_]:
        """(n,) False where the point has no weight."""

    @property
    def variance_floor_px2(self) -> float:
        """Variance per axis of real displacements about the model, beyond the points' covariance, px²."""

    @property
    def effective_points(self) -> float:
        """Number of independent points that would determine the correction as well as these points do."""

    @property
    def support(self) -> Support:
        """Where the tie points support the correction, and where it extrapolates."""

    def covariance(self, at_px: Array) -> Array:
        """Return the (n, 2, 2) covariance of the correction itself at (n, 2) predicted px, px²."""

    @property
    def errors(self) -> SharedErrors:
        """How far the points' errors are shared."""

    @property
    def whitener(self) -> Array:
        """(n, 2, 2) matrix that makes the covariance of a point's residual the identity."""

    @property
    def remainder_px(self) -> Array:
        """(n, 2) part of the displacements that `predictions` is to be applied to for cross-validation."""

    def predictions(self, training: NDArray[np.bool_], test: NDArray[np.bool_], values_px: Array) -> Array:
        """Return what the model, fitted to the training points' values alone, says at the test points.

        Weights are those of the fit to all points, so this is linear in the values.

        Parameters
        ----------
        training, test : (n,) masks
        values_px : (n, 2, m) array of float

        Returns
        -------
        (k, 2, m) array of float

        Raises
        ------
        InputError
            If the training points do not determine the model.
        """


class FitFunction(Protocol):
    """How every model is fitted."""

    def __call__(
        self, predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
    ) -> Fit:
        """Fit the model."""


@dataclass(frozen=True, slots=True, eq=False)
class ParametricFit:
    """Fit of a model with few parameters."""

    correction: Correction
    parameter_covariance: Array
    """(p, p) covariance of the parameters of `jacobian`, px². Shift: (col, row). Affine: the displacement at
    the points' centre (col, row), then what it gains over one RMS radius of the points along col (col, row)
    and along row (col, row). Overlapping windows are allowed for."""
    jacobian: Callable[[Array], Array]
    """Maps (n, 2) predicted px to the (n, 2, p) derivative of the observed px by the parameters."""
    predicted_px: Array
    """(n, 2) positions of the tie points (col, row)."""
    residual_px: Array
    """(n, 2) observed - model, px."""
    estimate: Estimate
    effective_points: float
    errors: SharedErrors
    support: Support

    @classmethod
    def of(
        cls,
        correction: Correction,
        jacobian: Callable[[Array], Array],
        predicted_px: Array,
        observed_px: Array,
        estimate: Estimate,
        footprint_px: float,
    ) -> ParametricFit:
        """Complete a robust estimate by its precision."""
        residual = observed_px - correction.forward(predicted_px)
        covariance, effective, errors = parameter_covariance(
            estimate.whitener @ jacobian(predicted_px),
            estimate.weight,
            np.einsum("iab,ib->ia", estimate.whitener, residual),
            predicted_px,
            footprint_px,
        )
        support = Support.of(predicted_px[estimate.weight > 0], footprint_px)
        return cls(
            correction, covariance, jacobian, predicted_px, residual, estimate, effective, errors, support
        )

    @property
    def freedom(self) -> float:
        """Number of parameters, both axes."""
        return float(len(self.parameter_covariance))

    @property
    def inlier(self) -> NDArray[np.bool_]:
        """(n,) False where the point has no weight."""
        return self.estimate.weight > 0

    @property
    def variance_floor_px2(self) -> float:
        """Variance per axis of real displacements about the model, beyond the points' covariance, px²."""
        return self.estimate.variance_floor_px2

    def covariance(self, at_px: Array) -> Array:
        """Return the (n, 2, 2) covariance of the correction itself at (n, 2) predicted px, px²."""

        def propagated(part_px: Array) -> Array:
            jacobian = self.jacobian(part_px)
            return np.asarray(jacobian @ self.parameter_covariance @ jacobian.transpose(0, 2, 1))

        return in_chunks(propagated, at_px)

    @property
    def whitener(self) -> Array:
        """(n, 2, 2) matrix that makes the covariance of a point's residual the identity."""
        return self.estimate.whitener

    @property
    def remainder_px(self) -> Array:
        """(n, 2) residuals: `predictions` is one Gauss-Newton step from the fit to all points."""
        return self.residual_px

    def predictions(self, training: NDArray[np.bool_], test: NDArray[np.bool_], values_px: Array) -> Array:
        """Return what the training points' values make of the test points (see `Fit.predictions`)."""
        root = np.sqrt(self.estimate.weight[training])[:, None, None] * self.estimate.whitener[training]
        rows = (root @ self.jacobian(self.predicted_px[training])).reshape(-1, len(self.parameter_covariance))
        normal = rows.T @ rows
        eigenvalues = np.linalg.eigvalsh(normal)
        if eigenvalues[0] <= DETERMINED * eigenvalues[-1]:
            raise InputError(
                "without those of one part of the image the tie points do not determine the "
                f"{self.correction.name} model"
            )
        values = (root @ values_px[training]).reshape(len(rows), -1)
        return np.asarray(self.jacobian(self.predicted_px[test]) @ np.linalg.solve(normal, rows.T @ values))


def predicted_sigma(fit: Fit, at_px: Array) -> Array:
    """Return the standard deviation of the correction itself at (n, 2) predicted px: (n, 2) (col, row), px.

    It says how well the model is determined, not how far a single pixel may be off it: real displacements
    about the model add `fit.variance_floor_px2`.
    """
    return np.sqrt(np.diagonal(fit.covariance(at_px), axis1=1, axis2=2))


def checked(
    name: str, least: int, predicted_px: Array, observed_px: Array, covariance_px2: Array
) -> tuple[Array, Array, Array]:
    """Return the arrays that every model is fitted to, as float64.

    Raises
    ------
    InputError
        If there are fewer points than `least`, or an array has a wrong shape or values that are not finite.
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
    if not all(np.isfinite(a).all() for a in arrays):
        raise InputError(f"some of the {n} tie points are not finite; leave them out")
    return arrays[0], arrays[1], arrays[2]
