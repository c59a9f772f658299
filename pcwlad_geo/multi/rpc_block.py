"""The joint adjustment of the RPCs of many images from tie points intersected with a DEM.

The place that one image of a pair observes is followed through its RPC to the DEM, and from there through
the RPC of the other image to its pixels. What is observed there beside it is the bias of the second RPC less
that of the first carried along, plus what an error of the DEM's height makes. The height of every tie point
is an unknown with the DEM as its prior, eliminated point by point: a point counts fully across the epipolar
line, and along it as far as the DEM is known (Grodecki & Dial 2003, doi:10.14358/PERS.69.1.59).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from pcwlad_geo.correction.fit import LOSSLESS
from pcwlad_geo.correction.models import AffineCorrection
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
from pcwlad_geo.raster.grid import Grid, jacobian, map_px, middle_pixel_size_m
from pcwlad_geo.raster.rpc.dem import Dem, relief
from pcwlad_geo.raster.rpc.grid import RpcGrid, at_mean_height, image_px, with_height_offset
from pcwlad_geo.types import Bool, Float64, Index

GROUND_CELLS: Final = 5
"""The ground is divided into so many cells along each axis, which are left out in turn: fewer where they
would be smaller than a pixel of the DEM, whose error neighbours would share."""
PRIOR_SHARED_PX: Final = 0.03
"""Standard deviation of the error that the points of a pair share, where no cycle tells it."""
MIN_TOTAL_REDUNDANCY: Final = 0.3
"""Least sum of the redundancies of all pairs with which that error is estimated from their cycles."""
MIN_BLOCK_SIGMA_REDUNDANCY: Final = 0.1
"""Redundancies below this are taken as this in the sigma of a pair."""
DATUM_DEFECT: Final = 1e-5
"""Combinations of biases of less information than this share of the best known one are a matter of datum."""
NO_PARALLAX: Final = 1e-3
"""Pairs that a metre of height displaces by fewer px tell nothing of heights."""
OUTLIER_SIGMAS: Final = 5.0
"""A pair that lies off all others by more sigmas may be an outlier."""
OUTLIER_SHARE: Final = 0.5
"""It is, if without it the others contradict each other by less than this share."""
ZERO_SIGMA: Final = 1e-6
"""Standard deviation that stands for zero."""
DEM_PLACE_M: Final = 100.0
"""Standard deviation of the horizontal place of a DEM, as weak as errors of a datum are large."""
PLACE_SIGMAS: Final = 5.0
"""A DEM stays where it is, unless the relief tells by more sigmas that it lies elsewhere."""
HEIGHT_LIMIT: Final = 0.2
"""Heights off by more of their standard deviations count by their sign: what the ground of most points tells
is their median, whatever lies on the rest (forest, cliffs, cells of a coarse DEM)."""
NEEDED_OBSERVATIONS: Final = "the correction of an RPC needs tie points or control points of each image"
"""Message where the equations are singular."""
HEIGHT_STEP_M: Final = 1.0
"""Step of the derivatives by the height of the DEM."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockPair:
    """Tie points of two images in the pixels of their files; the ground itself may be one of the two."""

    first: int
    second: int
    first_px: Float64
    """(n, 2) observed pixels (col, row) of the first image."""
    second_px: Float64
    """(n, 2) those of the same places in the second image."""
    covariance_px2: Float64
    """(n, 2, 2) covariance of the second, given the first, px²."""
    height_m: Float64 | None = None
    """(n,) heights of control points above the ellipsoid; NaN, and None for tie points: those of the DEM."""
    window_px: float = 0.0
    """Side of the windows in which they were matched, px of the frame; 0: points tell of their own places."""

    def __len__(self) -> int:
        return len(self.first_px)


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """The linearised observations of a pair: its points as predicted in the second image, and derivatives."""

    residual_px: Float64
    """(n, 2) observed less predicted."""
    first_jacobian: Float64
    """(n, 2, 2) derivatives of the predicted px by those of the first image, through the terrain: the mean of
    all points, as windows average what slopes change from point to point."""
    first_terms: Float64
    """(n, 3) terms 1, column, row of the first image's correction."""
    second_terms: Float64
    height_derivative: Float64
    """(n, 2) derivative of the predicted px by the height of the DEM, px per metre."""
    dem_jacobian: Float64
    """(n, 2, 2) derivatives by a shift of the DEM (col, row), its px, orthogonal to those by the height."""
    ground_px: Float64
    """(n, 2) px of the frame."""
    points_per_dem_px: float
    """Number of points per pixel of the DEM that holds any: they share its error of height."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockFit:
    """How the points of a pair agree with the adjustment."""

    used: bool
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

    @property
    def dem_moved(self) -> bool:
        """Whether the relief tells that the DEM lies elsewhere: corrections are those of its true place."""
        return bool(np.hypot(*self.dem_shift_px) > PLACE_SIGMAS * np.hypot(*self.dem_sigma_px))

    def covariance(self, image: int, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance of an image's correction at its (n, 2) `at_px`, px²."""
        if image not in self.free:
            return np.zeros((len(at_px), 2, 2))
        terms = LOSSLESS[self.model]
        size = 2 * len(terms)
        begin = self.free.index(image) * size
        own = slice(begin, begin + size)
        at_places = ImageTerms.over(self.shapes[image]).values(at_px)[:, terms]
        return propagated(_design(at_places), self.covariance_px2[own, own], self.spread_px[:, own])


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


