"""Tie points as the matcher makes them: a struct of arrays in pixel coordinates of two arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TiePoints:
    """Matched points of two images on the same matching grid.

    All coordinates are GDAL pixel coordinates, (col, row) with (0, 0) at the top-left
    corner of the top-left pixel, in matching-grid pixels.
    """

    reference_xy_px: Array
    """(n, 2) positions in the reference image."""
    target_xy_px: Array
    """(n, 2) observed positions in the target image."""
    covariance_px2: Array
    """(n, 2, 2) calibrated covariance of the observed target position, px²."""
    score: Array
    """(n,) match quality, higher is better: how far the coarse peak stands out, 0 to 1."""
    way_back_px: Array
    """(n,) how far off the match back from the target ends in the first pass; NaN if not done."""

    def __len__(self) -> int:
        return len(self.score)

    @property
    def displacement_px(self) -> Array:
        """(n, 2) target minus reference position."""
        return self.target_xy_px - self.reference_xy_px

    @property
    def sigma_px(self) -> Array:
        """(n, 2) standard deviation per axis."""
        return np.sqrt(np.diagonal(self.covariance_px2, axis1=1, axis2=2))

    def __getitem__(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> TiePoints:
        return TiePoints(*(getattr(self, field.name)[index] for field in fields(self)))

    def shifted(self, reference_xy_px: Array, target_xy_px: Array) -> TiePoints:
        """Return the points with a constant (col, row) added to either side."""
        return replace(
            self,
            reference_xy_px=self.reference_xy_px + reference_xy_px,
            target_xy_px=self.target_xy_px + target_xy_px,
        )

    @staticmethod
    def empty() -> TiePoints:
        """Return zero tie points."""
        return TiePoints(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0), np.empty(0))

    @staticmethod
    def concatenate(parts: list[TiePoints]) -> TiePoints:
        """Return the points of all parts in their order."""
        if not parts:
            return TiePoints.empty()
        return TiePoints(
            *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(TiePoints))
        )
