"""Cells of the ground left out of an adjustment in turn: errors of its models, and whether it does harm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.multi.block.block import RpcBlock
from pcwlad_geo.multi.block.equations import (
    BlockEstimate,
    BlockProblem,
    datum_combinations,
    equations_of,
    linearised_again,
)
from pcwlad_geo.multi.block.linearisation import Linearisation
from pcwlad_geo.raster import Dem, jacobian
from pcwlad_geo.types import Bool, Float64, Index

NEEDED_OBSERVATIONS: Final = "the correction of an RPC needs tie points or control points of each image"
"""Message where the equations are singular."""


@dataclass(frozen=True, slots=True)
class HoldOutCheck:
    """How far points lie off over the DEM as it is, cell by cell predicted from all others."""

    before_px: float
    """Mean distance with the RPCs as they came, px of the second image of a pair."""
    after_px: float
    """With the corrected ones."""
    sigma_px: float
    """Standard error of the difference, from cell to cell."""

    @property
    def worse(self) -> bool:
        """Whether the adjustment did harm."""
        return self.after_px - self.before_px > max(0.1, 2.0 * self.sigma_px)


def _cells(dem: Dem | None, block: RpcBlock, linearised: Sequence[Linearisation]) -> list[Index]:
    """Return the (n,) cell of the ground, no smaller than a pixel of a DEM, of the points of each pair."""
    every = np.concatenate([linear.ground_px for linear in linearised])
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    size = np.maximum(high - low, 1e-9)
    frame, most = block.frame, block.parameters.ground_cells
    count = np.full(2, most)
    if dem is not None:
        frame_px_per_dem_px = inverse(jacobian(frame.middle_px, frame, dem.grid)[0])
        count = np.clip(size / np.abs(frame_px_per_dem_px).max(axis=1), 1, most).astype(np.intp)
    cells = []
    for linear in linearised:
        place = np.clip(np.nan_to_num((linear.ground_px - low) / size) * count, 0, count - 1).astype(np.intp)
        cells.append(place[:, 1] * most + place[:, 0])
    return cells


def without_cells(
    problem: BlockProblem, state: BlockEstimate, dem: Dem | None
) -> Iterator[tuple[list[Bool], Float64]]:
    """Yield the points of each cell of the ground, pair by pair, and the (unknowns,) step without them."""
    datum, cells = datum_combinations(problem), _cells(dem, problem.block, state.linearised)
    for number in np.unique(np.concatenate(cells)).tolist():
        inside = [cell == number for cell in cells]
        if sum(int(mask.sum()) for mask in inside) * 2 > sum(len(mask) for mask in inside):
            continue  # what is left of it tells nothing
        equations = equations_of(problem, state, datum, [(~mask).astype(np.float64) for mask in inside])
        yield [np.asarray(mask) for mask in inside], equations.solve(NEEDED_OBSERVATIONS)


def squared_errors_px2(
    problem: BlockProblem, state: BlockEstimate, common_weights: Sequence[Float64]
) -> Float64:
    """Return the (cells,) mean squared error, px², of points that were predicted without their cell.

    Weighted by the (n, 2, 2) weights `common_weights` of each pair.
    """
    errors = []
    unit = sum(float(np.trace(weight.sum(axis=0))) for weight in common_weights) / sum(
        map(len, common_weights)
    )
    for inside, solution in without_cells(problem, state, problem.block.dem):
        squares, count = 0.0, 0
        for number, (mask, common) in enumerate(zip(inside, common_weights, strict=True)):
            linear = state.linearised[number]
            design, places = problem.design(problem.pairs[number], linear)
            valid = mask & common.any(axis=(1, 2)) & state.weights[number].any(axis=(1, 2))
            residual_px = linear.residual_px[valid] - design[valid] @ solution[places]
            residual_px -= solution[problem.shared(number)]
            residual_px -= linear.dem_jacobian[valid] @ solution[problem.dem]
            squares += float(np.einsum("na,nab,nb->", residual_px, common[valid], residual_px))
            count += int(valid.sum())
        if count:
            errors.append(2 * squares / count / unit)
    return np.array(errors)


def hold_out_check(problem: BlockProblem, state: BlockEstimate) -> HoldOutCheck | None:
    """Compare the points of each cell before and after an adjustment without them.

    Images are written over the DEM as it is, so that it is in its place here, wherever it may belong.
    """
    as_it_is, begun = replace(state, dem_px=np.zeros(2)), problem.flat(state.parameters - state.start)
    pairs = [number for number in range(len(problem.pairs)) if state.in_use[number]]
    linearised = {number: linearised_again(problem, number, as_it_is) for number in pairs}
    sums = [np.zeros((0, 3))]
    for inside, solution in without_cells(problem, state, None):
        for number in pairs:
            valid = inside[number] & state.weights[number].any(axis=(1, 2))
            design, places = problem.design(problem.pairs[number], linearised[number])
            step = (solution[: problem.unknowns] - begun)[places]
            after = linearised[number].residual_px[valid] - design[valid] @ step
            before = problem.linearisations[number].residual_px[valid]
            sums.append(np.array([[valid.sum(), np.hypot(*before.T).sum(), np.hypot(*after.T).sum()]]))
    count, before_px, after_px = (np.concatenate(sums) / max(1.0, np.concatenate(sums)[:, 0].sum())).T
    if not count.any():
        return None
    worse = after_px - before_px
    spread = worse - worse.sum() * count
    return HoldOutCheck(float(before_px.sum()), float(after_px.sum()), float(np.sqrt((spread**2).sum())))
