"""The joint least-squares adjustment of many images from the tie points of their pairs.

Every image places the ground X at X + g(X), where its georeferencing errs by g. The tie points of a pair
(a, b) tell g of b minus g of a. All g are estimated together; a pair adds an error of its own that all its
points share. What images of one kind see alike, and others do not, is in no contradiction of the pairs: by
how much the result depends on which ground is looked at tells of it (a jackknife of blocks of the ground).
Frames without georeferencing may get homographies instead. Of several models the simplest that predicts what
is left out as well as any is chosen.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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
"""Least sigma of the shared error of a pair, in what its own blocks tell."""
MOST_ROUNDS: Final = 20
"""Largest number of times that the pairs in use are chosen anew."""
FREEDOM: Final = 8
"""Degrees of freedom of the sigma of a pair: a few blocks tell it to a quarter."""
ALPHA: Final = 0.01
"""Probability that of all pairs of a stack, all right, one is left out."""
MEDIAN_SIGMAS: Final = (FREEDOM * (2.0 ** (2 / FREEDOM) - 1)) ** 0.5
"""Median of an offset of such a pair, in sigmas."""
MIN_REDUNDANCY: Final = 0.1
"""A pair that the others check less says nothing about the error that pairs have."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The displacements of all images in one frame, and their covariance."""

    basis: Basis
    """Of positions (x, y), map units."""
    coefficients: Float64
    """(images, terms, 2): displacement (x, y) per term, map units."""
    edges: tuple[EdgeFit, ...]
    shared: float
    """Standard deviation of the error that all points of a pair share, in what its own blocks tell of it."""
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

        With `other`, of the difference of the two images' displacements: how well they fit each other. It is
        the larger, direction by direction, of what the pairs tell by their contradictions and of what the
        blocks of the ground tell by theirs.
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

    A pair whose points contradict all others is found and left out: pairs lose weight by their offset first
    (L1 norm), then those far off are left out and tested again. The error that the points of a pair share is
    taken as proportional to the change of its own affine without blocks of its points, as matches of two
    sensors that see other edges vary more over the ground; by how much, the pairs in use tell by what they
    contradict each other (Förstner 1979).

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
        Standard deviation of the displacement of each along an axis as known beforehand, map units; infinite
        where it is not. One found far beyond counts for less.

    Raises
    ------
    InputError
        If the edges do not connect all images, unless they may be `split`, or there are none.
    """
    for edge in edges:
        check_observations("the tie points of a pair", edge.first_xy, edge.second_xy, edge.covariance)
    group = components(ends_of(edges), images)
    count = int(group.max()) + 1
    if not edges or (count > 1 and not split):
        away = np.flatnonzero(group != group[0]).tolist()
        raise InputError(f"{count} groups of images share no ground: images {away} are not connected")
    basis, edges = basis or basis_over([edge.first_xy for edge in edges], model), linked(edges)
    firsts = [int(np.flatnonzero(group == number)[0]) for number in range(count)]
    fixed = tuple(datum if datum is not None and group[datum] == group[each] else each for each in firsts)
    network, side = _network(images, basis, fixed), side_of_blocks(edges)
    coefficients = np.zeros((images, network.terms, 2))
    used, shared = np.ones(len(edges), bool), 0.0
    evidence = np.array([edge.evidence for edge in edges])
    for _ in range(3):  # at the ground that the displacements so far tell
        before = coefficients
        if sigma_known is not None and shared:  # not before the pairs themselves say how they err
            network = replace(network, known=_known(edges, basis, before, sigma_known))
        parts = [edge_equations(edge, basis, before, side) for edge in edges]
        shared = shared or _first_shared(network, parts)
        found = _consistent_solution(network, parts, used, shared, evidence)
        coefficients, used, shared = found.solution.coefficients, found.used, found.shared
    fits = tuple(replace(fit, used=bool(good)) for fit, good in zip(found.solution.fits, used, strict=True))
    spread = _spread(network, edges, basis, before, parts, used, found.sigma, side)
    if datum is None:
        coefficients, spread = _about_mean(coefficients, group), _about_mean(spread, group)
    normal = found.solution.normal
    return Adjustment(
        basis=basis,
        coefficients=coefficients,
        edges=fits,
        shared=shared,
        datum=datum,
        normal=normal,
        group=group,
        fixed=fixed,
        spread=spread,
    )


def _known(edges: Sequence[Edge], basis: Basis, coefficients: Float64, sigma: Float64) -> Float64:
    """Return `Network.known` of images whose displacements have a (images,) sigma beforehand."""
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
    """Adjust new images on the ground that an adjustment of the old ones tells, image 0 of the result."""
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
    """Return `Adjustment.spread`: solve again without each block of the ground."""
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


def _first_shared(network: Network, parts: Sequence[EdgeEquations]) -> float:
    """Return how much pairs typically contradict each other, as if each erred as it seems.

    In what the blocks of each tell of its error.
    """
    used, error = np.ones(len(parts), bool), errors_of(parts)
    shared = np.full(len(parts), 1e3)
    for _ in range(30):  # L1 norm
        fits = network.solve(parts, used, shared * error).fits
        size = np.array([np.hypot(*fit.offset) for fit in fits]) / error
        typical = max(float(np.median(size)), LEAST_SHARED)
        shared = np.sqrt(typical * np.maximum(size, typical))
    return typical


def critical(pairs: int) -> float:
    """Return by how many sigmas the offset of a right one of so many pairs lies off the others at most.

    The offset has two components, and its sigma some degrees of freedom only: half its square in sigmas
    follows Fisher's F (Pope 1976, NOAA Technical Report NOS 65 NGS 1). The largest of all is tested, so that
    of all pairs one at most is lost with the probability `ALPHA` (Šidák 1967, doi:10.2307/2283989).
    """
    alone = 1 - (1 - ALPHA) ** (1 / pairs)
    return float(np.sqrt(FREEDOM * (alone ** (-2 / FREEDOM) - 1)))


@dataclass(frozen=True, slots=True, eq=False)
class _RobustSolution:
    """A solution, the pairs that it is of, and what the points of each share."""

    solution: NetworkSolution
    used: Bool
    """(edges,) the pairs in use."""
    shared: float
    """See `Adjustment.shared`."""
    sigma: Float64
    """(edges,) standard deviations of the shared error, with what its own offset tells of each."""


def _consistent_solution(
    network: Network, parts: Sequence[EdgeEquations], used: Bool, shared: float, evidence: Float64
) -> _RobustSolution:
    """Solve with the pairs that agree, and of groups that contradict each other the one of more evidence."""
    for turn in range(MOST_ROUNDS):
        # two answers that replace each other: that of more evidence is the last
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
    that was left out is tested again, against the sigma of what is in use now. The weights are those of
    Student's t distribution (Lange, Little, Taylor 1989, doi:10.1080/01621459.1989.10478852): what a pair
    shares has a sigma known to `FREEDOM` degrees of freedom, and its own offset adds two more, so that pairs
    somewhat off count for less. The test is against the sigma without that.
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
    """Return the shared error by which the pairs in use contradict each other as they do.

    It counts in what the blocks of each pair tell of it. By the median: wrong pairs may be among them.
    """
    checked = [
        fit.ratio
        for fit, use in zip(solution.fits, used, strict=True)
        if use and fit.redundancy >= MIN_REDUNDANCY
    ]
    return before * float(np.median(checked)) / MEDIAN_SIGMAS if checked else before


def _consistent_pairs(
    network: Network, parts: Sequence[EdgeEquations], before: _RobustSolution, evidence: Float64
) -> Bool:
    """Return the pairs in use.

    The pairs of an image give way to others that agree on another place and have more evidence together, as
    many may err by one cause.
    """
    used, solution, limit = before.used, before.solution, critical(len(parts))
    found = used.copy()
    for image in range(network.images):
        at = [k for k, part in enumerate(parts) if image in (part.first, part.second)]
        away = [k for k in at if not used[k]]
        offsets = {k: np.array(solution.fits[k].offset) * (1 if parts[k].second == image else -1) for k in at}
        groups = [
            [
                other
                for other in away
                if np.hypot(*(offsets[k] - offsets[other])) <= limit * solution.fits[k].sigma
            ]
            for k in away
        ]
        most = max(groups, key=lambda group: float(evidence[group].sum()), default=[])
        if evidence[most].sum() > evidence[[k for k in at if used[k]]].sum():
            found[at] = False
            found[most] = True
            break
    return found


def _still_connected(
    edges: Sequence[EdgeEquations], images: int, used: Bool, wanted: Bool, ratio: Float64
) -> Bool:
    """Return the edges wanted, with the best of the others that are needed to keep all images connected."""
    chosen = wanted.copy()
    for index in np.argsort(ratio):
        if not chosen[index] and used[index]:
            part = components(ends_of(edges)[chosen], images)
            if part[edges[index].first] != part[edges[index].second]:
                chosen[index] = True
    return chosen


HOMOGRAPHY: Final = "projective"
"""Name of the model."""
FLEXIBLE_RATIO: Final = 2**0.5
"""Where a more flexible model was chosen, less than this share of what that leaves."""
NO_HOMOGRAPHY: Final = "no homography fits the tie points of all frames: choose another model"
"""Message where one puts ground beyond the horizon of a frame."""
HOMOGRAPHY_RATIO: Final = 0.9
"""Homographies are taken where they leave less than this share of what affines leave between the frames."""


@dataclass(frozen=True, eq=False)
class FrameAdjustment(Adjustment):
    """Homographies of all frames in the pixels of one, and their covariance.

    What it inherits is of the frames as these homographies rectify them, and zero but for their covariance.
    """

    matrices: Float64 = field(default_factory=lambda: np.zeros((0, 3, 3)))
    """(images, 3, 3): px of the reference (col, row, 1) to those of each frame."""

    def displacement(self, image: int, xy: Float64) -> Float64:
        """Return by how much a frame sees the (n, 2) px `xy` of the reference beside these, (n, 2)."""
        return self.correction(image).forward(xy) - xy

    def to_ground(self, image: int, xy: Float64) -> Float64:
        """Return the (n, 2) px of the reference that are seen at the (n, 2) px `xy` of a frame."""
        return self.correction(image).inverse(xy)

    def covariance(self, image: int, xy: Float64, other: int | None = None) -> Float64:
        """Return the (n, 2, 2) covariance of a frame's displacement at (n, 2) px `xy` of the reference, px².

        With `other`, that of the difference of the two frames' places in the reference.
        """
        covariance = super().covariance(image, xy, other)
        if other is not None:
            return covariance
        rate = _rate(self.matrices[image], xy)
        return rate @ covariance @ rate.transpose(0, 2, 1)

    def correction(self, image: int) -> ProjectiveCorrection:
        """Return the correction of a frame."""
        return ProjectiveCorrection(HOMOGRAPHY, self.matrices[image])


def on_epipolar_lines(edge: Edge) -> Edge | None:
    """Return a pair without the points that no depth explains; None if no geometry is found or few agree."""
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
    """Return homographies of all frames where another adjustment leaves more, else that.

    Beside a model that is more flexible they are the image of flat ground, and are taken unless they leave
    more than twice its squares. Parameters and errors are those of `homographies`.
    """
    if min(len(edge) for edge in edges) < MIN_EPIPOLAR_MATCHES:
        return found
    try:
        projective = homographies(edges, images, datum=datum, split=split)
    except InputError:
        return found
    flexible = terms_of(found.basis) > terms_of(basis_over([edge.first_xy for edge in edges], "affine"))
    left = [
        float(np.median([math.hypot(fit.scatter, *fit.offset) for fit in each.edges if fit.used]))
        for each in (found, projective)
    ]
    return projective if left[1] < (FLEXIBLE_RATIO if flexible else HOMOGRAPHY_RATIO) * left[0] else found


def homographies(
    edges: Sequence[Edge], images: int, *, datum: int | None = 0, split: bool = False
) -> FrameAdjustment:
    """Estimate the homographies of all frames from the tie points of their pairs.

    The tie points are in the pixels of the frames; those that leave their epipolar lines have no part. Other
    parameters are those of `adjust`. Raises `InputError` as that does, or if no homography fits the points of
    the pairs of a frame.
    """
    edges = [on_epipolar_lines(edge) or edge for edge in edges]
    matrices = _chained(edges, images, datum or 0)
    for _ in range(8):
        rectified = [_rectified(edge, matrices) for edge in edges]
        basis = polynomial_over([edge.first_xy for edge in rectified], 2, HomographyBasis)
        found = adjust(rectified, images, datum=datum, split=split, basis=basis)
        corners = np.array([basis.centre_px, basis.low_px, basis.high_px])
        steps = [found.displacement(image, corners) for image in range(images)]
        matrices = np.stack(
            [
                matrix @ _homography(basis, coefficients)
                for matrix, coefficients in zip(matrices, found.coefficients, strict=True)
            ]
        )
        if max(float(np.abs(step).max()) for step in steps) < 1e-4:
            break
    values = {name: getattr(found, name) for name in Adjustment.__dataclass_fields__}
    adjusted = FrameAdjustment(**values, matrices=matrices)
    corners = np.array(list(product(*zip(basis.low_px, basis.high_px, strict=True))))
    if not all(np.isfinite(adjusted.displacement(image, corners)).all() for image in range(images)):
        raise InputError(NO_HOMOGRAPHY)
    return adjusted


def _homography(basis: PolynomialBasis, coefficients: Float64) -> Float64:
    """Return the (3, 3) homography that displaces as the (6, 2) `coefficients` say, to first order."""
    (a, d), (b, e), (c, f) = (coefficients[:3] / basis.radius_px).tolist()
    g, h = float(coefficients[3, 0]) / basis.radius_px, float(coefficients[5, 1]) / basis.radius_px
    inner = np.array([[1 + b, c, a], [e, 1 + f, d], [-g, -h, 1.0]])
    x, y = basis.centre_px
    unit = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, basis.radius_px]]) / basis.radius_px
    found = inverse(unit) @ inner @ unit
    return np.asarray(found / found[2, 2])


def _chained(edges: Sequence[Edge], images: int, first: int) -> Float64:
    """Return (images, 3, 3) homographies along the pairs of most points from the first of each group."""
    pairwise = [plane_of(edge.first_xy, edge.second_xy) if len(edge) >= 6 else None for edge in edges]
    matrices = np.tile(np.eye(3), (images, 1, 1))
    known: set[int] = set()
    by_points = sorted(range(len(edges)), key=lambda number: -len(edges[number]))
    group = components(ends_of(edges), images)
    firsts = [int(np.flatnonzero(group == each)[0]) for each in range(int(group.max()) + 1)]
    for start in [first, *(each for each in firsts if group[each] != group[first])]:
        if start in known:
            continue
        known.add(start)
        waiting = deque([start])
        while waiting:
            here = waiting.popleft()
            for number in by_points:
                edge, step = edges[number], pairwise[number]
                if step is None:
                    continue
                ways = ((edge.first, edge.second, step), (edge.second, edge.first, inverse(step)))
                for one, other, way in ways:
                    if one == here and other not in known:
                        matrices[other] = way @ matrices[here]
                        known.add(other)
                        waiting.append(other)
    lost = {image for edge in edges for image in (edge.first, edge.second)} - known
    if lost:
        raise InputError(f"no homography fits the tie points of {len(lost)} frames: choose another model")
    return matrices / matrices[:, 2:, 2:]


def _rectified(edge: Edge, matrices: Float64) -> Edge:
    """Return the points of a pair in px of the reference, as the homographies so far place them.

    Raises `InputError` if one is beyond the horizon.
    """
    first, second = (ProjectiveCorrection(HOMOGRAPHY, matrices[image]) for image in (edge.first, edge.second))
    first_xy, second_xy = first.inverse(edge.first_xy), second.inverse(edge.second_xy)
    if not (np.isfinite(first_xy).all() and np.isfinite(second_xy).all()):
        raise InputError(NO_HOMOGRAPHY)
    rate = _rate(inverse(second.matrix), edge.second_xy)
    covariance = np.asarray(rate @ edge.covariance @ rate.transpose(0, 2, 1))
    return replace(edge, first_xy=first_xy, second_xy=second_xy, covariance=covariance)


def _rate(matrix: Float64, xy: Float64) -> Float64:
    """Return the (n, 2, 2) derivatives of a homography at (n, 2) positions."""
    moved = np.column_stack([xy, np.ones(len(xy))]) @ matrix.T
    place = moved[:, :2] / moved[:, 2:]
    rate = matrix[None, :2, :2] - place[:, :, None] * matrix[None, 2:, :2]
    return rate / moved[:, 2:, None]


CANDIDATE_MODELS: Final = {
    "auto": IMAGE_MODELS,
    **{name: of_option(name) for name in ("shift", "affine", "polynomial", SPLINE)},
}
"""Models of an image that are tried for each that can be asked for."""
MAX_IMAGES_TO_CHOOSE: Final = 40
"""Of more images so many of those nearest to the datum, in pairs, decide."""


def choose_basis(
    edges: Sequence[Edge], images: int, model: str, *, datum: int | None = 0, split: bool = False
) -> Basis:
    """Return the functions of place of the model that predicts left-out ground best.

    Cells of the ground are left out in turn, in all pairs at once; the tie points in them are held against
    the adjustment of the others. A simpler model stays unless a more flexible one is better by more than
    chance, cell by cell. The `model` is a key of `CANDIDATE_MODELS`; the rest is as `adjust` takes it.
    """
    places = [edge.first_xy for edge in edges]
    tried = [
        basis_over(places, name, roughness)
        for name in CANDIDATE_MODELS[model]
        for roughness in (ROUGHNESS if name == SPLINE else ROUGHNESS[:1])
    ]
    least = min(map(len, edges), default=0)  # control points may be few
    tried = [basis for basis in tried if isinstance(basis, SplineBasis) or terms_of(basis) < least] or tried[
        :1
    ]
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
        # what points scatter, and pairs share, is held against all models alike: as by the best of them
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


def _is_better(gain: Float64, before: bool, after: bool, scatter: float) -> bool:
    """Return whether a more flexible model predicts better, by the (turns,) gain in squared scatters.

    `before` and `after` tell which of the two are lossless. As for a pair: what matches of two sensors share
    looks like detail, so that a model that needs resampling must gain more than that, and between such
    models simplicity is worth nothing.
    """
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    if not before:
        return bool(gain.mean() > 0)
    if after:
        return bool(gain.mean() > 2 * error)
    enough = scatter * np.sqrt(max(gain.mean(), 0.0)) >= MIN_GAIN_PX
    return bool(enough and gain.mean() > RESAMPLING_SIGNIFICANCE * error)


def _nearest(
    edges: Sequence[Edge], images: int, datum: int | None
) -> tuple[Sequence[Edge], Sequence[int], int | None]:
    """Return the pairs of the images nearest to the datum, numbered anew if there are many, and these."""
    if images <= MAX_IMAGES_TO_CHOOSE:
        return edges, range(images), datum
    known = [datum or 0]
    for image in known:
        for edge in edges:
            if image in (edge.first, edge.second) and len(known) < MAX_IMAGES_TO_CHOOSE:
                other = edge.first + edge.second - image
                known += [] if other in known else [other]
    number = {image: index for index, image in enumerate(known)}
    kept = [
        replace(edge, first=number[edge.first], second=number[edge.second])
        for edge in edges
        if edge.first in number and edge.second in number
    ]
    return kept, known, None if datum is None else 0


@dataclass(frozen=True, slots=True, eq=False)
class _ModelTrial:
    """A model, and what the pairs tell by it, which is the same for splines of any roughness."""

    basis: Basis
    parts: list[EdgeEquations]
    folds: list[list[Fold]]
    """Of each pair."""
    shared: Float64
    """(edges,) standard deviations of what the points of each share, map units."""


def _trial(edges: Sequence[Edge], start: Adjustment, basis: Basis) -> _ModelTrial:
    """Sum up the pairs by a model, at the ground that another tells."""
    side = side_of_blocks(edges)
    network = _network(len(start.coefficients), basis, start.fixed)
    coefficients = np.zeros((network.images, network.terms, 2))
    for _ in range(2):  # at the ground that the displacements so far tell
        parts = [edge_equations(edge, basis, coefficients, side) for edge in edges]
        shared = errors_of(parts)
        coefficients = network.coefficients(parts, np.ones(len(parts), bool), shared)
    folds = [
        folds_of(edge, basis, coefficients, side / 2, part) for edge, part in zip(edges, parts, strict=True)
    ]
    return _ModelTrial(basis, parts, folds, shared)


def _errors(trial: _ModelTrial, start: Adjustment, scatter: Float64, shared: Float64) -> Float64:
    """Return, for each turn, the mean square of what left-out points lie off, in scatters of their pairs.

    NaN for turns in which none are left out.
    `scatter` and `shared`, (edges,) standard deviations, are of the points and of what those of a pair share.
    """
    network = _network(len(start.coefficients), trial.basis, start.fixed)
    found = np.full(BLOCKS**2, np.nan)
    for number in range(BLOCKS**2):
        left_out = [next((fold for fold in folds if fold.number == number), None) for folds in trial.folds]
        kept = [fold.kept if fold else part for part, fold in zip(trial.parts, left_out, strict=True)]
        without = network.coefficients(kept, np.ones(len(kept), bool), shared)
        total = count = 0.0
        for part, fold, unit in zip(trial.parts, left_out, scatter, strict=True):
            if fold is None or fold.kept is part:  # nothing of it was left out
                continue
            off = fold.observed - fold.values @ (without[part.second] - without[part.first])
            total += float(np.minimum((off / unit) ** 2, 3.0**2).sum())
            count += off.size
        if count:
            found[number] = total / count
    return found
