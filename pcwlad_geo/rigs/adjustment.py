"""Bundle adjustment [1]_ of a rig: its lenses, their poses, and the ground of each capture.

A point that the reference lens sees in direction (x, y) at inverse depth q (the mean distance over its depth)
is seen by lens i in the direction of R·(x, y, 1) + q·b. Inverse depth is a plane of the direction for each
capture (level ground is one exactly), and a deviation of each point from it, the relief, which is eliminated.
Two captures of the reference lens whose frames overlap are tied the same way, with a rotation and a baseline
of their own: they determine the distortion that all lenses have in common, which one capture hardly does.

References
----------
.. [1] Triggs, B. et al. (2000), Bundle adjustment: a modern synthesis, doi:10.1007/3-540-44480-7_21.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import cv2
import numpy as np
from scipy import sparse

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import huber, sigma_of
from pcwlad_geo.estimation.solving import NormalEquations, inverse, solve
from pcwlad_geo.rigs.lens import LENS_PARAMETERS, LensModel, project, rays
from pcwlad_geo.rigs.parameters import ADJUSTMENT
from pcwlad_geo.types import Bool, Float64, Index

LENS_SIZE: Final = len(LENS_PARAMETERS)
"""Number of parameters of a lens, see `rig.LENS_PARAMETERS`."""
POSE_SIZE: Final = 6
"""Number of parameters of a pose: rotation vector and baseline."""
PLANE_SIZE: Final = 3
"""Number of parameters of the plane of inverse depth of a capture."""
NEEDS: Final = (
    "the adjustment of a rig needs tie points of all lenses, within their frames, with sigmas above 0"
)
"""Message of the errors of its equations."""


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """n tie points: positions in the frames of the reference and of another lens."""

    capture: Index
    """(n,) number of the capture whose plane holds the point."""
    pose: Index
    """(n,) number of the pose: that of the lens, or beyond the lenses that of an overlapping capture."""
    lens: Index
    """(n,) number of the lens that saw it."""
    reference_px: Float64
    """(n, 2) position in the raw frame of the reference lens."""
    lens_px: Float64
    """(n, 2) position in the raw frame of the lens."""
    sigma_px: Float64
    """(n,) standard deviation per axis, in px of the lens."""

    def __len__(self) -> int:
        return len(self.sigma_px)

    @staticmethod
    def joined(parts: Sequence[Observations]) -> Observations:
        """Return the observations of all parts."""
        names = [field.name for field in fields(Observations)]
        return Observations(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def selected(self, mask: Bool) -> Observations:
        """Return those of the (n,) `mask`."""
        return Observations(*(getattr(self, field.name)[mask] for field in fields(self)))

    def point_numbers(self) -> Index:
        """Return the (n,) numbers of the points: equal for observations of one in several lenses."""
        keys = np.column_stack([self.capture, np.round(self.reference_px * 8).astype(np.int64)])
        return np.asarray(np.unique(keys, axis=0, return_inverse=True)[1]).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class RigState:
    """The parameters of an adjustment, or a number for each of them."""

    models: tuple[LensModel, ...]
    lenses: Float64
    """(lenses, 8), see `rig.PARAMETERS`."""
    poses: Float64
    """(poses, 6) rotation vector and baseline; the first is the reference's and stays zero."""
    planes: Float64
    """(captures, 3) inverse depth on the axis, and its slopes by x and y."""
    overlaps: tuple[tuple[int, int], ...] = ()
    """The two captures of each pose beyond those of the lenses."""

    @property
    def vector(self) -> Float64:
        """(parameters,) vector of lenses, poses and planes."""
        return np.concatenate([self.lenses.ravel(), self.poses.ravel(), self.planes.ravel()])

    def with_vector(self, vector: Float64) -> RigState:
        """Return the state of a (parameters,) `vector` in the order of `RigState.vector`."""
        lenses, poses, planes = np.split(vector, np.cumsum([self.lenses.size, self.poses.size]))
        return replace(
            self,
            lenses=lenses.reshape(-1, LENS_SIZE),
            poses=poses.reshape(-1, POSE_SIZE),
            planes=planes.reshape(-1, PLANE_SIZE),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """The result of an adjustment."""

    state: RigState
    covariance: Float64
    """Of all parameters in the order of `RigState.vector`."""
    residual_px: Float64
    """(n, 2) observed minus predicted."""
    inliers: Bool
    """(n,) mask of the observations that are no outliers."""


def adjust(
    start: RigState,
    expected: RigState,
    sigma: RigState,
    observed: Observations,
    points_per_window: float,
    *,
    unit_mean_depth: bool = True,
    sigma_by_lens: bool = False,
) -> Adjusted:
    """Adjust all parameters by the Levenberg-Marquardt method.

    Parameters
    ----------
    start : RigState
        State of the first step.
    expected : RigState
        Expected parameters, apart from the tie points.
    sigma : RigState
        Standard deviation of each parameter from the expected; parameters of 0 stay as in `start`.
    observed : Observations
        Tie points.
    points_per_window : float
        Number of points that share a window: their errors are not independent.
    unit_mean_depth : bool
        Whether the mean inverse depth of the captures is 1; otherwise it is free, as the baselines are known.
    sigma_by_lens : bool
        Whether the sigmas of the points of each lens, and of those between captures, are estimated from their
        residuals.

    Raises
    ------
    InputError
        If there are no tie points, or some are beyond all frames.
    """
    numbers = np.column_stack([observed.reference_px, observed.lens_px, observed.sigma_px])
    if not len(observed) or not np.abs(numbers).max() <= 1e6:  # NaN is not
        raise InputError(NEEDS)
    state, point = start, observed.point_numbers()
    observed = replace(observed, sigma_px=np.hypot(observed.sigma_px, ADJUSTMENT.model_sigma_px))
    matching_sigma_px = observed.sigma_px
    relief = np.zeros(point.max() + 1)
    scale, free = sigma.vector, np.flatnonzero(sigma.vector > 0)
    damping = 1e-3
    # along the parallax predictions are linearised at no relief: at the estimated one, longer baselines would
    # be biased towards less relief. Between captures relief is many px, and is applied across the parallax
    between = observed.pose >= len(state.lenses)
    for iteration in range(ADJUSTMENT.max_steps):
        level = np.where(between, relief[point], 0.0)
        by_relief, along, residual, relief = _with_relief(state, observed, point, level)
        jacobian = _jacobian(state, observed, level, along, set(free.tolist()))
        if sigma_by_lens and iteration >= ADJUSTMENT.lenient_steps:
            ratios = _sigma_ratios(state, observed, residual, by_relief, matching_sigma_px)
            observed = replace(observed, sigma_px=matching_sigma_px * ratios)
        weight = _weights(residual - by_relief * relief[point, None], observed, iteration)[0]
        weight = weight / max(points_per_window, 1.0)
        columns = jacobian[:, free] @ sparse.diags(scale[free])
        problem = _Problem(weight, point, _relief_sigma(state), expected.vector, scale, free, unit_mean_depth)
        # the derivatives by relief are kept: otherwise steps would favour states that permit more relief
        least, largest_change = problem.cost(state, residual, by_relief), 0.0
        for _ in range(8):  # each step shorter than the one before
            step, normal = problem.step(state, columns, residual, by_relief, damping)
            change = np.zeros(len(scale))
            change[free] = scale[free] * step
            candidate = state.with_vector(state.vector + change)
            misfit = observed.lens_px - _predicted(candidate, observed, level, along)
            if problem.cost(candidate, misfit, by_relief) <= least * (1 + 1e-9):
                state, largest_change = candidate, np.abs(columns @ step).max(initial=0.0)
                damping = damping / 10 if damping > 1e-9 else 0.0
                break
            damping = max(10 * damping, 1e-6)
        if largest_change < 1e-4 and iteration > ADJUSTMENT.lenient_steps:
            break
    relief = _with_relief(state, observed, point, level)[3]
    residual = observed.lens_px - predict(state, observed, relief[point])
    inliers = _weights(residual, observed, ADJUSTMENT.max_steps)[1]
    # robust standard deviation of the residuals over that expected
    factor = sigma_of(residual[inliers] / observed.sigma_px[inliers, None]) if inliers.any() else 1.0
    deviation = np.zeros((len(scale), len(free)))
    deviation[free, np.arange(len(free))] = scale[free] * max(factor, 1.0)
    return Adjusted(state, deviation @ inverse(normal, NEEDS) @ deviation.T, residual, inliers)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """The weighted least-squares problem of one step."""

    weight: Float64
    point: Index
    relief_sigma: float
    expected: Float64
    scale: Float64
    free: Index
    unit_mean_depth: bool

    def cost(self, state: RigState, residual: Float64, by_relief: Float64) -> float:
        """Return the weighted sum of squares, each point at its best relief; infinite, never NaN."""
        square = np.bincount(self.point, self.weight * (residual**2).sum(axis=1))
        mixed, diagonal = _relief_sums(self.point, self.weight, residual, by_relief)
        total = float((square - mixed**2 / (diagonal + 1 / self.relief_sigma**2)).sum())
        mean = self._mean_depth_row(state)[1] / ADJUSTMENT.mean_depth_sigma if self.unit_mean_depth else 0.0
        total = total + float((self._deviation(state) ** 2).sum()) + mean**2
        return total if math.isfinite(total) else math.inf

    def step(
        self, state: RigState, columns: sparse.sparray, residual: Float64, by_relief: Float64, damping: float
    ) -> tuple[Float64, Float64]:
        """Return the step of the free parameters, and their normal matrix with the reliefs eliminated.

        The `columns` are the derivatives by these parameters, which are in units of their standard deviation.
        """
        free, number = np.arange(len(self.free)), np.repeat(self.point, 2)
        relief = sparse.csr_array((by_relief.ravel(), (np.arange(len(number)), number)))
        equations = NormalEquations(len(free) + relief.shape[1])
        equations.observe_rows(sparse.hstack([columns, relief]), np.repeat(self.weight, 2), residual.ravel())
        equations.expect(free, 1.0, self._deviation(state))
        equations.expect(len(free) + np.arange(relief.shape[1]), self.relief_sigma)
        row, misfit = self._mean_depth_row(state)
        variance = ADJUSTMENT.mean_depth_sigma**2
        equations.add(free, np.outer(row, row) / variance, row * misfit / variance)
        normal, right = equations.reduced(len(free))
        return solve(normal + damping * np.diag(np.diag(normal)), right, NEEDS), normal

    def _deviation(self, state: RigState) -> Float64:
        return (self.expected - state.vector)[self.free] / self.scale[self.free]

    def _mean_depth_row(self, state: RigState) -> tuple[Float64, float]:
        """Return the derivatives of the mean inverse depth of the captures, and its difference to 1."""
        row = np.zeros(len(self.scale))
        row[state.lenses.size + state.poses.size :: PLANE_SIZE] = self.unit_mean_depth / len(state.planes)
        return (row * self.scale)[self.free], 1.0 - float(state.planes[:, 0].mean())


def _with_relief(
    state: RigState, observed: Observations, point: Index, level: Float64
) -> tuple[Float64, Float64, Float64, Float64]:
    """Return what the adjustment needs of the relief, linearised at the (n,) relief `level`.

    These are the (n, 2) derivatives of predictions by relief, their (n, 2) directions, the (n, 2) residuals
    of `_predicted`, and the (points,) relief by all observations of each point, so that outliers show.
    """
    by_relief = (predict(state, observed, level + 1e-4) - predict(state, observed, level)) / 1e-4
    along = by_relief / np.maximum(np.hypot(*by_relief.T), 1e-12)[:, None]
    residual = observed.lens_px - _predicted(state, observed, level, along)
    sigma = _relief_sigma(state)
    mixed, diagonal = _relief_sums(point, observed.sigma_px**-2, residual, by_relief)
    largest = min(ADJUSTMENT.max_relief_sigmas * sigma, ADJUSTMENT.max_relief)
    return by_relief, along, residual, np.clip(mixed / (diagonal + sigma**-2), -largest, largest)


def _predicted(
    state: RigState, observed: Observations, level: Float64, along: Float64, reference: Float64 | None = None
) -> Float64:
    """Return the (n, 2) predictions: along the parallax those of no relief, across it those of a relief.

    The (n,) `level` is that relief, and the (n, 2) `along` are the directions of the parallax. The (8,)
    parameters of the lens whose rays are projected are `reference`, by default those of the state.
    """
    reference_rays = rays(
        observed.reference_px, state.lenses[0] if reference is None else reference, state.models[0]
    )
    predicted = _projected(state, observed, reference_rays, 0.0)
    has_relief = level != 0
    shift = (
        _projected(state, observed.selected(has_relief), reference_rays[has_relief], level[has_relief])
        - predicted[has_relief]
    )
    predicted[has_relief] += shift - (shift * along[has_relief]).sum(axis=1)[:, None] * along[has_relief]
    return predicted


def _relief_sums(
    point: Index, weight: Float64, residual: Float64, by_relief: Float64
) -> tuple[Float64, Float64]:
    """Return the (points,) right side and diagonal of the normal equations of the reliefs."""
    mixed: Float64 = np.bincount(point, weight * (residual * by_relief).sum(axis=1)).astype(np.float64)
    diagonal: Float64 = np.bincount(point, weight * (by_relief**2).sum(axis=1)).astype(np.float64)
    return mixed, diagonal


def predict(state: RigState, observed: Observations, relief: Float64 | float) -> Float64:
    """Return the (n, 2) px at which the lenses see points.

    Their inverse depth differs from the plane of their capture by the (n,) `relief`, or one number for all.
    """
    reference_rays = rays(observed.reference_px, state.lenses[0], state.models[0])
    return _projected(state, observed, reference_rays, relief)


def _projected(
    state: RigState, observed: Observations, reference_rays: Float64, relief: Float64 | float
) -> Float64:
    axes = np.column_stack([reference_rays, np.ones(len(reference_rays))])
    plane = state.planes[observed.capture]
    x, y = reference_rays.T
    inverse_depth = plane[:, 0] + plane[:, 1] * x + plane[:, 2] * y + relief
    matrices = np.stack([cv2.Rodrigues(pose[:3])[0] for pose in state.poses])
    turned = np.einsum("nij,nj->ni", matrices[observed.pose], axes)
    turned += inverse_depth[:, None] * state.poses[observed.pose, 3:]
    direction = turned[:, :2] / np.maximum(turned[:, 2:], 0.05)
    result = np.empty_like(reference_rays)
    for number, model in enumerate(state.models):
        of_lens = observed.lens == number
        if of_lens.any():
            result[of_lens] = project(direction[of_lens], state.lenses[number], model)
    return result


def _weights(residual: Float64, observed: Observations, iteration: int) -> tuple[Float64, Bool]:
    """Return the (n,) weights, px⁻², and the mask of observations that are no outliers."""
    sigma, length = observed.sigma_px, np.hypot(*residual.T)
    spread = max(1.0, float(np.median(length / sigma)) / 1.18)
    ratio = length / (sigma * spread)
    limit = ADJUSTMENT.outlier_sigmas * (4 if iteration < ADJUSTMENT.lenient_steps else 1)
    inliers = (ratio < limit) | (length < ADJUSTMENT.least_outlier_px)
    return np.where(inliers, huber(ratio, 1.5 * 1.41) / sigma**2, 0.0), inliers


def _sigma_ratios(
    state: RigState, observed: Observations, residual: Float64, by_relief: Float64, sigma_px: Float64
) -> Float64:
    """Return the (n,) ratio of the sigma estimated for a lens, or for points between captures, to `sigma_px`.

    It is estimated across the parallax: along it the relief of each point absorbs most of the residual.
    """
    length = np.maximum(np.hypot(*by_relief.T), 1e-12)
    across = np.abs(residual[:, 0] * by_relief[:, 1] - residual[:, 1] * by_relief[:, 0]) / length / sigma_px
    ratio = np.ones(len(observed))
    group = np.minimum(observed.pose, len(state.lenses))
    for number in np.unique(group):
        ratio[group == number] = max(ADJUSTMENT.least_sigma_ratio, sigma_of(across[group == number]))
    return ratio


def _jacobian(
    state: RigState, observed: Observations, level: Float64, along: Float64, free: set[int]
) -> sparse.csr_matrix:
    """Return the (2 n, parameters) derivatives of `_predicted`.

    Columns of parameters that are not `free` are left empty.
    """
    n, lenses, poses = len(observed), state.lenses.size, state.poses.size
    now = _predicted(state, observed, level, along)
    entries: list[tuple[Index, Float64]] = []

    def difference(changed: RigState, step: float, reference: Float64 | None = None) -> Float64:
        return (_predicted(changed, observed, level, along, reference) - now) / step

    steps = [1e-5 * float(state.lenses[0, 0])] * 3 + [1e-5, 1e-5, 1e-5, 1e-6, 1e-6]  # they move px by little
    for k, step in enumerate(steps):
        changed = replace(state, lenses=state.lenses + step * np.eye(LENS_SIZE)[k])
        if free.intersection(range(k, lenses, LENS_SIZE)):
            entries.append((observed.lens * LENS_SIZE + k, difference(changed, step, state.lenses[0])))
        if k in free:
            entries.append((np.full(n, k), difference(state, step, changed.lenses[0])))
    for k in range(POSE_SIZE):
        if free.intersection(range(lenses + k, lenses + poses, POSE_SIZE)):
            changed = replace(state, poses=state.poses + 1e-6 * np.eye(POSE_SIZE)[k])
            entries.append((lenses + observed.pose * POSE_SIZE + k, difference(changed, 1e-6)))
    for k in range(PLANE_SIZE):
        changed = replace(state, planes=state.planes + 1e-4 * np.eye(PLANE_SIZE)[k])
        entries.append((lenses + poses + observed.capture * PLANE_SIZE + k, difference(changed, 1e-4)))
    columns = np.concatenate([np.repeat(column, 2) for column, _ in entries])
    values = np.concatenate([change.ravel() for _, change in entries])
    rows = np.tile(np.arange(2 * n), len(entries))
    return sparse.csr_matrix((values, (rows, columns)), (2 * n, lenses + poses + state.planes.size))


def _relief_sigma(state: RigState) -> float:
    """Return the standard deviation of a point's inverse depth from the plane of its capture."""
    baseline = float(np.hypot(*state.poses[: len(state.lenses), 3:5].T).max())
    sigma = ADJUSTMENT.relief_sigma_px / max(baseline * state.lenses[0, 0], 1e-9)
    return float(np.clip(sigma, *ADJUSTMENT.relief_sigma_limits))