@dataclass(frozen=True, slots=True)
class ImageTerms:
    """Terms 1, column, row, the last two from -1 to 1 over an image."""

    centre_px: tuple[float, float]
    radius_px: float

    @staticmethod
    def over(shape: tuple[int, int]) -> ImageTerms:
        """Return the basis of an image of `shape` (rows, columns)."""
        rows, cols = shape
        return ImageTerms((cols / 2, rows / 2), max(rows, cols) / 2)

    def values(self, at_px: Float64) -> Float64:
        """Return the (n, 3) terms at the (n, 2) `at_px` (col, row)."""
        return np.column_stack([np.ones(len(at_px)), (at_px - self.centre_px) / self.radius_px])

    def correction(self, parameters: Float64, model: str) -> AffineCorrection:
        """Return the correction of the (terms, 2) `parameters` of a model, px."""
        full = np.zeros((3, 2))
        full[list(LOSSLESS[model])] = parameters
        slope = full[1:].T / self.radius_px
        shift = full[0] - slope @ np.array(self.centre_px)
        return AffineCorrection(model, np.column_stack([np.eye(2) + slope, shift]))


@dataclass(frozen=True, slots=True)
class RpcBlock:
    """The images of a block and the frame in which the ground is given."""

    grids: tuple[Grid, ...]
    """RPC grids of the images; plain ones of a reference, and of the ground for control points."""
    frame: Grid
    fixed: frozenset[int] = field(default_factory=frozenset)
    """Numbers of the images with an RPC that stay."""

    @property
    def dem(self) -> Dem | None:
        """The DEM of the RPC grids."""
        found = (grid.heights for grid in self.grids if isinstance(grid, RpcGrid))
        return next((each for each in found if isinstance(each, Dem)), None)

    @property
    def free(self) -> tuple[int, ...]:
        """The images whose RPC is corrected."""
        placed = [number for number, grid in enumerate(self.grids) if isinstance(grid, RpcGrid)]
        return tuple(number for number in placed if number not in self.fixed)


def pixel_in_frame(block: RpcBlock, image: int) -> float:
    """Return the size of a pixel in the middle of an image, px of the frame."""
    grid = at_mean_height(block.grids[image])
    return float(np.sqrt(abs(np.linalg.det(jacobian(grid.middle_px, grid, block.frame)[0]))))


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
    linearisations = tuple(_linearised(block, pair) for pair in pairs)
    if simpler is None:
        free = _BlockProblem(block, tuple(pairs), models[0], linearisations, dem_moves=True)
        simpler = _result(free, _solved(free), {})
    common = linearisations, simpler.dem_moved
    problems = {model: _BlockProblem(block, tuple(pairs), model, *common) for model in models}
    solved = {model: _solved(problem) for model, problem in problems.items()}
    weights = solved[models[-1]].weights  # those of the most flexible model judge all
    errors = {model: _squared_errors_px2(problems[model], solved[model], weights) for model in models}
    chosen = _selected_model(errors)
    scores = {model: float(np.sqrt(each.mean())) for model, each in errors.items() if len(each)}
    result = _result(problems[chosen], solved[chosen], scores)
    return replace(result, dem_shift_px=simpler.dem_shift_px, dem_sigma_px=simpler.dem_sigma_px)


