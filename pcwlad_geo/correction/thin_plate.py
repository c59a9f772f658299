"""Fit a thin-plate spline: robust, smoothed by the points' covariance, never through every point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.fitted import checked
from pcwlad_geo.correction.local_surface import local_surface
from pcwlad_geo.correction.plate import Plate, Successive, mean_precision
from pcwlad_geo.correction.robust_linear import (
    Estimate,
    Solution,
    estimate,
    reweighted,
)
from pcwlad_geo.correction.smoothing import Trials, best
from pcwlad_geo.correction.spline_fit import SplineFit
from pcwlad_geo.correction.windows import Overlaps, probes_of

Array = NDArray[np.float64]

LEAST_POINTS = 12
STIFF = 0.02
"""Stiffness at which the softest mode of a square plate has a tenth of its size, over side⁴."""
FACTOR = 4.0
"""Between two stiffnesses tried: it doubles the effective number of parameters."""
MOST_STEPS = 14
TOLERANCE_PX = 1e-3
"""Largest change of the spline at a point at which its robust weights rest."""


def fit_tps(
    predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
) -> SplineFit:
    """Fit a thin-plate spline smoothed by the points' covariance: it passes near the points, never through.

    It is fitted to what a robust affine leaves over, and continued linearly beyond the box of the points.
    The smoothing minimises the generalised cross-validation score, in which errors that overlapping windows
    share do not pass for detail.

    Parameters
    ----------
    predicted_px, observed_px, covariance_px2, footprint_px
        As for `fit_shift`; n ≥ 12, not on one line.

    Raises
    ------
    InputError
        If the points are too few or lie on a line, or an array has a wrong shape or values that are not
        finite.
    """
    predicted, observed, covariance = checked("tps", LEAST_POINTS, predicted_px, observed_px, covariance_px2)
    centre, radius = predicted.mean(axis=0), float(np.ptp(predicted, axis=0).max()) or 1.0

    def plane(at_px: Array) -> Array:
        return np.column_stack([np.ones(len(at_px)), (at_px - centre) / radius])

    displacement = observed - predicted
    affine = estimate(plane(predicted), displacement, covariance)
    plate = Plate.of(predicted, footprint_px)
    task = _Task(
        plate,
        Overlaps.of(predicted, footprint_px),
        probes_of(predicted),
        displacement - affine.fitted_px,
        covariance,
    )
    start = local_surface(predicted, task.rest_px)
    stiffness = _stiffness(task, start)
    found = task.fitted(stiffness, start)
    smoothing = plate.smoothing(stiffness, mean_precision(found.whitener, found.weight))
    trial = task.trials(found).at(smoothing)
    straight = plane(plate.grid.nodes_px()) @ affine.parameters
    return SplineFit.of(plate, found, trial, straight, task.rest_px, predicted, footprint_px)


def _stiffness(task: _Task, start_px: Array) -> float:
    """Return the stiffness of the best score.

    The robust weights are those of the points' own neighbours while stiffnesses are compared: a stiff spline
    takes detail for outliers.
    """
    side = float(max(task.plate.grid.cells))
    tried = [STIFF * side**4 / FACTOR**step for step in range(MOST_STEPS)]
    trials = task.trials(task.weighted(start_px))
    found, alpha = _best(trials, tried)
    between = [tried[found] * factor for factor in (2.0, 1.0, 0.5)]
    near = [trials.at(trials.smoothing(stiffness)) for stiffness in between]
    return between[best(near, alpha)[0]]


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
    """What a spline is fitted to."""

    plate: Plate
    overlaps: Overlaps
    probes: Array
    rest_px: Array
    """(n, 2) displacement beyond the affine."""
    covariance_px2: Array

    def trials(self, pilot: Estimate) -> Trials:
        """Return trials with the weights of a fit."""
        return Trials.of(self.plate, self.overlaps, self.probes, self.rest_px, pilot.whitener, pilot.weight)

    def weighted(self, start_px: Array) -> Estimate:
        """Return the robust weights about a first fit."""

        def stay(_whitener: Array, _weight: Array) -> Solution:
            return Solution(np.empty((0, 2)), start_px, 0.0)

        return reweighted(stay, start_px, self.rest_px, self.covariance_px2)

    def fitted(self, stiffness: float, start_px: Array) -> Estimate:
        """Return the robust fit from a start."""
        freedom = self.plate.freedom(stiffness, self.probes)
        successive = Successive(self.plate, self.rest_px)

        def solve(whitener: Array, weight: Array) -> Solution:
            precision = weight[:, None, None] * (whitener.transpose(0, 2, 1) @ whitener)
            smoothing = self.plate.smoothing(stiffness, mean_precision(whitener, weight))
            found = successive.solve(precision, smoothing)
            return Solution(found, self.plate.design @ found, freedom)

        return reweighted(solve, start_px, self.rest_px, self.covariance_px2, tolerance_px=TOLERANCE_PX)
