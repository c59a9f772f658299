"""Least squares over all captures: lenses, how they stand, and the ground that each capture saw.

A point that the reference lens sees in direction (x, y) at inverse depth q (the mean distance over its depth)
is seen by lens i in the direction of R·(x, y, 1) + q·b. Inverse depth is a plane of the direction for each
capture (level ground is one exactly), and a deviation of each point from it, the relief, which is eliminated.
Two captures of the reference lens whose frames overlap are tied the same way, with a rotation and a base of
their own: that tells the distortion that all lenses have in common, which frames of one moment hardly do.

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
from pcwlad_geo.rigs.rig import LensModel, project, rays
from pcwlad_geo.types import Bool, Float64, Index

OF_LENS: Final = 8
"""Parameters of a lens."""
OF_POSE: Final = 6
"""Parameters of a pose."""
OF_PLANE: Final = 3
"""Parameters of the ground of a capture."""
ROUNDS: Final = 14
"""Largest number of Gauss–Newton steps."""
LENIENT_STEPS: Final = 3
"""Steps in which residuals may be larger, as the state is not yet near."""
LEAST_SHARE: Final = 0.2
"""The sigma of a lens's points is not below this share of what their matching says."""
MAX_SIGMAS: Final = 6.0
"""Residuals beyond so many sigmas, and `LEAST_FAR_PX`, do not count."""
LEAST_FAR_PX: Final = 0.6
"""A point nearer than this to the model is never left out."""
MODEL_SIGMA_PX: Final = 0.06
"""What the model itself leaves, and bands that look different, added to the sigma of every point."""
RELIEF_PX: Final = 0.1
"""Standard deviation of a point from its capture's plane, as parallax of the lens of the longest baseline."""
RELIEF_LIMITS: Final = (0.02, 0.3)
"""Smallest and largest of it, in inverse depth."""
MOST_RELIEF: Final = 0.5
"""Largest relief of a point, in inverse depth."""
MOST_RELIEF_SIGMAS: Final = 3.0
"""Largest relief of a point, in standard deviations of the relief of all."""
NEEDS: Final = (
    "the adjustment of a rig needs tie points of all lenses, within their frames, with sigmas above 0"
)
"""What its equations ask for."""
MEAN_SIGMA: Final = 1e-3
"""With this standard deviation the mean inverse depth of all captures is 1: the unit of the baselines."""


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """n positions at which lenses saw points of the reference lens."""

    capture: Index
    """(n,) number of the capture whose plane holds the point."""
    pose: Index
    """(n,) number of the pose: that of the lens, or beyond the lenses that of another capture."""
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
        names = [each.name for each in fields(Observations)]
        return Observations(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def part(self, some: Bool) -> Observations:
        """Return those of the (n,) mask `some`."""
        return Observations(*(getattr(self, each.name)[some] for each in fields(self)))

    def points(self) -> Index:
        """Return the (n,) number of the point that each observation is of."""
        keys = np.column_stack([self.capture, np.round(self.reference_px * 8).astype(np.int64)])
        return np.asarray(np.unique(keys, axis=0, return_inverse=True)[1]).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class RigState:
    """What is adjusted."""

    models: tuple[LensModel, ...]
    lenses: Float64
    """(lenses, 8), see `rig.PARAMETERS`."""
    poses: Float64
    """(poses, 6) rotation vector and baseline; the first is the reference's and stays zero."""
    planes: Float64
    """(captures, 3) inverse depth on the axis, and its slopes by x and y."""
    overlaps: tuple[tuple[int, int], ...] = ()
    """For each pose beyond those of the lenses the two captures that it is between."""

    @property
    def vector(self) -> Float64:
        """(parameters,) all of them, one after another."""
        return np.concatenate([self.lenses.ravel(), self.poses.ravel(), self.planes.ravel()])

    def with_vector(self, vector: Float64) -> RigState:
        """Return the state of a (parameters,) `vector` of all of them."""
        first, second = self.lenses.size, self.lenses.size + self.poses.size
        return replace(
            self,
            lenses=vector[:first].reshape(self.lenses.shape),
            poses=vector[first:second].reshape(self.poses.shape),
            planes=vector[second:].reshape(self.planes.shape),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """The result of an adjustment."""

    state: RigState
    covariance: Float64
    """Of all parameters in the order of `RigState.vector`."""
    residual_px: Float64
    """(n, 2) observed minus predicted."""
    kept: Bool
    """(n,) observations that count."""
    factor: float
    """Standard deviation of the residuals over that expected of them."""


def adjust(
    first: RigState,
    expected: RigState,
    sigma: RigState,
    observed: Observations,
    overlap: float,
    *,
    unit: bool = True,
    by_lens: bool = False,
) -> Adjusted:
    """Adjust all parameters.

    Parameters
    ----------
    first : RigState
        Where to begin.
    expected : RigState
        What is expected without the tie points.
    sigma : RigState
        How far each parameter may be from there; 0 holds it where it begins.
    observed : Observations
        Tie points.
    overlap : float
        How many points share a window: their errors are not independent.
    unit : bool
        Whether the mean inverse depth of the captures is 1; otherwise it is free, as the baselines are known.
    by_lens : bool
        Whether the points of each lens, and those between captures, have the sigma that their residuals say.

    Raises
    ------
    InputError
        If there are no tie points, or numbers that are none of frames.
    """
    _check(observed)
    state, point = first, observed.points()
    observed = replace(observed, sigma_px=np.hypot(observed.sigma_px, MODEL_SIGMA_PX))
    given_px, alike = observed.sigma_px, max(overlap, 1.0)
    relief = np.zeros(point.max() + 1)
    scale, before = sigma.vector, expected.vector
    free = np.flatnonzero(scale > 0)
    damping, normal = 1e-3, np.eye(len(free))
    # along the parallax linear at no relief: where it is, longer baselines would be drawn towards less of it.
    # Captures see many px of it, so that across it the prediction is that of the relief found so far
    between = observed.pose >= len(state.lenses)
    for turn in range(ROUNDS):
        level = np.where(between, relief[point], 0.0)
        by_relief, along = _by_relief(state, observed, level)
        residual = observed.lens_px - _predicted(state, observed, level, along)
        relief = _relief_of(state, observed, point, residual, by_relief)
        jacobian = _jacobian(state, observed, level, along, set(free.tolist()))
        if by_lens and turn >= LENIENT_STEPS:
            observed = replace(
                observed, sigma_px=given_px * _share_by_lens(state, observed, residual, by_relief, given_px)
            )
        weight, kept = _weights(residual - by_relief * relief[point, None], observed, turn)
        weight = weight / alike
        columns = jacobian[:, free] @ sparse.diags(scale[free])
        problem = _Problem(weight, point, _relief_sigma(state), before, scale, free, unit)
        # the parallax of relief stays as it is: a step would else be drawn to where more of it is allowed
        least, moved = problem.cost(state, residual, by_relief), 0.0
        for _ in range(8):  # each shorter than the last
            step, normal = problem.step(state, columns, residual, by_relief, damping)
            change = np.zeros(len(scale))
            change[free] = scale[free] * step
            there = state.with_vector(state.vector + change)
            misfit = observed.lens_px - _predicted(there, observed, level, along)
            if problem.cost(there, misfit, by_relief) <= least * (1 + 1e-9):
                state, moved = there, np.abs(columns @ step).max(initial=0.0)
                damping = damping / 10 if damping > 1e-9 else 0.0
                break
            damping = max(10 * damping, 1e-6)  # too far for what is linear
        if moved < 1e-4 and turn > LENIENT_STEPS:
            break
    residual = _left(state, observed, point, level)
    weight, kept = _weights(residual, observed, ROUNDS)
    # robust standard deviation of the residuals over that expected
    factor = sigma_of(residual[kept] / observed.sigma_px[kept, None]) if kept.any() else 1.0
    deviation = np.zeros((len(scale), len(free)))
    deviation[free, np.arange(len(free))] = scale[free] * max(factor, 1.0)
    return Adjusted(state, deviation @ inverse(normal, NEEDS) @ deviation.T, residual, kept, factor)


def _check(observed: Observations) -> None:
    """Raise `InputError` if there are no tie points, or numbers that are none of frames."""
    for each in (observed.reference_px, observed.lens_px, observed.sigma_px):
        if not len(observed) or not np.abs(each).max() <= 1e6:  # NaN is not
            raise InputError(NEEDS)


def _left(state: RigState, observed: Observations, point: Index, level: Float64) -> Float64:
    """Return the (n, 2) residuals, each point at its own relief, which is about `level`."""
    by_relief, along = _by_relief(state, observed, level)
    residual = observed.lens_px - _predicted(state, observed, level, along)
    relief = _relief_of(state, observed, point, residual, by_relief)
    return observed.lens_px - predict(state, observed, relief[point])


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """What a step is to reduce, with the weights of the place where it begins."""

    weight: Float64
    point: Index
    relief_sigma: float
    expected: Float64
    scale: Float64
    free: Index
    unit: bool

    def cost(self, state: RigState, residual: Float64, by_relief: Float64) -> float:
        """Return the sum of squares of a state, each point at its best relief; infinite if it has none."""
        count = int(self.point.max()) + 1
        weight = self.weight
        square = np.bincount(self.point, weight * (residual**2).sum(axis=1), count)
        along = np.bincount(self.point, weight * (residual * by_relief).sum(axis=1), count)
        own = np.bincount(self.point, weight * (by_relief**2).sum(axis=1), count)
        left = float((square - along**2 / (own + 1 / self.relief_sigma**2)).sum())
        mean = self._mean_row(state)[1] / MEAN_SIGMA if self.unit else 0.0
        total = left + float((self._off(state) ** 2).sum()) + mean**2
        return total if math.isfinite(total) else math.inf

    def step(
        self, state: RigState, columns: sparse.sparray, residual: Float64, by_relief: Float64, damping: float
    ) -> tuple[Float64, Float64]:
        """Return the step of the free parameters, and their normal matrix, reliefs eliminated.

        The `columns` are the derivatives by these parameters in units of their expected deviation.
        """
        free, number = np.arange(len(self.free)), np.repeat(self.point, 2)
        relief = sparse.csr_array((by_relief.ravel(), (np.arange(len(number)), number)))
        equations = NormalEquations(len(free) + relief.shape[1])
        equations.observe_rows(sparse.hstack([columns, relief]), np.repeat(self.weight, 2), residual.ravel())
        equations.expect(free, 1.0, self._off(state))
        equations.expect(len(free) + np.arange(relief.shape[1]), self.relief_sigma)
        row, off = self._mean_row(state)
        equations.add(free, np.outer(row, row) / MEAN_SIGMA**2, row * off / MEAN_SIGMA**2)
        normal, right = equations.reduced(len(free))
        return solve(normal + damping * np.diag(np.diag(normal)), right, NEEDS), normal

    def _off(self, state: RigState) -> Float64:
        return (self.expected - state.vector)[self.free] / self.scale[self.free]

    def _mean_row(self, state: RigState) -> tuple[Float64, float]:
        """Return the derivatives of the mean inverse depth of the captures, and how far it is from 1."""
        row = np.zeros(len(self.scale))
        row[state.lenses.size + state.poses.size :: OF_PLANE] = self.unit / len(state.planes)
        return (row * self.scale)[self.free], 1.0 - float(state.planes[:, 0].mean())


def _by_relief(state: RigState, observed: Observations, level: Float64) -> tuple[Float64, Float64]:
    """Return the (n, 2) derivatives of predictions by relief, at the (n,) `level`, and their directions."""
    by_relief = (predict(state, observed, level + 1e-4) - predict(state, observed, level)) / 1e-4
    return by_relief, by_relief / np.maximum(np.hypot(*by_relief.T), 1e-12)[:, None]


def _predicted(
    state: RigState, observed: Observations, level: Float64, along: Float64, moved: Float64 | None = None
) -> Float64:
    """Return the (n, 2) predictions: along the parallax those of no relief, across it those of a relief.

    The (n,) `level` is that relief, the (n, 2) `along` are the directions of the parallax, and `moved` may be
    another (8,) reference lens than that of the state.
    """
    first = rays(observed.reference_px, state.lenses[0] if moved is None else moved, state.models[0])
    found = _projected(state, observed, first, np.zeros(len(observed)))
    some = level != 0
    with_relief = _projected(state, observed.part(some), first[some], level[some]) - found[some]
    found[some] += with_relief - (with_relief * along[some]).sum(axis=1)[:, None] * along[some]
    return found


def _relief_of(
    state: RigState, observed: Observations, point: Index, residual: Float64, by_relief: Float64
) -> Float64:
    """Return the relief of each point, as all observations of it say, good or bad: then bad ones show.

    Given are the (n, 2) residuals at no relief, and their derivatives by it.
    """
    sigma = _relief_sigma(state)
    weight = observed.sigma_px**-2
    along = np.bincount(point, weight * (residual * by_relief).sum(axis=1))
    own = np.bincount(point, weight * (by_relief**2).sum(axis=1))
    most = min(MOST_RELIEF_SIGMAS * sigma, MOST_RELIEF)
    return np.clip(along / (own + sigma**-2), -most, most)


def predict(state: RigState, observed: Observations, relief: Float64) -> Float64:
    """Return the (n, 2) px at which lenses see the points; `relief` is the (n,) share beside the plane."""
    first = rays(observed.reference_px, state.lenses[0], state.models[0])
    return _projected(state, observed, first, relief)


def _projected(state: RigState, observed: Observations, first: Float64, relief: Float64) -> Float64:
    axes = np.column_stack([first, np.ones(len(first))])
    plane = state.planes[observed.capture]
    inverse_depth = plane[:, 0] + plane[:, 1] * first[:, 0] + plane[:, 2] * first[:, 1] + relief
    matrices = np.stack([cv2.Rodrigues(pose[:3])[0] for pose in state.poses])
    turned = np.einsum("nij,nj->ni", matrices[observed.pose], axes)
    turned += inverse_depth[:, None] * state.poses[observed.pose, 3:]
    direction = turned[:, :2] / np.maximum(turned[:, 2:], 0.05)
    result = np.empty_like(first)
    for number, model in enumerate(state.models):
        some = observed.lens == number
        if some.any():
            result[some] = project(direction[some], state.lenses[number], model)
    return result


def _weights(residual: Float64, observed: Observations, turn: int) -> tuple[Float64, Bool]:
    """Return the (n,) weights, px⁻², and which observations count; the first turns are more patient."""
    sigma, length = observed.sigma_px, np.hypot(*residual.T)
    spread = max(1.0, float(np.median(length / sigma)) / 1.18)
    ratio = length / (sigma * spread)
    far = MAX_SIGMAS * (4 if turn < LENIENT_STEPS else 1)
    kept = (ratio < far) | (length < LEAST_FAR_PX)
    weight = huber(ratio, 1.5 * 1.41)
    return np.where(kept, weight / sigma**2, 0.0), np.asarray(kept)


def _share_by_lens(
    state: RigState, observed: Observations, residual: Float64, by_relief: Float64, sigma_px: Float64
) -> Float64:
    """Return the (n,) sigma of the points of a lens, or between captures, over that expected of them.

    Residuals count across the parallax: along it the relief of each point takes most of them.
    """
    length = np.maximum(np.hypot(*by_relief.T), 1e-12)
    across = np.abs(residual[:, 0] * by_relief[:, 1] - residual[:, 1] * by_relief[:, 0]) / length / sigma_px
    share = np.ones(len(observed))
    group = np.minimum(observed.pose, len(state.lenses))
    for each in np.unique(group):
        some = group == each
        share[some] = max(LEAST_SHARE, sigma_of(across[some]))
    return share


def _jacobian(
    state: RigState, observed: Observations, level: Float64, along: Float64, free: set[int]
) -> sparse.csr_matrix:
    """Return the (2 n, parameters) derivatives of `_predicted`.

    Columns of parameters that are not `free` are left empty.
    """
    n, lenses, poses = len(observed), state.lenses.size, state.poses.size
    now = _predicted(state, observed, level, along)
    entries: list[tuple[Index, Float64]] = []
    small = [1e-5 * float(state.lenses[0, 0])] * 3 + [1e-5, 1e-5, 1e-5, 1e-6, 1e-6]  # they move px by little
    for k, step in enumerate(small):
        moved = state.lenses.copy()
        moved[:, k] += step
        if free.intersection(range(k, lenses, OF_LENS)):
            own = _predicted(replace(state, lenses=moved), observed, level, along, state.lenses[0])
            entries.append((observed.lens * OF_LENS + k, (own - now) / step))
        if k in free:
            other = _predicted(state, observed, level, along, moved[0])
            entries.append((np.full(n, k), (other - now) / step))
    for k in range(OF_POSE):
        if free.intersection(range(lenses + k, lenses + poses, OF_POSE)):
            moved = state.poses.copy()
            moved[:, k] += 1e-6
            change = (_predicted(replace(state, poses=moved), observed, level, along) - now) / 1e-6
            entries.append((lenses + observed.pose * OF_POSE + k, change))
    for k in range(OF_PLANE):
        moved = state.planes.copy()
        moved[:, k] += 1e-4
        change = (_predicted(replace(state, planes=moved), observed, level, along) - now) / 1e-4
        entries.append((lenses + poses + observed.capture * OF_PLANE + k, change))
    columns = np.concatenate([np.repeat(column, 2) for column, _ in entries])
    values = np.concatenate([change.ravel() for _, change in entries])
    rows = np.tile(np.arange(2 * n), len(entries))
    return sparse.csr_matrix((values, (rows, columns)), (2 * n, lenses + poses + state.planes.size))


def _relief_sigma(state: RigState) -> float:
    """Return the standard deviation of a point's inverse depth from the plane of its capture."""
    base = float(np.hypot(*state.poses[: len(state.lenses), 3:5].T).max())
    return float(np.clip(RELIEF_PX / max(base * state.lenses[0, 0], 1e-9), *RELIEF_LIMITS))
