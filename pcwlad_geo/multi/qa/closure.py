"""The closure of triangles of three pairs of bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from scipy.ndimage import correlate1d
from scipy.spatial import cKDTree

from pcwlad_geo.correction.error_statistics import FloatPair, float_pair
from pcwlad_geo.matching.field import Surface, predict
from pcwlad_geo.multi.qa.band_pairs import PairResult, cell_means
from pcwlad_geo.multi.qa.bands import Band
from pcwlad_geo.raster import RasterInfo
from pcwlad_geo.tiepoints.table import TiePointTable, predict_px
from pcwlad_geo.types import Float64, Index


@dataclass(frozen=True, slots=True)
class ClosureParameters:
    """The tuned numbers of the closure of triangles."""

    min_neighbours: int = 12
    """Least number of tie points for a local displacement: twice the least for the fit of a plane."""
    max_leverage: float = 0.5
    """Largest variance of the fitted plane relative to that of one tie point; high outside of the points."""
    max_reach: float = 2.5
    """Largest distance of neighbours relative to the typical one; in a corner it is about twice as large."""
    closes_px: float = 0.05
    """Closure error up to which a triangle closes whatever its standard error, px of the coarsest band."""
    closes_errors: float = 3.0
    """A triangle closes within so many standard errors, too."""


CLOSURE: Final = ClosureParameters()
"""The numbers in use."""


def larger_axis_px(mean_px: Sequence[float] | None) -> float:
    """Return the size of a closure error, px, of the larger axis; 0 if it is not known."""
    return float(max(map(abs, mean_px or (0.0, 0.0))))


def closes(
    mean_px: Sequence[float] | None,
    error_px: Sequence[float] | None,
    parameters: ClosureParameters = CLOSURE,
) -> bool:
    """Return whether a mean closure error is small, by itself or in standard errors."""
    if mean_px is None:
        return False
    pairs = zip(mean_px, error_px or (0.0, 0.0), strict=True)
    limit_px, errors = parameters.closes_px, parameters.closes_errors
    return all(abs(mean) <= max(limit_px, errors * error) for mean, error in pairs)


@dataclass(frozen=True, slots=True)
class Triangle:
    """The closure error of a triangle of bands, px (col, row) of the third, the coarsest."""

    bands: tuple[str, str, str]
    cells: int
    """Number of cells in which all three pairs have tie points."""
    mean_px: FloatPair | None
    """Mean of BC(AB(x)) − AC(x) over the cells; None if the three share no ground."""
    error_px: FloatPair | None
    """Standard error of that mean, from the scatter between cells; None for a single cell."""
    rms_px: FloatPair | None
    """Root mean square over the cells."""
    px_m: FloatPair | None
    """Size of the pixel of the third band (col, row), metres."""

    @property
    def name(self) -> str:
        """Names of the three bands, as text."""
        return " – ".join(self.bands)

    @property
    def error_size_px(self) -> float:
        """The closure error of the larger axis; 0 if it is not known."""
        return larger_axis_px(self.mean_px)

    @property
    def closes(self) -> bool:
        """Whether its closure error is small, by itself or in standard errors."""
        return closes(self.mean_px, self.error_px)

    @property
    def mean_m(self) -> FloatPair | None:
        """The mean in metres, along columns and rows."""
        if self.mean_px is None or self.px_m is None:
            return None
        return self.mean_px[0] * self.px_m[0], self.mean_px[1] * self.px_m[1]


@dataclass(frozen=True, slots=True, eq=False)
class TriangleSide:
    """A measured pair as a mapping from the pixels of its reference to those of its target."""

    reference: RasterInfo
    target: RasterInfo
    points: TiePointTable

    @staticmethod
    def of(pair: PairResult) -> TriangleSide:
        """Return the mapping of a measured pair."""
        if pair.points is None:
            raise ValueError(f"{pair.name} was refused")
        finite = np.asarray(np.isfinite(pair.points.displacement_px).all(axis=1))
        return TriangleSide(pair.reference.info, pair.target.info, pair.points[finite])

    def arrival(
        self, reference_px: Float64, neighbours: int, parameters: ClosureParameters = CLOSURE
    ) -> Float64:
        """Map (n, 2) `reference_px` to (n, 2) target px by the georeferencing and the local displacement.

        The displacement is the value of a robust plane through the nearest `neighbours` tie points: their
        mean would belong to another position, because they are not distributed evenly around this one. It is
        NaN where there are none nearby.
        """
        predicted = predict_px(reference_px, self.reference, self.target)
        arrived = np.full(predicted.shape, np.nan)
        valid = np.isfinite(predicted).all(axis=1)
        if not valid.any():
            return arrived
        at, displacement = self.points.predicted_px, self.points.displacement_px
        plane = predict(at, displacement, predicted[valid], Surface(neighbours, 1))
        reach = _reach_px(at, predicted[valid], neighbours)
        within = reach <= parameters.max_reach * np.median(_reach_px(at, at, neighbours))
        within &= plane.leverage <= parameters.max_leverage
        arrived[valid] = np.where(within[:, None], predicted[valid] + plane.displacement_px, np.nan)
        return arrived


def close_triangles(
    bands: Sequence[Band],
    pairs: Sequence[PairResult],
    window_px: float,
    parameters: ClosureParameters = CLOSURE,
) -> list[Triangle]:
    """Return the closure of every triangle whose three pairs were measured.

    The `bands` are in the order of the pairs, the coarsest last. Tie points within a matching window,
    `window_px` of the coarsest band wide, are not independent.
    """
    measured = {
        (pair.reference.name, pair.target.name): TriangleSide.of(pair)
        for pair in pairs
        if pair.status == "measured"
    }
    triangles = []
    for a, b, c in combinations(bands, 3):
        sides = [(a.name, b.name), (b.name, c.name), (a.name, c.name)]
        if all(side in measured for side in sides):
            ab, bc, ac = (measured[side] for side in sides)
            names = a.name, b.name, c.name
            triangles.append(close_triangle(names, (ab, bc, ac), window_px, c.px_m, parameters))
    return triangles


def close_triangle(
    names: tuple[str, str, str],
    sides: tuple[TriangleSide, TriangleSide, TriangleSide],
    window_px: float,
    px_m: FloatPair | None = None,
    parameters: ClosureParameters = CLOSURE,
) -> Triangle:
    """Return the closure of one triangle on the ground that its three pairs share.

    The `sides` are the pairs A to B, B to C and A to C of the bands `names`. A cell is at least `window_px`
    wide, px of C; `px_m` is the pixel size of C (col, row), metres, if known.
    """
    if not all(len(side.points) for side in sides):
        return Triangle(names, 0, None, None, None, px_m)
    (ab, bc, ac), net = sides, _Net.of(sides, window_px, parameters.min_neighbours)
    to_b, from_b, direct = net.neighbours
    at_b_px = ab.arrival(net.places_px, to_b, parameters)
    at_c_px = bc.arrival(at_b_px, from_b, parameters)
    closure_errors = at_c_px - ac.arrival(net.places_px, direct, parameters)
    valid = np.isfinite(closure_errors).all(axis=1)
    squares, closure_errors = net.squares[valid], closure_errors[valid]
    if not len(closure_errors):
        return Triangle(names, 0, None, None, None, px_m)
    return Triangle(
        names,
        len(closure_errors),
        float_pair(closure_errors.mean(axis=0)),
        float_pair(standard_error(closure_errors, squares)) if len(closure_errors) > 1 else None,
        float_pair(np.sqrt((closure_errors**2).mean(axis=0))),
        px_m,
    )


def standard_error(values: Float64, squares: Index) -> Float64:
    """Return the (k,) standard errors of the means of k correlated quantities in n cells of a regular net.

    The errors of neighbouring cells are correlated, as they share pixels and tie points. Their covariance is
    included with Bartlett weights (Conley 1999, doi:10.1016/S0304-4076(98)00084-0). The estimate is unbiased
    for uncorrelated errors. The (n, k) `values` are in any unit; the (n, 2) `squares` are column and row of
    each cell.
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
    """The cells of a regular grid on C, so large that they share few pixels and few tie points."""

    squares: Index
    """(n, 2) column and row of each cell in the grid."""
    places_px: Float64
    """(n, 2) mean position (col, row) of the tie points of A to C in each cell, px of A."""
    neighbours: tuple[int, int, int]
    """Typical number of tie points in a cell of A to B, B to C and A to C."""

    @staticmethod
    def of(
        sides: tuple[TriangleSide, TriangleSide, TriangleSide], window_px: float, min_neighbours: int
    ) -> _Net:
        """Define the grid: the side of a cell is that of the window, or larger where tie points are sparse.

        The `sides` are the pairs A to B, B to C and A to C; the window is `window_px` wide, px of C.
        """
        ab, bc, ac = (side.points for side in sides)
        of_ab_px, of_bc_px, of_ac_px, of_ac_in_a_px = (
            float(np.median(_reach_px(points_px, points_px, min_neighbours)))
            for points_px in (ab.reference_px, bc.predicted_px, ac.predicted_px, ac.reference_px)
        )
        reach_px = np.array([of_ab_px * (of_ac_px / of_ac_in_a_px), of_bc_px, of_ac_px])
        enough_px = np.sqrt(np.pi) * reach_px  # side of a square with the area of the neighbours' circle
        side = max(window_px, float(enough_px.max()))
        means = cell_means(ac.predicted_px, ac.reference_px, side)
        to_b, from_b, direct = np.round(min_neighbours * (side / enough_px) ** 2).astype(int).tolist()
        squares = np.array(list(means), np.intp).reshape(-1, 2)
        places_px = np.array([cell.mean_px for cell in means.values()]).reshape(-1, 2)
        return _Net(squares, places_px, (to_b, from_b, direct))


def _reach_px(points_px: Float64, at_px: Float64, neighbours: int) -> Float64:
    """Return (n,) distances, px, from (n, 2) positions to the farthest of their nearest points."""
    distance, _ = cKDTree(points_px).query(at_px, k=[min(neighbours, len(points_px))])
    return np.asarray(distance[:, 0], dtype=np.float64)
