"""The joint least-squares adjustment of many images from the tie points of their pairs.

Every image places the ground X at X + g(X), where its georeferencing errs by g. The tie points of a pair
(a, b) tell g of b minus g of a. All g are estimated together; a pair adds an error of its own that all its
points share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from pcwlad_geo.correction.models import PolynomialBasis
from pcwlad_geo.errors import InputError
from pcwlad_geo.types import Bool, Float64, Index

SHARED_TERMS: Final = 3
"""Terms of the error that the points of a pair share: a shift, and slopes along x and y."""
LEAST_SHARED: Final = 1e-3
"""Least sigma of the shared error of a pair, in scatters of its points."""
LEAST_SCATTER: Final = 0.1
"""Least scatter of the points of a pair, in medians of their own sigmas."""
ROUNDS: Final = 30
"""Number of rounds in which pairs that contradict the others lose their weight."""
LINEARISED: Final = 3
"""Number of times that the points are summed up at the ground found so far."""
SETTLING: Final = 20
"""Largest number of times that the pairs in use are chosen anew."""
WRONG: Final = 5.0
"""A pair whose points lie off what all others tell by more sigmas is wrong."""
READMITTED: Final = 4.0
"""One that was left out is used again if it lies off by fewer."""
MIN_REDUNDANCY: Final = 0.1
"""A pair that the others check less says nothing about the error that pairs have."""
RAYLEIGH_MEDIAN: Final = 1.1774
"""Median of a length of two normal components of unit variance."""
POINT_LIMIT: Final = 3.0
"""Points that lie off their pair's by more sigmas lose weight (Huber 1964, doi:10.1214/aoms/1177703732)."""


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

    @property
    def ratio(self) -> float:
        """The offset in standard deviations."""
        return float(np.hypot(*self.offset)) / self.sigma


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The displacements of all images in one frame, and their covariance."""

    basis: PolynomialBasis
    """Of positions (x, y), map units."""
    coefficients: Float64
    """(images, terms, 2): displacement (x, y) per term, map units."""
    edges: tuple[EdgeFit, ...]
    shared: float
    """Standard deviation of the error that all points of a pair share, in scatters of its points."""
    datum: int | None
    """Number of the image that stays; None: the mean of all images does."""
    normal: csc_array
    """Normal matrix of the free coefficients, image by image, then axis, then term."""

    def displacement(self, image: int, xy: Float64) -> Float64:
        """Return by how much an image places the ground at (n, 2) positions `xy` beside itself, (n, 2)."""
        return np.asarray(self.basis.values(xy) @ self.coefficients[image])

    def to_ground(self, image: int, xy: Float64) -> Float64:
        """Return the (n, 2) ground of the (n, 2) positions `xy` as an image's georeferencing places them."""
        ground = np.asarray(xy, dtype=np.float64)
        for _ in range(8):  # displacements are nearly the same a few pixels beside
            ground = xy - self.displacement(image, ground)
        return ground

    def covariance(self, image: int, xy: Float64, other: int | None = None) -> Float64:
        """Return the (n, 2, 2) covariance of an image's displacement at (n, 2) positions `xy`, map units².

        With `other`, of the difference of the two images' displacements: how well they fit each other.
        """
        terms = len(self.basis.exponents)
        rows = np.zeros((2 * terms, len(self.coefficients), 2 * terms))
        rows[:, image] += np.eye(2 * terms)
        if other is not None:
            rows[:, other] -= np.eye(2 * terms)
        rows = rows if self.datum is not None else rows - rows.mean(axis=1, keepdims=True)
        free = np.delete(rows, self.fixed, axis=1).reshape(2 * terms, -1)
        solved = self._factor.solve(free.T)
        blocks = (free @ solved).reshape(2, terms, 2, terms)
        values = self.basis.values(xy)
        return np.asarray(np.einsum("nt,atbs,ns->nab", values, blocks, values))

    @property
    def fixed(self) -> int:
        """Number of the image whose coefficients are not unknowns."""
        return 0 if self.datum is None else self.datum

    @cached_property
    def _factor(self) -> SuperLU:
        return splu(self.normal)


