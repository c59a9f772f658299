"""Fits of smoothing thin-plate splines and of the measured field, robust and weighted by covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcwlad_geo.correction.dense import Lattice
from pcwlad_geo.correction.fitted import Fit, Support, Trend, checked
from pcwlad_geo.correction.local_surface import local_surface
from pcwlad_geo.correction.smoothing import SplineTask, smoothing_by_blocks, smoothing_by_score
from pcwlad_geo.correction.splines import SplineCorrection
from pcwlad_geo.correction.thin_plate import (
    THIN_PLATE,
    WINDOWED_SPLINE,
    SplineParameters,
    ThinPlateSystem,
    mean_precision,
    precision_matrices,
)
from pcwlad_geo.estimation.shared_errors import Overlaps, probes_of
from pcwlad_geo.estimation.solving import BandedFactor
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True, eq=False)
class SplineFit(Fit):
    """Fit of a thin-plate spline; its remainder is the displacements minus their robust affine."""

    system: ThinPlateSystem
    smoothing: float
    """λ."""
    footprint_px: float
    parameters: SplineParameters

    def left_out(self, folds: Sequence[Bool], values_px: Sequence[Float64]) -> list[Float64]:
        """Return the (k, 2, m) predictions for each of (n,) `folds` from (n, 2, m) `values_px`.

        See `Fit.left_out`.
        """
        precision = mean_precision(self.whitener, self.estimate.weight)
        predicted = []
        for fold, values in zip(folds, values_px, strict=True):
            of_others = np.where(fold, 0.0, precision)
            factor = self.system.factor(self.system.normal(of_others), self.smoothing)
            flat = of_others[:, None] * values.reshape(len(values), -1)
            prediction = self.system.design[fold] @ factor.solve(self.system.transposed @ flat)
            predicted.append(np.asarray(prediction.reshape(-1, *values.shape[1:])))
        return predicted

    def covariance(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance, px², of the correction at the (n, 2) predicted `at_px`.

        It is the propagated errors of the points plus the expected bias by smoothing a field as rough as this
        one (Nychka 1988, doi:10.1080/01621459.1988.10478711). At more than 400 places it is interpolated
        between at most 400 nodes, so all places should be passed at once.
        """
        at_px = np.asarray(at_px, dtype=np.float64)
        nodes = self.parameters.covariance_nodes
        if len(at_px) <= nodes**2:
            return self._covariance(at_px)
        lattice = Lattice.over(at_px.min(axis=0), at_px.max(axis=0), self.system.grid.spacing_px, nodes)
        values = self._covariance(lattice.nodes_px()).reshape(*lattice.shape, 2, 2)
        return lattice.interpolated(values, at_px)

    def _covariance(self, at_px: Float64) -> Float64:
        normal = self.system.normal(precision_matrices(self.whitener, self.estimate.weight))
        factor = self.system.factor(normal, self.smoothing)
        step = self.parameters.covariance_places
        parts = [
            self._covariance_of_part(factor, at_px[start : start + step])
            for start in range(0, len(at_px), step)
        ]
        return np.concatenate(parts) if parts else np.empty((0, 2, 2))

    def _covariance_of_part(self, factor: BandedFactor, at_px: Float64) -> Float64:
        m = len(at_px)
        design = self.system.grid.design(at_px).toarray().T
        k = len(design)
        right = np.zeros((2, k, m, 2))
        right[0, :, :, 0] = right[1, :, :, 1] = design
        answer = factor.solve(right.reshape(2 * k, 2 * m)).reshape(2, k, 2 * m)
        energy = np.stack([self.system.energy @ answer[axis] for axis in range(2)])
        bias = self.smoothing * _products(answer, energy)
        at_points = np.stack([self.system.design @ answer[axis] for axis in range(2)], axis=1)
        # (n, 2, 2 · m) derivatives of the correction at the places by the whitened observations
        influence = self.estimate.weight[:, None, None] * (self.whitener @ at_points)
        size = np.abs(influence).max(axis=(1, 2))
        influential = size > 1e-3 * size.max()
        influence = influence[influential]
        noise = _products(influence, influence)
        if self.footprint_px > 0:
            shared = Overlaps.of(self.predicted_px[influential], self.footprint_px).times(influence)
            alpha = self.errors.alpha
            noise = (1 - alpha) * noise + alpha * _products(influence, shared)
        return self.errors.scale * (noise + bias)


