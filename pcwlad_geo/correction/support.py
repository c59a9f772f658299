"""Where tie points support a correction, and where it extrapolates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

Array = NDArray[np.float64]

SPACINGS = 3.0
"""A place this many typical spacings from all tie points is beyond them."""


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """The tie points of a fit, as far as they reach."""

    points_px: Array
    """(n, 2) predicted position (col, row) of the points that count, px."""
    reach_px: float
    """Distance up to which a point speaks for its surroundings: a matching window, or three times the typical
    spacing of the points if that is more, px."""

    @classmethod
    def of(cls, points_px: Array, footprint_px: float) -> Support:
        """Return the support of (n, 2) points with matching windows of this side, px."""
        spacing = np.sqrt(_hull_area(points_px) / max(len(points_px), 1))
        if spacing == 0 and len(points_px):
            spacing = float(np.hypot(*np.ptp(points_px, axis=0))) / len(points_px)
        return cls(points_px, max(footprint_px, SPACINGS * float(spacing)))

    def extrapolated(self, at_px: Array) -> NDArray[np.bool_]:
        """Return whether (n, 2) positions (col, row) lie outside the tie points, or in a wide hole."""
        distance, _ = cKDTree(self.points_px).query(at_px, distance_upper_bound=self.reach_px)
        return np.asarray(distance > self.reach_px)


def _hull_area(points_px: Array) -> float:
    try:
        return float(ConvexHull(points_px).volume)  # of a plane figure, scipy's volume is the area
    except (QhullError, ValueError):
        return 0.0  # fewer than three points, or all on a line
