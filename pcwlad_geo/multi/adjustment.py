"""The joint least-squares adjustment of many images from the tie points of their pairs.

Every image places the ground X at X + g(X), where g is the error of its georeferencing. The tie points of a
pair (a, b) measure g of b minus g of a, with an error that all points of the pair share. All g are estimated
together. An error that all pairs of two kinds of images have in common causes no contradiction between pairs;
a jackknife over blocks of the ground estimates it. Frames without georeferencing may get homographies
instead. Of several models the simplest that predicts left-out points as well as any is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Final

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU

from pcwlad_geo.correction.fit import of_option
from pcwlad_geo.correction.models import PolynomialBasis, ProjectiveCorrection
from pcwlad_geo.correction.selection import MIN_GAIN_PX, RESAMPLING_SIGNIFICANCE
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import jackknife, propagated
from pcwlad_geo.estimation.solving import check_observations, components, inverse
from pcwlad_geo.execution.runner import one_library_thread
from pcwlad_geo.matching.epipolar import MIN_EPIPOLAR_MATCHES, EpipolarGeometry, largest_distance_px, plane_of
from pcwlad_geo.multi.network import (
    BLOCKS,
    IMAGE_MODELS,
    ROUGHNESS,
    SPLINE,
    Basis,
    Edge,
    EdgeEquations,
    EdgeFit,
    Fold,
    HomographyBasis,
    Network,
    NetworkSolution,
    SplineBasis,
    basis_over,
    edge_equations,
    ends_of,
    errors_of,
    factor_of,
    folds_of,
    linked,
    mixing_of,
    named,
    penalty_of,
    polynomial_over,
    side_of_blocks,
    terms_of,
)
from pcwlad_geo.types import Bool, Float64, Index

LEAST_SHARED: Final = 1.0
"""Least value of `Adjustment.shared`."""
MOST_ROUNDS: Final = 20
"""Largest number of iterations in which pairs are selected and weighted."""
FREEDOM: Final = 8
"""Degrees of freedom of the sigma of a pair, which a few blocks estimate to a quarter of its value."""
ALPHA: Final = 0.01
"""Probability that any pair of a stack is left out where all are right."""
MEDIAN_SIGMAS: Final = (FREEDOM * (2.0 ** (2 / FREEDOM) - 1)) ** 0.5
"""Median of the length of the offset of a right pair, in sigmas, by the distribution of `critical`."""
MIN_REDUNDANCY: Final = 0.1
"""Least redundancy of the pairs that the shared error is estimated from."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The displacements of all images in one frame, and their covariance."""

    basis: Basis
    """Functions of the position (x, y), map units."""
    coefficients: Float64
    """(images, terms, 2): displacement (x, y) per term, map units."""
    edges: tuple[EdgeFit, ...]
    shared: float
    """Standard deviation of the error that all points of a pair share, relative to that by its own blocks."""
    datum: int | None
    """Number of the image that stays; None: the mean of all images does."""
    normal: csc_array
    """Normal matrix of the free coefficients, image by image, then axis, then term."""
    group: Index
    """(images,) number of the group of images that pairs connect; each has a datum of its own."""
    fixed: tuple[int, ...]
    """Numbers of the images whose coefficients are not unknowns, one of each group."""
    spread: Float64
    """(blocks, images, terms, 2): changes of the coefficients without a block of the ground, scaled so that
    the sum of their products is the covariance (jackknife: Tukey 1958, doi:10.1214/aoms/1177706647)."""

    def displacement(self, image: int, xy: Float64) -> Float64:
        """Return the (n, 2) displacements of an image at the (n, 2) ground positions `xy`."""
        return np.asarray(self.basis.values(xy) @ self.coefficients[image])

    def to_ground(self, image: int, xy: Float64) -> Float64:
        """Return the (n, 2) ground positions that an image's georeferencing places at the (n, 2) `xy`."""
        ground = np.asarray(xy, dtype=np.float64)
        for _ in range(8):  # converges, as displacements change slowly with position
            ground = xy - self.displacement(image, ground)
        return ground

    def covariance(self, image: int, xy: Float64, other: int | None = None) -> Float64:
        """Return the (n, 2, 2) covariance of an image's displacement at (n, 2) positions `xy`, map units².

        With `other`, of the difference of the two images' displacements: how well they fit each other. In
        each direction it is the larger of the covariance of the least-squares solution and of the jackknife.
        """
        values = self.basis.values(xy)
        terms = values.shape[1]
        rows = np.zeros((2 * terms, len(self.coefficients), 2 * terms))
        rows[:, image] += np.eye(2 * terms)
        changes = self.spread[:, image]
        if other is not None:
            rows[:, other] -= np.eye(2 * terms)
            changes = changes - self.spread[:, other]
        if self.datum is None:
            rows = _about_mean(rows[..., None], self.group)[..., 0]
        free = np.delete(rows, self.fixed, axis=1)
        mixing = mixing_of(self.basis)
        free = (free if mixing is None else free @ mixing).reshape(2 * terms, -1)
        changes = changes.transpose(0, 2, 1).reshape(len(changes), -1)
        design = np.asarray(np.kron(np.eye(2), values[:, None]), np.float64)
        return propagated(design, free @ self._factor.solve(free.T), changes)

    @cached_property
    def _factor(self) -> SuperLU:
        return factor_of(self.normal, len(self.coefficients), self.fixed, check=True)


