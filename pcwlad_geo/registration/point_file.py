"""Tie points of a file, with what the registration that they come from says of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcwlad_geo.correction.agreement import agreement
from pcwlad_geo.correction.points import hold_out
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import ViewPair, file_px_per_px
from pcwlad_geo.registration.motions import Motion
from pcwlad_geo.text import read_json, typed
from pcwlad_geo.tiepoints.pair_points import read_tie_points
from pcwlad_geo.tiepoints.table import TiePointTable, joined
from pcwlad_geo.types import Index

UNKNOWN_ORIGIN: Final = (
    "the tie points are of a file without the results of their matching beside it: their own errors, and "
    "whether they were chosen by their residuals, are not known, so all figures may be too good"
)
"""Why tie points without a history make no good registration."""


@dataclass(frozen=True, slots=True)
class PointFileParameters:
    """Numbers by which the points of a file are checked, and recognised."""

    most_unexplained: float = 0.1
    """Scatter about an affine, as a share of the points' spread, beyond which they do not describe the
    pair."""
    same_px: float = 0.002
    """A point of a file that lies within this distance of one of a table, in both rasters, is that one."""


@dataclass(frozen=True, slots=True)
class Origin:
    """What is known of the tie points of a file, beside their positions."""

    folder: str | None = None
    """Results of the matching that found them; null where nothing tells."""
    left_out: Annotated[int, ("minimum", 0)] = 0
    """Points which that matching had kept, and the file lacks or disables."""
    added: Annotated[int, ("minimum", 0)] = 0
    """Points that are not in its table, all where there is none."""
    window_px: int | None = None
    """Side of the window that it refined them with, matching-grid px; null where that is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class FilePoints:
    """The tie points of a file, with what the registration that they come from knew of them."""

    table: TiePointTable
    """Status ``matched`` or ``rejected``; also check points that the file lacks."""
    every: TiePointTable
    """All points which that registration had, with its statuses, and those added; the same without one."""
    roles: NDArray[np.str_] | None
    """(n,) of the table's rows ``fit``, ``check`` or ``unused``; None where check points are to be chosen."""
    refusal: str | None
    """Why none can be used; None if they can."""
    counts: dict[str, int]
    origin: Origin
    motions: tuple[Motion, ...] = ()
    jitter_px: float = 0.0
    bend_px: float = 0.0


def user_points(
    path: Path | str, pair: ViewPair, parameters: PointFileParameters = PointFileParameters()
) -> FilePoints:
    """Return the tie points of a file, those that their neighbours contradict ``rejected``.

    Points that the table of a registration in the same folder has too keep what they were there: their sigma,
    and whether they are check points. Others without a sigma get the one that their agreement with their
    neighbours shows. Raises `InputError` if the file cannot be read, is of another pair, or its points mirror
    the target.
    """
    table = read_tie_points(path, pair)
    enabled = np.flatnonzero(table.status == "matched")
    counts = {"in_the_file": len(table), "switched_off": len(table) - len(enabled)}
    if len(enabled) == 0:
        raise InputError(f"{path}: all {len(table)} points are switched off: enable some")
    earlier = _earlier(path, pair)
    row_of = None if earlier is None else _rows_of(table, earlier.table, parameters)
    if earlier is not None and row_of is not None:
        is_earlier = row_of >= 0
        covariance_px2, score = table.covariance_px2.copy(), table.score.copy()
        covariance_px2[is_earlier] = earlier.table.covariance_px2[row_of[is_earlier]]
        score[is_earlier] = earlier.table.score[row_of[is_earlier]]
        table = replace(table, covariance_px2=covariance_px2, score=score)
    table, reason = _contradicted(
        path, table, enabled, known_origin=row_of is not None, parameters=parameters
    )
    count = int(np.count_nonzero(table.status == "matched"))
    counts |= {"inconsistent": len(enabled) - count, "tie_points": count}
    if earlier is None or row_of is None:
        return FilePoints(table, table, None, reason, counts, Origin(added=len(table)))
    return _with_history(FilePoints(table, table, None, reason, counts, Origin()), earlier, row_of, pair)


