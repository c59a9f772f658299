"""The joint least-squares adjustment of many images from the tie points of their pairs.

Every image places the ground X at X + g(X), where g is the error of its georeferencing. The tie points of a
pair (a, b) measure g of b minus g of a, with an error that all points of the pair share. All g are estimated
together. An error that all pairs of two kinds of images have in common causes no contradiction between pairs;
a jackknife over blocks of the ground estimates it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import jackknife, propagated
from pcwlad_geo.estimation.solving import check_observations, components
from pcwlad_geo.execution.runner import one_library_thread
from pcwlad_geo.multi.stack.bases import Basis, basis_over, mixing_of, penalty_of, terms_of
from pcwlad_geo.multi.stack.edges import Edge, linked
from pcwlad_geo.multi.stack.equations import (
    EdgeEquations,
    GroundBlocks,
    edge_equations,
    ends_of,
    errors_of,
    folds_of,
)
from pcwlad_geo.multi.stack.network import EdgeFit, Network, NetworkSolution, factor_of, named
from pcwlad_geo.multi.stack.parameters import ADJUSTMENT, AdjustmentParameters
from pcwlad_geo.types import Bool, Float64, Index


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
    parameters: AdjustmentParameters = field(default=ADJUSTMENT, kw_only=True)

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
    parameters: AdjustmentParameters = ADJUSTMENT,
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
    parameters : AdjustmentParameters
        The tuned numbers.

    Raises
    ------
    InputError
        If the edges do not connect all images, unless they may be `split`, or there are none.
    """
    for edge in edges:
        check_observations("the tie points of a pair", edge.first_xy, edge.second_xy, edge.covariance)
    group = components(ends_of(edges), images)
    fixed = datums_of(group, datum)
    if not edges or (len(fixed) > 1 and not split):
        away = np.flatnonzero(group != group[0]).tolist()
        raise InputError(f"{len(fixed)} groups of images share no ground: images {away} are not connected")
    basis = basis or basis_over([edge.first_xy for edge in edges], model)
    edges = linked(edges, parameters.feature_px)
    network = network_of(images, basis, fixed, parameters)
    blocks = GroundBlocks.of(edges, parameters.blocks)
    coefficients = np.zeros((images, network.terms, 2))
    in_use, shared = np.ones(len(edges), bool), 0.0
    evidence = np.array([edge.evidence for edge in edges])
    for _ in range(3):  # the ground of the points depends on the displacements
        before = coefficients
        if sigma_known is not None and shared:  # only after the shared error is estimated from the pairs
            network = replace(network, prior=_prior(edges, basis, before, sigma_known))
        parts = [edge_equations(edge, basis, before, blocks) for edge in edges]
        shared = shared or _initial_shared_error(network, parts)
        robust = _consistent_solution(network, parts, in_use, shared, evidence)
        coefficients, in_use, shared = robust.solution.coefficients, robust.in_use, robust.shared
    fits = tuple(
        replace(fit, in_use=bool(good)) for fit, good in zip(robust.solution.fits, in_use, strict=True)
    )
    spread = _spread(network, edges, basis, before, parts, in_use, robust.sigma, blocks)
    if datum is None:
        coefficients, spread = _about_mean(coefficients, group), _about_mean(spread, group)
    normal = robust.solution.normal
    numbers = basis, coefficients, fits, shared, datum, normal, group, fixed, spread
    return Adjustment(*numbers, parameters=parameters)


def datums_of(group: Index, datum: int | None) -> tuple[int, ...]:
    """Return an image of each `group`, (images,) numbers: the datum of its own, the first of the others."""
    first_images: list[int] = np.unique(group, return_index=True)[1].tolist()
    if datum is not None:
        first_images[group[datum]] = datum
    return tuple(first_images)


def _prior(edges: Sequence[Edge], basis: Basis, coefficients: Float64, sigma: Float64) -> Float64:
    """Return `Network.prior` for displacements with the (images,) prior standard deviations `sigma`."""
    values = basis.values(np.concatenate([edge.first_xy for edge in edges]))
    moment = values.T @ values / len(values)
    squares = np.einsum("ita,ts,isa->i", coefficients, moment, coefficients)
    weight = 1 / (sigma**2 + squares / 5.0**2)  # half as much at five sigmas
    return np.asarray(weight[:, None, None] * moment)


