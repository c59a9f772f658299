"""The tie points of the pairs of a stack on the ground, and the features that several pairs share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.estimation.solving import components
from pcwlad_geo.types import Float64, Index


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


def linked(edges: Sequence[Edge], feature_px: float) -> list[Edge]:
    """Return pairs with the number of images that share each of their points.

    Points of two pairs that lie within `feature_px` of each other in an image that both have are of one
    feature: what that image sees of it is in the error of both. Those so connected are a track. The pairs of
    k images of it tell no more than k - 1 independent ones: with a weight of 2 / k each, as many as all
    k (k - 1) / 2 of them would.
    """
    count = np.cumsum([0, *(len(edge) for edge in edges)])
    at = np.concatenate([place for edge in edges for place in (edge.first_xy, edge.second_xy)])
    of_point = np.concatenate([np.tile(np.arange(a, b), 2) for a, b in pairwise(count.tolist())])
    image = np.concatenate([np.repeat([edge.first, edge.second], len(edge)) for edge in edges])
    links = [np.empty((0, 2), dtype=np.intp)]
    for number in np.unique(image):
        members = np.flatnonzero(image == number)
        links.append(of_point[members[_near_pairs(at[members], feature_px)]])
    track = components(np.concatenate(links), int(count[-1]))
    tracked = np.unique(np.column_stack([track[of_point], image]), axis=0)[:, 0]
    images = np.bincount(tracked, minlength=len(track)).astype(np.float64)[track]
    return [replace(edge, images=images[a:b]) for edge, (a, b) in zip(edges, pairwise(count), strict=True)]


def _near_pairs(at: Float64, within: float) -> Index:
    """Return (k, 2) numbers of points `within` a distance of each other, which connect all that lie so near.

    Of many points in one place each is paired with a few alone: all pairs would be as many as their square.
    """
    places, of_place = np.unique(np.round(at, 6), axis=0, return_inverse=True)
    order = np.argsort(of_place.ravel(), kind="stable")
    same = np.flatnonzero(np.diff(of_place.ravel()[order]) == 0)
    equal = np.column_stack([order[same], order[same + 1]])
    first = np.full(len(places), len(at))
    np.minimum.at(first, of_place.ravel(), np.arange(len(at)))
    # itself, and enough to connect those of one feature
    distance, neighbour = cKDTree(places).query(places, k=17, distance_upper_bound=within)
    one, other = np.nonzero(np.isfinite(distance))
    links = np.column_stack([first[one], first[neighbour[one, other]]])
    return np.vstack([equal, links[links[:, 0] != links[:, 1]]]).astype(np.intp)
