"""The refinement in plain numpy: slow, short, and the oracle of the compiled one.

The same algorithm as `kernels/refinement.c`, written anew from the equations: interpolation by scipy's
spline, gain and offset as two more unknowns of each channel, eliminated by projection instead of by sums.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.ndimage import map_coordinates, uniform_filter

from pcwlad_geo.matching.kernels.refinement import ITERATION_LIMITS as LIMITS
from pcwlad_geo.matching.refinement import (
    REFINEMENT,
    ChannelMaps,
    Float64,
    Index,
    InitialEstimate,
    Refined,
    correlation_half_px,
    first_relaxation,
)

GRADIENT_STEP_PX: Final = 1e-3
VARIANCE_FLOOR: Final = 1e-5


class _StuckError(Exception):
    """The window left the image, or says nothing about the shift."""


def refine_plain(
    reference: ChannelMaps,
    target: ChannelMaps,
    corners_rc: Index,
    start: InitialEstimate,
    *,
    window_px: int | tuple[int, int],
    step_px: int = 1,
    use_structure: bool = True,
    robust: bool = True,
    affine: bool = False,
    iterations: int = 20,
    least_valid: float = 0.6,
) -> Refined:
    """Return what `refinement.refine` computes; the parameters are the same."""
    n = len(corners_rc)
    result = Refined(np.zeros((n, 2)), np.zeros((n, 2, 2)), np.zeros((n, 2, 2)), np.zeros(n, bool))
    for p, (row, col) in enumerate(corners_rc):
        window = _Window(reference, target, int(row), int(col), window_px, step_px, affine)
        shift, linear = start.shift_xy_px[p].copy(), start.linear[p].copy()
        valid = window.validity(shift)
        if valid is None or valid.mean() < least_valid:
            continue
        try:
            structure = None
            if start.structure is not None:
                structure = [start.structure[p] * valid] * len(reference.maps)
            elif not use_structure:
                structure = [valid] * len(reference.maps)
            elif start.structure_xy_px is not None:
                structure = window.structure(start.structure_xy_px[p], linear, valid)
            relaxation = first_relaxation(robust, structure is None)
            control = _StepControl(relaxation, start.reached_by_px, learns=not affine)
            for iteration in range(iterations):
                weights = structure if structure is not None else window.structure(shift, linear, valid)
                matrix, right, scores = window.equations(shift, linear, weights, robust)
                step = np.asarray(np.linalg.solve(matrix, right), np.float64).reshape(2, -1)
                linear += step[:, 1:] / window.half if affine else 0.0
                before_px = control.length
                shift += control.move(step[:, 0])
                if np.linalg.norm(shift - start.shift_xy_px[p]) > REFINEMENT.most_move_px:
                    raise _StuckError
                next_px = control.length * min(control.length / before_px, 1.0)
                if before_px < LIMITS.near_px and next_px < REFINEMENT.tolerance_px:
                    every = len(matrix) // 2
                    bread = np.linalg.inv(matrix)[::every, ::every]
                    result.covariance_px2[p] = bread @ (scores.T @ scores) @ bread
                    result.converged[p] = control.determined(LIMITS.min_slope)
                    break
                if iteration >= LIMITS.settled_after and control.length > LIMITS.settling_px and not affine:
                    break
                if iteration >= LIMITS.patience and not control.determined(LIMITS.min_slope / 2):
                    break
        except _StuckError:
            result.converged[p] = False
        result.shift_xy_px[p], result.linear[p] = shift, linear
    return result


class _StepControl:
    """Makes moves longer than plain steps, by how much these have shrunk so far (Broyden's method)."""

    def __init__(self, relaxation: float, reached_by_px: float, *, learns: bool) -> None:
        self.learns = learns
        self.slopes: Float64 = np.eye(2) / relaxation
        self.learned, self.length = False, reached_by_px
        self.moved: Float64 | None = None
        self.before: Float64 = np.zeros(2)

    def move(self, plain: Float64) -> Float64:
        """Return the move for a plain step; `length` is that of the move before it was cut."""
        if self.moved is not None and self.learns:
            self._learn(self.before - plain, self.moved)
        move = np.linalg.solve(self.slopes, plain) if np.linalg.det(self.slopes) > 0 else plain
        if move @ plain <= 0:
            move = plain
        longer = float(np.linalg.norm(move) / np.linalg.norm(plain))
        move = move / max(longer / LIMITS.largest_relaxation, 1.0)
        self.length = float(np.linalg.norm(move))
        cut = max(self.length / LIMITS.longest_step_px, 1.0)
        self.moved, self.before = np.asarray(move / cut, np.float64), plain
        return self.moved

    def _learn(self, shrunk: Float64, moved: Float64) -> None:
        if not self.learned:
            slope = float(shrunk @ moved / (moved @ moved))
            self.slopes = min(max(slope, 1 / LIMITS.largest_relaxation), 1.0) * np.eye(2)
            self.learned = True
        self.slopes = self.slopes + np.outer(shrunk - self.slopes @ moved, moved) / (moved @ moved)

    def determined(self, least: float) -> bool:
        """Tell whether plain steps shrink in every direction."""
        return bool(np.linalg.eigvalsh((self.slopes + self.slopes.T) / 2)[0] >= least)


class _Window:
    """One point's window in both images."""

    def __init__(
        self,
        reference: ChannelMaps,
        target: ChannelMaps,
        row: int,
        col: int,
        window_px: int | tuple[int, int],
        step_px: int,
        affine: bool,
    ) -> None:
        self.reference, self.target, self.affine = reference, target, affine
        half_rows, half_cols = (side // 2 // step_px for side in np.broadcast_to(window_px, 2).tolist())
        self.half = np.array([half_cols, half_rows])
        self.pad = correlation_half_px(2 * int(self.half.min()) + 1)
        down, across = (
            np.arange(-half - self.pad, half + self.pad + 1) * step_px for half in (half_rows, half_cols)
        )
        self.y, self.x = np.meshgrid(down, across, indexing="ij")
        self.rows, self.cols = row + self.y, col + self.x
        self.inside = _inside(reference.valid.shape, self.rows, self.cols, 0, 0)
        self.maps = reference.maps[:, self.rows, self.cols].astype(float) if self.inside else reference.maps
        self.core = np.s_[self.pad : -self.pad, self.pad : -self.pad]
        blocks = max(4, round(max(np.broadcast_to(window_px, 2)) / REFINEMENT.block_px))
        block_row, block_col = (np.arange(2 * n + 1) * blocks // (2 * n + 1) for n in (half_rows, half_cols))
        self.block = block_row[:, None] * blocks + block_col

    def validity(self, shift: Float64) -> Float64 | None:
        """Return 1 where both images are valid, None where the reference's window sticks out."""
        if not self.inside:
            return None
        rows, cols = self.rows[self.core], self.cols[self.core]
        there = rows + int(np.round(shift[1])), cols + int(np.round(shift[0]))
        target = map_coordinates(self.target.valid.astype(float), there, order=0, mode="constant", cval=0.0)
        both: Float64 = self.reference.valid[rows, cols] * target
        return both

    def structure(self, shift: Float64, linear: Float64, valid: Float64) -> list[Float64]:
        """Return the squared positive local correlation of each channel."""
        weights = []
        for channel, g in enumerate(self.maps):
            i = self._sample(channel, shift, linear)[0]
            mean = [uniform_filter(a, 2 * self.pad + 1)[self.core] for a in (g, i, g * g, i * i, g * i)]
            covariance = np.maximum(mean[4] - mean[0] * mean[1], 0)
            variance_g, variance_i = mean[2] - mean[0] ** 2, mean[3] - mean[1] ** 2
            weights.append(
                valid * covariance**2 / (variance_g + VARIANCE_FLOOR) / (variance_i + VARIANCE_FLOOR)
            )
        return weights

    def equations(
        self, shift: Float64, linear: Float64, structure: list[Float64], robust: bool
    ) -> tuple[Float64, Float64, Float64]:
        """Return the normal matrix and right side of all channels, and the scores of the blocks."""
        total = []
        for channel, weight in enumerate(structure):
            i, slope_x, slope_y = (a[self.core].ravel() for a in self._sample(channel, shift, linear))
            g, w = self.maps[channel][self.core].ravel(), weight.ravel()
            radiometric = np.c_[np.ones(i.size), i]
            fit = _weighted_fit(radiometric, g, w)
            residual = g - radiometric @ fit
            if robust:
                sigma = LIMITS.sigma_per_mean_deviation * (w * abs(residual)).sum() / w.sum()
                w = w / (1 + abs(residual) / sigma)
                fit = _weighted_fit(radiometric, g, w)
                residual = g - radiometric @ fit
            if fit[1] <= 0 and len(structure) > 1:
                continue
            design = fit[1] * np.c_[slope_x, slope_y]
            if self.affine:
                position = np.c_[np.ones(i.size), self.x[self.core].ravel(), self.y[self.core].ravel()]
                position[:, 1:] /= self.half
                design = (design[:, :, None] * position[:, None, :]).reshape(-1, 6)
            apart = design - radiometric @ _weighted_fit(radiometric, design, w)
            variance = (w * residual**2).sum() / w.sum()
            pull = (w * residual)[:, None] * apart / variance
            scores = [np.bincount(self.block.ravel(), pull[:, k]) for k in (0, design.shape[1] // 2)]
            total.append(((apart.T * w) @ apart / variance, pull.sum(axis=0), np.stack(scores, axis=1)))
        if not total:
            raise _StuckError
        matrix, right, scores = (np.sum(parts, axis=0) for parts in zip(*total, strict=True))
        return matrix, right, scores

    def _sample(self, channel: int, shift: Float64, linear: Float64) -> Float64:
        """Return the target's values and gradient (along the target's own axes), (3, extended, extended)."""
        cols = self.cols + linear[0, 0] * self.x + linear[0, 1] * self.y + shift[0]
        rows = self.rows + linear[1, 0] * self.x + linear[1, 1] * self.y + shift[1]
        plane = self.target.coefficients[channel].astype(float)
        if not _inside(plane.shape, rows, cols, 1, 2):
            raise _StuckError
        h = GRADIENT_STEP_PX
        at = [
            map_coordinates(plane, (rows + dy, cols + dx), order=3, prefilter=False, mode="mirror")
            for dy, dx in ((0, 0), (0, h), (0, -h), (h, 0), (-h, 0))
        ]
        return np.stack([at[0], (at[1] - at[2]) / (2 * h), (at[3] - at[4]) / (2 * h)])


def _inside(
    shape: tuple[int, ...], rows: Float64 | Index, cols: Float64 | Index, before: int, after: int
) -> bool:
    low = min(rows.min(), cols.min()) >= before
    return bool(low and np.floor(rows.max()) + after < shape[0] and np.floor(cols.max()) + after < shape[1])


def _weighted_fit(design: Float64, values: Float64, weight: Float64) -> Float64:
    """Return the coefficients of the weighted least-squares fit values = design · coefficients."""
    weighted = design.T * weight
    return np.asarray(np.linalg.solve(weighted @ design, weighted @ values), np.float64)
