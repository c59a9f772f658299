"""Clusters of matches that agree among themselves, and contradict what all others predict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import Delaunay, QhullError

from pcwlad_geo.estimation.robust import axis_sigma
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.estimation.surfaces import surface_terms
from pcwlad_geo.matching.outliers import OUTLIERS
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class ClusterParameters:
    """When matches are a cluster that contradicts all others."""

    least_px: float = 3.0
    """Least distance of a cluster from what the others predict."""
    scatters: float = 6.0
    """The same in scatters per axis of the others: the parts of a rough displacement field all differ."""
    least_matches: int = 6
    """Least number of matches of a cluster; fewer are outliers to any robust fit."""
    most_share: float = 0.2
    """Largest share of the matches in clusters. More are a part of the scene."""
    spread: float = 0.25
    """Largest typical deviation from the median of its matches, as a share of that from the prediction."""
    gap: float = 2 / 3
    """Least part of that distance between the cluster and the matches next to it."""
    gap_share: float = 0.8
    """Least share of the pairs of such neighbours where it is as large."""
    quadratic_from: int = 40
    """Number of matches from which a quadratic surface predicts too."""
    typical_sides: float = 3.0
    """Neighbours farther apart than so many typical ones, and than two windows, are none."""


CLUSTERS: Final = ClusterParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Matches that agree among themselves, and with nothing around them."""

    index: Index
    """(k,) the matches."""
    offset_px: Float64
    """(2,) their median displacement (col, row) less what all others predict there."""


def contradicted_clusters(
    xy_px: Float64, displacement_px: Float64, window_px: float, unit_px: float = 1.0
) -> list[Cluster]:
    """Find clusters of matches that contradict what all other matches predict.

    A cluster is a minority of neighbours that have moved alike, several pixels and many scatters beside a
    plane (of enough matches also a quadratic surface) through all others, with a step all around. Wrong
    matches of a repeated structure are like that, and so is a landslide: displacements alone cannot tell them
    apart. The (n, 2) `xy_px` and (n, 2) `displacement_px` are (col, row); `unit_px` is the size of a pixel of
    the matching in px of the arrays. Islands far from all others contradict nobody.
    """
    n = len(xy_px)
    if n < 2 * OUTLIERS.neighbours:
        return []
    everyone = np.ones(n, bool)
    residual = displacement_px - _trend(xy_px, displacement_px, everyone, 1)
    distant = _length(residual) > _limit_px(residual, everyone, unit_px)
    if np.count_nonzero(distant) < CLUSTERS.least_matches:
        return []
    edges = _neighbour_pairs(xy_px, 2 * window_px)
    clusters = []
    for members in _groups(residual, distant, edges):
        if CLUSTERS.least_matches <= len(members) <= CLUSTERS.most_share * n:
            inside = np.zeros(n, bool)
            inside[members] = True
            cluster = _against_all_others(xy_px, displacement_px, inside, edges, unit_px)
            clusters += [] if cluster is None else [cluster]
    return (
        clusters
        if sum(len(cluster_found.index) for cluster_found in clusters) <= CLUSTERS.most_share * n
        else []
    )


def _against_all_others(
    xy: Float64, displacement: Float64, inside: Bool, edges: Index, unit_px: float
) -> Cluster | None:
    """Return the matches inside as a cluster if they contradict the others."""
    orders = (1, 2) if np.count_nonzero(~inside) >= CLUSTERS.quadratic_from else (1,)
    nearest = None
    for order in orders:
        residual = displacement - _trend(xy, displacement, ~inside, order)
        offset = np.median(residual[inside], axis=0)
        size = float(np.hypot(*offset))
        if size <= _limit_px(residual, ~inside, unit_px) or not _is_isolated(
            residual, inside, edges, offset, size
        ):
            return None
        if nearest is None or size < np.hypot(*nearest.offset_px):
            nearest = Cluster(np.flatnonzero(inside), offset)
    return nearest


def _is_isolated(residual: Float64, inside: Bool, edges: Index, offset: Float64, size: float) -> bool:
    """Whether the matches inside are off by one and the same amount, and those next to them are not."""
    if np.median(_length(residual[inside] - offset)) > CLUSTERS.spread * size:
        return False
    across = edges[inside[edges[:, 0]] != inside[edges[:, 1]]]
    if len(across) == 0:
        return False
    step = _length(residual[across[:, 0]] - residual[across[:, 1]])
    return bool((step >= CLUSTERS.gap * size).mean() >= CLUSTERS.gap_share)


def _groups(residual: Float64, distant: Bool, edges: Index) -> Iterator[Index]:
    """Yield neighbouring far matches that have moved alike."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    one, other = edges[distant[edges].all(axis=1)].T
    least = np.minimum(_length(residual[one]), _length(residual[other]))
    similar = _length(residual[one] - residual[other]) <= 2 * CLUSTERS.spread * least
    linked = coo_array(
        (np.ones(similar.sum()), (one[similar], other[similar])), shape=(len(distant), len(distant))
    )
    _, group = connected_components(linked, directed=False)
    for number in np.unique(group[distant]):
        yield np.flatnonzero(distant & (group == number))


def _neighbour_pairs(xy: Float64, reach_px: float) -> Index:
    """Return the (m, 2) sides of the Delaunay triangles, but the longest; none if all lie on a line."""
    try:
        corners = Delaunay(xy).simplices
    except QhullError:
        return np.empty((0, 2), np.intp)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    sides = np.unique(np.sort(sides, axis=1), axis=0).astype(np.intp)
    length = _length(xy[sides[:, 0]] - xy[sides[:, 1]])
    return sides[length <= max(reach_px, CLUSTERS.typical_sides * float(np.median(length)))]


def _trend(xy: Float64, displacement: Float64, mask: Bool, order: int) -> Float64:
    """Return (n, 2) a plane or a quadratic surface, of least absolute deviations from the matches used."""
    place = (xy - xy[mask].mean(axis=0)) / max(float(np.ptp(xy[mask], axis=0).max()), 1e-9)
    basis, weight = surface_terms(place, order), mask.astype(np.float64)
    for _ in range(30):
        weighted = basis.T * weight
        fitted = basis @ least_squares(weighted @ basis, weighted @ displacement)
        off = _length(displacement - fitted)
        weight = mask / np.maximum(off, max(0.1 * float(np.median(off[mask])), 1e-6))
    return fitted


def _limit_px(residual: Float64, mask: Bool, unit_px: float) -> float:
    """Return how far a match must lie off the trend to contradict it."""
    return max(CLUSTERS.least_px * unit_px, CLUSTERS.scatters * axis_sigma(_length(residual[mask])))


def _length(vectors: Float64) -> Float64:
    return np.hypot(vectors[:, 0], vectors[:, 1])