@one_library_thread()
def adjust(
    edges: Sequence[Edge],
    images: int,
    *,
    model: str = "affine",
    datum: int | None = 0,
    split: bool = False,
    basis: Basis | None = None,
    sigma_known: Float64 | None = None,
) -> Adjustment:
    """Estimate the displacements of all images from the tie points of their pairs.

    A pair whose points contradict all others is left out: pairs lose weight by their offset first (L1 norm),
    then those far off are left out and tested again. The error that the points of a pair share is taken as
    proportional to the change of its own affine without blocks of its points, as matches of two sensors that
    show different edges vary more over the ground; the factor is estimated from the contradictions between
    the pairs in use (Förstner 1979).

    Parameters
    ----------
    edges : sequence of Edge
        Each with three points at least.
    images : int
        Number of images.
    model : str
        Of the displacement of an image: one of `network.IMAGE_MODELS`.
    datum : int, optional
        Number of the image that stays; None: the mean of all images does.
    split : bool
        Whether there may be groups of images that no edge connects: in each but that of the datum the first
        image stays.
    basis : Basis, optional
        Instead of that of the model over the points.
    sigma_known : (images,) array, optional
        Prior standard deviation of the displacement of each image along an axis, map units; infinite where
        there is none. It has less weight for an image that is displaced by many sigmas.

    Raises
    ------
    InputError
        If the edges do not connect all images, unless they may be `split`, or there are none.
    """
    for edge in edges:
        check_observations("the tie points of a pair", edge.first_xy, edge.second_xy, edge.covariance)
    group = components(ends_of(edges), images)
    fixed = _datums(group, datum)
    if not edges or (len(fixed) > 1 and not split):
        away = np.flatnonzero(group != group[0]).tolist()
        raise InputError(f"{len(fixed)} groups of images share no ground: images {away} are not connected")
    basis, edges = basis or basis_over([edge.first_xy for edge in edges], model), linked(edges)
    network, side = _network(images, basis, fixed), side_of_blocks(edges)
    coefficients = np.zeros((images, network.terms, 2))
    used, shared = np.ones(len(edges), bool), 0.0
    evidence = np.array([edge.evidence for edge in edges])
    for _ in range(3):  # the ground of the points depends on the displacements
        before = coefficients
        if sigma_known is not None and shared:  # only after the shared error is estimated from the pairs
            network = replace(network, known=_known(edges, basis, before, sigma_known))
        parts = [edge_equations(edge, basis, before, side) for edge in edges]
        shared = shared or _initial_shared_error(network, parts)
        found = _consistent_solution(network, parts, used, shared, evidence)
        coefficients, used, shared = found.solution.coefficients, found.used, found.shared
    fits = tuple(replace(fit, used=bool(good)) for fit, good in zip(found.solution.fits, used, strict=True))
    spread = _spread(network, edges, basis, before, parts, used, found.sigma, side)
    if datum is None:
        coefficients, spread = _about_mean(coefficients, group), _about_mean(spread, group)
    normal = found.solution.normal
    return Adjustment(basis, coefficients, fits, shared, datum, normal, group, fixed, spread)