def _selected_model(errors: Mapping[str, Float64]) -> str:
    """Return the last model that clearly beats the one so far, or the first, by (cells,) squared errors."""
    chosen, *others = errors
    for model in others:
        gain = errors[chosen] - errors[model]
        clear = len(gain) >= 6 and gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain))
        if clear and gain.mean() > 0.05**2:
            chosen = model
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class _BlockEstimate:
    """The unknowns of an adjustment as it proceeds, and what it was linearised and weighted with."""

    parameters: Float64
    """(images, terms, 2)."""
    start: Float64
    """(images, terms, 2) those at which the observations were linearised."""
    offsets: Float64
    """(pairs, 2) error that the points of each pair share, px of its second image."""
    used: Bool
    """(pairs,) those that no outlier test has excluded."""
    linearised: tuple[Linearisation, ...] = ()
    weights: tuple[Float64, ...] = ()
    """(n, 2, 2) of each pair."""
    scatters: tuple[float, ...] = ()
    """Of each pair, px."""
    dem_px: Float64 = field(default_factory=lambda: np.zeros(2))
    """(2,) shift of the DEM (col, row), its px."""
    start_dem_px: Float64 = field(default_factory=lambda: np.zeros(2))
    """(2,) that at which the observations were linearised."""
    shared_px: float = PRIOR_SHARED_PX
    """Standard deviation of the error that all points of a pair share."""
    sigma_height_m: float = 0.0
    """That of the heights of the DEM."""


@dataclass(frozen=True, eq=False)
class _BlockProblem:
    """The unknowns of an adjustment with one model: images, then terms, then (col, row)."""

    block: RpcBlock
    pairs: tuple[BlockPair, ...]
    model: str
    linearisations: tuple[Linearisation, ...]
    """Of each pair by the RPCs as they are: the derivatives hardly change."""
    dem_moves: bool = False
    """Whether the place of the DEM is an unknown."""

    @property
    def terms(self) -> list[int]:
        """Numbers of the terms of the model."""
        return list(LOSSLESS[self.model])

    @property
    def size(self) -> int:
        """Number of parameters of an image."""
        return 2 * len(self.terms)

    @cached_property  # asked for with each set of equations
    def dem_prior_px(self) -> float:
        """Standard deviation of the place of the DEM, its px."""
        dem = self.block.dem if self.dem_moves else None
        return DEM_PLACE_M / max(middle_pixel_size_m(dem.grid) or (DEM_PLACE_M,)) if dem else ZERO_SIGMA

    @property
    def unknowns(self) -> int:
        """Number of parameters of all free images; the shared errors and the DEM's shift follow them."""
        return len(self.block.free) * self.size

    @property
    def dem(self) -> Index:
        """(2,) numbers of the unknown shift of the DEM, the last."""
        return self.shared(len(self.pairs))

    def shared(self, pair: int) -> Index:
        """Return the (2,) numbers of the unknown error that the points of a pair share."""
        return self.unknowns + 2 * pair + np.arange(2)

    def start(self) -> _BlockEstimate:
        """Return the RPCs and the DEM as they are, all pairs in use."""
        zero, count = np.zeros((len(self.block.grids), len(self.terms), 2)), len(self.pairs)
        return _BlockEstimate(zero, zero, np.zeros((count, 2)), np.ones(count, bool))

    def correction(self, image: int, parameters: Float64) -> AffineCorrection:
        """Return the correction of an image, given those of all, (images, terms, 2)."""
        return ImageTerms.over(self.block.grids[image].shape).correction(parameters[image], self.model)

    def flat(self, parameters: Float64) -> Float64:
        """Return the (unknowns,) of the (images, terms, 2) `parameters`."""
        return parameters[list(self.block.free)].reshape(-1)

    def design(self, pair: BlockPair, linear: Linearisation) -> tuple[Float64, Index]:
        """Return the (n, 2, q) design of a pair and the (q,) numbers of its unknowns."""
        blocks, places = [np.zeros((len(pair), 2, 0))], [np.zeros(0, np.intp)]
        for image, terms, derivative in (
            (pair.second, linear.second_terms, np.eye(2)),
            (pair.first, linear.first_terms, -linear.first_jacobian),
        ):
            if image in self.block.free:
                begin = self.block.free.index(image) * self.size
                blocks.append(derivative @ _design(terms[:, self.terms]))
                places.append(np.arange(begin, begin + self.size))
        return np.concatenate(blocks, axis=2), np.concatenate(places)

    def residual_px(self, number: int, state: _BlockEstimate) -> Float64:
        """Return the (n, 2) distances of a pair's points from the adjustment."""
        linear = state.linearised[number]
        design, places = self.design(self.pairs[number], linear)
        step = self.flat(state.parameters - state.start)[places]
        return linear.residual_px - design @ step - linear.dem_jacobian @ (state.dem_px - state.start_dem_px)


def _design(terms: Float64) -> Float64:
    """Return the (n, 2, 2 k) design of (n, k) terms: each has a parameter of columns and one of rows."""
    return np.asarray(np.kron(terms[:, None], np.eye(2)), np.float64)


