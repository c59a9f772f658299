"""Adaptive local consistency: a match is kept where its neighbours have similar displacements.

Two stages after the idea of Huang, Pan and Zhou (2024), ISPRS Annals X-1-2024, 99-106
(doi:10.5194/isprs-annals-X-1-2024-99-2024): a wide test against the neighbours' median displacement
removes the gross errors, a narrow one, whose width follows the scatter of the survivors and each
point's own sigma, removes the rest. Neighbours that err alike vouch for each other: clusters of matches are
therefore compared with what all others predict.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from pcwlad_geo.estimation.robust import axis_sigma
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.types import Bool, Float64, Index

NEIGHBOURS: Final = 12
"""Number of nearest neighbours that a match is compared with."""
WIDE_PX: Final = 6.0
"""Limit of the wide test: largest distance of a displacement from the median of its neighbours."""
NARROW_PX: Final = 2.0
"""Largest limit of the narrow test."""
MIN_NARROW_PX: Final = 0.25
"""Least limit of the narrow test."""
SCATTERS: Final = 7.856
"""The narrow limit is this many times the scatter of the survivors, per axis, about their neighbours. The
value was tuned: it is large because a rough displacement field scatters correct points too."""
SIGMAS: Final = 3.0
"""The narrow limit is at least this many times the radial sigma of the point."""
MIN_SUPPORT: Final = 1 / 3
"""Least share of the neighbours that must agree with a point within the wide, then the narrow limit."""
CONFIRMING: Final = 3
"""Number of neighbours that confirm an inconsistent match."""
CONFIRMING_SHARE: Final = 0.2
"""They differ from it by less than this share of its distance from the prediction."""
EQUAL_SHARE: Final = 0.05
"""Neighbours however near confirm it if they differ by less than this share."""
CELLS_AROUND: Final = 8
"""Number of nearest cells, other than its own, that a match is compared with."""

CONTRADICTION_PX: Final = 3.0
"""Least distance of a cluster from what the others predict."""
CONTRADICTION_SCATTERS: Final = 6.0
"""The same, in scatters per axis of the others about their own prediction: the parts of a rough displacement
field all differ, and none of them is a contradiction."""
MIN_CLUSTER: Final = 6
"""Least number of matches of a cluster; fewer are outliers to any robust fit."""
MAX_CLUSTERED: Final = 0.2
"""Largest share of the matches in clusters. More are a part of the scene, which no majority can overrule."""
CLUSTER_SPREAD: Final = 0.25
"""Largest typical deviation of a cluster's matches from their median, as a share of their distance from the
prediction: ground that bends smoothly has all displacements between the two."""
CLUSTER_GAP: Final = 2 / 3
"""Least part of that distance that must lie between the cluster and the matches next to it."""
CLUSTER_GAP_SHARE: Final = 0.8
"""Least share of the pairs of such neighbours where it does."""
QUADRATIC_FROM: Final = 40
"""Number of matches from which a quadratic surface predicts a cluster, beside a plane: the nearer counts."""
TYPICAL_SIDES: Final = 3.0
"""Neighbours farther apart than so many typical ones, and than two windows, are none."""


def consistent(xy_px: Float64, displacement_px: Float64, sigma_px: Float64, window_px: int) -> Bool:
    """Return the (n,) mask of the matches that agree with their neighbours.

    They are at the (n, 2) positions `xy_px`, with the (n, 2) displacements `displacement_px` (col, row) and
    their (n,) radial standard deviations `sigma_px`. Points nearer to each other than the side of the
    matching window share pixels and can share errors.
    """
    kept = np.ones(len(xy_px), bool)
    for narrow in (False, True):
        for _ in range(6):
            before = kept
            kept = _one_round(xy_px, displacement_px, sigma_px, kept, narrow)
            if (kept == before).all():
                break
    return _with_their_surroundings(xy_px, displacement_px, sigma_px, kept, window_px / 2)


def confirmed(
    xy_px: Float64, displacement_px: Float64, index: Index, predicted_px: Float64, window_px: int
) -> Bool:
    """Return the (m,) mask of inconsistent matches that others next to them confirm, against the field.

    Such ground has moved by itself: a slide, a cloud, another depth. At least three of the nearest matches
    are nearer to the match than to the prediction, by far; matches nearer than a quarter of the window err
    alike, if not by the same. All matches are at the (n, 2) `xy_px` with the (n, 2) `displacement_px` (col,
    row); the inconsistent ones are those of the (m,) intp `index`, with the (m, 2) `predicted_px`.
    """
    if len(xy_px) <= CONFIRMING or len(index) == 0:
        return np.zeros(len(index), bool)
    distance, near = cKDTree(xy_px).query(xy_px[index], k=min(NEIGHBOURS + 1, len(xy_px)))
    own = displacement_px[index]
    difference = np.linalg.norm(displacement_px[near[:, 1:]] - own[:, None], axis=2)
    off = np.linalg.norm(own - predicted_px, axis=1)
    nearer = difference < CONFIRMING_SHARE * off[:, None]
    confirms = (nearer & (distance[:, 1:] >= window_px / 4)).sum(axis=1) >= CONFIRMING
    return np.asarray(confirms | ((difference < EQUAL_SHARE * off[:, None]).sum(axis=1) >= CONFIRMING))


def _one_round(xy: Float64, displacement: Float64, sigma: Float64, kept: Bool, narrow: bool) -> Bool:
    index = np.flatnonzero(kept)
    if len(index) < 4:
        return np.zeros_like(kept)
    k = min(NEIGHBOURS, len(index) - 1)
    _, neighbours = cKDTree(xy[index]).query(xy[index], k=k + 1)
    around = displacement[index][neighbours[:, 1:]]
    own = displacement[index]
    residual = np.linalg.norm(own - np.median(around, axis=1), axis=1)
    limit = np.full(len(index), WIDE_PX)
    if narrow:
        width = np.maximum(SCATTERS * axis_sigma(residual), SIGMAS * sigma[index])
        limit = np.clip(width, MIN_NARROW_PX, NARROW_PX)
    agreeing = (np.linalg.norm(around - own[:, None, :], axis=2) < np.maximum(limit, 1.0)[:, None]).mean(
        axis=1
    )
    result = np.zeros_like(kept)
    result[index] = (residual < limit) & (agreeing >= MIN_SUPPORT)
    return result


def _with_their_surroundings(
    xy: Float64, displacement: Float64, sigma: Float64, kept: Bool, cell_px: float
) -> Bool:
    """Remove clusters that agree only among themselves: moved clouds, a wrong peak common to many windows.

    Every point is compared with the medians of the nearest cells other than its own.
    """
    index = np.flatnonzero(kept)
    if len(index) < 4:
        return np.zeros_like(kept)
    place, moved = xy[index], displacement[index]
    cells, cell_of = np.unique(np.floor(place / cell_px).astype(np.intp), axis=0, return_inverse=True)
    cell_of = cell_of.ravel()
    if len(cells) < CELLS_AROUND:
        return kept
    order = np.argsort(cell_of, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(cell_of[order])) + 1)
    centres = np.array([place[group].mean(axis=0) for group in groups])
    medians = np.array([np.median(moved[group], axis=0) for group in groups])
    _, nearest = cKDTree(centres).query(centres, k=min(CELLS_AROUND + 1, len(cells)))
    around = np.median(medians[nearest[:, 1:]], axis=1)
    residual = np.linalg.norm(moved - around[cell_of], axis=1)
    width = np.maximum(SCATTERS * axis_sigma(residual), SIGMAS * sigma[index])
    result = np.zeros_like(kept)
    result[index] = residual < np.clip(width, MIN_NARROW_PX, WIDE_PX)
    return result


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
    plane (and, where there are enough matches, a quadratic surface) fitted robustly to all others, with a
    step all around: a smooth bend of the ground is none. Wrong matches of a repeated structure are like that,
    and so is a landslide: the displacements alone cannot tell them apart. The (n, 2) `xy_px` and
    `displacement_px`, also (n, 2), are (col, row). An island farther than two windows (and than three typical
    distances of neighbours) from all others contradicts nobody; `unit_px` is the size of a pixel of the
    matching in px of the arrays. There are none where more than a fifth of the matches are in clusters.
    """
    n = len(xy_px)
    if n < 2 * NEIGHBOURS:
        return []
    everyone = np.ones(n, bool)
    left = displacement_px - _trend(xy_px, displacement_px, everyone, 1)
    far = _length(left) > _limit_px(left, everyone, unit_px)
    if np.count_nonzero(far) < MIN_CLUSTER:
        return []
    edges = _neighbour_pairs(xy_px, 2 * window_px)
    found = []
    for members in _groups(left, far, edges):
        if MIN_CLUSTER <= len(members) <= MAX_CLUSTERED * n:
            inside = np.zeros(n, bool)
            inside[members] = True
            cluster = _against_all_others(xy_px, displacement_px, inside, edges, unit_px)
            found += [] if cluster is None else [cluster]
    return found if sum(len(each.index) for each in found) <= MAX_CLUSTERED * n else []


