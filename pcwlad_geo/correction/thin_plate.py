"""Robust fit of smoothing thin-plate splines, weighted by the covariance of the points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcwlad_geo.correction.dense import Lattice
from pcwlad_geo.correction.fitted import Fit, Support, checked
from pcwlad_geo.correction.models import SplineCorrection
from pcwlad_geo.correction.points import cross_validation_blocks, local_surface
from pcwlad_geo.correction.thin_plate_system import (
    Factor,
    Successive,
    ThinPlateSystem,
    Trials,
    best,
    mean_precision,
)
from pcwlad_geo.estimation.robust import Estimate, Solution, estimate, reweighted
from pcwlad_geo.estimation.shared_errors import Overlaps, probes_of, random_signs
from pcwlad_geo.types import Bool, Float64

LATTICE_SIDE = 32
"""Number of places whose precision is computed at once."""
NODES = 20
"""Largest number of nodes along an axis between which the precision at many places is interpolated."""
NEGLIGIBLE = 1e-3
"""Influence of a point, as a share of the largest, up to which it is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class SplineFit(Fit):
    """Fit of a thin-plate spline; its remainder are the displacements beyond the affine."""

    system: ThinPlateSystem
    smoothing: float
    """λ."""
    footprint_px: float

    def predictions(self, training: Bool, test: Bool, values_px: Float64) -> Float64:
        """Return the (k, 2, m) predictions from the (n,) masks `training`, `test` and (n, 2, m) `values_px`.

        See `Fit.predictions`.
        """
        weight = np.where(training, self.estimate.weight, 0.0)
        precision = mean_precision(self.estimate.whitener, weight)
        factor = self.system.factor(self.system.normal(precision), self.smoothing)
        flat = values_px.reshape(len(values_px), -1)
        found = self.system.design[test] @ factor.solve(self.system.design.T @ (precision[:, None] * flat))
        return np.asarray(found.reshape(-1, *values_px.shape[1:]))

    def covariance(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance, px², of the correction at the (n, 2) predicted `at_px`.

        It is the propagated errors of the points plus the expected bias by smoothing a field as rough as this
        one (Nychka 1988, doi:10.1080/01621459.1988.10478711). At more than 400 places it is interpolated
        between at most as many nodes, so all places should be passed at once.
        """
        at_px = np.asarray(at_px, dtype=np.float64)
        if len(at_px) <= NODES**2:
            return self._covariance(at_px)
        lattice = Lattice.over(at_px.min(axis=0), at_px.max(axis=0), self.system.grid.spacing_px, NODES)
        values = self._covariance(lattice.nodes_px()).reshape(*lattice.shape, 2, 2)
        return lattice.interpolated(values, at_px)

    def _covariance(self, at_px: Float64) -> Float64:
        factor = _factor(self.system, self.estimate, self.smoothing)
        parts = [
            self._covariance_of_places(factor, at_px[start : start + LATTICE_SIDE])
            for start in range(0, len(at_px), LATTICE_SIDE)
        ]
        return np.concatenate(parts) if parts else np.empty((0, 2, 2))

    def _covariance_of_places(self, factor: Factor, at_px: Float64) -> Float64:
        m = len(at_px)
        design = self.system.grid.design(at_px).toarray().T
        k = len(design)
        right = np.zeros((2, k, m, 2))
        right[0, :, :, 0] = right[1, :, :, 1] = design
        answer = factor.solve(right.reshape(2 * k, 2 * m)).reshape(2, k, 2 * m)
        energy = np.stack([self.system.energy @ answer[axis] for axis in range(2)])
        missed = self.smoothing * _pairs(answer.reshape(2 * k, m, 2), energy.reshape(2 * k, m, 2))
        influence = _influence(self.system, self.estimate, answer)
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


def _factor(system: ThinPlateSystem, estimate: Estimate, smoothing: float) -> Factor:
    whitener = estimate.whitener
    precision = estimate.weight[:, None, None] * (whitener.transpose(0, 2, 1) @ whitener)
    return system.factor(system.normal(precision), smoothing)


def _influence(system: ThinPlateSystem, estimate: Estimate, answer: Float64) -> Float64:
    """Return the (n, 2, m) derivatives of m combinations of coefficients by the whitened observations."""
    moved = np.stack([system.design @ answer[axis] for axis in range(2)], axis=1)
    return np.asarray(estimate.weight[:, None, None] * (estimate.whitener @ moved))


def _pairs(left: Float64, right: Float64) -> Float64:
    """Return the (m, 2, 2) sums over the first axis of products of (k, m, 2) arrays."""
    return np.asarray(np.einsum("kma,kmb->mab", left, right))


MIN_POINTS = 12
"""Least number of tie points of a thin-plate spline."""
STIFF = 0.02
"""Stiffness over side⁴ at which the softest mode of a square plate is reduced to a tenth."""
FACTOR = 4.0
"""Ratio of successive stiffnesses tried, which doubles the effective number of parameters."""
MAX_STEPS = 14
"""Largest number of stiffnesses tried."""
HOLE = 2.0
"""A field returns to the affine over so many times the distance up to which a point supports a correction."""
FINER_STEPS = 6
"""Number of stiffnesses that are compared by cross-validation."""
FOLD_COEFFICIENTS = 8000
"""Number of coefficients, those of a spline times the folds, up to which more folds are computed."""
MIN_FOLDS = 4
"""Least number of folds."""
PROBES = 8
"""Number of random sign vectors that estimate the errors shared with a fold."""
TOLERANCE_PX = 1e-3
"""The reweighting ends where the spline changes by less than this at every point."""


def fit_tps(
    predicted_px: Float64, observed_px: Float64, covariance_px2: Float64, *, footprint_px: float = 0.0
) -> SplineFit:
    """Fit a smoothing thin-plate spline (Duchon 1977, doi:10.1007/BFb0086566), weighted by the covariance.

    It is fitted to the residuals of a robust affine, and continued linearly beyond the box of the points. The
    smoothing minimises the generalised cross-validation score, in which errors that overlapping windows share
    do not count as detail (Opsomer, Wang & Yang 2001). The spline never interpolates the points. Raises
    `InputError` if the points are too few or lie on a line, or an array has a wrong shape or values that are
    not finite.

    Parameters
    ----------
    predicted_px, observed_px, covariance_px2 : (n, 2), (n, 2) and (n, 2, 2) arrays of float
        See `fit.fit_polynomial`, also for `footprint_px`; n ≥ 12, not on one line.
    """
    points = checked("tps", MIN_POINTS, predicted_px, observed_px, covariance_px2)
    return _fit_spline("tps", ThinPlateSystem.of(points[0], footprint_px), points, footprint_px)


def fit_field(
    predicted_px: Float64, observed_px: Float64, covariance_px2: Float64, *, footprint_px: float = 0.0
) -> SplineFit:
    """Fit the measured field: an affine, plus what the points show beyond it, weighted by the covariance.

    It differs from the thin-plate spline in four ways. Its cells are smaller. A displacement is taken for the
    mean of the field over its window, so that detail which windows have averaged is restored. What is beyond
    the affine goes to zero in wide holes, so that the affine fills them. And the smoothing minimises the
    error at left-out blocks of one window each, with the errors that these share with their neighbours
    allowed for. Raises `InputError` if the points are too few or lie on a line, or an array has a wrong shape
    or values that are not finite.

    Parameters
    ----------
    predicted_px, observed_px, covariance_px2 : (n, 2), (n, 2) and (n, 2, 2) arrays of float
        See `fit.fit_polynomial`, also for `footprint_px`; n ≥ 12, not on one line.
    """
    points = checked("field", MIN_POINTS, predicted_px, observed_px, covariance_px2)
    reach_px = HOLE * (Support.of(points[0], footprint_px).reach_px or 1.0)
    system = ThinPlateSystem.of_field(points[0], footprint_px, reach_px)
    return _fit_spline("field", system, points, footprint_px)


def _fit_spline(
    name: str, system: ThinPlateSystem, points: tuple[Float64, Float64, Float64], footprint_px: float
) -> SplineFit:
    """Fit a spline, given its equations, to (predicted, observed, covariance) of points."""
    predicted, observed, covariance = points
    centre, radius = predicted.mean(axis=0), float(np.ptp(predicted, axis=0).max()) or 1.0

    def plane(at_px: Float64) -> Float64:
        return np.column_stack([np.ones(len(at_px)), (at_px - centre) / radius])

    displacement = observed - predicted
    affine = estimate(plane(predicted), displacement, covariance)
    overlaps, rest = Overlaps.of(predicted, footprint_px), displacement - affine.fitted_px
    task = _Task(system, overlaps, probes_of(predicted), rest, covariance)
    start = local_surface(predicted, rest)
    stiffness = (
        _validated_stiffness(task, start, footprint_px, predicted)
        if name == "field"
        else _stiffness(task, start)
    )
    found = task.fitted(stiffness, start)
    smoothing = system.smoothing(stiffness, mean_precision(found.whitener, found.weight))
    trial = task.trials(found).at(smoothing)
    coefficients = found.parameters + plane(system.grid.nodes_px()) @ affine.parameters
    return SplineFit(
        correction=SplineCorrection(name, system.grid, coefficients.reshape(*system.grid.shape, 2)),
        freedom=2 * found.freedom,
        predicted_px=predicted,
        remainder_px=rest,
        estimate=found,
        errors=trial.errors,
        support=Support.of(predicted[found.weight > 0], footprint_px),
        system=system,
        smoothing=trial.smoothing,
        footprint_px=footprint_px,
    )


def _validated_stiffness(task: _Task, start_px: Float64, footprint_px: float, xy_px: Float64) -> float:
    """Return the stiffness with the least error at blocks left out.

    Generalised cross-validation, which smooths too much where errors are shared, says where to begin. A block
    and its prediction from windows that overlap its own have errors in common, which flatters the prediction:
    twice their expected covariance is added (see `points.left_out_errors`).
    """
    tried = _tried(task)
    trials = task.trials(task.weighted(start_px))
    stiffest, _ = _best(trials, tried)
    blocks = cross_validation_blocks(xy_px, footprint_px)
    folds = int(np.clip(FOLD_COEFFICIENTS // task.system.energy.shape[0], MIN_FOLDS, len(blocks.tests)))
    tests = [np.asarray(test) for test in blocks.tests[:folds]]
    precision, system = trials.precision, task.system
    sigma = np.where(precision > 0, 1 / np.sqrt(np.where(precision > 0, precision, 1.0)), 0.0)[:, None]
    signs = random_signs(xy_px, PROBES)
    shared = [sigma * task.overlaps.times(signs * sigma * test[:, None]) for test in tests]
    errors = trials.at(trials.smoothing(tried[stiffest])).errors
    finer = tried[stiffest : stiffest + FINER_STEPS]
    scores = np.zeros(len(finer))
    for test, noise in zip(tests, shared, strict=True):
        kept = np.where(test, 0.0, precision)
        normal, values = system.normal(kept), np.column_stack([task.rest_px, noise])
        right = system.design.T @ (kept[:, None] * values)
        for step, stiffness in enumerate(finer):
            factor = system.factor(normal, trials.smoothing(stiffness))
            made = system.design[test] @ factor.solve(right)
            missed = ((task.rest_px[test] - made[:, :2]) ** 2).sum(axis=1)
            # 2 of the covariance, of 2 axes
            flattery = 4 * (signs[test] * made[:, 2:]).mean(axis=1)
            missed += errors.alpha * errors.scale * flattery
            scores[step] += float((precision[test] * missed).sum())
    return finer[int(np.argmin(scores))]


def _stiffness(task: _Task, start_px: Float64) -> float:
    """Return the stiffness of the best score.

    While stiffnesses are compared, the robust weights are those about the points' own neighbours, as a stiff
    spline takes detail for outliers.
    """
    tried = _tried(task)
    trials = task.trials(task.weighted(start_px))
    found, alpha = _best(trials, tried)
    between = [tried[found] * factor for factor in (2.0, 1.0, 0.5)]
    near = [trials.at(trials.smoothing(stiffness)) for stiffness in between]
    return between[best(near, alpha)[0]]


def _tried(task: _Task) -> list[float]:
    """Return the stiffnesses that are tried, the largest first."""
    side = float(max(task.system.grid.cells))
    return [STIFF * side**4 / FACTOR**step for step in range(MAX_STEPS)]


def _best(trials: Trials, tried: list[float]) -> tuple[int, float]:
    """Return the step of the best score, and how far errors are shared."""
    done = []
    for stiffness in tried:
        done.append(trials.at(trials.smoothing(stiffness)))
        if not np.isfinite(done[-1].score(alpha=0.0)):
            break
    return best(done, alpha=1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """The data to which a spline is fitted."""

    system: ThinPlateSystem
    overlaps: Overlaps
    probes: Float64
    rest_px: Float64
    """(n, 2) displacement beyond the affine."""
    covariance_px2: Float64

    def trials(self, pilot: Estimate) -> Trials:
        """Return trials with the weights of a fit."""
        return Trials.of(self.system, self.overlaps, self.probes, self.rest_px, pilot.whitener, pilot.weight)

    def weighted(self, start_px: Float64) -> Estimate:
        """Return the robust weights about a first fit."""

        def stay(_whitener: Float64, _weight: Float64) -> Solution:
            return Solution(np.empty((0, 2)), start_px, 0.0)

        return reweighted(stay, start_px, self.rest_px, self.covariance_px2)

    def fitted(self, stiffness: float, start_px: Float64) -> Estimate:
        """Return the robust fit that starts from given (n, 2) values."""
        freedom = self.system.freedom(stiffness, self.probes)
        successive = Successive(self.system, self.rest_px)

        def solve(whitener: Float64, weight: Float64) -> Solution:
            precision = weight[:, None, None] * (whitener.transpose(0, 2, 1) @ whitener)
            smoothing = self.system.smoothing(stiffness, mean_precision(whitener, weight))
            found = successive.solve(precision, smoothing)
            return Solution(found, self.system.design @ found, freedom)

        return reweighted(solve, start_px, self.rest_px, self.covariance_px2, tolerance_px=TOLERANCE_PX)