def _solved(problem: _BlockProblem) -> _BlockEstimate:
    """Iterate until lines of sight, weights and the pairs in use no longer change."""
    count, state, datum = len(problem.pairs), problem.start(), _datum(problem)
    for turn in range(10):
        before_px = state.dem_px
        linearised = [_linearised_again(problem, number, state) for number in range(count)]
        state = replace(state, start=state.parameters, start_dem_px=state.dem_px)
        state = replace(state, linearised=_orthogonal_to_height(linearised))
        state = _reweighted(problem, state, datum)
        if turn and np.abs(state.dem_px - before_px).max() < 0.1:  # px of the DEM
            break
    for _ in range(count):
        better = _without_the_outlier(problem, state, datum)
        if better is None:
            break
        state = _reweighted(problem, better, datum)
    return state


def _reweighted(problem: _BlockProblem, state: _BlockEstimate, datum: Float64) -> _BlockEstimate:
    for _ in range(5):
        state = _step(problem, _weighted(problem, state), datum)
    return state


def _linearised_again(problem: _BlockProblem, number: int, state: _BlockEstimate) -> Linearisation:
    """Follow the points of a pair with the corrections and the place of the DEM so far.

    The images were matched over the DEM where it was given: a place elsewhere changes what a window shows by
    the median change of height in it.
    """
    pair, frame = problem.pairs[number], problem.block.frame
    one, other = (problem.correction(image, state.parameters) for image in (pair.first, pair.second))
    grids = [problem.block.grids[image] for image in (pair.first, pair.second)]
    predicted_px = one.inverse(pair.first_px)
    ground_px = map_px(predicted_px, grids[0], frame)
    at_px = image_px(grids[1], frame, ground_px, pair.height_m)
    derivative = problem.linearisations[number].height_derivative
    higher_m, slope = relief(problem.block.dem, frame, ground_px, pair.window_px, state.dem_px)
    return replace(
        problem.linearisations[number],
        residual_px=pair.second_px - other.forward(at_px + derivative * higher_m[:, None]),
        dem_jacobian=np.nan_to_num(-derivative[:, :, None] * slope[:, None, :]),
        first_terms=ImageTerms.over(grids[0].shape).values(predicted_px),
        second_terms=ImageTerms.over(grids[1].shape).values(at_px),
        ground_px=ground_px,
    )


def _linearised(block: RpcBlock, pair: BlockPair, *, level: bool = False) -> Linearisation:
    """Follow the points of a pair through the first image, the ground (`level` or not), the second image.

    The DEM stays where it is: `dem_jacobian` is 0.
    """
    grids, frame = [block.grids[image] for image in (pair.first, pair.second)], block.frame
    if level:
        grids = [at_mean_height(grid) for grid in grids]

    def predict(px: Float64, higher_m: float = 0.0) -> Float64:
        first, second = (with_height_offset(grid, higher_m) if higher_m else grid for grid in grids)
        return image_px(second, frame, map_px(px, first, frame), pair.height_m)

    at_px, ground_px = predict(pair.first_px), map_px(pair.first_px, grids[0], frame)
    sides = [predict(pair.first_px + step) - predict(pair.first_px - step) for step in np.eye(2) / 2]
    by_first = np.stack(sides, axis=2)
    height_derivative = (predict(pair.first_px, HEIGHT_STEP_M) - at_px) / HEIGHT_STEP_M
    return Linearisation(
        residual_px=pair.second_px - at_px,
        first_jacobian=np.broadcast_to(np.nanmean(by_first, axis=0), by_first.shape),
        first_terms=ImageTerms.over(grids[0].shape).values(pair.first_px),
        second_terms=ImageTerms.over(grids[1].shape).values(at_px),
        height_derivative=height_derivative,
        dem_jacobian=np.zeros((len(pair), 2, 2)),
        ground_px=ground_px,
        points_per_dem_px=_points_per_dem_px(block, ground_px),
    )


def _points_per_dem_px(block: RpcBlock, ground_px: Float64) -> float:
    """Return `Linearisation.points_per_dem_px` of points at the (n, 2) `ground_px` of the frame."""
    if block.dem is None:
        return 1.0
    at_px = np.floor(map_px(ground_px, block.frame, block.dem.grid))
    return len(at_px) / max(1, len(np.unique(at_px, axis=0)))


