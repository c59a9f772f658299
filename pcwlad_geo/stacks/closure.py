"""Closure of triangles of bands: a check of the matching that needs no truth.

The way from A to B and on to C must lead where the way from A to C leads. The three are measured
independently, so what is missing is their error: not that of the bands, whose true displacements cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.spatial import cKDTree

from pcwlad_geo.matching.field import Surface, predict
from pcwlad_geo.raster.locate import predict_px
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.stacks.bands import Band
from pcwlad_geo.stacks.cells import cell_means
from pcwlad_geo.stacks.pairs import PairResult

Array = NDArray[np.float64]
Pair = tuple[float, float]

LEAST_NEIGHBOURS: Final = 12
"""Tie points that say where a pair leads from a place; twice the least that a plane is laid through."""
MOST_LEVERAGE: Final = 0.5
"""Variance of a plane over that of one tie point: about one over their number, unless they lie aside."""
MOST_REACH: Final = 2.5
"""Neighbours may lie so many times as far from a place as is typical; in a corner they lie twice as far."""


@dataclass(frozen=True, slots=True)
class Triangle:
    """How well a triangle of bands closes, in px (col, row) of the third, the coarsest."""

    bands: tuple[str, str, str]
    cells: int
    """Places where all three pairs have tie points."""
    mean_px: Pair | None
    """Mean over the places of BC(AB(x)) − AC(x); None where the three share no ground."""
    error_px: Pair | None
    """Standard error of that mean, from the scatter between places; None with a single place."""
    rms_px: Pair | None
    """Root mean square over the places."""
    px_m: Pair | None
    """Size of that pixel in metres."""

    @property
    def name(self) -> str:
        """The three bands."""
        return " – ".join(self.bands)

    @property
    def mean_m(self) -> Pair | None:
        """The mean in metres, along columns and rows."""
        if self.mean_px is None or self.px_m is None:
            return None
        return self.mean_px[0] * self.px_m[0], self.mean_px[1] * self.px_m[1]


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """A measured pair as a map from the pixels of its reference to those of its target."""

    reference: RasterInfo
    target: RasterInfo
    points: TiePointTable

    @staticmethod
    def of(pair: PairResult) -> Leg:
        """Return the map of a measured pair."""
        if pair.points is None:
            raise ValueError(f"{pair.name} was refused")
        finite = np.asarray(np.isfinite(pair.points.displacement_px).all(axis=1))
        return Leg(pair.reference.info, pair.target.info, pair.points[finite])

    def arrival(self, reference_px: Array, neighbours: int) -> Array:
        """Map reference px to target px: what the georeferencing predicts, and the displacement there.

        That is the value of a robust plane through the nearest tie points: a mean of them would be the
        displacement of another place, as they do not lie evenly round this one.

        Parameters
        ----------
        reference_px : (n, 2) array
            NaN is passed on.
        neighbours : int
            Tie points of a plane.

        Returns
        -------
        (n, 2) array
            NaN where the tie points do not reach.
        """
        predicted = predict_px(reference_px, self.reference, self.target)
        arrived = np.full(predicted.shape, np.nan)
        known = np.isfinite(predicted).all(axis=1)
        if not known.any():
            return arrived
        at, moved = self.points.predicted_px, self.points.displacement_px
        plane = predict(at, moved, predicted[known], Surface(neighbours, 1))
        reach = _reach_px(at, predicted[known], neighbours)
        within = reach <= MOST_REACH * np.median(_reach_px(at, at, neighbours))
        within &= plane.leverage <= MOST_LEVERAGE
        arrived[known] = np.where(within[:, None], predicted[known] + plane.displacement_px, np.nan)
        return arrived


def close_triangles(bands: Sequence[Band], pairs: Sequence[PairResult], window_px: float) -> list[Triangle]:
    """Close every triangle whose three pairs were measured.

    Parameters
    ----------
    bands : sequence of Band
        In the order of the pairs, the coarsest last: the reference of a pair comes first.
    pairs : sequence of PairResult
    window_px : float
        Side of the matching window, px of the coarsest band: tie points within one are not independent.
    """
    legs = {
        (pair.reference.name, pair.target.name): Leg.of(pair) for pair in pairs if pair.status == "measured"
    }
    triangles = []
    for a, b, c in combinations(bands, 3):
        sides = [(a.name, b.name), (b.name, c.name), (a.name, c.name)]
        if all(side in legs for side in sides):
            ab, bc, ac = (legs[side] for side in sides)
            triangles.append(close((a.name, b.name, c.name), (ab, bc, ac), window_px, c.px_m))
    return triangles


def close(
    names: tuple[str, str, str], legs: tuple[Leg, Leg, Leg], window_px: float, px_m: Pair | None = None
) -> Triangle:
    """Close one triangle on the ground that its three legs share.

    Parameters
    ----------
    names : three of str
    legs : three of Leg
        A to B, B to C, A to C.
    window_px : float
        Least side of a place, px of C.
    px_m : (float, float), optional
        Size of a pixel of C.
    """
    if not all(len(leg.points) for leg in legs):
        return Triangle(names, 0, None, None, None, px_m)
    (ab, bc, ac), net = legs, _Net.of(legs, window_px)
    to_b, from_b, direct = net.neighbours
    gaps = bc.arrival(ab.arrival(net.places_px, to_b), from_b) - ac.arrival(net.places_px, direct)
    known = np.isfinite(gaps).all(axis=1)
    squares, gaps = net.squares[known], gaps[known]
    if not len(gaps):
        return Triangle(names, 0, None, None, None, px_m)
    return Triangle(
        names,
        len(gaps),
        _pair(gaps.mean(axis=0)),
        _pair(standard_error(gaps, squares)) if len(gaps) > 1 else None,
        _pair(np.sqrt((gaps**2).mean(axis=0))),
        px_m,
    )


def standard_error(values: Array, squares: NDArray[np.intp]) -> Array:
    """Return the standard error of the mean of values in the squares of a net.

    Neighbouring squares err alike, as they share pixels and tie points: their covariance counts with the
    weights of Bartlett (Conley 1999, doi:10.1016/S0304-4076(98)00084-0). Without bias where they do not.

    Parameters
    ----------
    values : (n, k) array
        n is two or more.
    squares : (n, 2) array of int
        Column and row of each in the net.

    Returns
    -------
    (k,) array
    """
    n = len(values)
    first = squares - squares.min(axis=0)
    net = np.zeros((*(first.max(axis=0) + 1), values.shape[1] + 1))
    net[first[:, 0], first[:, 1]] = np.c_[values - values.mean(axis=0), np.ones(n)]
    around = net
    for axis in (0, 1):
        around = correlate1d(around, [0.5, 1.0, 0.5], axis, mode="constant")
    products = (net * around).sum(axis=(0, 1)) / n**2
    return np.asarray(np.sqrt(products[:-1] / (1 - products[-1])), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Net:
    """Places that share few pixels and few tie points: the squares of a net on C."""

    squares: NDArray[np.intp]
    """(n, 2) column and row in the net."""
    places_px: Array
    """(n, 2) amid the tie points of A to C in each square, px of A."""
    neighbours: tuple[int, int, int]
    """Tie points that a square typically holds of A to B, B to C and A to C."""

    @staticmethod
    def of(legs: tuple[Leg, Leg, Leg], window_px: float) -> _Net:
        """Lay the net: the side of a square is the window's, or more where tie points are few.

        Parameters
        ----------
        legs : three of Leg
            A to B, B to C, A to C.
        window_px : float
            px of C.
        """
        ab, bc, ac = (leg.points for leg in legs)
        per_a_px = _typical_reach_px(ac.predicted_px) / _typical_reach_px(ac.reference_px)
        reach_px = np.array(
            [
                _typical_reach_px(ab.reference_px) * per_a_px,
                _typical_reach_px(bc.predicted_px),
                _typical_reach_px(ac.predicted_px),
            ]
        )
        enough_px = np.sqrt(np.pi) * reach_px  # side of a square as large as the circle of the neighbours
        side = max(window_px, float(enough_px.max()))
        found = cell_means(ac.predicted_px, ac.reference_px, side)
        to_b, from_b, direct = np.round(LEAST_NEIGHBOURS * (side / enough_px) ** 2).astype(int).tolist()
        places = np.array([cell.mean_px for cell in found.values()])
        return _Net(
            np.array(list(found), np.intp).reshape(-1, 2), places.reshape(-1, 2), (to_b, from_b, direct)
        )


def _typical_reach_px(points_px: Array) -> float:
    return float(np.median(_reach_px(points_px, points_px, LEAST_NEIGHBOURS)))


def _reach_px(points_px: Array, at_px: Array, neighbours: int) -> Array:
    """Return (n,) distances from places to the farthest of their nearest points."""
    distance, _ = cKDTree(points_px).query(at_px, k=[min(neighbours, len(points_px))])
    return np.asarray(distance[:, 0], dtype=np.float64)


def _pair(values: Array) -> Pair:
    return float(values[0]), float(values[1])
