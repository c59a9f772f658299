"""The unknowns of a block, and their normal equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pcwlad_geo.correction.fit import LOSSLESS
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.estimation.solving import NormalEquations
from pcwlad_geo.multi.block.block import BlockPair, ImageTerms, RpcBlock, pixel_in_frame
from pcwlad_geo.multi.block.linearisation import ZERO_SIGMA, Linearisation, linearised_pair, point_weights
from pcwlad_geo.multi.block.parameters import BLOCK, BlockParameters
from pcwlad_geo.raster import map_px, middle_pixel_size_m
from pcwlad_geo.raster.rpc.dem import relief
from pcwlad_geo.raster.rpc.grid import image_px
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True, eq=False)
class BlockEstimate:
    """The unknowns of an adjustment as it proceeds, and what it was linearised and weighted with."""

    parameters: Float64
    """(images, terms, 2)."""
    start: Float64
    """(images, terms, 2) those at which the observations were linearised."""
    offsets: Float64
    """(pairs, 2) error that the points of each pair share, px of its second image."""
    in_use: Bool
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
    shared_px: float = BLOCK.prior_shared_px
    """Standard deviation of the error that all points of a pair share."""
    sigma_height_m: float = 0.0
    """That of the heights of the DEM."""


@dataclass(frozen=True, eq=False)
class BlockProblem:
    """The unknowns of an adjustment with one model: images, then terms, then (col, row)."""

    block: RpcBlock
    pairs: tuple[BlockPair, ...]
    model: str
    linearisations: tuple[Linearisation, ...]
    """Of each pair by the RPCs as they are: the derivatives hardly change."""
    dem_moves: bool = False
    """Whether the place of the DEM is an unknown."""

    @property
    def parameters(self) -> BlockParameters:
        """The tuned numbers of its block."""
        return self.block.parameters

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
        position_m = self.parameters.dem_position_m
        return position_m / max(middle_pixel_size_m(dem.grid) or (position_m,)) if dem else ZERO_SIGMA

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

    def start(self) -> BlockEstimate:
        """Return the RPCs and the DEM as they are, all pairs in use."""
        zero, count = np.zeros((len(self.block.grids), len(self.terms), 2)), len(self.pairs)
        shared_px = self.parameters.prior_shared_px
        return BlockEstimate(zero, zero, np.zeros((count, 2)), np.ones(count, bool), shared_px=shared_px)

    def correction(self, image: int, parameters: Float64) -> AffineCorrection:
        """Return the correction of an image by the (images, terms, 2) `parameters` of all."""
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
                blocks.append(derivative @ term_design(terms[:, self.terms]))
                places.append(np.arange(begin, begin + self.size))
        return np.concatenate(blocks, axis=2), np.concatenate(places)

    def residual_px(self, number: int, state: BlockEstimate) -> Float64:
        """Return the (n, 2) distances of a pair's points from the adjustment."""
        linear = state.linearised[number]
        design, places = self.design(self.pairs[number], linear)
        step = self.flat(state.parameters - state.start)[places]
        return linear.residual_px - design @ step - linear.dem_jacobian @ (state.dem_px - state.start_dem_px)


def term_design(terms: Float64) -> Float64:
    """Return the (n, 2, 2 k) design of (n, k) `terms`: each has a parameter of columns and one of rows."""
    return np.asarray(np.kron(terms[:, None], np.eye(2)), np.float64)


def linearised_again(problem: BlockProblem, number: int, state: BlockEstimate) -> Linearisation:
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


def equations_of(
    problem: BlockProblem, state: BlockEstimate, datum: Float64, keep: Sequence[Float64] | None = None
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
        if not state.in_use[number]:
            continue
        linear, weight = state.linearised[number], state.weights[number]
        valid = weight.any(axis=(1, 2))
        design, places = problem.design(pair, linear)
        identity = np.broadcast_to(np.eye(2), (len(pair), 2, 2))
        design = np.concatenate([design, identity, linear.dem_jacobian], axis=2)[valid]
        weight = weight[valid] if keep is None else weight[valid] * keep[number][valid, None, None]
        equations.observe(np.concatenate([places, shared, dem]), design, weight, linear.residual_px[valid])
    largest = float(equations.matrix.diagonal()[unknowns].max(initial=1.0))
    equations.add(unknowns, 1e3 * largest * datum @ datum.T)  # far more than any point says
    equations.expect(unknowns, 1e3)  # what is unobservable stays as it is
    return equations


def datum_combinations(problem: BlockProblem) -> Float64:
    """Return the (unknowns, d) orthonormal combinations of the parameters that are a matter of datum.

    They are those that hardly change anything on level ground: the DEM's own relief is no datum.
    """
    block = problem.block
    linearised = tuple(linearised_pair(block, pair, level=True) for pair in problem.pairs)
    pairs = zip(problem.pairs, linearised, strict=True)
    masks: list[Bool] = [np.asarray(point_weights(*pair).any(axis=(1, 2))) for pair in pairs]
    # all pairs count alike: what few or uncertain control points say is known, and no matter of datum
    weights = tuple(mask[:, None, None] * np.eye(2) / max(mask.sum(), 1) for mask in masks)
    state = replace(problem.start(), linearised=linearised, weights=weights, shared_px=ZERO_SIGMA)
    whole = equations_of(problem, state, np.zeros((problem.unknowns, 0))).matrix
    normal = whole[: problem.unknowns, : problem.unknowns].toarray()
    # scaled to lengths on the ground, so that the minimum norm holds there
    scale = np.repeat([pixel_in_frame(block, image) for image in block.free], problem.size)
    value, vector = np.linalg.eigh(normal / np.outer(scale, scale))
    free = (
        vector[:, value < problem.parameters.datum_defect * value[-1]] * scale[:, None]
        if len(value)
        else vector
    )
    return np.linalg.qr(free)[0]