def adjust(edges: Sequence[Edge], images: int, *, order: int = 1, datum: int | None = 0) -> Adjustment:
    """Estimate the displacements of all images from the tie points of their pairs.

    A pair whose points contradict all others is found and left out: pairs lose weight by their offset first
    (L1 norm), then those far off are left out and tested again. The error that the points of a pair share is
    taken as proportional to their scatter, as that of matches of two sensors is; by how much, the pairs in
    use tell by what they contradict each other (Förstner 1979).

    Parameters
    ----------
    edges : sequence of Edge
        Each with three points at least.
    images : int
        Number of images.
    order : int
        Of the polynomial in x and y of an image: 0 shift, 1 affine, 2, 3.
    datum : int, optional
        Number of the image that stays; None: the mean of all images does.

    Raises
    ------
    InputError
        If the edges do not connect all images.
    """
    count, part = components(edges, images, np.ones(len(edges), bool))
    if count > 1:
        apart = np.flatnonzero(part != part[0]).tolist()
        raise InputError(f"{count} groups of images share no ground: images {apart} are not connected")
    basis = _basis(edges, order)
    network = _Network(images, len(basis.exponents), datum)
    coefficients = np.zeros((images, len(basis.exponents), 2))
    used, shared = np.ones(len(edges), bool), 0.0
    for _ in range(LINEARISED):  # at the ground that the displacements so far tell
        parts = [_part(edge, basis, coefficients) for edge in edges]
        shared = shared or _first_shared(network, parts)
        for _ in range(images):
            solution, used, shared = _settled(network, parts, used, shared)
            outvoted = _outvoted(network, parts, solution, used)
            if (outvoted == used).all():
                break
            used = outvoted
        coefficients = solution.coefficients
    fits = tuple(replace(fit, used=bool(good)) for fit, good in zip(solution.fits, used, strict=True))
    if datum is None:
        coefficients = coefficients - coefficients.mean(axis=0)
    return Adjustment(basis, coefficients, fits, shared, datum, solution.normal)


def _first_shared(network: _Network, parts: Sequence[_Part]) -> float:
    """Return how much pairs typically contradict each other, in scatters, as if each erred as it seems."""
    used, scatter = np.ones(len(parts), bool), np.array([part.scatter for part in parts])
    shared = np.full(len(parts), 1e3)
    for _ in range(ROUNDS):
        fits = network.solve(parts, used, shared * scatter).fits
        size = np.array([np.hypot(*fit.offset) for fit in fits]) / scatter
        typical = max(float(np.median(size)), LEAST_SHARED)
        shared = np.sqrt(typical * np.maximum(size, typical))
    return typical


def _settled(
    network: _Network, parts: Sequence[_Part], used: Bool, shared: float
) -> tuple[_Solution, Bool, float]:
    """Solve, and leave out pairs that contradict the others, until both no longer change."""
    scatter = np.array([part.scatter for part in parts])
    for _ in range(SETTLING):
        solution = network.solve(parts, used, shared * scatter)
        before, shared = shared, max(_shared_error(solution, used, shared), LEAST_SHARED)
        ratio = np.array([fit.ratio for fit in solution.fits]) * before / shared
        wanted = np.where(used, ratio <= WRONG, ratio <= READMITTED)
        again = _still_connected(parts, network.images, used, wanted, ratio)
        if (again == used).all() and abs(shared - before) <= 0.01 * before:
            break
        used = again
    return solution, used, shared


def components(edges: Sequence[Edge] | Sequence[_Part], images: int, used: Bool) -> tuple[int, Index]:
    """Return how many groups of images the edges in use connect, and the (images,) group of each.

    The (edges,) bool array `used` says which are.
    """
    ends = np.array([(edge.first, edge.second) for edge in edges], dtype=np.intp).reshape(-1, 2)[used]
    links = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(images, images))
    count, part = connected_components(links, directed=False)
    return int(count), np.asarray(part, dtype=np.intp)