def _products(one: Float64, other: Float64) -> Float64:
    """Return the (m, 2, 2) sums, over all but the last axis, of products of (..., 2 · m) arrays."""
    pairs = (array.reshape(-1, array.shape[-1] // 2, 2) for array in (one, other))
    return np.asarray(np.einsum("kma,kmb->mab", *pairs))


def fit_tps(
    predicted_px: Float64,
    observed_px: Float64,
    covariance_px2: Float64,
    *,
    footprint_px: float = 0.0,
    trend: Trend | None = None,
    parameters: SplineParameters = THIN_PLATE,
) -> SplineFit:
    """Fit a smoothing thin-plate spline (Duchon 1977, doi:10.1007/BFb0086566), weighted by the covariance.

    It is fitted to the residuals of a robust affine, and continued linearly beyond the box of the points. The
    smoothing minimises the generalised cross-validation score, in which errors that overlapping windows share
    do not count as detail (Opsomer, Wang & Yang 2001). The spline never interpolates the points. Raises
    `InputError` if the points are too few or lie on a line, or an array has a wrong shape or values that are
    not finite. The (n, 2) `predicted_px` and `observed_px` and the (n, 2, 2) `covariance_px2` are those of
    `fit.fit_polynomial`, as are `footprint_px` and `trend`; n ≥ 12, not on one line.
    """
    points = checked("tps", parameters.min_points, predicted_px, observed_px, covariance_px2)
    system = ThinPlateSystem.of(points[0], footprint_px, parameters)
    return _fit_spline("tps", system, points, footprint_px, trend, parameters)


def fit_field(
    predicted_px: Float64,
    observed_px: Float64,
    covariance_px2: Float64,
    *,
    footprint_px: float = 0.0,
    trend: Trend | None = None,
    parameters: SplineParameters = WINDOWED_SPLINE,
) -> SplineFit:
    """Fit the measured field: an affine, plus what the points show beyond it, weighted by the covariance.

    It differs from the thin-plate spline in four ways. Its cells are smaller. A displacement is taken for the
    mean of the field over its window, which restores detail that the windows have averaged. The difference
    from the affine decays to zero in wide holes. And the smoothing minimises the error at left-out blocks of
    one window each, with the errors that these share with their neighbours allowed for. Raises `InputError`
    if the points are too few or lie on a line, or an array has a wrong shape or values that are not finite.
    The (n, 2) `predicted_px` and `observed_px` and the (n, 2, 2) `covariance_px2` are those of
    `fit.fit_polynomial`, as are `footprint_px` and `trend`; n ≥ 12, not on one line.
    """
    points = checked("field", parameters.min_points, predicted_px, observed_px, covariance_px2)
    reach_px = parameters.hole * (Support.of(points[0], footprint_px).reach_px or 1.0)
    system = ThinPlateSystem.of_field(points[0], footprint_px, reach_px, parameters)
    return _fit_spline("field", system, points, footprint_px, trend, parameters)


def _fit_spline(
    name: str,
    system: ThinPlateSystem,
    points: tuple[Float64, Float64, Float64],
    footprint_px: float,
    trend: Trend | None,
    parameters: SplineParameters,
) -> SplineFit:
    """Fit a spline, given its equations, to (predicted, observed, covariance) of points."""
    predicted, observed, covariance = points
    trend = trend or Trend.of(predicted, observed, covariance)
    overlaps = Overlaps.of(predicted, footprint_px)
    remainder = observed - predicted - trend.estimate.fitted_px
    task = SplineTask(system, overlaps, probes_of(predicted), remainder, covariance, parameters)
    start = local_surface(predicted, remainder)
    if name == "field":
        relative_smoothing = smoothing_by_blocks(task, start, footprint_px, predicted)
    else:
        relative_smoothing = smoothing_by_score(task, start)
    estimate = task.fitted(relative_smoothing, start)
    smoothing = system.smoothing(relative_smoothing, mean_precision(estimate.whitener, estimate.weight))
    coefficients = estimate.parameters + trend.terms(system.grid.nodes_px()) @ trend.estimate.parameters
    return SplineFit(
        correction=SplineCorrection(name, system.grid, coefficients.reshape(*system.grid.shape, 2)),
        freedom=2 * estimate.freedom,
        predicted_px=predicted,
        remainder_px=remainder,
        estimate=estimate,
        errors=task.trials(estimate).at(smoothing).errors,
        support=Support.of(predicted[estimate.weight > 0], footprint_px),
        system=system,
        smoothing=smoothing,
        footprint_px=footprint_px,
        parameters=parameters,
    )