def _against_all_others(
    xy: Float64, displacement: Float64, inside: Bool, edges: Index, unit_px: float
) -> Cluster | None:
    """Return the matches inside as a cluster if they contradict the others."""
    orders = (1, 2) if np.count_nonzero(~inside) >= QUADRATIC_FROM else (1,)
    found = None
    for order in orders:
        left = displacement - _trend(xy, displacement, ~inside, order)
        offset = np.median(left[inside], axis=0)
        size = float(np.hypot(*offset))
        if size <= _limit_px(left, ~inside, unit_px) or not _is_isolated(left, inside, edges, offset, size):
            return None
        if found is None or size < np.hypot(*found.offset_px):
            found = Cluster(np.flatnonzero(inside), offset)
    return found


def _is_isolated(left: Float64, inside: Bool, edges: Index, offset: Float64, size: float) -> bool:
    """Whether the matches inside are off by one and the same amount, and those next to them are not."""
    if np.median(_length(left[inside] - offset)) > CLUSTER_SPREAD * size:
        return False
    across = edges[inside[edges[:, 0]] != inside[edges[:, 1]]]
    if len(across) == 0:
        return False
    step = _length(left[across[:, 0]] - left[across[:, 1]])
    return bool((step >= CLUSTER_GAP * size).mean() >= CLUSTER_GAP_SHARE)


