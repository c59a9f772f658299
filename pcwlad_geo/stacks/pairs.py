"""The pairs of a stack: which are compared, and what their tie points say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Literal

import numpy as np

from pcwlad_geo.correction.error_statistics import ErrorStatistics, in_units
from pcwlad_geo.raster.geodesy import pixel_sizes_m
from pcwlad_geo.raster.native_pixels import native_per_px
from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.stacks.bands import Band

FEW_POINTS = 30
"""Fewer points than this are too few for an accuracy figure (ASPRS 2023)."""

Status = Literal["measured", "refused"]


@dataclass(frozen=True, slots=True, eq=False)
class PairResult:
    """What a pair of bands has come to."""

    reference: Band
    target: Band
    """Placed as the matching had it: a band without a geotransform may have an RPC."""
    status: Status
    reason: str | None = None
    """Why it was refused."""
    warnings: tuple[str, ...] = ()
    points: TiePointTable | None = None
    """The tie points that agree with their neighbours; None where refused."""
    rejected: int = 0
    """Tie points that do not."""
    statistics: Mapping[str, ErrorStatistics | None] = field(default_factory=dict)
    """Of the displacements, by unit: `px` (of the target), `native px`, `m`; None: that unit is not known."""

    @property
    def name(self) -> str:
        """Reference and target."""
        return f"{self.reference.name} – {self.target.name}"

    @property
    def native_m(self) -> tuple[float, float] | None:
        """The coarser of the two native pixel sizes (col, row), metres."""
        return native_m(self.reference, self.target)


def plan_pairs(bands: Sequence[Band], against: Band | None) -> list[tuple[Band, Band]]:
    """Return the pairs (reference, target): all of them, or each band against one."""
    if against is None:
        return list(combinations(bands, 2))
    return [(against, band) for band in bands if band.name != against.name]


def measured(reference: Band, target: Band, found: Registration) -> PairResult:
    """Return the figures of a pair that was matched.

    Parameters
    ----------
    reference, target : Band
    found : Registration
        Status ``matched`` or ``rejected``.
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
        statistics=statistics_by_unit(kept, reference, target),
    )


def statistics_by_unit(
    points: TiePointTable, reference: Band, target: Band
) -> dict[str, ErrorStatistics | None]:
    """Return the statistics of the displacements in target px, native px and metres on the ground."""
    one, native = np.ones(2), native_m(reference, target)
    sizes_m = pixel_sizes_m(target.info.grid, points.predicted_px)
    factors = {"px": one, "native px": one, "m": sizes_m}
    if target.px_m is not None and native is not None:
        factors["native px"] = native_per_px(target.px_m, native)
    return in_units(points.displacement_px, points.sigma_px, factors)


def native_m(reference: Band, target: Band) -> tuple[float, float] | None:
    """Return the coarser of two native pixel sizes, metres; None where none is known."""
    known = [band.native_m for band in (reference, target) if band.native_m is not None]
    return max(known, key=lambda size: size[0] * size[1], default=None)
