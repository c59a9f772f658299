"""The equations of the tie points of a pair, whole and without blocks of the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.estimation.robust import MEASURED, ROBUST, outlier_factors, sigma_of
from pcwlad_geo.estimation.solving import RANK, inverse, least_squares, solve
from pcwlad_geo.multi.stack.bases import Basis, polynomial_over
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True, eq=False)
class EdgeEquations:
    """What the points of an edge say of the difference of its images' coefficients, axis by axis.

    The error that all its points share has a shift and slopes along x and y about their middle: three terms.
    """

    first: int
    second: int
    normal: Float64
    """(2 terms, 2 terms) normal matrix of the difference."""
    across: Float64
    """(2 terms, 6) products with the shared error's terms."""
    inner: Float64
    """(6, 6) normal matrix of those."""
    rhs: Float64
    """(2 terms,) right-hand side."""
    shared_rhs: Float64
    """(6,) that of the shared error."""
    values: Float64
    """(terms,) weighted mean of the terms."""
    observed: Float64
    """(2,) weighted mean of the observed differences, map units."""
    formal: float
    """Variance of that along an axis by the points' own errors."""
    scatter: float
    """Robust standard deviation of the points along an axis."""
    error: float
    """Standard deviation, along an axis, of what all points share: of the change of their own affine
    without a block of them."""

    def without(self, block: Sequence[Float64]) -> EdgeEquations:
        """Return what is left without a block; the whole where that is more than half of it.

        The points of the `block` add (2 terms, 2 terms), (2 terms, 6), (6, 6), (2 terms,) and (6,) arrays to
        `normal`, `across`, `inner`, `rhs` and `shared_rhs`.
        """
        block_normal, across, inner, rhs, shared_rhs = block
        if np.trace(block_normal) > np.trace(self.normal) / 2:
            return self
        return replace(
            self,
            normal=self.normal - block_normal,
            across=self.across - across,
            inner=self.inner - inner,
            rhs=self.rhs - rhs,
            shared_rhs=self.shared_rhs - shared_rhs,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Weighted:
    """The points of an edge with their weights at the ground that the displacements so far tell."""

    ground: Float64
    values: Float64
    affine: Float64
    weights: Float64
    observed: Float64
    residual: Float64


def edge_equations(edge: Edge, basis: Basis, coefficients: Float64, blocks: GroundBlocks) -> EdgeEquations:
    """Sum up the points of an edge, those that lie off the others with less weight.

    The `coefficients`, (images, terms, 2), tell the ground so far, which is divided into `blocks`.
    """
    return _summed(edge, _weighted(edge, basis, coefficients), basis, blocks)


def errors_of(parts: Sequence[EdgeEquations]) -> Float64:
    """Return the (edges,) standard deviations of what the points of each share, relative to each other.

    A few blocks tell them with a quarter of error; the scatter of the points, which is well known, goes with
    them: the geometric mean of both.
    """
    error, scatter = np.array([(part.error, part.scatter) for part in parts]).T
    return np.asarray(np.sqrt(error * scatter * np.median(error / scatter)))


@dataclass(frozen=True, slots=True)
class GroundBlocks:
    """Squares of the ground, which are left out in turn."""

    side: float
    """Map units."""
    along: int
    """A square of `along` times `along` blocks holds each number once, wherever it lies: they repeat."""

    @staticmethod
    def of(edges: Sequence[Edge], along: int) -> GroundBlocks:
        """Return those of images of the size that pairs of them typically share, `along` each axis."""
        sizes = [np.sqrt(np.prod(np.ptp(edge.first_xy, axis=0))) for edge in edges]
        return GroundBlocks(max(float(np.median(sizes)), 1e-9) / along, along)

    @property
    def halved(self) -> GroundBlocks:
        """Blocks of half the side."""
        return replace(self, side=self.side / 2)

    @property
    def count(self) -> int:
        """How many numbers there are, from 0."""
        return self.along**2

    def numbers(self, ground: Float64, low: tuple[float, float]) -> Index:
        """Return the (n,) numbers of the blocks of (n, 2) positions `ground`, whose corner is `low`."""
        col, row = (np.floor((ground - low) / self.side).astype(int) % self.along).T
        return np.asarray(row * self.along + col)


@dataclass(frozen=True, slots=True, eq=False)
class Fold:
    """A block of the points of an edge, left out."""

    number: int
    remaining: EdgeEquations
    """What is left of the edge; the whole where the block held more than half of it."""
    observed: Float64
    """(n, 2) differences that the points of the block show, map units."""
    values: Float64
    """(n, terms) values of the functions there."""


def folds_of(
    edge: Edge, basis: Basis, coefficients: Float64, blocks: GroundBlocks, whole: EdgeEquations
) -> list[Fold]:
    """Return the points of an edge without each of the `blocks` in turn.

    A block that holds more than half of the edge stays. The (images, terms, 2) `coefficients` tell the ground
    so far; `whole` are all points of the edge.
    """
    points = _weighted(edge, basis, coefficients)
    number = blocks.numbers(points.ground, basis.low_px)
    return [
        Fold(
            int(block),
            whole.without(_sums(points, number == block)),
            points.observed[number == block],
            points.values[number == block],
        )
        for block in np.unique(number)
    ]


def _weighted(edge: Edge, basis: Basis, coefficients: Float64) -> _Weighted:
    ground = edge.first_xy
    for _ in range(4):
        ground = edge.first_xy - basis.values(ground) @ coefficients[edge.first]
    values = basis.values(ground)
    observed = edge.second_xy - edge.first_xy
    residual = observed - values @ (coefficients[edge.second] - coefficients[edge.first])
    # about the pair's own middle: slopes about that of all ground would be shifts where a pair lies off it
    affine = polynomial_over([ground], 1).values(ground)
    residual = residual - affine @ least_squares(affine, residual)
    residual = residual - np.median(residual, axis=0)
    weights = inverse(edge.covariance, MEASURED)
    weights *= outlier_factors(residual, weights)[:, None, None]
    if edge.images is not None:
        weights *= (2.0 / edge.images)[:, None, None]
    return _Weighted(ground, values, affine, weights, observed, residual)


def _summed(edge: Edge, points: _Weighted, basis: Basis, blocks: GroundBlocks) -> EdgeEquations:
    weights = points.weights
    total = weights.sum(axis=0)
    share = np.trace(weights, axis1=1, axis2=2) / np.trace(total)
    typical_sigma = float(np.median(np.sqrt(np.trace(edge.covariance, axis1=1, axis2=2) / 2)))
    scatter = max(sigma_of(points.residual), 0.1 * typical_sigma)
    sums, number = _sums(points, slice(None)), blocks.numbers(points.ground, basis.low_px)
    return EdgeEquations(
        edge.first,
        edge.second,
        *sums,
        values=share @ points.values,
        observed=share @ points.observed,
        formal=float(np.trace(inverse(total, MEASURED))) / 2,
        scatter=scatter,
        error=max(_error(points, sums, number), scatter / np.sqrt(len(edge))),
    )


def _error(points: _Weighted, sums: Sequence[Float64], number: Index) -> float:
    """Return `EdgeEquations.error`: the jackknife of the affine of an edge."""
    inner, shared_rhs = sums[2], sums[4]
    solutions = []
    for block_number in np.unique(number):
        block = _sums(points, number == block_number)
        if np.trace(block[2]) <= np.trace(inner) / 2:
            solutions.append(_solved(inner - block[2], shared_rhs - block[4]))
    if len(solutions) < 4:  # fewer blocks tell nothing
        return 0.0
    terms = points.affine.shape[1]
    changes = (np.array(solutions) - np.mean(solutions, axis=0)).reshape(len(solutions), 2, terms)
    moment = points.affine.T @ points.affine / len(points.affine)
    variance = np.einsum("kat,ts,kas->", changes, moment, changes) / 2 * (len(solutions) - 1) / len(solutions)
    return ROBUST.block_correlation * float(np.sqrt(variance))


def _solved(normal: Float64, right: Float64) -> Float64:
    """Solve (n, n) normal equations; what the points leave open, as slopes across a line of them, is 0."""
    if np.linalg.cond(normal) < 1 / RANK:
        return solve(normal, right, MEASURED)
    return least_squares(normal, right, least=RANK)


def _sums(points: _Weighted, selection: Bool | slice) -> tuple[Float64, Float64, Float64, Float64, Float64]:
    """Return the matrices and right-hand sides of `EdgeEquations` over points, axis by axis."""
    terms, affine_terms = points.values.shape[1], points.affine.shape[1]
    design = np.hstack([points.values, points.affine, points.observed])[selection]
    products = np.zeros((2, design.shape[1], 2, design.shape[1]))
    for a, b in ((0, 0), (0, 1), (1, 1)):
        products[a, :, b] = products[b, :, a] = design.T @ (points.weights[selection, a, b, None] * design)
    one, other = slice(0, terms), slice(terms, terms + affine_terms)
    right = products[:, :, 0, -2] + products[:, :, 1, -1]
    return (
        products[:, one, :, one].reshape(2 * terms, 2 * terms),
        products[:, one, :, other].reshape(2 * terms, 2 * affine_terms),
        products[:, other, :, other].reshape(2 * affine_terms, 2 * affine_terms),
        right[:, one].ravel(),
        right[:, other].ravel(),
    )


def ends_of(edges: Sequence[Edge] | Sequence[EdgeEquations]) -> Index:
    """Return the (edges, 2) numbers of the images of edges."""
    return np.array([(edge.first, edge.second) for edge in edges], np.intp).reshape(-1, 2)