def _groups(left: Float64, far: Bool, edges: Index) -> Iterator[Index]:
    """Yield neighbouring far matches that have moved alike."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    one, other = edges[far[edges].all(axis=1)].T
    least = np.minimum(_length(left[one]), _length(left[other]))
    alike = _length(left[one] - left[other]) <= 2 * CLUSTER_SPREAD * least
    linked = coo_array((np.ones(alike.sum()), (one[alike], other[alike])), shape=(len(far), len(far)))
    _, group = connected_components(linked, directed=False)
    for number in np.unique(group[far]):
        yield np.flatnonzero(far & (group == number))


def _neighbour_pairs(xy: Float64, reach_px: float) -> Index:
    """Return the (m, 2) sides of the Delaunay triangles, but the longest; none if all lie on a line."""
    try:
        corners = Delaunay(xy).simplices
    except QhullError:
        return np.empty((0, 2), np.intp)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    sides = np.unique(np.sort(sides, axis=1), axis=0).astype(np.intp)
    length = _length(xy[sides[:, 0]] - xy[sides[:, 1]])
    return sides[length <= max(reach_px, TYPICAL_SIDES * float(np.median(length)))]


def _trend(xy: Float64, displacement: Float64, used: Bool, order: int) -> Float64:
    """Return (n, 2) a plane or a quadratic surface, of least absolute deviations from the matches used."""
    place = (xy - xy[used].mean(axis=0)) / max(float(np.ptp(xy[used], axis=0).max()), 1e-9)
    x, y = place.T
    terms = [np.ones_like(x), x, y] + ([x * x, x * y, y * y] if order == 2 else [])
    basis, weight = np.column_stack(terms), used.astype(np.float64)
    for _ in range(30):
        weighted = basis.T * weight
        fitted = basis @ least_squares(weighted @ basis, weighted @ displacement)
        off = _length(displacement - fitted)
        weight = used / np.maximum(off, max(0.1 * float(np.median(off[used])), 1e-6))
    return fitted


def _limit_px(left: Float64, used: Bool, unit_px: float) -> float:
    """Return how far a match must lie off the trend to contradict it."""
    return max(CONTRADICTION_PX * unit_px, CONTRADICTION_SCATTERS * axis_sigma(_length(left[used])))


def _length(vectors: Float64) -> Float64:
    return np.hypot(vectors[:, 0], vectors[:, 1])
