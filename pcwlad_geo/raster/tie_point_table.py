"""Tie points in the coordinates of the two original files and of the reference CRS."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TiePointTable:
    """What `tiepoints.csv` holds: one row a tie point.

    Pixel coordinates are GDAL's (col, row), corner-based, of the ORIGINAL files.
    """

    reference_px: Array
    """(n, 2) position in the reference file."""
    target_px: Array
    """(n, 2) observed position in the target file."""
    predicted_px: Array
    """(n, 2) target position that the original georeferencing predicts for the reference point."""
    xy: Array
    """(n, 2) map coordinates of the reference point in the reference CRS; (col, -row) without one."""
    displacement_m: Array
    """(n, 2) displacement in metres along the reference CRS axes, y north; NaN without a CRS."""
    covariance_px2: Array
    """(n, 2, 2) covariance of target_px, target px²."""
    score: Array
    """(n,) match quality, 0 to 1."""
    residual_px: Array
    """(n, 2) observed minus model, target px; NaN before a fit."""
    status: NDArray[np.str_]
    """(n,) fit, check, unused (too near to a check point), rejected; from `match`: matched, rejected."""
    crs: CRS | None
    """Reference CRS."""

    def __len__(self) -> int:
        return len(self.score)

    @property
    def displacement_px(self) -> Array:
        """(n, 2) observed minus predicted target position, target px."""
        return self.target_px - self.predicted_px

    @property
    def sigma_px(self) -> Array:
        """(n, 2) standard deviation of target_px per axis."""
        return np.sqrt(np.diagonal(self.covariance_px2, axis1=1, axis2=2))

    @property
    def placed(self) -> TiePointTable:
        """The rows that have a place in both files and on the map: what a ground control point needs."""
        places = np.column_stack([self.reference_px, self.target_px, self.xy])
        return self[np.asarray(np.isfinite(places).all(axis=1))]

    def select(self, *statuses: str) -> TiePointTable:
        """Return the rows whose status is one of those named."""
        return self[np.isin(self.status, statuses)]

    def __getitem__(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> TiePointTable:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        crs = values.pop("crs")
        return TiePointTable(**{name: value[index] for name, value in values.items()}, crs=crs)