def _datums(group: Index, datum: int | None) -> tuple[int, ...]:
    """Return one image of each of the (images,) groups: the datum in its own, the first in the others."""
    found: list[int] = np.unique(group, return_index=True)[1].tolist()
    if datum is not None:
        found[group[datum]] = datum
    return tuple(found)


def _known(edges: Sequence[Edge], basis: Basis, coefficients: Float64, sigma: Float64) -> Float64:
    """Return `Network.known` for displacements with the (images,) prior standard deviations `sigma`."""
    values = basis.values(np.concatenate([edge.first_xy for edge in edges]))
    moment = values.T @ values / len(values)
    squares = np.einsum("ita,ts,isa->i", coefficients, moment, coefficients)
    weight = 1 / (sigma**2 + squares / 5.0**2)  # half as much at five sigmas
    return np.asarray(weight[:, None, None] * moment)


def _network(images: int, basis: Basis, fixed: tuple[int, ...]) -> Network:
    return Network(images, terms_of(basis), fixed, penalty_of(basis), mixing_of(basis))


@one_library_thread()
def extend(
    before: Adjustment, edges: Sequence[Edge], more: Sequence[Edge], images: int, ground: bool = False
) -> Adjustment:
    """Place images after those of an adjustment, which stay where they are.

    The `edges` are those of the adjustment `before`, of the first images, and `more` those of the new images,
    the first of each an old image or an earlier new one. The last image of `before` may be the `ground`
    itself, on which control points lie: it becomes the last of all `images`, and its pairs the last.
    """
    old = len(before.coefficients) - ground
    placed = _on_frame(before, more, old, images - ground)
    coefficients = np.concatenate(
        [before.coefficients[:old], placed.coefficients[1:], before.coefficients[old:]]
    )
    last = sum(edge.first < old for edge in edges)  # those with the ground come after those of images
    every = linked([*edges[:last], *more, *(replace(edge, first=images - 1) for edge in edges[last:])])
    fits = (*before.edges[:last], *placed.edges, *before.edges[last:])
    shared = np.repeat([before.shared, placed.shared, before.shared], [last, len(more), len(edges) - last])
    network = _network(
        images, before.basis, tuple(images - 1 if ground and each == old else each for each in before.fixed)
    )
    side = side_of_blocks(every)
    parts = [edge_equations(edge, before.basis, coefficients, side) for edge in every]
    used, sigma = np.array([fit.used for fit in fits]), shared * errors_of(parts)
    spread = _spread(network, every, before.basis, coefficients, parts, used, sigma, side)
    group = components(ends_of(every), images)
    return replace(
        before,
        coefficients=coefficients,
        edges=fits,
        normal=network.equations(parts, used, sigma)[0],
        group=group,
        fixed=network.fixed,
        datum=images - 1 if ground and before.datum == old else before.datum,
        spread=_about_mean(spread, group) if before.datum is None else spread,
    )


def _on_frame(before: Adjustment, more: Sequence[Edge], old: int, images: int) -> Adjustment:
    """Adjust new images to the ground as the old ones are adjusted to it: that is image 0 of the result."""
    frame = [
        replace(
            edge,
            first=max(edge.first - old + 1, 0),
            second=edge.second - old + 1,
            first_xy=before.to_ground(edge.first, edge.first_xy) if edge.first < old else edge.first_xy,
        )
        for edge in more
    ]
    with named([0, *range(old, images)]):
        return adjust(frame, images - old + 1, basis=before.basis)


def _about_mean(coefficients: Float64, group: Index) -> Float64:
    """Return (..., images, terms, 2) coefficients less the mean of each group of images."""
    found = coefficients.copy()
    for number in range(int(group.max()) + 1):
        members = group == number
        found[..., members, :, :] -= found[..., members, :, :].mean(axis=-3, keepdims=True)
    return found


def _spread(
    network: Network,
    edges: Sequence[Edge],
    basis: Basis,
    coefficients: Float64,
    parts: Sequence[EdgeEquations],
    used: Bool,
    sigma: Float64,
    side: float,
) -> Float64:
    """Return `Adjustment.spread`: the jackknife over the blocks of the ground."""
    if not network.free.size:
        return np.zeros((1, network.images, network.terms, 2))
    blocks = [
        {fold.number: fold.kept for fold in folds_of(edge, basis, coefficients, side, part)} if good else {}
        for edge, part, good in zip(edges, parts, used, strict=True)
    ]
    found = []
    for number in range(BLOCKS**2):
        kept = [of_edge.get(number, part) for part, of_edge in zip(parts, blocks, strict=True)]
        found.append(network.coefficients(kept, used, sigma))
    return jackknife(np.array(found))


