"""Tie points that the user brings: read, judged by one another, never matched."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.correction.gross_errors import agreement
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.tie_point_files import read_tie_points
from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.registration.judge import Verdict

SIGMA_PX: Final = 1.0
"""Taken for points without a sigma that are too few to tell."""
MOST_UNEXPLAINED: Final = 0.1
"""Scatter about an affine, as a share of the points' spread, beyond which they do not describe the pair."""
DENSE: Final = 100
"""From so many on, points are taken to come from overlapping matching windows; fewer were set one by one."""


def points_of_file(path: Path | str, pair: ViewPair) -> tuple[TiePointTable, Verdict, dict[str, int]]:
    """Return the tie points of a file, those that their neighbours contradict ``rejected``.

    Points without a sigma get the one that their agreement with their neighbours shows.

    Raises
    ------
    InputError
        If the file cannot be read, is of another pair, or its points mirror the target.
    """
    table = read_tie_points(path, pair)
    enabled = np.flatnonzero(table.status == "matched")
    counts = {"in_the_file": len(table), "switched_off": len(table) - len(enabled)}
    if len(enabled) == 0:
        raise InputError(f"{path}: all {len(table)} points are switched off: enable some")
    found = agreement(
        table.predicted_px[enabled], table.target_px[enabled], np.hypot(*table.sigma_px[enabled].T)
    )
    if np.linalg.det(found.linear) < 0:
        raise InputError(
            f"{path}: the points mirror the target: the columns x and y (col, row) of one side are exchanged"
        )
    status = table.status.copy()
    status[enabled[~found.kept]] = "rejected"
    kept = status == "matched"
    counts |= {"inconsistent": int((~found.kept).sum()), "tie_points": int(kept.sum())}
    reason = None
    if found.unexplained > MOST_UNEXPLAINED:
        reason = (
            f"the {len(enabled)} points of {path} describe no common displacement (they scatter "
            f"by {found.unexplained:.0%} of their spread): check their columns, and whose they are"
        )
    verdict = Verdict(reason is None, reason, 0, 0, 0.0)
    sigma_px = SIGMA_PX if np.isnan(found.sigma_px) else found.sigma_px
    known = np.asarray(np.isfinite(table.covariance_px2).all(axis=(1, 2), keepdims=True))
    covariance_px2 = np.where(known, table.covariance_px2, sigma_px**2 * np.eye(2))
    return replace(table, status=status, covariance_px2=covariance_px2), verdict, counts


def footprint_px(table: TiePointTable, window_px: float) -> float:
    """Return the side of the window that neighbouring points share, target px; 0 for a few set by hand."""
    return window_px if np.count_nonzero(table.status == "matched") >= DENSE else 0.0