def _basis(edges: Sequence[Edge], order: int) -> PolynomialBasis:
    everywhere = np.concatenate([edge.first_xy for edge in edges])
    low, high = everywhere.min(axis=0), everywhere.max(axis=0)
    centre, radius = (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)
    return PolynomialBasis(order, _xy(centre), radius, _xy(low), _xy(high))


def _xy(values: Float64) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _typical_sigma(edge: Edge) -> float:
    return float(np.median(np.sqrt(np.trace(edge.covariance, axis1=1, axis2=2) / 2)))


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """What the points of an edge say of the difference of its images' coefficients, axis by axis."""

    first: int
    second: int
    own: Float64
    """(2 terms, 2 terms) normal matrix of the difference."""
    across: Float64
    """(2 terms, 2 SHARED_TERMS) products with the shared error's terms."""
    inner: Float64
    """(2 SHARED_TERMS, 2 SHARED_TERMS) normal matrix of those."""
    seen: Float64
    """(2 terms,) right-hand side."""
    beside: Float64
    """(2 SHARED_TERMS,) that of the shared error."""
    values: Float64
    """(terms,) weighted mean of the terms."""
    observed: Float64
    """(2,) weighted mean of the observed differences, map units."""
    formal: float
    """Variance of that along an axis by the points' own errors."""
    scatter: float
    """Robust standard deviation of the points along an axis."""


def _part(edge: Edge, basis: PolynomialBasis, coefficients: Float64) -> _Part:
    """Sum up the points of an edge, those that lie off the others with less weight."""
    ground = edge.first_xy
    for _ in range(4):
        ground = edge.first_xy - basis.values(ground) @ coefficients[edge.first]
    values = basis.values(ground)
    observed = edge.second_xy - edge.first_xy
    left = observed - values @ (coefficients[edge.second] - coefficients[edge.first])
    near = np.column_stack([np.ones(len(edge)), (ground - basis.centre_px) / basis.radius_px])
    left = left - near @ np.linalg.lstsq(near, left, rcond=None)[0]
    left = left - np.median(left, axis=0)
    weights: Float64 = np.linalg.inv(edge.covariance).astype(np.float64)
    off = np.sqrt(np.maximum(np.einsum("na,nab,nb->n", left, weights, left), 1e-12))
    unit = max(1.0, float(np.median(off)) / RAYLEIGH_MEDIAN)
    weights *= (np.minimum(1.0, POINT_LIMIT * unit / off) / unit**2)[:, None, None]
    total = weights.sum(axis=0)
    each = np.trace(weights, axis1=1, axis2=2) / np.trace(total)
    return _Part(
        edge.first,
        edge.second,
        own=_products(values, weights, values),
        across=_products(values, weights, near),
        inner=_products(near, weights, near),
        seen=np.einsum("nt,nab,nb->at", values, weights, observed, optimize=True).ravel(),
        beside=np.einsum("nt,nab,nb->at", near, weights, observed, optimize=True).ravel(),
        values=each @ values,
        observed=each @ observed,
        formal=float(np.trace(np.linalg.inv(total))) / 2,
        scatter=max(float(1.4826 * np.median(np.abs(left))), LEAST_SCATTER * _typical_sigma(edge)),
    )


def _products(one: Float64, weights: Float64, other: Float64) -> Float64:
    """Return the sum over points of the products of two designs, axis by axis: (2 s, 2 t)."""
    found = np.einsum("ns,nab,nt->asbt", one, weights, other, optimize=True)
    return np.asarray(found.reshape(2 * one.shape[1], 2 * other.shape[1]))


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    coefficients: Float64
    """(images, terms, 2)."""
    fits: tuple[EdgeFit, ...]
    normal: csc_array