def _initial_shared_error(network: Network, parts: Sequence[EdgeEquations]) -> float:
    """Return the median offset of the pairs in a solution of least L1 norm, relative to their own errors."""
    used, error = np.ones(len(parts), bool), errors_of(parts)
    shared = np.full(len(parts), 1e3)
    for _ in range(30):  # iteratively reweighted least squares
        fits = network.solve(parts, used, shared * error).fits
        size = np.array([np.hypot(*fit.offset) for fit in fits]) / error
        typical = max(float(np.median(size)), LEAST_SHARED)
        shared = np.sqrt(typical * np.maximum(size, typical))
    return typical


def critical(pairs: int) -> float:
    """Return the critical value of the outlier test: the largest offset of a right one of `pairs`, sigmas.

    The offset has two components, and its sigma few degrees of freedom: half its square in sigmas follows
    Fisher's F (Pope 1976, NOAA Technical Report NOS 65 NGS 1). The largest offset of all pairs is tested: the
    probability that any right one is lost is `ALPHA` (Šidák 1967, doi:10.2307/2283989).
    """
    alpha_of_one = 1 - (1 - ALPHA) ** (1 / pairs)
    return float(np.sqrt(FREEDOM * (alpha_of_one ** (-2 / FREEDOM) - 1)))


@dataclass(frozen=True, slots=True, eq=False)
class _RobustSolution:
    """A solution, the pairs in use, and their shared errors."""

    solution: NetworkSolution
    used: Bool
    """(edges,) the pairs in use."""
    shared: float
    """See `Adjustment.shared`."""
    sigma: Float64
    """(edges,) standard deviations of the shared errors, larger for pairs with a large offset."""


def _consistent_solution(
    network: Network, parts: Sequence[EdgeEquations], used: Bool, shared: float, evidence: Float64
) -> _RobustSolution:
    """Solve with the pairs that agree; of groups that contradict each other, with that of more evidence."""
    for turn in range(MOST_ROUNDS):
        # where two groups alternate, the last round keeps that of more evidence
        found = _robust_solution(network, parts, used, shared, keep=turn == MOST_ROUNDS - 1)
        used, shared = _consistent_pairs(network, parts, found, evidence), found.shared
        if (used == found.used).all():
            break
    return found


def _robust_solution(
    network: Network, parts: Sequence[EdgeEquations], used: Bool, shared: float, *, keep: bool
) -> _RobustSolution:
    """Solve, test all pairs for outliers and weight them anew, until nothing changes.

    The outlier test leaves out the pairs that contradict the others, unless it is to `keep` those `used`; one
    that was left out is tested again, against the sigma of those in use now. The weights are those of
    Student's t distribution (Lange, Little, Taylor 1989, doi:10.1080/01621459.1989.10478852): the sigma of a
    shared error has `FREEDOM` degrees of freedom, and the offset of the pair adds two more, so that pairs
    somewhat off count for less. The test uses the sigma without these weights.
    """
    error, limit = errors_of(parts), critical(len(parts))
    factor = np.ones(len(parts))  # of the sigma of each, by its weight
    for _ in range(MOST_ROUNDS):
        sigma = shared * error * factor
        solution = network.solve(parts, used, sigma)
        fits = tuple(
            replace(fit, sigma=fit.sigma / own, shared=fit.shared / own)
            for fit, own in zip(solution.fits, factor, strict=True)
        )
        solution = replace(solution, fits=fits)
        before, shared = shared, max(_shared_error(solution, used, shared), LEAST_SHARED)
        ratio = np.array([fit.ratio for fit in fits]) * before / shared
        passed = used if keep else _still_connected(parts, network.images, used, ratio <= limit, ratio)
        weighted = np.sqrt((FREEDOM + np.minimum(ratio, limit) ** 2) / (FREEDOM + 2))
        same = (passed == used).all() and abs(shared - before) <= 0.01 * before
        if same and np.abs(weighted / factor - 1).max() <= 0.02:
            break
        used, factor = passed, weighted
    return _RobustSolution(solution, used, shared, sigma)


