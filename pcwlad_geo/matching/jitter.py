"""Jitter of a sensor: rows or columns that move within a window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.estimation.robust import huber
from pcwlad_geo.matching.guidance import FieldGuide
from pcwlad_geo.matching.prepare import ChannelPair
from pcwlad_geo.matching.refinement import InitialEstimate, refine
from pcwlad_geo.matching.types import TiePoints, to_index
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class JitterParameters:
    """Windows that show jitter, and the evidence of it."""

    length_px: int = 61
    """Length of windows of few rows or of few columns."""
    width_px: int = 5
    """Their width."""
    same_rows_px: float = 4.0
    """Windows whose rows are less apart lie on the same rows."""
    disjoint_px: float = 90.0
    """Windows that are farther apart along the rows share no pixel."""
    limit_medians: float = 4.0
    """Longer residuals, in the median of all, are cut to that."""
    least_pairs: int = 50
    """Least number of pairs of windows of the same rows."""
    band_px: float = 16.0
    """Width of bands of rows that are independent of each other."""
    clear_errors: float = 3.0
    """Standard errors from which what they share is jitter."""


JITTER: Final = JitterParameters()
"""Those in use."""


def displacement_by_stripes(
    pair: ChannelPair, points: TiePoints, guide: FieldGuide, beside_px: Sequence[int]
) -> Float64:
    """Return (2k, n, 2) displacements (col, row) by windows of few rows, then of few columns, NaN if lost.

    The n `points` and their `guide` are in pixel coordinates of the arrays of `pair`. There are k windows of
    either kind, beside the points by `beside_px`, across their length. The displacements are at the points
    themselves, as the deformation of their window tells.
    """
    begin = np.where(guide.leads[:, None], guide.structure_xy_px, points.displacement_px)
    corners, displacements = to_index(points), []
    rows, cols = (JITTER.width_px, JITTER.length_px), (JITTER.length_px, JITTER.width_px)
    for window_px, across_xy in ((rows, (0, 1)), (cols, (1, 0))):
        for offset_px in beside_px:
            offset_xy = offset_px * np.array(across_xy)
            bent_px = guide.linear @ offset_xy
            refined = refine(
                pair.reference,
                pair.target,
                corners + offset_xy[::-1],
                InitialEstimate(begin + bent_px, guide.linear),
                window_px=window_px,
                use_structure=False,
                threads=pair.threads,
            )
            shift_xy = np.where(refined.converged[:, None], refined.shift_xy_px, np.nan)
            displacements.append(shift_xy - bent_px)
    return np.stack(displacements)


def jitter_px(xy_px: Float64, difference_px: Float64, beside_px: Sequence[int] = (0,)) -> float:
    """Return by how much rows and columns move within a window, RMS, px; 0 where that may be chance.

    The n points have (n, 2) positions `xy_px` (col, row); the (2k, n, 2) `difference_px` are their
    displacements by k windows of few rows, then of few columns, which lie beside them by `beside_px`, less
    those by whole windows; NaN for failures. Errors of windows are their own, except for what those of the
    same rows, far along them, share.
    """
    rows, cols = difference_px.reshape(2, -1, 2)
    across = np.array([[0, offset_px] for offset_px in beside_px], np.float64)
    at_rows, at_cols = ((part[:, None] + xy_px).reshape(-1, 2) for part in (across, across[:, ::-1]))
    return float(np.hypot(_shared(at_rows, rows, 1), _shared(at_cols, cols, 0)))


def _shared(xy_px: Float64, difference_px: Float64, across: int) -> float:
    finite = np.isfinite(difference_px).all(axis=1)
    if np.count_nonzero(finite) < 2:
        return 0.0
    residual = difference_px[finite] - np.median(difference_px[finite], axis=0)
    size = np.linalg.norm(residual, axis=1)
    residual *= huber(np.maximum(size, 1e-9), JITTER.limit_medians * np.median(size))[:, None]
    distance = np.abs(xy_px[finite, None] - xy_px[finite])
    first, second = np.nonzero(
        np.triu(
            (distance[..., across] < JITTER.same_rows_px) & (distance[..., 1 - across] > JITTER.disjoint_px)
        )
    )
    if len(first) < JITTER.least_pairs:
        return 0.0
    product = (residual[first] * residual[second]).sum(axis=1)
    # windows of nearby rows see the same pixels: only sums of rows farther apart are independent
    band = np.floor(xy_px[finite][first, across] / JITTER.band_px)
    _, of_band = np.unique(band, return_inverse=True)
    sums = np.bincount(of_band, product - product.mean())
    error = float(np.sqrt((sums**2).sum())) / len(product)
    return float(np.sqrt(product.mean())) if product.mean() > JITTER.clear_errors * error else 0.0
