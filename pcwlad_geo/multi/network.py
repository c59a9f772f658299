"""The normal equations of a stack: functions of place, and what the tie points of each pair say of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final, Protocol

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU
from scipy.spatial import cKDTree

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.models import PolynomialBasis, SplineGrid
from pcwlad_geo.correction.thin_plate import bending
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import BLOCK_CORRELATION, MEASURED, outlier_factors, reliability, sigma_of
from pcwlad_geo.estimation.solving import (
    RANK,
    NormalEquations,
    components,
    factorised,
    inverse,
    least_squares,
    solve,
    undetermined,
)
from pcwlad_geo.types import Bool, Float64, Index

SPLINE: Final = "tps"
"""The model whose displacement is a smooth spline."""
IMAGE_MODELS: Final = (*(name for name, model in MODELS.items() if model.order is not None), SPLINE)
"""Models of an image, the simpler first."""
SPLINE_CELLS: Final = 4
"""Cells of a spline along the longer side of the ground."""
ROUGHNESS: Final = (0.1, 1.0, 10.0)
"""Bendings of a spline that are tried, map units over the side of a cell: of the deviation of neighbouring
coefficients from a plane, standard deviation."""
SAME_PX: Final = 0.5
"""Points that lie nearer to each other in an image are of one feature, map units (px of the frame)."""
MIN_EDGE_SIGMA_REDUNDANCY: Final = 0.01
"""Redundancies below this are taken as this in the sigma of an edge."""
LARGEST_GROWTH: Final = 1e4
"""Coefficients so many times as large as what is observed are those of a singular matrix."""
BLOCKS: Final = 3
"""An image is divided into so many blocks along each axis, which are left out in turn."""


def lossless(basis: Basis) -> bool:
    """Return whether images of a model keep their pixels, with a corrected geotransform."""
    return isinstance(basis, PolynomialBasis) and basis.order <= 1


class Basis(Protocol):
    """Functions of place."""

    @property
    def low_px(self) -> tuple[float, float]:
        """Corner (x, y) of the ground, map units."""

    @property
    def centre_px(self) -> tuple[float, float]:
        """Its middle."""

    def values(self, at_px: Float64) -> Float64:
        """Return the (n, terms) values of the functions at the (n, 2) positions `at_px` (x, y)."""


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """Bicubic B-splines on a coarse grid; planes cost nothing, bending does."""

    grid: SplineGrid
    centre_px: tuple[float, float]
    low_px: tuple[float, float]
    roughness: float
    """Standard deviation, map units, of what the bending of a cell is expected to be."""

    def values(self, at_px: Float64) -> Float64:
        """Return the (n, terms) values of the B-splines, row by row of the grid, at the (n, 2) `at_px`."""
        return np.asarray(self.grid.design(np.asarray(at_px, dtype=np.float64)).toarray())

    @cached_property
    def penalty(self) -> Float64:
        """The (terms, terms) normal matrix of what is known beforehand: little bending."""
        return np.asarray(bending(self.grid).toarray()) / self.roughness**2


@dataclass(frozen=True, slots=True, eq=False)
class HomographyBasis(PolynomialBasis):
    """An infinitesimal homography: a polynomial of order 2, of eight unknowns for both axes together."""

    @property
    def mixing(self) -> Float64:
        """The (12, 8) coefficients, axis by axis, by the parameters of a homography.

        These are the displacement and slopes of each axis, then those of the horizon, which move (u, v) by
        u (u, v) and by v (u, v).
        """
        found = np.zeros((12, 8))
        for axis in range(2):
            for term in range(3):
                found[6 * axis + term, 3 * axis + term] = 1.0
        found[3, 6] = found[10, 6] = 1.0  # u² along x, uv along y
        found[4, 7] = found[11, 7] = 1.0  # uv along x, v² along y
        return found


def mixing_of(basis: Basis) -> Float64 | None:
    """Return the (2 * terms, p) coefficients of an image by p unknowns; None where they are the unknowns."""
    return basis.mixing if isinstance(basis, HomographyBasis) else None


def terms_of(basis: Basis) -> int:
    """Return the number of functions of a basis."""
    return int(basis.values(np.array([basis.centre_px])).shape[1])


def penalty_of(basis: Basis) -> Float64:
    """Return the (terms, terms) normal matrix of what is known of coefficients beforehand: of a spline."""
    terms = terms_of(basis)
    return basis.penalty if isinstance(basis, SplineBasis) else np.zeros((terms, terms))


def polynomial_over(
    places: Sequence[Float64], order: int, kind: type[PolynomialBasis] = PolynomialBasis
) -> PolynomialBasis:
    """Return the terms of a polynomial about the middle of the ground of (n, 2) `places` (x, y)."""
    low = np.min([place.min(axis=0) for place in places], axis=0)
    high = np.max([place.max(axis=0) for place in places], axis=0)
    centre, radius = (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)
    return kind(order, float_pair(centre), radius, float_pair(low), float_pair(high))


def basis_over(places: Sequence[Float64], model: str, roughness: float = ROUGHNESS[1]) -> Basis:
    """Return the functions of a model, one of `IMAGE_MODELS`, over the ground of tie points.

    The `places` of these are (n, 2) positions (x, y), map units; for the `roughness` see `SplineBasis`.
    """
    polynomial = polynomial_over(places, MODELS[model].order or 0)
    if model != SPLINE:
        return polynomial
    spacing = 2 * polynomial.radius_px / SPLINE_CELLS
    size = np.subtract(polynomial.high_px, polynomial.low_px)
    across, down = (max(1, int(np.ceil(side / spacing - 1e-9))) for side in size)
    grid = SplineGrid(polynomial.low_px, spacing, (across, down))
    return SplineBasis(grid, polynomial.centre_px, polynomial.low_px, roughness)


class UndeterminedImageError(InputError):
    """The tie points of an image, which has a number or a name, leave its correction open."""

    def __str__(self) -> str:
        return (
            f"the points of image {self.args[0]} do not determine its correction, as they are few or lie on "
            "a line: give more, or a simpler --model"
        )


@contextmanager
def named(images: Sequence[int | str]) -> Iterator[None]:
    """Give the image of an `UndeterminedImageError` its number or its name among `images`."""
    try:
        yield
    except UndeterminedImageError as error:
        error.args = (images[error.args[0]],)
        raise


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """The tie points of a pair of images, on the ground where each image's own georeferencing places them."""

    first: int
    """Number of the image that was the reference."""
    second: int
    first_xy: Float64
    """(n, 2) positions (x, y) by the first image, map units."""
    second_xy: Float64
    """(n, 2) positions of the same places by the second image."""
    covariance: Float64
    """(n, 2, 2) covariance of their differences, map units²."""
    images: Float64 | None = None
    """(n,) number of images that share each point, see `linked`; None: these two."""
    evidence: float = 1.0
    """How much speaks for the pair by itself, relative to others."""

    def __len__(self) -> int:
        return len(self.first_xy)