def _shared_error(solution: NetworkSolution, used: Bool, before: float) -> float:
    """Return `Adjustment.shared` by the median offset of the pairs in use, as some of them may be wrong."""
    checked = [
        fit.ratio
        for fit, use in zip(solution.fits, used, strict=True)
        if use and fit.redundancy >= MIN_REDUNDANCY
    ]
    return before * float(np.median(checked)) / MEDIAN_SIGMAS if checked else before


def _consistent_pairs(
    network: Network, parts: Sequence[EdgeEquations], before: _RobustSolution, evidence: Float64
) -> Bool:
    """Return the pairs to use.

    The pairs of an image are replaced by left-out ones that agree on another position of it and have more
    evidence together, as many pairs may be wrong for one reason.
    """
    used, ends, fits = before.used, ends_of(parts), before.solution.fits
    offset = np.array([fit.offset for fit in fits])
    limit = critical(len(parts)) * np.array([fit.sigma for fit in fits])
    found = used.copy()
    for image in range(network.images):
        at = (ends == image).any(axis=1)
        out = np.flatnonzero(at & ~used)
        of_image = offset[out] * np.where(ends[out, 1:] == image, 1, -1)
        groups = [
            out[np.hypot(*(of_image - each).T) <= most]
            for each, most in zip(of_image, limit[out], strict=True)
        ]
        best = max(groups, key=lambda group: float(evidence[group].sum()), default=out)
        if evidence[best].sum() > evidence[at & used].sum():
            found[at] = False
            found[best] = True
            break
    return found


def _still_connected(
    edges: Sequence[EdgeEquations], images: int, used: Bool, wanted: Bool, ratio: Float64
) -> Bool:
    """Return the edges wanted, and the best of the others that are needed to keep all images connected."""
    chosen = wanted.copy()
    for index in np.argsort(ratio):
        if used[index] and not chosen[index]:
            group = components(ends_of(edges)[chosen], images)
            chosen[index] = group[edges[index].first] != group[edges[index].second]
    return chosen


HOMOGRAPHY: Final = "projective"
"""Name of the model."""
HOMOGRAPHY_RATIO: Final = 0.9
"""Homographies are used where their residuals are smaller than those of affines by this ratio at least."""
FLEXIBLE_RATIO: Final = 2**0.5
"""The same where a more flexible model than an affine was chosen: their squares may be twice as large."""
NO_HOMOGRAPHY: Final = "no homography fits the tie points of all frames: choose another model"
"""Message where tie points or ground lie beyond the horizon of a frame."""


@dataclass(frozen=True, eq=False)
class FrameAdjustment(Adjustment):
    """Homographies of all frames in the pixels of one, and their covariance.

    The inherited fields are those of the frames rectified by the homographies, whose displacements are zero.
    """

    matrices: Float64
    """(images, 3, 3): px of the reference (col, row, 1) to those of each frame."""

    def displacement(self, image: int, xy: Float64) -> Float64:
        """Return the (n, 2) displacements of a frame at the (n, 2) px `xy` of the reference."""
        return self.correction(image).forward(xy) - xy

    def to_ground(self, image: int, xy: Float64) -> Float64:
        """Map the (n, 2) px `xy` of a frame to the (n, 2) px of the reference."""
        return self.correction(image).inverse(xy)

    def covariance(self, image: int, xy: Float64, other: int | None = None) -> Float64:
        """Return the (n, 2, 2) covariance of a frame's displacement at (n, 2) px `xy` of the reference, px².

        With `other`, that of the difference of the two frames' places in the reference.
        """
        covariance = super().covariance(image, xy, other)
        if other is not None:
            return covariance
        jacobian = _jacobian(self.matrices[image], xy)
        return jacobian @ covariance @ jacobian.transpose(0, 2, 1)

    def correction(self, image: int) -> ProjectiveCorrection:
        """Return the correction of a frame."""
        return ProjectiveCorrection(HOMOGRAPHY, self.matrices[image])


