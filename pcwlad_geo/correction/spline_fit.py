"""A fitted thin-plate spline: its precision anywhere, and how it predicts points left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.lattice import Lattice
from pcwlad_geo.correction.models import SplineCorrection
from pcwlad_geo.correction.overlap import SharedErrors
from pcwlad_geo.correction.plate import Factor, Plate, mean_precision
from pcwlad_geo.correction.robust_linear import Estimate
from pcwlad_geo.correction.smoothing import Trial
from pcwlad_geo.correction.support import Support
from pcwlad_geo.correction.windows import Overlaps

Array = NDArray[np.float64]

PLACES = 32
"""Places whose precision is found at once."""
NODES = 20
"""Most nodes along an axis between which the precision at many places is interpolated."""
NEGLIGIBLE = 1e-3
"""Influence of a point, as a share of the largest, below which it is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class SplineFit:
    """Fit of a thin-plate spline."""

    correction: SplineCorrection
    plate: Plate
    estimate: Estimate
    smoothing: float
    """λ."""
    rest_px: Array
    """(n, 2) displacement beyond the affine that the spline was fitted to."""
    predicted_px: Array
    """(n, 2) positions of the tie points (col, row)."""
    footprint_px: float
    errors: SharedErrors
    freedom: float
    """Effective number of parameters, both axes."""
    support: Support

    @classmethod
    def of(
        cls,
        plate: Plate,
        estimate: Estimate,
        trial: Trial,
        straight_px: Array,
        rest_px: Array,
        predicted_px: Array,
        footprint_px: float,
    ) -> SplineFit:
        """Complete a robust estimate by its precision; `straight_px`: (k, 2) coefficients of the affine."""
        coefficients = (estimate.parameters + straight_px).reshape(*plate.grid.shape, 2)
        return cls(
            correction=SplineCorrection("tps", plate.grid, coefficients),
            plate=plate,
            estimate=estimate,
            smoothing=trial.smoothing,
            rest_px=rest_px,
            predicted_px=predicted_px,
            footprint_px=footprint_px,
            errors=trial.errors,
            freedom=2 * estimate.freedom,
            support=Support.of(predicted_px[estimate.weight > 0], footprint_px),
        )

    @property
    def inlier(self) -> NDArray[np.bool_]:
        """(n,) False where the point has no weight."""
        return self.estimate.weight > 0

    @property
    def variance_floor_px2(self) -> float:
        """Variance per axis of real displacements about the model, beyond the points' covariance, px²."""
        return self.estimate.variance_floor_px2

    @property
    def effective_points(self) -> float:
        """Number of independent points that would determine the correction as well as these points do."""
        n = int(np.count_nonzero(self.estimate.weight))
        return min(float(n), self.errors.patches / self.errors.alpha if self.errors.alpha > 0 else n)

    @property
    def whitener(self) -> Array:
        """(n, 2, 2) matrix that makes the covariance of a point's residual the identity."""
        return self.estimate.whitener

    @property
    def remainder_px(self) -> Array:
        """(n, 2) displacement beyond the affine, to which `predictions` applies."""
        return self.rest_px

    def predictions(self, training: NDArray[np.bool_], test: NDArray[np.bool_], values_px: Array) -> Array:
        """Return what the training points' values make of the test points (see `Fit.predictions`)."""
        weight = np.where(training, self.estimate.weight, 0.0)
        precision = mean_precision(self.estimate.whitener, weight)
        factor = self.plate.factor(self.plate.normal(precision), self.smoothing)
        flat = values_px.reshape(len(values_px), -1)
        found = self.plate.design[test] @ factor.solve(self.plate.design.T @ (precision[:, None] * flat))
        return np.asarray(found.reshape(-1, *values_px.shape[1:]))

    def covariance(self, at_px: Array) -> Array:
        """Return the (n, 2, 2) covariance of the correction itself at (n, 2) predicted px, px².

        The errors of the points, propagated, plus what the smoothing is expected to take from a field as
        rough as this one (Nychka 1988, doi:10.1080/01621459.1988.10478711). Asked for at more than 400 places
        it is interpolated between at most so many nodes: ask for all places at once.
        """
        at_px = np.asarray(at_px, dtype=np.float64)
        if len(at_px) <= NODES**2:
            return self._covariance(at_px)
        lattice = Lattice.over(at_px.min(axis=0), at_px.max(axis=0), self.plate.grid.spacing_px, NODES)
        values = self._covariance(lattice.nodes_px()).reshape(*lattice.shape, 2, 2)
        return lattice.interpolated(values, at_px)

    def _covariance(self, at_px: Array) -> Array:
        factor = _factor(self.plate, self.estimate, self.smoothing)
        parts = [
            self._covariance_of_places(factor, at_px[start : start + PLACES])
            for start in range(0, len(at_px), PLACES)
        ]
        return np.concatenate(parts) if parts else np.empty((0, 2, 2))

    def _covariance_of_places(self, factor: Factor, at_px: Array) -> Array:
        m = len(at_px)
        design = self.plate.grid.design(at_px).toarray().T
        k = len(design)
        right = np.zeros((2, k, m, 2))
        right[0, :, :, 0] = right[1, :, :, 1] = design
        answer = factor.solve(right.reshape(2 * k, 2 * m)).reshape(2, k, 2 * m)
        energy = np.stack([self.plate.energy @ answer[axis] for axis in range(2)])
        missed = self.smoothing * _pairs(answer.reshape(2 * k, m, 2), energy.reshape(2 * k, m, 2))
        influence = _influence(self.plate, self.estimate, answer)
        size = np.abs(influence).max(axis=(1, 2))
        near = size > NEGLIGIBLE * size.max()
        influence = influence[near]
        noise = _pairs(influence.reshape(-1, m, 2), influence.reshape(-1, m, 2))
        if self.footprint_px > 0:
            shared = Overlaps.of(self.predicted_px[near], self.footprint_px).times(influence)
            alpha = self.errors.alpha
            noise = (1 - alpha) * noise + alpha * _pairs(
                influence.reshape(-1, m, 2), shared.reshape(-1, m, 2)
            )
        return np.asarray(self.errors.scale * (noise + missed))


def _factor(plate: Plate, estimate: Estimate, smoothing: float) -> Factor:
    whitener = estimate.whitener
    precision = estimate.weight[:, None, None] * (whitener.transpose(0, 2, 1) @ whitener)
    return plate.factor(plate.normal(precision), smoothing)


def _influence(plate: Plate, estimate: Estimate, answer: Array) -> Array:
    """Return how the (n, 2) whitened observations move m combinations of coefficients: (n, 2, m)."""
    moved = np.stack([plate.design @ answer[axis] for axis in range(2)], axis=1)
    return np.asarray(estimate.weight[:, None, None] * (estimate.whitener @ moved))


def _pairs(left: Array, right: Array) -> Array:
    """Return the (m, 2, 2) sums over the first axis of products of (k, m, 2) arrays."""
    return np.asarray(np.einsum("kma,kmb->mab", left, right))
