"""Jitter within a matching window: rows, or columns, that move as a whole, which the window averages out.

Windows of a few rows see it. What they show beside the smooth field is noise of their own, except for what
the windows of the same rows far along them share.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from pcwlad_geo.matching.guidance import FieldGuide
from pcwlad_geo.matching.prepare import ChannelPair
from pcwlad_geo.matching.refinement import Start, refine
from pcwlad_geo.matching.types import TiePoints
from pcwlad_geo.types import Float64

LENGTH_PX: Final = 61
"""Length of the windows along the rows, or the columns."""
WIDTH_PX: Final = 5
"""Their width across."""
SAME_PX: Final = 4.0
"""Windows whose rows are less apart lie on the same rows."""
APART_PX: Final = 1.5 * LENGTH_PX
"""Windows that are farther apart along the rows share no pixel."""
OUTLYING: Final = 4.0
"""Longer residuals, in the median of all, are cut to that."""
MIN_PAIRS: Final = 50
"""Least number of pairs of windows of the same rows that tell."""
CLEAR: Final = 5.0
"""What they share is jitter beyond so many standard errors; without any it was 3 at most."""


def seen_by_stripes(pair: ChannelPair, points: TiePoints, guide: FieldGuide) -> Float64:
    """Return (2, n, 2) displacements (col, row) by windows of few rows, then of few columns, NaN if lost.

    The n `points` and their `guide` are in pixel coordinates of the arrays of `pair`.
    """
    begin = np.where(guide.leads[:, None], guide.structure_xy_px, points.displacement_px)
    corners = np.floor(points.reference_xy_px[:, ::-1]).astype(np.intp)
    rows = np.zeros((len(points), LENGTH_PX, LENGTH_PX), np.float32)
    rows[:, LENGTH_PX // 2 - WIDTH_PX // 2 :][:, :WIDTH_PX] = 1.0
    seen = []
    for weight in (rows, np.ascontiguousarray(rows.transpose(0, 2, 1))):
        start = Start(begin, guide.linear, structure=weight)
        found = refine(pair.reference, pair.target, corners, start, window_px=LENGTH_PX, threads=pair.threads)
        seen.append(np.where(found.converged[:, None], found.shift_xy_px, np.nan))
    return np.stack(seen)


def jitter_px(xy_px: Float64, beside_px: Float64) -> float:
    """Return by how much rows and columns move beside the field, RMS, px; 0 where that may be chance.

    The n points have (n, 2) positions `xy_px` (col, row); `beside_px` is what `seen_by_stripes` returns for
    them, less the displacement that the field predicts.
    """
    return float(np.hypot(_shared(xy_px, beside_px[0], 1), _shared(xy_px, beside_px[1], 0)))


def _shared(xy_px: Float64, beside_px: Float64, across: int) -> float:
    known = np.isfinite(beside_px).all(axis=1)
    if np.count_nonzero(known) < 2:
        return 0.0
    left = beside_px[known] - np.median(beside_px[known], axis=0)
    size = np.linalg.norm(left, axis=1)
    left *= np.minimum(1.0, OUTLYING * np.median(size) / np.maximum(size, 1e-9))[:, None]
    apart = np.abs(xy_px[known, None] - xy_px[known])
    first, second = np.nonzero(np.triu((apart[..., across] < SAME_PX) & (apart[..., 1 - across] > APART_PX)))
    if len(first) < MIN_PAIRS:
        return 0.0
    product = (left[first] * left[second]).sum(axis=1)
    error = float(np.sqrt((product**2).mean() / len(product)))
    return float(np.sqrt(product.mean())) if product.mean() > CLEAR * error else 0.0