def on_epipolar_lines(edge: Edge) -> Edge | None:
    """Return a pair without points off their epipolar lines; None if no geometry is found or few fit it."""
    geometry = EpipolarGeometry.of(edge.first_xy, edge.second_xy)
    if geometry is None:
        return None
    off = np.abs(geometry.distance_px(edge.first_xy, edge.second_xy))
    good: Bool = off <= largest_distance_px(off)
    if good.mean() < 0.5:
        return None
    return replace(
        edge, first_xy=edge.first_xy[good], second_xy=edge.second_xy[good], covariance=edge.covariance[good]
    )


def or_homographies(
    found: Adjustment, edges: Sequence[Edge], images: int, *, datum: int | None = 0, split: bool = False
) -> Adjustment:
    """Return homographies of all frames where the tie points fit them better than an adjustment, else that.

    Against a model that is more flexible than an affine they are preferred, as flat ground is mapped by
    homographies (`FLEXIBLE_RATIO`). Parameters and errors are those of `homographies`.
    """
    if min(len(edge) for edge in edges) < MIN_EPIPOLAR_MATCHES:
        return found
    try:
        projective = homographies(edges, images, datum=datum, split=split)
    except InputError:
        return found
    before, after = (
        float(np.median([math.hypot(fit.scatter, *fit.offset) for fit in each.edges if fit.used]))
        for each in (found, projective)
    )
    ratio = HOMOGRAPHY_RATIO if lossless(found.basis) else FLEXIBLE_RATIO
    return projective if after < ratio * before else found


def homographies(
    edges: Sequence[Edge], images: int, *, datum: int | None = 0, split: bool = False
) -> FrameAdjustment:
    """Estimate the homographies of all frames from the tie points of their pairs.

    The tie points are in the pixels of the frames; those off their epipolar lines are left out. Other
    parameters are those of `adjust`. Raises `InputError` as that does, or if no homography fits the points of
    the pairs of a frame.
    """
    edges = [on_epipolar_lines(edge) or edge for edge in edges]
    matrices = _chained(edges, images, datum)
    for _ in range(8):
        rectified = [_rectified(edge, matrices) for edge in edges]
        basis = polynomial_over([edge.first_xy for edge in rectified], 2, HomographyBasis)
        found = adjust(rectified, images, datum=datum, split=split, basis=basis)
        corners = np.array([basis.centre_px, basis.low_px, basis.high_px])
        steps = [np.abs(found.displacement(image, corners)).max() for image in range(images)]
        matrices = matrices @ np.stack([_homography(basis, each) for each in found.coefficients])
        if max(steps) < 1e-4:
            break
    values = {name: getattr(found, name) for name in Adjustment.__dataclass_fields__}
    adjusted = FrameAdjustment(**values, matrices=matrices)
    corners = np.array(list(product(*zip(basis.low_px, basis.high_px, strict=True))))
    if not all(np.isfinite(adjusted.displacement(image, corners)).all() for image in range(images)):
        raise InputError(NO_HOMOGRAPHY)
    return adjusted


def _homography(basis: PolynomialBasis, coefficients: Float64) -> Float64:
    """Return the (3, 3) homography whose displacement is to first order that of the (6, 2) `coefficients`."""
    (a, d), (b, e), (c, f) = (coefficients[:3] / basis.radius_px).tolist()
    g, h = float(coefficients[3, 0]) / basis.radius_px, float(coefficients[5, 1]) / basis.radius_px
    inner = np.array([[1 + b, c, a], [e, 1 + f, d], [-g, -h, 1.0]])
    x, y = basis.centre_px
    unit = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, basis.radius_px]]) / basis.radius_px
    found = inverse(unit) @ inner @ unit
    return np.asarray(found / found[2, 2])


def _chained(edges: Sequence[Edge], images: int, datum: int | None) -> Float64:
    """Return (images, 3, 3) homographies, chained from the datum of each group by pairs of most points first.

    Raises `InputError` if those that have a homography do not connect all images.
    """
    steps: list[tuple[int, int, Float64]] = []
    for edge in sorted(edges, key=len, reverse=True):
        matrix = plane_of(edge.first_xy, edge.second_xy) if len(edge) >= 6 else None
        if matrix is not None:
            steps += [(edge.first, edge.second, matrix), (edge.second, edge.first, inverse(matrix))]
    matrices = np.tile(np.eye(3), (images, 1, 1))
    known = list(_datums(components(ends_of(edges), images), datum))
    for image in known:  # breadth first: it grows
        for first, second, matrix in steps:
            if first == image and second not in known:
                matrices[second] = matrix @ matrices[image]
                known.append(second)
    lost = images - len(known)
    if lost:
        raise InputError(f"no homography fits the tie points of {lost} frames: choose another model")
    return matrices / matrices[:, 2:, 2:]