def _orthogonal_to_height(linearised: Sequence[Linearisation]) -> tuple[Linearisation, ...]:
    """Remove from the derivatives by the DEM's place what a uniform change of height explains."""
    by_height = [np.nan_to_num(linear.height_derivative) for linear in linearised]
    every, by_place = np.concatenate(by_height), np.concatenate([each.dem_jacobian for each in linearised])
    share = np.einsum("na,nab->b", every, by_place) / max(float((every**2).sum()), NO_PARALLAX**2)
    return tuple(
        replace(linear, dem_jacobian=linear.dem_jacobian - each[:, :, None] * share)
        for linear, each in zip(linearised, by_height, strict=True)
    )


def _weighted(problem: _BlockProblem, state: _BlockEstimate) -> _BlockEstimate:
    """Weight all points by their residuals, and estimate the uncertainty of the DEM."""
    left = [problem.residual_px(number, state) - each for number, each in enumerate(state.offsets)]
    sigma_m = _height_sigma(problem, state.linearised, left)
    weights, scatters = [], []
    for pair, linear, residual in zip(problem.pairs, state.linearised, left, strict=True):
        weight = _weights(pair, linear, _height_variance(pair, linear, residual, sigma_m))
        known = np.asarray(weight.any(axis=(1, 2)))
        # control points are a few, set one by one: a wrong one must not pull at all
        power = 1 if pair.height_m is None else 3
        weight[known] *= outlier_factors(residual[known], weight[known], power)[:, None, None]
        weights.append(weight)
        scatters.append(sigma_of(residual[known]) if known.any() else 0.0)
    return replace(state, weights=tuple(weights), scatters=tuple(scatters), sigma_height_m=sigma_m)


def _height_variance(pair: BlockPair, linear: Linearisation, residual_px: Float64, sigma_m: float) -> Float64:
    """Return the (n,) variances of the DEM's heights, m²: all points of one of its pixels count as one."""
    height, _ = implied_heights(pair, linear, residual_px)
    off = np.abs(np.nan_to_num(height)) / (HEIGHT_LIMIT * max(sigma_m, ZERO_SIGMA))
    return sigma_m**2 * linear.points_per_dem_px * np.maximum(1.0, off)


def _weights(pair: BlockPair, linear: Linearisation, variance_m2: Float64 | float = 0.0) -> Float64:
    """Return the (n, 2, 2) inverse covariances of points, heights eliminated; 0 where unknown."""
    by_height = linear.height_derivative
    covariance = pair.covariance_px2 + (variance_m2 * (by_height[:, :, None] * by_height[:, None, :]).T).T
    known = np.isfinite(linear.residual_px).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    known &= np.isfinite(linear.first_jacobian).all(axis=(1, 2))
    weight = np.zeros_like(covariance)
    weight[known] = inverse(covariance[known], MEASURED)
    return weight


def implied_heights(pair: BlockPair, linear: Linearisation, residual_px: Float64) -> tuple[Float64, Float64]:
    """Return by how much (n,) points lie above the DEM, and the (n,) variance of that, metres and m².

    NaN where there is no parallax. The (n, 2) `residual_px` are distances from an adjustment.
    """
    weight = inverse(pair.covariance_px2, MEASURED)
    information = np.einsum("na,nab,nb->n", linear.height_derivative, weight, linear.height_derivative)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.einsum("na,nab,nb->n", linear.height_derivative, weight, residual_px) / information
        visible = np.hypot(*linear.height_derivative.T) >= NO_PARALLAX
        return np.where(visible, height, np.nan), np.where(visible, 1 / information, np.nan)


def _height_sigma(
    problem: _BlockProblem, linearised: Sequence[Linearisation], left: Sequence[Float64]
) -> float:
    """Return the robust standard deviation of the DEM at the points, beyond their own errors, metres."""
    found = [implied_heights(*each) for each in zip(problem.pairs, linearised, left, strict=True)]
    height, variance = (np.concatenate(each) for each in zip(*found, strict=True))
    known = np.isfinite(height) & np.isfinite(variance)
    if not known.any():
        return 0.0
    typical = sigma_of(height[known])
    return float(np.sqrt(max(typical**2 - float(np.median(variance[known])), 0.0)))