def network_of(
    images: int, basis: Basis, fixed: tuple[int, ...], parameters: AdjustmentParameters
) -> Network:
    """Return the unknowns of images with a model, those `fixed` excepted."""
    penalty, mixing = penalty_of(basis), mixing_of(basis)
    return Network(images, terms_of(basis), fixed, penalty, mixing, parameters=parameters)


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
    addition = _on_frame(before, more, old, images - ground)
    coefficients = np.concatenate(
        [before.coefficients[:old], addition.coefficients[1:], before.coefficients[old:]]
    )
    last = sum(edge.first < old for edge in edges)  # those with the ground come after those of images
    every = [*edges[:last], *more, *(replace(edge, first=images - 1) for edge in edges[last:])]
    every = linked(every, before.parameters.feature_px)
    fits = (*before.edges[:last], *addition.edges, *before.edges[last:])
    shared = np.repeat([before.shared, addition.shared, before.shared], [last, len(more), len(edges) - last])
    network = network_of(
        images,
        before.basis,
        tuple(images - 1 if ground and image == old else image for image in before.fixed),
        before.parameters,
    )
    blocks = GroundBlocks.of(every, before.parameters.blocks)
    parts = [edge_equations(edge, before.basis, coefficients, blocks) for edge in every]
    in_use, sigma = np.array([fit.in_use for fit in fits]), shared * errors_of(parts)
    spread = _spread(network, every, before.basis, coefficients, parts, in_use, sigma, blocks)
    group = components(ends_of(every), images)
    return replace(
        before,
        coefficients=coefficients,
        edges=fits,
        normal=network.equations(parts, in_use, sigma)[0],
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
        return adjust(frame, images - old + 1, basis=before.basis, parameters=before.parameters)


def _about_mean(coefficients: Float64, group: Index) -> Float64:
    """Return (..., images, terms, 2) coefficients less the mean of each group of images."""
    centred = coefficients.copy()
    for number in range(int(group.max()) + 1):
        members = group == number
        centred[..., members, :, :] -= centred[..., members, :, :].mean(axis=-3, keepdims=True)
    return centred


def _spread(
    network: Network,
    edges: Sequence[Edge],
    basis: Basis,
    coefficients: Float64,
    parts: Sequence[EdgeEquations],
    in_use: Bool,
    sigma: Float64,
    blocks: GroundBlocks,
) -> Float64:
    """Return `Adjustment.spread`: the jackknife over the blocks of the ground."""
    if not network.free.size:
        return np.zeros((1, network.images, network.terms, 2))
    parts_without: list[dict[int, EdgeEquations]] = []
    for edge, part, good in zip(edges, parts, in_use, strict=True):
        folds = folds_of(edge, basis, coefficients, blocks, part) if good else []
        parts_without.append({fold.number: fold.remaining for fold in folds})
    solutions = []
    for number in range(blocks.count):
        remaining = [of_edge.get(number, part) for part, of_edge in zip(parts, parts_without, strict=True)]
        solutions.append(network.coefficients(remaining, in_use, sigma))
    return jackknife(np.array(solutions))


def _initial_shared_error(network: Network, parts: Sequence[EdgeEquations]) -> float:
    """Return the median offset of the pairs in a solution of least L1 norm, relative to their own errors."""
    in_use, error = np.ones(len(parts), bool), errors_of(parts)
    shared = np.full(len(parts), 1e3)
    for _ in range(30):  # iteratively reweighted least squares
        fits = network.solve(parts, in_use, shared * error).fits
        size = np.array([np.hypot(*fit.offset) for fit in fits]) / error
        typical = max(float(np.median(size)), network.parameters.min_shared)
        shared = np.sqrt(typical * np.maximum(size, typical))
    return typical


def critical(pairs: int, parameters: AdjustmentParameters = ADJUSTMENT) -> float:
    """Return the critical value of the outlier test: the largest offset of a right one of `pairs`, sigmas.

    The offset has two components, and its sigma few degrees of freedom: half its square in sigmas follows
    Fisher's F (Pope 1976, NOAA Technical Report NOS 65 NGS 1). The largest offset of all pairs is tested: the
    probability that any right one is lost is `alpha` (Šidák 1967, doi:10.2307/2283989).
    """
    freedom, alpha_of_one = parameters.freedom, 1 - (1 - parameters.alpha) ** (1 / pairs)
    return float(np.sqrt(freedom * (alpha_of_one ** (-2 / freedom) - 1)))


@dataclass(frozen=True, slots=True, eq=False)
class _RobustSolution:
    """A solution, the pairs in use, and their shared errors."""

    solution: NetworkSolution
    in_use: Bool
    """(edges,) the pairs in use."""
    shared: float
    """See `Adjustment.shared`."""
    sigma: Float64
    """(edges,) standard deviations of the shared errors, larger for pairs with a large offset."""


def _consistent_solution(
    network: Network, parts: Sequence[EdgeEquations], in_use: Bool, shared: float, evidence: Float64
) -> _RobustSolution:
    """Solve with the pairs that agree; of groups that contradict each other, with that of more evidence."""
    rounds = network.parameters.max_rounds
    for turn in range(rounds):
        # where two groups alternate, the last round keeps that of more evidence
        result = _robust_solution(network, parts, in_use, shared, keep=turn == rounds - 1)
        in_use, shared = _consistent_pairs(network, parts, result, evidence), result.shared
        if (in_use == result.in_use).all():
            break
    return result


def _robust_solution(
    network: Network, parts: Sequence[EdgeEquations], in_use: Bool, shared: float, *, keep: bool
) -> _RobustSolution:
    """Solve, test all pairs for outliers and weight them anew, until nothing changes.

    The outlier test leaves out the pairs that contradict the others, unless it is to `keep` those `in_use`;
    one that was left out is tested again, against the sigma of those in use now. The weights are those of
    Student's t distribution (Lange, Little, Taylor 1989, doi:10.1080/01621459.1989.10478852): the sigma of a
    shared error has `freedom` degrees of freedom, and the offset of the pair adds two more, so that pairs
    somewhat off count for less. The test uses the sigma without these weights.
    """
    parameters = network.parameters
    error, limit, freedom = errors_of(parts), critical(len(parts), parameters), parameters.freedom
    factor = np.ones(len(parts))  # of the sigma of each, by its weight
    for _ in range(parameters.max_rounds):
        sigma = shared * error * factor
        solution = network.solve(parts, in_use, sigma)
        fits = tuple(
            replace(fit, sigma=fit.sigma / inflation, shared=fit.shared / inflation)
            for fit, inflation in zip(solution.fits, factor, strict=True)
        )
        solution = replace(solution, fits=fits)
        before = shared
        shared = max(_shared_error(solution, in_use, shared, parameters), parameters.min_shared)
        ratio = np.array([fit.ratio for fit in fits]) * before / shared
        passed = in_use if keep else _still_connected(parts, network.images, in_use, ratio <= limit, ratio)
        weighted = np.sqrt((freedom + np.minimum(ratio, limit) ** 2) / (freedom + 2))
        same = (passed == in_use).all() and abs(shared - before) <= 0.01 * before
        if same and np.abs(weighted / factor - 1).max() <= 0.02:
            break
        in_use, factor = passed, weighted
    return _RobustSolution(solution, in_use, shared, sigma)


def _shared_error(
    solution: NetworkSolution, in_use: Bool, before: float, parameters: AdjustmentParameters
) -> float:
    """Return `Adjustment.shared` by the median offset of the pairs in use, as some of them may be wrong."""
    checked = [
        fit.ratio
        for fit, use in zip(solution.fits, in_use, strict=True)
        if use and fit.redundancy >= parameters.min_redundancy
    ]
    return before * float(np.median(checked)) / parameters.median_sigmas if checked else before


def _consistent_pairs(
    network: Network, parts: Sequence[EdgeEquations], before: _RobustSolution, evidence: Float64
) -> Bool:
    """Return the pairs to use.

    The pairs of an image are replaced by left-out ones that agree on another position of it and have more
    evidence together, as many pairs may be wrong for one reason. Those that alone connect other images with
    it stay: these images go with it.
    """
    in_use, ends, fits = before.in_use, ends_of(parts), before.solution.fits
    offset = np.array([fit.offset for fit in fits])
    limit = critical(len(parts), network.parameters) * np.array([fit.sigma for fit in fits])
    selection = in_use.copy()
    for image in range(network.images):
        at = (ends == image).any(axis=1)
        out = np.flatnonzero(at & ~in_use)
        of_image = offset[out] * np.where(ends[out, 1:] == image, 1, -1)
        groups = [
            out[np.hypot(*(of_image - vector).T) <= most]
            for vector, most in zip(of_image, limit[out], strict=True)
        ]
        best = max(groups, key=lambda group: float(evidence[group].sum()), default=out)
        if evidence[best].sum() > evidence[at & in_use].sum():
            selection[at] = False
            selection[best] = True
            ratio = np.array([fit.ratio for fit in fits])
            return _still_connected(parts, network.images, in_use, selection, ratio)
    return selection


def _still_connected(
    edges: Sequence[EdgeEquations], images: int, in_use: Bool, accepted: Bool, ratio: Float64
) -> Bool:
    """Return the edges wanted, and the best of the others that are needed to keep all images connected."""
    selection = accepted.copy()
    for index in np.argsort(ratio):
        if in_use[index] and not selection[index]:
            group = components(ends_of(edges)[selection], images)
            selection[index] = group[edges[index].first] != group[edges[index].second]
    return selection