@dataclass(frozen=True, slots=True)
class EdgeFit:
    """How a pair agrees with all others."""

    used: bool
    """False for a pair that contradicts the others."""
    offset: tuple[float, float]
    """By how much its points lie off the adjustment on average (x, y), map units."""
    sigma: float
    """Standard deviation of that offset along an axis, if the pair is right, map units."""
    redundancy: float
    """Share of the offset that the other pairs check, 0 to 1: nothing tells whether one of 0 is wrong."""
    scatter: float
    """Robust standard deviation of its points along an axis, map units."""
    shared: float
    """Standard deviation of the error that all its points share, along an axis, map units."""

    @property
    def ratio(self) -> float:
        """The offset in standard deviations."""
        return float(np.hypot(*self.offset)) / self.sigma


@dataclass(frozen=True, slots=True, eq=False)
class EdgeEquations:
    """What the points of an edge say of the difference of its images' coefficients, axis by axis.

    The error that all its points share has a shift and slopes along x and y about their middle: three terms.
    """

    first: int
    second: int
    own: Float64
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
        `own`, `across`, `inner`, `rhs` and `shared_rhs`.
        """
        own, across, inner, rhs, shared_rhs = block
        if np.trace(own) > np.trace(self.own) / 2:
            return self
        return replace(
            self,
            own=self.own - own,
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
    near: Float64
    weights: Float64
    observed: Float64
    left: Float64


def edge_equations(edge: Edge, basis: Basis, coefficients: Float64, side: float) -> EdgeEquations:
    """Sum up the points of an edge, those that lie off the others with less weight.

    Blocks of its points are squares of a `side`, map units; `coefficients`, (images, terms, 2), tell the
    ground so far.
    """
    return _summed(edge, _weighted(edge, basis, coefficients), basis, side)


def errors_of(parts: Sequence[EdgeEquations]) -> Float64:
    """Return the (edges,) standard deviations of what the points of each share, relative to each other.

    A few blocks tell them with a quarter of error; the scatter of the points, which is well known, goes with
    them: the geometric mean of both.
    """
    error, scatter = np.array([(part.error, part.scatter) for part in parts]).T
    return np.asarray(np.sqrt(error * scatter * np.median(error / scatter)))


def linked(edges: Sequence[Edge]) -> list[Edge]:
    """Return pairs with the number of images that share each of their points.

    Points of two pairs that lie within `SAME_PX` of each other in an image that both have are of one feature;
    what that image sees of it is in the error of both. Those so connected are a track. The pairs of k images
    of it tell no more than k - 1 independent ones: with a weight of 2 / k each, as many as all k (k - 1) / 2
    of them would.
    """
    count = np.cumsum([0, *(len(edge) for edge in edges)])
    at = np.concatenate([place for edge in edges for place in (edge.first_xy, edge.second_xy)])
    of_point = np.concatenate([np.tile(np.arange(a, b), 2) for a, b in pairwise(count.tolist())])
    image = np.concatenate([np.repeat([edge.first, edge.second], len(edge)) for edge in edges])
    links = [np.empty((0, 2), dtype=np.intp)]
    for number in np.unique(image):
        there = np.flatnonzero(image == number)
        links.append(of_point[there[_near_pairs(at[there])]])
    track = components(np.concatenate(links), int(count[-1]))
    tracked = np.unique(np.column_stack([track[of_point], image]), axis=0)[:, 0]
    images = np.bincount(tracked, minlength=len(track)).astype(np.float64)[track]
    return [replace(edge, images=images[a:b]) for edge, (a, b) in zip(edges, pairwise(count), strict=True)]


def _near_pairs(at: Float64) -> Index:
    """Return (k, 2) numbers of points within `SAME_PX` of each other, which connect all that lie so near.

    Of many points in one place each is paired with a few alone: all pairs would be as many as their square.
    """
    places, of_place = np.unique(np.round(at, 6), axis=0, return_inverse=True)
    order = np.argsort(of_place.ravel(), kind="stable")
    same = np.flatnonzero(np.diff(of_place.ravel()[order]) == 0)
    equal = np.column_stack([order[same], order[same + 1]])
    first = np.full(len(places), len(at))
    np.minimum.at(first, of_place.ravel(), np.arange(len(at)))
    # itself, and enough to connect those of one feature
    distance, near = cKDTree(places).query(places, k=17, distance_upper_bound=SAME_PX)
    one, other = np.nonzero(np.isfinite(distance))
    found = np.column_stack([first[one], first[near[one, other]]])
    return np.vstack([equal, found[found[:, 0] != found[:, 1]]]).astype(np.intp)


def side_of_blocks(edges: Sequence[Edge]) -> float:
    """Return the side of the blocks of images of the size that pairs of them typically share, map units."""
    sizes = [np.sqrt(np.prod(np.ptp(edge.first_xy, axis=0))) for edge in edges]
    return max(float(np.median(sizes)), 1e-9) / BLOCKS


@dataclass(frozen=True, slots=True, eq=False)
class Fold:
    """A block of the points of an edge, left out."""

    number: int
    kept: EdgeEquations
    """What is left of the edge; the whole where the block held more than half of it."""
    observed: Float64
    """(n, 2) differences that the points of the block show, map units."""
    values: Float64
    """(n, terms) values of the functions there."""


def folds_of(
    edge: Edge, basis: Basis, coefficients: Float64, side: float, whole: EdgeEquations
) -> list[Fold]:
    """Return each block of the points of an edge, a square of a side in map units, left out.

    A block that holds more than half of the edge stays. Blocks are numbered 0 to BLOCKS² - 1, and the numbers
    repeat beyond: a square of BLOCKS x BLOCKS blocks holds each once, wherever it lies. The (images, terms,
    2) `coefficients` tell the ground so far; `whole` are all points of the edge.
    """
    points = _weighted(edge, basis, coefficients)
    number = _numbers(points, basis, side)
    return [
        Fold(
            int(each),
            whole.without(_sums(points, number == each)),
            points.observed[number == each],
            points.values[number == each],
        )
        for each in np.unique(number)
    ]


def _numbers(points: _Weighted, basis: Basis, side: float) -> Index:
    """Return the (n,) number of the block of each point."""
    col, row = (np.floor((points.ground - basis.low_px) / side).astype(int) % BLOCKS).T
    return np.asarray(row * BLOCKS + col)


def _weighted(edge: Edge, basis: Basis, coefficients: Float64) -> _Weighted:
    ground = edge.first_xy
    for _ in range(4):
        ground = edge.first_xy - basis.values(ground) @ coefficients[edge.first]
    values = basis.values(ground)
    observed = edge.second_xy - edge.first_xy
    left = observed - values @ (coefficients[edge.second] - coefficients[edge.first])
    # about the pair's own middle: slopes about that of all ground would be shifts where a pair lies off it
    near = polynomial_over([ground], 1).values(ground)
    left = left - near @ least_squares(near, left)
    left = left - np.median(left, axis=0)
    weights = inverse(edge.covariance, MEASURED)
    weights *= outlier_factors(left, weights)[:, None, None]
    if edge.images is not None:
        weights *= (2.0 / edge.images)[:, None, None]
    return _Weighted(ground, values, near, weights, observed, left)


def _summed(edge: Edge, points: _Weighted, basis: Basis, side: float) -> EdgeEquations:
    weights = points.weights
    total = weights.sum(axis=0)
    each = np.trace(weights, axis1=1, axis2=2) / np.trace(total)
    typical_sigma = float(np.median(np.sqrt(np.trace(edge.covariance, axis1=1, axis2=2) / 2)))
    scatter = max(sigma_of(points.left), 0.1 * typical_sigma)
    sums = _sums(points, slice(None))
    return EdgeEquations(
        edge.first,
        edge.second,
        *sums,
        values=each @ points.values,
        observed=each @ points.observed,
        formal=float(np.trace(inverse(total, MEASURED))) / 2,
        scatter=scatter,
        error=max(_error(points, sums, _numbers(points, basis, side)), scatter / np.sqrt(len(edge))),
    )


def _error(points: _Weighted, sums: Sequence[Float64], number: Index) -> float:
    """Return `EdgeEquations.error`: the jackknife of the affine of an edge."""
    inner, shared_rhs = sums[2], sums[4]
    found = []
    for each in np.unique(number):
        block = _sums(points, number == each)
        if np.trace(block[2]) <= np.trace(inner) / 2:
            found.append(_solved(inner - block[2], shared_rhs - block[4]))
    if len(found) < 4:  # fewer blocks tell nothing
        return 0.0
    terms = points.near.shape[1]
    changes = (np.array(found) - np.mean(found, axis=0)).reshape(len(found), 2, terms)
    moment = points.near.T @ points.near / len(points.near)
    variance = np.einsum("kat,ts,kas->", changes, moment, changes) / 2 * (len(found) - 1) / len(found)
    return BLOCK_CORRELATION * float(np.sqrt(variance))


def _solved(normal: Float64, right: Float64) -> Float64:
    """Solve (n, n) normal equations; what the points leave open, as slopes across a line of them, is 0."""
    if np.linalg.cond(normal) < 1 / RANK:
        return solve(normal, right, MEASURED)
    return least_squares(normal, right, least=RANK)


def _sums(points: _Weighted, chosen: Bool | slice) -> tuple[Float64, Float64, Float64, Float64, Float64]:
    """Return the matrices and right-hand sides of `EdgeEquations` over points, axis by axis."""
    terms, near = points.values.shape[1], points.near.shape[1]
    design = np.hstack([points.values, points.near, points.observed])[chosen]
    found = np.zeros((2, design.shape[1], 2, design.shape[1]))
    for a, b in ((0, 0), (0, 1), (1, 1)):
        found[a, :, b] = found[b, :, a] = design.T @ (points.weights[chosen, a, b, None] * design)
    one, other = slice(0, terms), slice(terms, terms + near)
    right = found[:, :, 0, -2] + found[:, :, 1, -1]
    return (
        found[:, one, :, one].reshape(2 * terms, 2 * terms),
        found[:, one, :, other].reshape(2 * terms, 2 * near),
        found[:, other, :, other].reshape(2 * near, 2 * near),
        right[:, one].ravel(),
        right[:, other].ravel(),
    )


def ends_of(edges: Sequence[Edge] | Sequence[EdgeEquations]) -> Index:
    """Return the (edges, 2) numbers of the images of edges."""
    return np.array([(edge.first, edge.second) for edge in edges], np.intp).reshape(-1, 2)


def factor_of(normal: csc_array, images: int, fixed: Sequence[int], *, check: bool = False) -> SuperLU:
    """Return the factors of the normal matrix of all `images` but the `fixed`, which must be determined.

    With `check` by more than rounding; raises `UndeterminedImageError`.
    """
    factor = None
    with suppress(InputError):
        factor = factorised(normal, MEASURED)
    unknown = undetermined(normal, factor) if check or factor is None else None
    if factor is None or unknown is not None:
        free = np.delete(np.arange(images), fixed)
        raise UndeterminedImageError(int(free[(unknown or 0) * len(free) // normal.shape[0]]))
    return factor


@dataclass(frozen=True, slots=True, eq=False)
class NetworkSolution:
    """A solution of the normal equations."""

    coefficients: Float64
    """(images, terms, 2)."""
    fits: tuple[EdgeFit, ...]
    normal: csc_array


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The unknowns: image by image, then axis, then term."""

    images: int
    terms: int
    fixed: tuple[int, ...]
    """Numbers of the images whose coefficients are no unknowns."""
    penalty: Float64
    """(terms, terms) normal matrix of what is known of an image's coefficients beforehand, axis by axis."""
    mixing: Float64 | None = None
    """(2 terms, p) coefficients of an image by its p unknowns, axis by axis; None: they are the unknowns."""
    known: Float64 | None = None
    """(images, terms, terms) normal matrices of what is known of each beforehand, axis by axis, besides."""

    @property
    def size(self) -> int:
        """Number of unknowns of an image."""
        return 2 * self.terms if self.mixing is None else self.mixing.shape[1]

    @property
    def free(self) -> Index:
        """The (free,) numbers of the unknowns of images that are not fixed."""
        size = self.size
        every = np.arange(self.images * size).reshape(self.images, size)
        return np.delete(every, self.fixed, axis=0).ravel()

    def solve(self, parts: Sequence[EdgeEquations], used: Bool, shared: Float64) -> NetworkSolution:
        """Solve the normal equations of the edges in use, each with a sigma of its shared error.

        The (edges,) bool array `used` says which count, and the (edges,) array `shared` the standard
        deviation of the shared error of each, map units.
        """
        normal, right = self.equations(parts, used, shared)
        factor = factor_of(normal, self.images, self.fixed)
        coefficients = self.unpacked(factor.solve(right))
        largest = max(float(np.abs(part.observed).max()) for part in parts)
        size = np.abs(coefficients).max(axis=(1, 2))
        if not size.max(initial=0.0) < LARGEST_GROWTH * (1.0 + largest):
            raise UndeterminedImageError(int(size.argmax()))
        fits = tuple(
            self._fit(part, coefficients, bool(good), float(sigma), factor)
            for part, good, sigma in zip(parts, used, shared, strict=True)
        )
        return NetworkSolution(coefficients, fits, normal)

    def equations(
        self, parts: Sequence[EdgeEquations], used: Bool, shared: Float64
    ) -> tuple[csc_array, Float64]:
        """Return the (free, free) normal matrix of the coefficients, and the (free,) right-hand side.

        The (edges,) arrays `used` and `shared` are those of `solve`.
        """
        size = self.size
        chosen = [part for part, good in zip(parts, used, strict=True) if good]
        own, across, inner, rhs, shared_rhs = (
            np.array([getattr(part, name) for part in chosen])
            for name in ("own", "across", "inner", "rhs", "shared_rhs")
        )
        inner = inner + np.eye(inner.shape[1]) / (shared[used] ** 2)[:, None, None]
        gain = solve(inner, across.transpose(0, 2, 1), MEASURED).transpose(0, 2, 1)
        block = own - gain @ across.transpose(0, 2, 1)
        rhs = rhs - (gain @ shared_rhs[:, :, None])[:, :, 0]
        if self.mixing is not None:
            block, rhs = self.mixing.T @ block @ self.mixing, rhs @ self.mixing
        equations = NormalEquations(self.images * size)
        places = np.arange(self.images * size).reshape(self.images, size)
        equations.add(
            places[ends_of(chosen)].reshape(len(chosen), -1),
            np.kron([[1.0, -1.0], [-1.0, 1.0]], block),
            np.hstack([-rhs, rhs]),
        )
        for prior in (self.penalty[None], self.known):
            if prior is not None and prior.any():  # of each image, axis by axis
                equations.add(places, np.broadcast_to(np.kron(np.eye(2), prior), (self.images, size, size)))
        free = self.free
        return csc_array(equations.matrix[free][:, free]), equations.right[free]

    def coefficients(self, parts: Sequence[EdgeEquations], used: Bool, shared: Float64) -> Float64:
        """Return the (images, terms, 2) coefficients alone; (edges,) `used` and `shared` as in `solve`."""
        normal, right = self.equations(parts, used, shared)
        return self.unpacked(factor_of(normal, self.images, self.fixed).solve(right))

    def unpacked(self, free: Float64) -> Float64:
        """Return the (images, terms, 2) coefficients of the (free,) `free`; zeros of images that stay."""
        found = np.zeros(self.images * self.size)
        found[self.free] = free
        if self.mixing is not None:
            found = (found.reshape(self.images, -1) @ self.mixing.T).ravel()
        return found.reshape(self.images, 2, self.terms).transpose(0, 2, 1)

    def _fit(
        self, part: EdgeEquations, coefficients: Float64, used: bool, shared: float, factor: SuperLU
    ) -> EdgeFit:
        """Return how an edge agrees with a solution, in which one not in use had no part."""
        offset = part.observed - part.values @ (coefficients[part.second] - coefficients[part.first])
        row = np.zeros((self.images, 2, self.terms))  # of x; the other axis is as well known
        row[part.second, 0], row[part.first, 0] = part.values, -part.values
        of_image = row.reshape(self.images, -1)
        free = (of_image if self.mixing is None else of_image @ self.mixing).ravel()[self.free]
        adjusted = float(free @ factor.solve(free))
        # an edge that nothing checks agrees with itself
        sigma, redundancy = reliability(shared**2 + part.formal, adjusted, used, MIN_EDGE_SIGMA_REDUNDANCY)
        return EdgeFit(used, (float(offset[0]), float(offset[1])), sigma, redundancy, part.scatter, shared)