def _contradicted(
    path: Path | str,
    table: TiePointTable,
    enabled: Index,
    *,
    known_origin: bool,
    parameters: PointFileParameters,
) -> tuple[TiePointTable, str | None]:
    """Reject points that their neighbours contradict, complete the sigmas, and tell why none can be used."""
    neighbours = agreement(
        table.predicted_px[enabled], table.target_px[enabled], np.hypot(*table.sigma_px[enabled].T)
    )
    if np.linalg.det(neighbours.linear) < 0:
        raise InputError(
            f"{path}: the points mirror the target: the columns x and y (col, row) of one side are exchanged"
        )
    status = table.status.copy()
    status[enabled[~neighbours.consistent]] = "rejected"
    reason = None
    if neighbours.unexplained > parameters.most_unexplained:
        reason = (
            f"the {len(enabled)} points of {path} describe no common displacement (they scatter "
            f"by {neighbours.unexplained:.0%} of their spread): check their columns, and whose they are"
        )
    measured = np.asarray(np.isfinite(table.covariance_px2).all(axis=(1, 2), keepdims=True))
    sigma_px = 1.0 if np.isnan(neighbours.sigma_px) else neighbours.sigma_px
    if known_origin and measured.any():  # a point set by hand is no better than one that was matched
        variances_px2 = np.diagonal(table.covariance_px2[measured.ravel()], axis1=1, axis2=2)
        sigma_px = max(sigma_px, float(np.sqrt(variances_px2.mean())))
    covariance_px2 = np.where(measured, table.covariance_px2, sigma_px**2 * np.eye(2))
    return replace(table, status=status, covariance_px2=covariance_px2), reason


@dataclass(frozen=True, slots=True)
class _ReadOrigin:
    """Where a report says that its tie points come from."""

    tie_points: str | None = None


@dataclass(frozen=True, slots=True)
class _ReadMatching:
    """What is read back of the report of a matching."""

    settings: _ReadOrigin
    tie_points: Mapping[str, int]
    window_px: int | None
    motions: tuple[Motion, ...]
    jitter_px: float
    bend_px: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Earlier:
    """The registration that a file of tie points comes from."""

    folder: Path
    table: TiePointTable
    """With its own statuses."""
    report: _ReadMatching


def _earlier(path: Path | str, pair: ViewPair) -> _Earlier | None:
    """Return the matching whose results lie in the folder of a file; None where there is none of this pair.

    Points that were given to a registration, too, are followed back to the one that has matched them.
    """
    folder = Path(path).absolute().parent
    for _ in range(16):
        try:
            report = typed(read_json(folder / "report.json"), _ReadMatching)
            if report.settings.tie_points is None:
                table = _table_of(folder, report.tie_points, pair)
                return None if table is None else _Earlier(folder, table, report)
            folder = Path(report.settings.tie_points).absolute().parent
        except (OSError, InputError, ValueError):
            return None
    return None


def _table_of(folder: Path, counts: Mapping[str, int], pair: ViewPair) -> TiePointTable | None:
    """Return the tie points of a folder as its report counts them; None where they were changed."""
    for name in ("tiepoints.csv", "tiepoints.gpkg"):
        if not (folder / name).is_file():
            continue
        table = read_tie_points(folder / name, pair, as_stated=True)
        statuses = {status: np.count_nonzero(table.status == status) for status in counts}
        if {**statuses, "total": len(table)} == counts:
            return table
    return None


def _rows_of(table: TiePointTable, earlier: TiePointTable, parameters: PointFileParameters) -> Index | None:
    """Return the (n,) row of each point in the earlier table, -1 where it is in none; None if most are."""
    tree = cKDTree(np.hstack([earlier.reference_px, earlier.target_px]))
    distance, row = tree.query(np.hstack([table.reference_px, table.target_px]))
    same = distance <= parameters.same_px
    return np.where(same, row, -1) if 2 * np.count_nonzero(same) >= len(table) else None


def _with_history(points: FilePoints, earlier: _Earlier, row_of: Index, pair: ViewPair) -> FilePoints:
    """Return points with the roles that they had, and all others that were known of."""
    before, table = earlier.table, points.table
    window_px = float(earlier.report.window_px or 0) * float(file_px_per_px(pair.target)[0])
    roles = before.status.astype("<U8")
    matched = np.flatnonzero(roles == "matched")  # by the command match: divided as its fit would have been
    roles[matched] = hold_out(before.predicted_px[matched], window_px)
    earlier_rows = np.flatnonzero(row_of >= 0)
    on = np.zeros(len(before), bool)
    on[row_of[earlier_rows]] = table.status[earlier_rows] == "matched"
    missing = np.flatnonzero(roles == "check")
    missing = missing[~np.isin(missing, row_of)]
    role_of = np.full(len(table), "fit", dtype="<U8")
    role_of[earlier_rows] = roles[row_of[earlier_rows]]
    role_of[role_of == "rejected"] = "fit"  # who knows better has switched it on
    statuses = np.where(before.status == "rejected", "rejected", "matched").astype("<U8")
    before = replace(before, status=statuses)
    return replace(
        points,
        table=joined(table, before[missing]),
        every=joined(before, table[row_of < 0]),
        roles=np.concatenate([role_of, roles[missing]]) if (roles == "check").any() else None,
        origin=Origin(
            str(earlier.folder),
            int(np.count_nonzero((statuses == "matched") & ~on)),
            int(np.count_nonzero(row_of < 0)),
            earlier.report.window_px,
        ),
        motions=earlier.report.motions,
        jitter_px=earlier.report.jitter_px,
        bend_px=earlier.report.bend_px,
    )