def _rectified(edge: Edge, matrices: Float64) -> Edge:
    """Return a pair with its points in px of the reference, mapped there by the homographies.

    Raises `InputError` if one is beyond the horizon.
    """
    first, second = (ProjectiveCorrection(HOMOGRAPHY, matrices[image]) for image in (edge.first, edge.second))
    first_xy, second_xy = first.inverse(edge.first_xy), second.inverse(edge.second_xy)
    if not (np.isfinite(first_xy).all() and np.isfinite(second_xy).all()):
        raise InputError(NO_HOMOGRAPHY)
    jacobian = _jacobian(inverse(second.matrix), edge.second_xy)
    covariance = np.asarray(jacobian @ edge.covariance @ jacobian.transpose(0, 2, 1))
    return replace(edge, first_xy=first_xy, second_xy=second_xy, covariance=covariance)


def _jacobian(matrix: Float64, xy: Float64) -> Float64:
    """Return the (n, 2, 2) derivatives of a homography at (n, 2) positions."""
    moved = np.column_stack([xy, np.ones(len(xy))]) @ matrix.T
    place = moved[:, :2] / moved[:, 2:]
    return (matrix[:2, :2] - place[:, :, None] * matrix[2:, :2]) / moved[:, 2:, None]


CANDIDATE_MODELS: Final = {
    "auto": IMAGE_MODELS,
    **{name: of_option(name) for name in ("shift", "affine", "polynomial", SPLINE)},
}
"""Models of an image that are tried, by the option that the user gives."""
MAX_IMAGES_TO_CHOOSE: Final = 40
"""Largest number of images that the model is chosen by: those connected to the datum by the fewest pairs."""


def choose_basis(
    edges: Sequence[Edge], images: int, model: str, *, datum: int | None = 0, split: bool = False
) -> Basis:
    """Return the basis of the model that predicts left-out ground best (cross-validation).

    Blocks of the ground are left out in turn, in all pairs at once; the tie points in them are compared with
    the adjustment of the others. A simpler model is kept unless a more flexible one is significantly better.
    The `model` is a key of `CANDIDATE_MODELS`; the other parameters are those of `adjust`.
    """
    places = [edge.first_xy for edge in edges]
    tried = [
        basis_over(places, name, roughness)
        for name in CANDIDATE_MODELS[model]
        for roughness in (ROUGHNESS if name == SPLINE else ROUGHNESS[:1])
    ]
    least = min(map(len, edges), default=0)  # control points may be few
    determined = [each for each in tried if isinstance(each, SplineBasis) or terms_of(each) < least]
    tried = determined or tried[:1]
    if len(tried) == 1:
        return tried[0]
    edges, known, datum = _nearest(edges, images, datum)
    with named(known):
        start = adjust(edges, len(known), datum=datum, split=split)
        edges = [edge for edge, fit in zip(linked(edges), start.edges, strict=True) if fit.used]
        trials: list[_ModelTrial] = []
        for basis in tried:
            same = bool(trials) and all(isinstance(each, SplineBasis) for each in (basis, trials[-1].basis))
            trials.append(replace(trials[-1], basis=basis) if same else _trial(edges, start, basis))
        # all models are compared with the same weights: the smallest scatters and shared errors of all
        scatter = np.min([[part.scatter for part in trial.parts] for trial in trials], axis=0)
        shared = np.min([trial.shared for trial in trials], axis=0)
        errors = [_errors(trial, start, scatter, shared) for trial in trials]
    typical, chosen = float(np.median(scatter)), 0
    for number in range(1, len(tried)):
        gain = errors[chosen] - errors[number]
        gain = gain[np.isfinite(gain)]
        if len(gain) > 1 and _is_better(gain, lossless(tried[chosen]), lossless(tried[number]), typical):
            chosen = number
    return tried[chosen]


