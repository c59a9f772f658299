"""The joint adjustment of the RPCs of many images from tie points intersected with a DEM.

The place that one image of a pair observes is followed through its RPC to the DEM, and from there through
the RPC of the other image to its pixels. What is observed there beside it is the bias of the second RPC less
that of the first carried along, plus what an error of the DEM's height makes. The height of every tie point
is an unknown with the DEM as its prior, eliminated point by point: a point counts fully across the epipolar
line, and along it as far as the DEM is known (Grodecki & Dial 2003, doi:10.14358/PERS.69.1.59).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.correction.fit import LOSSLESS
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.selection_parameters import SELECTION
from pcwlad_geo.estimation.comparison import is_significant, simplest_unbeaten
from pcwlad_geo.estimation.robust import (
    MEASURED,
    jackknife,
    outlier_factors,
    propagated,
    reliability,
    sigma_of,
)
from pcwlad_geo.estimation.solving import NormalEquations, components, inverse
from pcwlad_geo.execution.runner import one_library_thread
from pcwlad_geo.multi.block.block import BlockPair, ImageTerms, RpcBlock
from pcwlad_geo.multi.block.equations import (
    BlockEstimate,
    BlockProblem,
    datum_combinations,
    equations_of,
    linearised_again,
    term_design,
)
from pcwlad_geo.multi.block.left_out import (
    NEEDED_OBSERVATIONS,
    HoldOutCheck,
    hold_out_check,
    squared_errors_px2,
    without_cells,
)
from pcwlad_geo.multi.block.linearisation import (
    Linearisation,
    height_variance,
    implied_heights,
    linearised_pair,
    orthogonal_to_height,
    point_weights,
)
from pcwlad_geo.multi.block.parameters import BLOCK, BlockParameters
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True, eq=False)
class BlockFit:
    """How the points of a pair agree with the adjustment."""

    in_use: bool
    offset_px: tuple[float, float]
    """Their weighted mean distance from the adjustment (col, row), px of the second image."""
    sigma_px: float
    """Standard deviation of that along an axis, if the pair is right."""
    redundancy: float
    """Share of the offset that other pairs check."""
    scatter_px: float
    """Robust standard deviation of its points along an axis, heights free as far as the DEM is uncertain."""
    residual_px: Float64
    """(n, 2) residuals."""
    weight: Float64
    """(n, 2, 2) weights of the points, 1/px²; 0 for those not used."""
    linear: Linearisation


@dataclass(frozen=True, slots=True, eq=False)
class BlockAdjustment:
    """The corrections of all RPCs of a block, in one frame, and their covariance."""

    model: str
    """shift, drift or affine."""
    scores: Mapping[str, float]
    """RMSE (px) by model of points that were left out."""
    corrections: tuple[AffineCorrection, ...]
    """Of each image; the identity for one that stays."""
    edges: tuple[BlockFit, ...]
    shared_px: float
    """Standard deviation of the error that all points of a pair share."""
    sigma_height_m: float
    """Robust standard deviation of the DEM's heights at the tie points, where parallax tells it."""
    free: tuple[int, ...]
    """Numbers of the images with a correction."""
    shapes: tuple[tuple[int, int], ...]
    """Rows and columns of each image."""
    covariance_px2: Float64
    """(p, p) covariance of the parameters of the free images: image by image, term by term, (col, row)."""
    spread_px: Float64
    """(cells, p) changes of the parameters without a cell of the ground, scaled as a jackknife asks for."""
    datum_rank: int
    """Number of combinations of the parameters that only the datum tells."""
    by_height_px: Float64
    """(images, 2) mean corrections (col, row) that a DEM one metre too high would bring about, px."""
    dem_shift_px: Float64
    """(2,) by which the DEM must be moved (col, row) for its relief to fit the points, its px."""
    dem_sigma_px: Float64
    """(2,) standard deviation of that."""
    hold_out: HoldOutCheck | None
    """What points held out say of the adjustment; None where all lie in one place."""
    parameters: BlockParameters = BLOCK

    @property
    def dem_moved(self) -> bool:
        """Whether the relief tells that the DEM lies elsewhere: corrections are those of its true place."""
        return bool(
            np.hypot(*self.dem_shift_px) > self.parameters.dem_shift_sigmas * np.hypot(*self.dem_sigma_px)
        )

    def covariance(self, image: int, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance of an image's correction at its (n, 2) `at_px`, px²."""
        if image not in self.free:
            return np.zeros((len(at_px), 2, 2))
        terms = LOSSLESS[self.model]
        size = 2 * len(terms)
        begin = self.free.index(image) * size
        span = slice(begin, begin + size)
        at_places = ImageTerms.over(self.shapes[image]).values(at_px)[:, terms]
        return propagated(term_design(at_places), self.covariance_px2[span, span], self.spread_px[:, span])


@one_library_thread()
def adjust_block(
    block: RpcBlock,
    pairs: Sequence[BlockPair],
    models: Sequence[str] = tuple(LOSSLESS),
    simpler: BlockAdjustment | None = None,
) -> BlockAdjustment:
    """Estimate the biases of all RPCs of a block together.

    The simplest model is taken that no other beats in predicting cells of the ground that were left out, by
    more than a standard error and 0.05 px. Where neither reference nor control points fix them, the biases
    are those of the smallest sum of squares on the ground (inner constraints). The DEM stays in its place
    unless its relief clearly tells another; that place is that of the `simpler` adjustment, where it was
    estimated before. The pairs connect all images, and of the `models` to choose from the simplest is first.
    """
    linearisations = tuple(linearised_pair(block, pair) for pair in pairs)
    if simpler is None:
        free = BlockProblem(block, tuple(pairs), models[0], linearisations, dem_moves=True)
        simpler = _result(free, _solved(free), {})
    common = linearisations, simpler.dem_moved
    problems = {model: BlockProblem(block, tuple(pairs), model, *common) for model in models}
    solved = {model: _solved(problem) for model, problem in problems.items()}
    weights = solved[models[-1]].weights  # those of the most flexible model judge all
    errors = {model: squared_errors_px2(problems[model], solved[model], weights) for model in models}
    model_name = _selected_model(errors, block.parameters)
    scores = {model: float(np.sqrt(squares.mean())) for model, squares in errors.items() if len(squares)}
    result = _result(problems[model_name], solved[model_name], scores)
    return replace(result, dem_shift_px=simpler.dem_shift_px, dem_sigma_px=simpler.dem_sigma_px)


def _selected_model(errors: Mapping[str, Float64], parameters: BlockParameters) -> str:
    """Return the last model that clearly beats the one so far, or the first, by (cells,) squared errors."""

    def beats(model: str, simpler: str) -> bool:
        gain = errors[simpler] - errors[model]
        enough = len(gain) >= parameters.min_cells
        return enough and is_significant(gain, SELECTION.significance, parameters.min_gain_px**2)

    return simplest_unbeaten(errors, beats)


def _solved(problem: BlockProblem) -> BlockEstimate:
    """Iterate until lines of sight, weights and the pairs in use no longer change."""
    count, state, datum = len(problem.pairs), problem.start(), datum_combinations(problem)
    for turn in range(10):
        before_px = state.dem_px
        linearised = [linearised_again(problem, number, state) for number in range(count)]
        state = replace(state, start=state.parameters, start_dem_px=state.dem_px)
        state = replace(state, linearised=orthogonal_to_height(linearised))
        state = _reweighted(problem, state, datum)
        if turn and np.abs(state.dem_px - before_px).max() < 0.1:  # px of the DEM
            break
    for _ in range(count):
        better = _without_the_outlier(problem, state, datum)
        if better is None:
            break
        state = _reweighted(problem, better, datum)
    return state


def _reweighted(problem: BlockProblem, state: BlockEstimate, datum: Float64) -> BlockEstimate:
    for _ in range(5):
        state = _step(problem, _weighted(problem, state), datum)
    return state


def _weighted(problem: BlockProblem, state: BlockEstimate) -> BlockEstimate:
    """Weight all points by their residuals, and estimate the uncertainty of the DEM."""
    residuals = [problem.residual_px(number, state) - offset for number, offset in enumerate(state.offsets)]
    sigma_m = _height_sigma(problem, state.linearised, residuals)
    weights, scatters = [], []
    for pair, linear, residual in zip(problem.pairs, state.linearised, residuals, strict=True):
        variance = height_variance(pair, linear, residual, sigma_m, problem.parameters.height_limit)
        weight = point_weights(pair, linear, variance)
        valid = np.asarray(weight.any(axis=(1, 2)))
        power = 1 if pair.height_m is None else problem.parameters.control_power
        weight[valid] *= outlier_factors(residual[valid], weight[valid], power)[:, None, None]
        weights.append(weight)
        scatters.append(sigma_of(residual[valid]) if valid.any() else 0.0)
    return replace(state, weights=tuple(weights), scatters=tuple(scatters), sigma_height_m=sigma_m)


def _height_sigma(
    problem: BlockProblem, linearised: Sequence[Linearisation], residuals: Sequence[Float64]
) -> float:
    """Return the robust standard deviation of the DEM at the points, beyond their own errors, metres."""
    heights = [implied_heights(*arrays) for arrays in zip(problem.pairs, linearised, residuals, strict=True)]
    height, variance = (np.concatenate(arrays) for arrays in zip(*heights, strict=True))
    valid = np.isfinite(height) & np.isfinite(variance)
    if not valid.any():
        return 0.0
    typical = sigma_of(height[valid])
    return float(np.sqrt(max(typical**2 - float(np.median(variance[valid])), 0.0)))


def _step(problem: BlockProblem, state: BlockEstimate, datum: Float64) -> BlockEstimate:
    """Solve the equations, and estimate the error that the points of a pair share by the cycles."""
    equations = equations_of(problem, state, datum)
    solution = equations.solve(NEEDED_OBSERVATIONS)
    parameters, free = state.start.copy(), list(problem.block.free)
    parameters[free] += solution[: problem.unknowns].reshape(len(free), len(problem.terms), 2)
    offsets = np.asarray(solution[problem.unknowns : -2].reshape(-1, 2), np.float64)
    counted = state.in_use & np.array([pair.height_m is None for pair in problem.pairs])
    redundancy = float(_redundancy(problem, state, equations)[counted].sum())
    numbers = problem.parameters
    shared_px = numbers.prior_shared_px
    if redundancy >= numbers.min_total_redundancy:
        rms_px = float(np.sqrt((offsets[counted] ** 2).sum() / (2 * redundancy)))
        shared_px = max(rms_px, numbers.least_shared_px)
    dem_px = state.start_dem_px + solution[problem.dem]
    return replace(state, parameters=parameters, offsets=offsets, shared_px=shared_px, dem_px=dem_px)


def _redundancy(problem: BlockProblem, state: BlockEstimate, equations: NormalEquations) -> Float64:
    """Return for each of the (pairs,) how much of its shared error the other pairs check, from 0 to 1."""
    variances = np.diagonal(equations.covariance(NEEDED_OBSERVATIONS))[problem.unknowns : -2]
    return np.asarray(np.clip(1.0 - variances.reshape(-1, 2).mean(axis=1) / state.shared_px**2, 0.0, 1.0))


def _without_the_outlier(problem: BlockProblem, state: BlockEstimate, datum: Float64) -> BlockEstimate | None:
    """Return the state without the pair that contradicts all others; None if none does, or none can tell.

    Without it the others must still check each other, and contradict each other much less.
    """
    candidates: list[BlockEstimate] = []
    numbers = problem.parameters
    ends = np.array([(pair.first, pair.second) for pair in problem.pairs])
    for number in np.flatnonzero(state.in_use).tolist():
        in_use = state.in_use.copy()
        in_use[number] = False
        if len(np.unique(components(ends[in_use], len(problem.block.grids))[ends])) > 1:  # it connects others
            continue
        trial = replace(state, in_use=in_use, shared_px=numbers.prior_shared_px)
        for _ in range(3):
            trial = _step(problem, trial, datum)
        limit_px = numbers.outlier_sigmas * max(trial.shared_px, numbers.prior_shared_px)
        is_far = np.hypot(*_mean_residual(problem, trial, number)[0]) > limit_px
        if is_far and trial.shared_px < numbers.outlier_share * state.shared_px:
            candidates.append(trial)
    if not candidates:
        return None
    best = min(candidates, key=lambda state_tried: state_tried.shared_px)
    # do the pairs in use form cycles, which tell that they agree?
    redundancy = _redundancy(problem, best, equations_of(problem, best, datum))
    return best if redundancy[best.in_use].sum() >= numbers.min_total_redundancy else None


def _mean_residual(
    problem: BlockProblem, state: BlockEstimate, number: int
) -> tuple[Float64, Float64, Float64]:
    """Return the (2,) weighted mean distance of a pair's points, its (2, 2) formal covariance, its design."""
    weight = state.weights[number]
    total = inverse(weight.sum(axis=0) + 1e-12 * np.eye(2), MEASURED)
    valid = weight.any(axis=(1, 2))
    design, places = problem.design(problem.pairs[number], state.linearised[number])
    mean = np.zeros((2, problem.unknowns))
    mean[:, places] = total @ np.einsum("nab,nbp->ap", weight[valid], design[valid])
    residual_px = problem.residual_px(number, state)[valid]
    return np.asarray(total @ np.einsum("nab,nb->a", weight[valid], residual_px)), total, mean


def _result(problem: BlockProblem, state: BlockEstimate, scores: Mapping[str, float]) -> BlockAdjustment:
    """Return the adjustment with its covariance and what it says of each pair."""
    datum, unknowns = datum_combinations(problem), problem.unknowns
    covariance = equations_of(problem, state, datum).covariance(NEEDED_OBSERVATIONS)
    steps = np.array([step for _, step in without_cells(problem, state, problem.block.dem)])
    spread = jackknife(steps) if len(steps) > 1 else np.zeros((1, len(covariance)))
    dem_px2 = np.maximum(np.diagonal(covariance)[-2:], (spread[:, -2:] ** 2).sum(axis=0))
    parameter_covariance = np.ascontiguousarray(covariance[:unknowns, :unknowns])
    return BlockAdjustment(
        model=problem.model,
        scores=dict(scores),
        corrections=tuple(
            problem.correction(image, state.parameters) for image in range(len(problem.block.grids))
        ),
        edges=tuple(
            _fit(problem, state, number, parameter_covariance) for number in range(len(problem.pairs))
        ),
        shared_px=state.shared_px,
        sigma_height_m=state.sigma_height_m,
        free=problem.block.free,
        shapes=tuple(grid.shape for grid in problem.block.grids),
        covariance_px2=parameter_covariance,
        spread_px=np.asarray(spread[:, :unknowns]),
        datum_rank=datum.shape[1],
        by_height_px=_response_to_height(problem, state, datum),
        dem_shift_px=state.dem_px,
        dem_sigma_px=np.sqrt(dem_px2),
        hold_out=hold_out_check(problem, state),
        parameters=problem.parameters,
    )


def _response_to_height(problem: BlockProblem, state: BlockEstimate, datum: Float64) -> Float64:
    """Return `BlockAdjustment.by_height_px`, of level ground: its relief is told by the other unknowns."""
    level = [linearised_pair(problem.block, pair, level=True) for pair in problem.pairs]
    linearised = tuple(replace(linear, residual_px=-linear.height_derivative) for linear in level)
    state = replace(state, linearised=linearised, start_dem_px=np.zeros(2))
    step = equations_of(problem, state, datum).solve(NEEDED_OBSERVATIONS)[: problem.unknowns]
    response = np.zeros((len(problem.block.grids), 2))
    response[list(problem.block.free)] = step.reshape(-1, len(problem.terms), 2)[:, 0]
    return response


def _fit(problem: BlockProblem, state: BlockEstimate, number: int, covariance: Float64) -> BlockFit:
    offset, formal, mean = _mean_residual(problem, state, number)
    variance = float(np.trace(formal)) / 2
    variance += state.shared_px**2 if problem.pairs[number].height_m is None else 0.0
    adjusted = float(np.trace(mean @ covariance @ mean.T)) / 2
    in_use = bool(state.in_use[number])
    sigma_px, redundancy = reliability(variance, adjusted, in_use, problem.parameters.min_sigma_redundancy)
    return BlockFit(
        in_use=in_use,
        offset_px=(float(offset[0]), float(offset[1])),
        sigma_px=sigma_px,
        redundancy=redundancy,
        scatter_px=state.scatters[number],
        residual_px=problem.residual_px(number, state),
        weight=state.weights[number],
        linear=state.linearised[number],
    )
