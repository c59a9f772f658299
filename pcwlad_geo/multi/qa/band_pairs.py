"""The measured displacements of a pair of bands, as a whole and locally."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from pcwlad_geo.correction.error_statistics import ErrorStatistics, in_units
from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.multi.qa.bands import Band
from pcwlad_geo.products.finding import native_per_px
from pcwlad_geo.raster import pixel_sizes_m
from pcwlad_geo.registration import Registration
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64

SQUARES: Final = 8
"""Number of squares along the longer side of the target."""
FEW_POINTS = 30
"""Least number of points for an accuracy figure (ASPRS Positional Accuracy Standards, 2023)."""
BandPairStatus = Literal["measured", "refused"]


@dataclass(frozen=True, slots=True)
class CellMean:
    """The mean of the points of a cell."""

    n: int
    mean_px: tuple[float, float]
    """Mean of the values (col, row), px."""


def cell_means(at_px: Float64, values_px: Float64, side_px: float) -> dict[tuple[int, int], CellMean]:
    """Return the mean of the values in each cell with three points or more, by the cell's column and row.

    The positions `at_px` and the `values_px` are (n, 2) arrays (col, row), px; `side_px` is the side of a
    cell.
    """
    if len(at_px) == 0:
        return {}
    cells, cell_of_point, count = np.unique(
        np.floor(at_px / side_px).astype(np.intp), axis=0, return_inverse=True, return_counts=True
    )
    cell_of_point = cell_of_point.ravel()
    col_mean, row_mean = (np.bincount(cell_of_point, weights=values_px[:, axis]) / count for axis in (0, 1))
    return {
        (int(col), int(row)): CellMean(int(count[index]), (float(col_mean[index]), float(row_mean[index])))
        for index, (col, row) in enumerate(cells)
        if count[index] >= 3
    }


@dataclass(frozen=True, slots=True)
class LocalMean:
    """Mean displacement of the tie points in a square."""

    at_px: tuple[float, float]
    """Middle of the square (col, row), px of the target."""
    n: int
    mean_px: tuple[float, float]
    """Mean displacement (col, row), px of the target."""


def local_means(points: TiePointTable, shape: tuple[int, int]) -> list[LocalMean]:
    """Return the mean displacement in each square of the target with three tie points or more.

    The `shape` (rows, cols) is that of the target, px.
    """
    side = max(shape) / SQUARES
    return [
        LocalMean(((col + 0.5) * side, (row + 0.5) * side), cell.n, cell.mean_px)
        for (col, row), cell in cell_means(points.predicted_px, points.displacement_px, side).items()
    ]


@dataclass(frozen=True, slots=True, eq=False)
class PairResult:
    """The result of a pair of bands."""

    reference: Band
    target: Band
    """Target with the georeferencing used for matching: a band without a geotransform may have an RPC."""
    status: BandPairStatus
    reason: str | None = None
    """Reason why the pair was refused."""
    warnings: tuple[str, ...] = ()
    points: TiePointTable | None = None
    """Tie points that agree with their neighbours; None for a refused pair."""
    rejected: int = 0
    """Number of tie points that disagree with their neighbours."""
    window_px: int = 0
    """Side of the window that the tie points were refined with; 0 for a refused pair."""
    statistics: Mapping[str, ErrorStatistics | None] = field(default_factory=dict)
    """Statistics of displacements by unit: `px` (of the target), `native px`, `m`; None: unit not known."""
    proof: Proof | None = None
    """The tool's own error on the pair, where that was asked for."""

    @property
    def name(self) -> str:
        """Names of reference and target, as text."""
        return f"{self.reference.name} – {self.target.name}"

    @property
    def native_m(self) -> tuple[float, float] | None:
        """The coarser of the two native pixel sizes (col, row), metres."""
        return native_m(self.reference, self.target)


def pair_result(reference: Band, target: Band, registration: Registration) -> PairResult:
    """Return the result of a pair by its registration, which has the status ``matched`` or ``rejected``."""
    reference, target = (
        replace(reference, info=registration.reference),
        replace(target, info=registration.target),
    )
    points = registration.tie_points.select("matched")
    rejected = len(registration.tie_points) - len(points)
    if registration.status == "rejected" or len(points) == 0:
        reason = registration.reason or "no tie points"
        return PairResult(reference, target, "refused", reason, registration.warnings, rejected=rejected)
    warnings = list(registration.warnings)
    if len(points) < FEW_POINTS:
        warnings.append(
            f"only {len(points)} tie points: fewer than {FEW_POINTS} are too few for an accuracy figure"
        )
    return PairResult(
        reference,
        target,
        "measured",
        warnings=tuple(warnings),
        points=points,
        rejected=rejected,
        window_px=registration.window_px or 0,
        statistics=statistics_by_unit(points, reference, target),
        proof=registration.proof,
    )


def statistics_by_unit(
    points: TiePointTable, reference: Band, target: Band
) -> dict[str, ErrorStatistics | None]:
    """Return the statistics of the displacements of `points` in target px, native px and metres.

    The bands `reference` and `target` define the pixel sizes; an unknown unit is None.
    """
    native, sizes_m = native_m(reference, target), pixel_sizes_m(target.info.grid, points.predicted_px)
    factors = {"px": np.ones(2), "native px": np.ones(2), "m": sizes_m}
    if target.px_m is not None and native is not None:
        factors["native px"] = native_per_px(target.px_m, native)
    return in_units(points.displacement_px, points.sigma_px, factors)


def native_m(reference: Band, target: Band) -> tuple[float, float] | None:
    """Return the coarser native pixel size (col, row), m, of `reference` and `target`; None if unknown."""
    sizes = [band.native_m for band in (reference, target) if band.native_m is not None]
    return max(sizes, key=lambda size: size[0] * size[1], default=None)