def _equations(
    problem: _BlockProblem, state: _BlockEstimate, datum: Float64, keep: Sequence[Float64] | None = None
) -> NormalEquations:
    """Return the normal equations of the parameters, the shared errors, the DEM's shift.

    The (unknowns, d) combinations of the parameters that are the `datum` are zero. The points of each pair
    may have (n,) factors `keep`.
    """
    unknowns, dem = np.arange(problem.unknowns), problem.dem
    equations = NormalEquations(int(dem[-1]) + 1)
    equations.expect(dem, problem.dem_prior_px, -state.start_dem_px)
    for number, pair in enumerate(problem.pairs):
        shared = problem.shared(number)
        # control points are seen one by one
        equations.expect(shared, state.shared_px if pair.height_m is None else ZERO_SIGMA)
        if not state.used[number]:
            continue
        linear, weight = state.linearised[number], state.weights[number]
        known = weight.any(axis=(1, 2))
        design, places = problem.design(pair, linear)
        alike = np.broadcast_to(np.eye(2), (len(pair), 2, 2))
        design = np.concatenate([design, alike, linear.dem_jacobian], axis=2)[known]
        weight = weight[known] if keep is None else weight[known] * keep[number][known, None, None]
        equations.observe(np.concatenate([places, shared, dem]), design, weight, linear.residual_px[known])
    largest = float(equations.matrix.diagonal()[unknowns].max(initial=1.0))
    equations.add(unknowns, 1e3 * largest * datum @ datum.T)  # far more than any point says
    equations.expect(unknowns, 1e3)  # what is unobservable stays as it is
    return equations


def _datum(problem: _BlockProblem) -> Float64:
    """Return the (unknowns, d) orthonormal combinations of the parameters that are a matter of datum.

    They are those that hardly change anything on level ground: the DEM's own relief is no datum.
    """
    block = problem.block
    linearised = tuple(_linearised(block, pair, level=True) for pair in problem.pairs)
    pairs = zip(problem.pairs, linearised, strict=True)
    known: list[Bool] = [np.asarray(_weights(*each).any(axis=(1, 2))) for each in pairs]
    # all pairs count alike: what few or uncertain control points say is known, and no matter of datum
    weights = tuple(each[:, None, None] * np.eye(2) / max(each.sum(), 1) for each in known)
    state = replace(problem.start(), linearised=linearised, weights=weights, shared_px=ZERO_SIGMA)
    whole = _equations(problem, state, np.zeros((problem.unknowns, 0))).matrix
    normal = whole[: problem.unknowns, : problem.unknowns].toarray()
    # scaled to lengths on the ground, so that the minimum norm holds there
    scale = np.repeat([pixel_in_frame(block, image) for image in block.free], problem.size)
    value, vector = np.linalg.eigh(normal / np.outer(scale, scale))
    free = vector[:, value < DATUM_DEFECT * value[-1]] * scale[:, None] if len(value) else vector
    return np.linalg.qr(free)[0]


def _step(problem: _BlockProblem, state: _BlockEstimate, datum: Float64) -> _BlockEstimate:
    """Solve the equations, and estimate the error that the points of a pair share by the cycles."""
    equations = _equations(problem, state, datum)
    solution = equations.solve(NEEDED_OBSERVATIONS)
    parameters, free = state.start.copy(), list(problem.block.free)
    parameters[free] += solution[: problem.unknowns].reshape(len(free), len(problem.terms), 2)
    offsets = np.asarray(solution[problem.unknowns : -2].reshape(-1, 2), np.float64)
    counted = state.used & np.array([pair.height_m is None for pair in problem.pairs])
    redundancy = float(_redundancy(problem, state, equations)[counted].sum())
    shared_px = PRIOR_SHARED_PX
    if redundancy >= MIN_TOTAL_REDUNDANCY:
        shared_px = max(float(np.sqrt((offsets[counted] ** 2).sum() / (2 * redundancy))), 0.01)
    dem_px = state.start_dem_px + solution[problem.dem]
    return replace(state, parameters=parameters, offsets=offsets, shared_px=shared_px, dem_px=dem_px)


def _redundancy(problem: _BlockProblem, state: _BlockEstimate, equations: NormalEquations) -> Float64:
    """Return for each of the (pairs,) how much of its shared error the other pairs check, from 0 to 1."""
    variances = np.diagonal(equations.covariance(NEEDED_OBSERVATIONS))[problem.unknowns : -2]
    return np.asarray(np.clip(1.0 - variances.reshape(-1, 2).mean(axis=1) / state.shared_px**2, 0.0, 1.0))


