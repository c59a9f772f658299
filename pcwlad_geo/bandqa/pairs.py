"""The pairs of bands, and the triangles that they close."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final, Literal

import numpy as np
from scipy.ndimage import correlate1d
from scipy.spatial import cKDTree

from pcwlad_geo.bandqa.bands import Band
from pcwlad_geo.correction.error_statistics import ErrorStatistics, in_units
from pcwlad_geo.matching.field import Surface, predict
from pcwlad_geo.products import native_per_px
from pcwlad_geo.raster.geodesy import pixel_sizes_m
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.tiepoints.table import TiePointTable, predict_px
from pcwlad_geo.types import Float64, Index

MIN_POINTS: Final = 3
"""Least number of points of a cell for its mean."""


@dataclass(frozen=True, slots=True)
class CellMean:
    """The mean of the points of a cell."""

    n: int
    mean_px: tuple[float, float]
    """Mean of the values (col, row), px."""


def cell_means(at_px: Float64, values_px: Float64, side_px: float) -> dict[tuple[int, int], CellMean]:
    """Return the mean of the values in each cell with enough points, by the cell's column and row.

    The positions `at_px` are an (n, 2) array (col, row), px; the `values_px` an (n, 2) array of the same
    kind; `side_px` is the side of a cell.
    """
    if len(at_px) == 0:
        return {}
    cells, of, count = np.unique(
        np.floor(at_px / side_px).astype(np.intp), axis=0, return_inverse=True, return_counts=True
    )
    of = of.ravel()
    col_mean, row_mean = (np.bincount(of, weights=values_px[:, axis]) / count for axis in (0, 1))
    return {
        (int(col), int(row)): CellMean(int(count[index]), (float(col_mean[index]), float(row_mean[index])))
        for index, (col, row) in enumerate(cells)
        if count[index] >= MIN_POINTS
    }


SQUARES: Final = 8
"""Number of squares along the longer side of the target."""


@dataclass(frozen=True, slots=True)
class LocalMean:
    """Mean displacement of the tie points in a square."""

    at_px: tuple[float, float]
    """Middle of the square (col, row), px of the target."""
    n: int
    mean_px: tuple[float, float]
    """Mean displacement (col, row), px of the target."""


def local_means(points: TiePointTable, shape: tuple[int, int]) -> list[LocalMean]:
    """Return the mean displacement in each square with enough tie points.

    Parameters
    ----------
    shape : (rows, cols)
        Size of the target, px.
    """
    side = max(shape) / SQUARES
    return [
        LocalMean(((col + 0.5) * side, (row + 0.5) * side), cell.n, cell.mean_px)
        for (col, row), cell in cell_means(points.predicted_px, points.displacement_px, side).items()
    ]


FEW_POINTS = 30
"""Least number of points for an accuracy figure (ASPRS Positional Accuracy Standards, 2023)."""

Status = Literal["measured", "refused"]


@dataclass(frozen=True, slots=True, eq=False)
class PairResult:
    """The result of a pair of bands."""

    reference: Band
    target: Band
    """Target with the georeferencing used for matching: a band without a geotransform may have an RPC."""
    status: Status
    reason: str | None = None
    """Reason why the pair was refused."""
    warnings: tuple[str, ...] = ()
    points: TiePointTable | None = None
    """Tie points that agree with their neighbours; None for a refused pair."""
    rejected: int = 0
    """Number of tie points that do not."""
    window_px: int = 0
    """Side of the window that the tie points were refined with; 0 for a refused pair."""
    statistics: Mapping[str, ErrorStatistics | None] = field(default_factory=dict)
    """Statistics of displacements by unit: `px` (of the target), `native px`, `m`; None: unit not known."""

    @property
    def name(self) -> str:
        """Names of reference and target, as text."""
        return f"{self.reference.name} – {self.target.name}"

    @property
    def native_m(self) -> tuple[float, float] | None:
        """The coarser of the two native pixel sizes (col, row), metres."""
        return native_m(self.reference, self.target)


def plan_pairs(bands: Sequence[Band], against: Band | None) -> list[tuple[Band, Band]]:
    """Return the pairs (reference, target) of `bands`: all of them, or each band with `against`."""
    if against is None:
        return list(combinations(bands, 2))
    return [(against, band) for band in bands if band.name != against.name]


def measured(reference: Band, target: Band, found: Registration) -> PairResult:
    """Return the result of a pair that was matched.

    Parameters
    ----------
    found : Registration
        Registration with status ``matched`` or ``rejected``.
    """
    reference, target = replace(reference, info=found.reference), replace(target, info=found.target)
    table = found.tie_points
    kept = table.select("matched")
    rejected = len(table) - len(kept)
    if found.status == "rejected" or len(kept) == 0:
        reason = found.reason or "no tie points"
        return PairResult(reference, target, "refused", reason, found.warnings, rejected=rejected)
    warnings = list(found.warnings)
    if len(kept) < FEW_POINTS:
        warnings.append(
            f"only {len(kept)} tie points: fewer than {FEW_POINTS} are too few for an accuracy figure"
        )
    return PairResult(
        reference,
        target,
        "measured",
        warnings=tuple(warnings),
        points=kept,
        rejected=rejected,
        window_px=found.window_px or 0,
        statistics=statistics_by_unit(kept, reference, target),
    )


def statistics_by_unit(
    points: TiePointTable, reference: Band, target: Band
) -> dict[str, ErrorStatistics | None]:
    """Return the statistics of the displacements of `points` in target px, native px and metres.

    The bands `reference` and `target` define the pixel sizes; an unknown unit is None.
    """
    one, native = np.ones(2), native_m(reference, target)
    sizes_m = pixel_sizes_m(target.info.grid, points.predicted_px)
    factors = {"px": one, "native px": one, "m": sizes_m}
    if target.px_m is not None and native is not None:
        factors["native px"] = native_per_px(target.px_m, native)
    return in_units(points.displacement_px, points.sigma_px, factors)


def native_m(reference: Band, target: Band) -> tuple[float, float] | None:
    """Return the coarser native pixel size (col, row), m, of `reference` and `target`; None if unknown."""
    known = [band.native_m for band in (reference, target) if band.native_m is not None]
    return max(known, key=lambda size: size[0] * size[1], default=None)


Pair = tuple[float, float]

MIN_NEIGHBOURS: Final = 12
"""Least number of tie points for a local displacement: twice the least for the fit of a plane."""
MAX_LEVERAGE: Final = 0.5
"""Largest variance of the fitted plane relative to that of one tie point; high outside of the points."""
MAX_REACH: Final = 2.5
"""Largest distance of neighbours relative to the typical one; in a corner it is about twice as large."""


@dataclass(frozen=True, slots=True)
class Triangle:
    """The closure error of a triangle of bands, px (col, row) of the third, the coarsest."""

    bands: tuple[str, str, str]
    cells: int
    """Number of cells in which all three pairs have tie points."""
    mean_px: Pair | None
    """Mean of BC(AB(x)) − AC(x) over the cells; None if the three share no ground."""
    error_px: Pair | None
    """Standard error of that mean, from the scatter between cells; None for a single cell."""
    rms_px: Pair | None
    """Root mean square over the cells."""
    px_m: Pair | None
    """Size of the pixel of the third band (col, row), metres."""

    @property
    def name(self) -> str:
        """Names of the three bands, as text."""
        return " – ".join(self.bands)

    @property
    def mean_m(self) -> Pair | None:
        """The mean in metres, along columns and rows."""
        if self.mean_px is None or self.px_m is None:
            return None
        return self.mean_px[0] * self.px_m[0], self.mean_px[1] * self.px_m[1]


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """A measured pair as a mapping from the pixels of its reference to those of its target."""

    reference: RasterInfo
    target: RasterInfo
    points: TiePointTable

    @staticmethod
    def of(pair: PairResult) -> Leg:
        """Return the mapping of a measured pair."""
        if pair.points is None:
            raise ValueError(f"{pair.name} was refused")
        finite = np.asarray(np.isfinite(pair.points.displacement_px).all(axis=1))
        return Leg(pair.reference.info, pair.target.info, pair.points[finite])

    def arrival(self, reference_px: Float64, neighbours: int) -> Float64:
        """Map (n, 2) `reference_px` to (n, 2) target px by the georeferencing and the local displacement.

        The displacement is the value of a robust plane through the nearest `neighbours` tie points: their
        mean would belong to another position, because they are not distributed evenly around this one. It is
        NaN where there are none nearby.
        """
        predicted = predict_px(reference_px, self.reference, self.target)
        arrived = np.full(predicted.shape, np.nan)
        known = np.isfinite(predicted).all(axis=1)
        if not known.any():
            return arrived
        at, moved = self.points.predicted_px, self.points.displacement_px
        plane = predict(at, moved, predicted[known], Surface(neighbours, 1))
        reach = _reach_px(at, predicted[known], neighbours)
        within = reach <= MAX_REACH * np.median(_reach_px(at, at, neighbours))
        within &= plane.leverage <= MAX_LEVERAGE
        arrived[known] = np.where(within[:, None], predicted[known] + plane.displacement_px, np.nan)
        return arrived


def close_triangles(bands: Sequence[Band], pairs: Sequence[PairResult], window_px: float) -> list[Triangle]:
    """Return the closure of every triangle whose three pairs were measured.

    The `bands` are in the order of the pairs, the coarsest last. Tie points within a matching window,
    `window_px` of the coarsest band wide, are not independent.
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
    """Return the closure of one triangle on the ground that its three pairs share.

    The `legs` are the pairs A to B, B to C and A to C of the bands `names`. A cell is at least `window_px`
    wide, px of C; `px_m` is the pixel size of C (col, row), metres, if known.
    """
    if not all(len(leg.points) for leg in legs):
        return Triangle(names, 0, None, None, None, px_m)
    (ab, bc, ac), net = legs, _Net.of(legs, window_px)
    to_b, from_b, direct = net.neighbours
    closure_errors = bc.arrival(ab.arrival(net.places_px, to_b), from_b) - ac.arrival(net.places_px, direct)
    known = np.isfinite(closure_errors).all(axis=1)
    squares, closure_errors = net.squares[known], closure_errors[known]
    if not len(closure_errors):
        return Triangle(names, 0, None, None, None, px_m)
    return Triangle(
        names,
        len(closure_errors),
        _pair(closure_errors.mean(axis=0)),
        _pair(standard_error(closure_errors, squares)) if len(closure_errors) > 1 else None,
        _pair(np.sqrt((closure_errors**2).mean(axis=0))),
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
    """The cells of a regular net on C, which share few pixels and few tie points."""

    squares: Index
    """(n, 2) column and row of each cell in the net."""
    places_px: Float64
    """(n, 2) mean position (col, row) of the tie points of A to C in each cell, px of A."""
    neighbours: tuple[int, int, int]
    """Typical number of tie points in a cell of A to B, B to C and A to C."""

    @staticmethod
    def of(legs: tuple[Leg, Leg, Leg], window_px: float) -> _Net:
        """Define the net: the side of a cell is that of the window, or larger where tie points are sparse.

        The `legs` are the pairs A to B, B to C and A to C; the window is `window_px` wide, px of C.
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
        enough_px = np.sqrt(np.pi) * reach_px  # side of a square with the area of the neighbours' circle
        side = max(window_px, float(enough_px.max()))
        found = cell_means(ac.predicted_px, ac.reference_px, side)
        to_b, from_b, direct = np.round(MIN_NEIGHBOURS * (side / enough_px) ** 2).astype(int).tolist()
        places = np.array([cell.mean_px for cell in found.values()])
        return _Net(
            np.array(list(found), np.intp).reshape(-1, 2), places.reshape(-1, 2), (to_b, from_b, direct)
        )


def _typical_reach_px(points_px: Float64) -> float:
    return float(np.median(_reach_px(points_px, points_px, MIN_NEIGHBOURS)))


def _reach_px(points_px: Float64, at_px: Float64, neighbours: int) -> Float64:
    """Return (n,) distances, px, from (n, 2) positions to the farthest of their nearest points."""
    distance, _ = cKDTree(points_px).query(at_px, k=[min(neighbours, len(points_px))])
    return np.asarray(distance[:, 0], dtype=np.float64)


def _pair(values: Float64) -> Pair:
    return float(values[0]), float(values[1])