@dataclass(frozen=True, slots=True)
class _Network:
    """The unknowns: image by image, then axis, then term."""

    images: int
    terms: int
    datum: int | None

    @property
    def fixed(self) -> int:
        """Number of the image whose coefficients are no unknowns."""
        return 0 if self.datum is None else self.datum

    def solve(self, parts: Sequence[_Part], used: Bool, shared: Float64) -> _Solution:
        """Solve the normal equations of the edges in use, each with a sigma of its shared error."""
        size, inner = 2 * self.terms, np.arange(2 * self.terms)
        right = np.zeros((self.images, size))
        rows, cols, data = [], [], []
        for part, sigma in ((p, s) for p, s, good in zip(parts, shared, used, strict=True) if good):
            gain = np.linalg.solve(part.inner + np.eye(len(part.inner)) / sigma**2, part.across.T).T
            block, seen = part.own - gain @ part.across.T, part.seen - gain @ part.beside
            ends = ((part.first, -1.0), (part.second, 1.0))
            for one, sign in ends:
                right[one] += sign * seen
                for other, opposite in ends:
                    rows.append(np.repeat(one * size + inner, size))
                    cols.append(np.tile(other * size + inner, size))
                    data.append((sign * opposite * block).ravel())
        place = np.concatenate(rows), np.concatenate(cols)
        whole = coo_array((np.concatenate(data), place), shape=(self.images * size,) * 2).tocsc()
        free = np.delete(np.arange(self.images * size), self.fixed * size + inner)
        normal = csc_array(whole[free][:, free])
        factor, found = splu(normal), np.zeros(self.images * size)
        found[free] = factor.solve(right.ravel()[free])
        coefficients = found.reshape(self.images, 2, self.terms).transpose(0, 2, 1)
        fits = tuple(
            self._fit(part, coefficients, bool(good), float(sigma), factor)
            for part, good, sigma in zip(parts, used, shared, strict=True)
        )
        return _Solution(coefficients, fits, normal)

    def _fit(self, part: _Part, coefficients: Float64, used: bool, shared: float, factor: SuperLU) -> EdgeFit:
        """Return how an edge agrees with a solution, in which one not in use had no part."""
        offset = part.observed - part.values @ (coefficients[part.second] - coefficients[part.first])
        row = np.zeros((self.images, 2, self.terms))  # of x; the other axis is as well known
        row[part.second, 0], row[part.first, 0] = part.values, -part.values
        free = np.delete(row.reshape(self.images, -1), self.fixed, axis=0).ravel()
        adjusted = float(free @ factor.solve(free))
        own = shared**2 + part.formal
        redundancy = max(0.0, 1.0 - adjusted / own) if used else 1.0
        variance = own * redundancy if used else own + adjusted
        # an edge that nothing checks agrees with itself
        sigma = float(np.sqrt(max(variance, 1e-6 * own)))
        return EdgeFit(used, _xy(offset), sigma, redundancy, part.scatter)


def _shared_error(solution: _Solution, used: Bool, before: float) -> float:
    """Return the shared error, in scatters, by which the pairs in use contradict each other as they do.

    By the median: wrong pairs may be among them.
    """
    checked = [
        fit.ratio
        for fit, use in zip(solution.fits, used, strict=True)
        if use and fit.redundancy >= MIN_REDUNDANCY
    ]
    return before * float(np.median(checked)) / RAYLEIGH_MEDIAN if checked else before


def _outvoted(network: _Network, parts: Sequence[_Part], solution: _Solution, used: Bool) -> Bool:
    """Return the pairs in use; those of an image give way to more others that agree on another place."""
    found = used.copy()
    for image in range(network.images):
        at = [k for k, part in enumerate(parts) if image in (part.first, part.second)]
        away = [k for k in at if not used[k]]
        offsets = {k: np.array(solution.fits[k].offset) * (1 if parts[k].second == image else -1) for k in at}
        groups = [
            [
                other
                for other in away
                if np.hypot(*(offsets[k] - offsets[other])) <= WRONG * solution.fits[k].sigma
            ]
            for k in away
        ]
        most = max(groups, key=len, default=[])
        if len(most) > len(at) - len(away):
            found[at] = False
            found[most] = True
            break
    return found


def _still_connected(edges: Sequence[_Part], images: int, used: Bool, wanted: Bool, ratio: Float64) -> Bool:
    """Return the edges wanted, with the best of the others that are needed to keep all images connected."""
    chosen = wanted.copy()
    for index in np.argsort(ratio):
        if not chosen[index] and used[index]:
            _, part = components(edges, images, chosen)
            if part[edges[index].first] != part[edges[index].second]:
                chosen[index] = True
    return chosen