def _without_the_outlier(
    problem: _BlockProblem, state: _BlockEstimate, datum: Float64
) -> _BlockEstimate | None:
    """Return the state without the pair that contradicts all others; None if none does, or none can tell.

    Without it the others must still check each other, and contradict each other much less.
    """
    found: list[_BlockEstimate] = []
    ends = np.array([(pair.first, pair.second) for pair in problem.pairs])
    for number in np.flatnonzero(state.used).tolist():
        used = state.used.copy()
        used[number] = False
        if len(np.unique(components(ends[used], len(problem.block.grids))[ends])) > 1:  # it connects others
            continue
        trial = replace(state, used=used, shared_px=PRIOR_SHARED_PX)
        for _ in range(3):
            trial = _step(problem, trial, datum)
        limit_px = OUTLIER_SIGMAS * max(trial.shared_px, PRIOR_SHARED_PX)
        far = np.hypot(*_mean_residual(problem, trial, number)[0]) > limit_px
        if far and trial.shared_px < OUTLIER_SHARE * state.shared_px:
            found.append(trial)
    if not found:
        return None
    best = min(found, key=lambda each: each.shared_px)
    # do the pairs in use form cycles, which tell that they agree?
    redundancy = _redundancy(problem, best, _equations(problem, best, datum))
    return best if redundancy[best.used].sum() >= MIN_TOTAL_REDUNDANCY else None


def _mean_residual(
    problem: _BlockProblem, state: _BlockEstimate, number: int
) -> tuple[Float64, Float64, Float64]:
    """Return the (2,) weighted mean distance of a pair's points, its (2, 2) formal covariance, its design."""
    weight = state.weights[number]
    total = inverse(weight.sum(axis=0) + 1e-12 * np.eye(2), MEASURED)
    known = weight.any(axis=(1, 2))
    design, places = problem.design(problem.pairs[number], state.linearised[number])
    mean = np.zeros((2, problem.unknowns))
    mean[:, places] = total @ np.einsum("nab,nbp->ap", weight[known], design[known])
    left = problem.residual_px(number, state)[known]
    return np.asarray(total @ np.einsum("nab,nb->a", weight[known], left)), total, mean


def _cells(dem: Dem | None, frame: Grid, linearised: Sequence[Linearisation]) -> list[Index]:
    """Return the (n,) cell of the ground, no smaller than a pixel of a DEM, of the points of each pair."""
    every = np.concatenate([linear.ground_px for linear in linearised])
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    size = np.maximum(high - low, 1e-9)
    count = np.full(2, GROUND_CELLS)
    if dem is not None:
        frame_px_per_dem_px = inverse(jacobian(frame.middle_px, frame, dem.grid)[0])
        count = np.clip(size / np.abs(frame_px_per_dem_px).max(axis=1), 1, GROUND_CELLS).astype(np.intp)
    found = []
    for linear in linearised:
        place = np.clip(np.nan_to_num((linear.ground_px - low) / size) * count, 0, count - 1).astype(np.intp)
        found.append(place[:, 1] * GROUND_CELLS + place[:, 0])
    return found


def _without_cells(
    problem: _BlockProblem, state: _BlockEstimate, dem: Dem | None
) -> Iterator[tuple[list[Bool], Float64]]:
    """Yield the points of each cell of the ground, pair by pair, and the (unknowns,) step without them."""
    datum, cells = _datum(problem), _cells(dem, problem.block.frame, state.linearised)
    for number in np.unique(np.concatenate(cells)).tolist():
        inside = [cell == number for cell in cells]
        if sum(int(each.sum()) for each in inside) * 2 > sum(len(each) for each in inside):
            continue  # what is left of it tells nothing
        equations = _equations(problem, state, datum, [(~each).astype(np.float64) for each in inside])
        yield [np.asarray(each) for each in inside], equations.solve(NEEDED_OBSERVATIONS)


def _squared_errors_px2(
    problem: _BlockProblem, state: _BlockEstimate, common_weights: Sequence[Float64]
) -> Float64:
    """Return the (cells,) mean squared error, px², of points that were predicted without their cell.

    Weighted by the (n, 2, 2) weights `common_weights` of each pair.
    """
    found = []
    unit = sum(float(np.trace(each.sum(axis=0))) for each in common_weights) / sum(map(len, common_weights))
    for inside, solution in _without_cells(problem, state, problem.block.dem):
        squares, count = 0.0, 0
        for number, (chosen, common) in enumerate(zip(inside, common_weights, strict=True)):
            linear = state.linearised[number]
            design, places = problem.design(problem.pairs[number], linear)
            known = chosen & common.any(axis=(1, 2)) & state.weights[number].any(axis=(1, 2))
            left = linear.residual_px[known] - design[known] @ solution[places]
            left -= solution[problem.shared(number)]
            left -= linear.dem_jacobian[known] @ solution[problem.dem]
            squares += float(np.einsum("na,nab,nb->", left, common[known], left))
            count += int(known.sum())
        if count:
            found.append(2 * squares / count / unit)
    return np.array(found)


