"""The smoothing of a spline: generalised cross-validation, and the error at blocks left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcwlad_geo.correction.cross_validation import CROSS_VALIDATION, cross_validation_blocks
from pcwlad_geo.correction.thin_plate import (
    SplineParameters,
    Successive,
    ThinPlateSystem,
    mean_precision,
    precision_matrices,
)
from pcwlad_geo.estimation.robust import Estimate, Solution, reweighted
from pcwlad_geo.estimation.shared_errors import Overlaps, SharedErrors, random_signs
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class SmoothingTrial:
    """How well a spline of a given smoothing fits."""

    squares: float
    """Sum of the weighted squared residuals, mean of the axes."""
    parameters_per_point: tuple[float, float]
    """Effective number of them, for independent errors and for errors that windows share."""
    errors: SharedErrors
    """How far the errors are shared, as estimated from the residuals."""

    def score(self, alpha: float) -> float:
        """Return the generalised cross-validation score; infinite if the spline has too many parameters.

        A spline follows correlated errors as if it had more parameters (Opsomer, Wang & Yang 2001,
        Nonparametric regression with correlated errors, Statistical Science 16(2), 134-153).
        """
        independent, common = self.parameters_per_point
        share = (1 - alpha) * independent + alpha * common
        return self.squares / (1 - share) ** 2 if share < 0.6 else np.inf


@dataclass(frozen=True, slots=True, eq=False)
class SmoothingTrials:
    """Weighted points to which splines of any smoothing can be fitted; col and row have the same weights."""

    system: ThinPlateSystem
    overlaps: Overlaps
    normal: Float64
    """Diagonals of the normal matrix, the same for every smoothing."""
    root: Float64
    """(n, 1) square root of the precision, 1/px, 0 for outliers."""
    inlier: Float64
    """(n, 1) 1, or 0 for outliers."""
    probes: Float64
    """(n, m) random signs."""
    shared: Float64
    """(n, m) products of these signs with the overlaps of the inliers' windows."""
    planes: Float64
    """(n, 3) orthonormal vectors that span the planes, see `ThinPlateSystem.planes`."""
    patches: float
    """Number of independent windows, see `Overlaps.patches`."""
    straight: tuple[float, float]
    """Parameters of the planes, for independent errors and for errors that windows share."""
    whitened: Float64
    """(n, m') probes, products with the overlaps, planes and values, to which every spline is fitted."""
    right: Float64
    """(k, m') right sides of their normal equations."""

    @classmethod
    def of(
        cls,
        system: ThinPlateSystem,
        overlaps: Overlaps,
        probes: Float64,
        values_px: Float64,
        whitener: Float64,
        weight: Float64,
    ) -> SmoothingTrials:
        """Return trials of a spline in which inliers have weight 1.

        Weights that follow the residuals would make these look small. The (n, m) `probes` are random signs,
        see `probes_of`. Splines are fitted to the (n, 2) `values_px` (col, row). The (n, 2, 2) `whitener` and
        (n,) `weight` are those of `Estimate`.
        """
        inlier = (weight > 0).astype(np.float64)[:, None]
        precision = mean_precision(whitener, inlier[:, 0])
        root, count = np.sqrt(precision)[:, None], probes.shape[1]
        planes = system.planes(root[:, 0])
        times = inlier * overlaps.times(inlier * np.column_stack([probes, planes]))
        shared = times[:, :count]
        whitened = np.column_stack([probes, shared, planes, root * values_px])
        return cls(
            system=system,
            overlaps=overlaps,
            normal=system.normal(precision),
            root=root,
            inlier=inlier,
            probes=probes,
            shared=shared,
            planes=planes,
            patches=overlaps.patches(),
            straight=(float((planes**2).sum()), float((planes * times[:, count:]).sum())),
            whitened=whitened,
            right=system.transposed @ (root * whitened),
        )

    @property
    def precision(self) -> Float64:
        """(n,) 1/px², 0 for outliers."""
        return self.root[:, 0] ** 2

    def smoothing(self, relative_smoothing: float) -> float:
        """Return the λ of a relative smoothing parameter."""
        return self.system.smoothing(relative_smoothing, self.precision)

    def at(self, smoothing: float) -> SmoothingTrial:
        """Fit a spline with the `smoothing` λ; estimate its response to independent and shared errors."""
        coefficients = self.system.factor(self.normal, smoothing).solve(self.right)
        remaining = self.whitened - self.root * (self.system.design @ coefficients)
        count = self.probes.shape[1]
        missed, shared_error, bent, residual = np.split(remaining, [count, 2 * count, 2 * count + 3], axis=1)
        followed = self.probes - missed
        single = self.inlier * self.probes
        single_error = single - followed  # a spline follows inliers alone
        times = self.inlier * self.overlaps.times(self.inlier * np.column_stack([missed, residual]))
        products = [[(a * b).sum() for b in (single_error, shared_error)] for a in (missed, times[:, :count])]
        squares = float((residual**2).sum()) / 2
        errors = SharedErrors.of(
            np.array(products) / count,
            squares,
            float((residual * times[:, count:]).sum()) / 2,
            self.patches,
        )
        # Planes are reproduced, and counted exactly; random signs estimate the rest of the traces.
        smoothed = followed - (self.planes - bent) @ (self.planes.T @ self.probes)
        independent, common = (
            (part + float((smoothed * noise).sum()) / count) / float(self.inlier.sum())
            for part, noise in zip(self.straight, (single, self.shared), strict=True)
        )
        return SmoothingTrial(squares, (independent, common), errors)