def lossless(basis: Basis) -> bool:
    """Return whether images of a model keep their pixels, with a corrected geotransform."""
    return isinstance(basis, PolynomialBasis) and basis.order <= 1


def _is_better(gain: Float64, lossless_before: bool, lossless_after: bool, scatter: float) -> bool:
    """Return whether a more flexible model predicts better, by the (blocks,) gain in squared scatters.

    As for a pair, common errors of the matches of two sensors look like local displacements: a model that
    needs resampling must gain more than these where the other one is lossless, and between two models that
    need resampling the better one is chosen, however small its gain.
    """
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    if not lossless_before:
        return bool(gain.mean() > 0)
    if lossless_after:
        return bool(gain.mean() > 2 * error)
    enough = scatter * np.sqrt(max(gain.mean(), 0.0)) >= MIN_GAIN_PX
    return bool(enough and gain.mean() > RESAMPLING_SIGNIFICANCE * error)


def _nearest(
    edges: Sequence[Edge], images: int, datum: int | None
) -> tuple[Sequence[Edge], Sequence[int], int | None]:
    """Return the pairs of the images nearest to the datum, these images, and the number of the datum.

    The images are numbered anew if there are more than `MAX_IMAGES_TO_CHOOSE`.
    """
    if images <= MAX_IMAGES_TO_CHOOSE:
        return edges, range(images), datum
    known = [datum or 0]
    for image in known:
        for edge in edges:
            if image in (edge.first, edge.second) and len(known) < MAX_IMAGES_TO_CHOOSE:
                other = edge.first + edge.second - image
                known += [other] if other not in known else []
    number = {image: index for index, image in enumerate(known)}
    kept = [
        replace(edge, first=number[edge.first], second=number[edge.second])
        for edge in edges
        if edge.first in number and edge.second in number
    ]
    return kept, known, None if datum is None else 0


@dataclass(frozen=True, slots=True, eq=False)
class _ModelTrial:
    """A model, and the equations of the pairs by it, which are the same for splines of any roughness."""

    basis: Basis
    parts: list[EdgeEquations]
    folds: list[dict[int, Fold]]
    """Left-out blocks of each pair, by their number."""
    shared: Float64
    """(edges,) standard deviations of the error that the points of each share, map units."""


def _trial(edges: Sequence[Edge], start: Adjustment, basis: Basis) -> _ModelTrial:
    """Return the equations of the pairs by a model, with the datum of the adjustment `start`."""
    side = side_of_blocks(edges)
    network = _network(len(start.coefficients), basis, start.fixed)
    coefficients = np.zeros((network.images, network.terms, 2))
    for _ in range(2):  # the ground of the points depends on the displacements
        parts = [edge_equations(edge, basis, coefficients, side) for edge in edges]
        shared = errors_of(parts)
        coefficients = network.coefficients(parts, np.ones(len(parts), bool), shared)
    folds = [
        {fold.number: fold for fold in folds_of(edge, basis, coefficients, side / 2, part)}
        for edge, part in zip(edges, parts, strict=True)
    ]
    return _ModelTrial(basis, parts, folds, shared)


def _errors(trial: _ModelTrial, start: Adjustment, scatter: Float64, shared: Float64) -> Float64:
    """Return the mean squared residual of the points of each left-out block, in scatters of their pairs.

    It is NaN for blocks without points. `scatter` and `shared` are the (edges,) standard deviations of the
    points and of the error that those of a pair share.
    """
    network = _network(len(start.coefficients), trial.basis, start.fixed)
    found = np.full(BLOCKS**2, np.nan)
    for number in range(BLOCKS**2):
        left_out = [folds.get(number) for folds in trial.folds]
        kept = [fold.kept if fold else part for part, fold in zip(trial.parts, left_out, strict=True)]
        without = network.coefficients(kept, np.ones(len(kept), bool), shared)
        total = count = 0.0
        for part, fold, unit in zip(trial.parts, left_out, scatter, strict=True):
            if fold is None or fold.kept is part:  # nothing of it was left out
                continue
            residual = fold.observed - fold.values @ (without[part.second] - without[part.first])
            total += float(np.minimum((residual / unit) ** 2, 3.0**2).sum())
            count += residual.size
        if count:
            found[number] = total / count
    return found