def _result(problem: _BlockProblem, state: _BlockEstimate, scores: Mapping[str, float]) -> BlockAdjustment:
    """Return the adjustment with its covariance and what it says of each pair."""
    datum, unknowns = _datum(problem), problem.unknowns
    covariance = _equations(problem, state, datum).covariance(NEEDED_OBSERVATIONS)
    steps = np.array([step for _, step in _without_cells(problem, state, problem.block.dem)])
    spread = jackknife(steps) if len(steps) > 1 else np.zeros((1, len(covariance)))
    dem_px2 = np.maximum(np.diagonal(covariance)[-2:], (spread[:, -2:] ** 2).sum(axis=0))
    own = np.ascontiguousarray(covariance[:unknowns, :unknowns])
    return BlockAdjustment(
        model=problem.model,
        scores=dict(scores),
        corrections=tuple(
            problem.correction(image, state.parameters) for image in range(len(problem.block.grids))
        ),
        edges=tuple(_fit(problem, state, number, own) for number in range(len(problem.pairs))),
        shared_px=state.shared_px,
        sigma_height_m=state.sigma_height_m,
        free=problem.block.free,
        shapes=tuple(grid.shape for grid in problem.block.grids),
        covariance_px2=own,
        spread_px=np.asarray(spread[:, :unknowns]),
        datum_rank=datum.shape[1],
        by_height_px=_response_to_height(problem, state, datum),
        dem_shift_px=state.dem_px,
        dem_sigma_px=np.sqrt(dem_px2),
        hold_out=_hold_out_check(problem, state),
    )


def _hold_out_check(problem: _BlockProblem, state: _BlockEstimate) -> HoldOutCheck | None:
    """Compare the points of each cell before and after an adjustment without them.

    Images are written over the DEM as it is, so that it is in its place here, wherever it may belong.
    """
    as_it_is, begun = replace(state, dem_px=np.zeros(2)), problem.flat(state.parameters - state.start)
    pairs = [number for number in range(len(problem.pairs)) if state.used[number]]
    linearised = {number: _linearised_again(problem, number, as_it_is) for number in pairs}
    sums = [np.zeros((0, 3))]
    for inside, solution in _without_cells(problem, state, None):
        for number in pairs:
            known = inside[number] & state.weights[number].any(axis=(1, 2))
            design, places = problem.design(problem.pairs[number], linearised[number])
            step = (solution[: problem.unknowns] - begun)[places]
            after = linearised[number].residual_px[known] - design[known] @ step
            before = problem.linearisations[number].residual_px[known]
            sums.append(np.array([[known.sum(), np.hypot(*before.T).sum(), np.hypot(*after.T).sum()]]))
    count, before_px, after_px = (np.concatenate(sums) / max(1.0, np.concatenate(sums)[:, 0].sum())).T
    if not count.any():
        return None
    worse = after_px - before_px
    spread = worse - worse.sum() * count
    return HoldOutCheck(float(before_px.sum()), float(after_px.sum()), float(np.sqrt((spread**2).sum())))


def _response_to_height(problem: _BlockProblem, state: _BlockEstimate, datum: Float64) -> Float64:
    """Return `BlockAdjustment.by_height_px`, of level ground: its relief is told by the other unknowns."""
    level = [_linearised(problem.block, pair, level=True) for pair in problem.pairs]
    linearised = tuple(replace(linear, residual_px=-linear.height_derivative) for linear in level)
    state = replace(state, linearised=linearised, start_dem_px=np.zeros(2))
    step = _equations(problem, state, datum).solve(NEEDED_OBSERVATIONS)[: problem.unknowns]
    found = np.zeros((len(problem.block.grids), 2))
    found[list(problem.block.free)] = step.reshape(-1, len(problem.terms), 2)[:, 0]
    return found


def _fit(problem: _BlockProblem, state: _BlockEstimate, number: int, covariance: Float64) -> BlockFit:
    offset, formal, mean = _mean_residual(problem, state, number)
    own = float(np.trace(formal)) / 2
    own += state.shared_px**2 if problem.pairs[number].height_m is None else 0.0
    adjusted = float(np.trace(mean @ covariance @ mean.T)) / 2
    used = bool(state.used[number])
    sigma_px, redundancy = reliability(own, adjusted, used, MIN_BLOCK_SIGMA_REDUNDANCY)
    return BlockFit(
        used=used,
        offset_px=(float(offset[0]), float(offset[1])),
        sigma_px=sigma_px,
        redundancy=redundancy,
        scatter_px=state.scatters[number],
        residual_px=problem.residual_px(number, state),
        weight=state.weights[number],
        linear=state.linearised[number],
    )