def best(trials: list[SmoothingTrial], alpha: float) -> int:
    """Return the index of the best of several trials, of which the first has the largest smoothing.

    It depends on `alpha`, the part of the errors that windows share, which itself depends on the residuals of
    the best spline. The iteration starts from 1, which smooths most, or from an earlier result.
    """
    for _ in range(4):
        index = int(np.argmin([trial.score(alpha) for trial in trials]))
        before, alpha = alpha, trials[index].errors.alpha
        if abs(alpha - before) < 0.02:
            break
    return index


@dataclass(frozen=True, slots=True, eq=False)
class SplineTask:
    """The data to which a spline is fitted."""

    system: ThinPlateSystem
    overlaps: Overlaps
    probes: Float64
    remainder_px: Float64
    """(n, 2) displacements (col, row) minus their robust affine."""
    covariance_px2: Float64
    parameters: SplineParameters

    def trials(self, pilot: Estimate) -> SmoothingTrials:
        """Return trials with the inliers of the fit `pilot`."""
        return SmoothingTrials.of(
            self.system, self.overlaps, self.probes, self.remainder_px, pilot.whitener, pilot.weight
        )

    def weighted(self, start_px: Float64) -> Estimate:
        """Return the robust weights of the residuals from the (n, 2) values `start_px`."""
        unchanged = Solution(np.empty((0, 2)), start_px, 0.0)
        return reweighted(lambda *_: unchanged, start_px, self.remainder_px, self.covariance_px2)

    def fitted(self, relative_smoothing: float, start_px: Float64) -> Estimate:
        """Return the robust fit that starts from the (n, 2) values `start_px`."""
        freedom = self.system.freedom(relative_smoothing, self.probes)
        successive = Successive(self.system, self.remainder_px)

        def solve(whitener: Float64, weight: Float64) -> Solution:
            precision = precision_matrices(whitener, weight)
            smoothing = self.system.smoothing(relative_smoothing, mean_precision(whitener, weight))
            coefficients = successive.solve(precision, smoothing)
            return Solution(coefficients, self.system.design @ coefficients, freedom)

        return reweighted(solve, start_px, self.remainder_px, self.covariance_px2, tolerance_px=1e-3)


def smoothing_by_blocks(task: SplineTask, start_px: Float64, footprint_px: float, xy_px: Float64) -> float:
    """Return the relative smoothing parameter with the least error at blocks left out.

    Generalised cross-validation, which smooths too much where errors are shared, gives the first one tried. A
    block and its prediction from windows that overlap it have errors in common, which makes the prediction
    look too good: twice their expected covariance is added (see `cross_validation.left_out_errors`). The
    points are at (n, 2) `xy_px` (col, row), and their robust weights come from the (n, 2) values `start_px`.
    """
    levels = _levels(task)
    trials = task.trials(task.weighted(start_px))
    smoothest, trial = _best(trials, levels)
    errors = trial.errors
    blocks = cross_validation_blocks(xy_px, footprint_px)
    precision, system = trials.precision, task.system
    folds = int(np.clip(8000 // system.energy.shape[0], 4, len(blocks.tests)))
    sigma = np.divide(1, trials.root, out=np.zeros_like(trials.root), where=trials.root > 0)
    signs = random_signs(xy_px, CROSS_VALIDATION.probes)
    finer = levels[smoothest : smoothest + task.parameters.finer_levels]
    scores = np.zeros(len(finer))
    for test in blocks.tests[:folds]:
        noise = sigma * task.overlaps.times(signs * sigma * test[:, None])
        of_others = np.where(test, 0.0, precision)
        normal, values = system.normal(of_others), np.column_stack([task.remainder_px, noise])
        right = system.transposed @ (of_others[:, None] * values)
        for step, relative_smoothing in enumerate(finer):
            factor = system.factor(normal, trials.smoothing(relative_smoothing))
            predicted = system.design[test] @ factor.solve(right)
            missed = ((task.remainder_px[test] - predicted[:, :2]) ** 2).sum(axis=1)
            # 2 of the covariance, of 2 axes
            optimism = 4 * (signs[test] * predicted[:, 2:]).mean(axis=1)
            missed += errors.alpha * errors.scale * optimism
            scores[step] += float((precision[test] * missed).sum())
    return finer[int(np.argmin(scores))]


def smoothing_by_score(task: SplineTask, start_px: Float64) -> float:
    """Return the relative smoothing parameter of the best score.

    The robust weights are those of the residuals from a local surface through each point's neighbours, as a
    smooth spline takes detail for outliers: from the (n, 2) values `start_px` of that.
    """
    levels = _levels(task)
    trials = task.trials(task.weighted(start_px))
    index, trial = _best(trials, levels)
    between = [levels[index] * factor for factor in (2.0, 1.0, 0.5)]
    less, more = (trials.at(trials.smoothing(between[k])) for k in (0, 2))
    return between[best([less, trial, more], trial.errors.alpha)]


def _levels(task: SplineTask) -> list[float]:
    """Return the smoothing parameters that are tried, the largest first."""
    side = float(max(task.system.grid.cells))
    # The first leaves a tenth of a square plate's softest mode; each next one doubles the parameters.
    return [0.02 * side**4 / 4.0**step for step in range(task.parameters.smoothing_levels)]


def _best(trials: SmoothingTrials, levels: list[float]) -> tuple[int, SmoothingTrial]:
    """Return the index of the smoothing parameter of the best score, and its trial."""
    results = []
    for relative_smoothing in levels:
        results.append(trials.at(trials.smoothing(relative_smoothing)))
        if not np.isfinite(results[-1].score(alpha=0.0)):
            break
    index = best(results, alpha=1.0)
    return index, results[index]
