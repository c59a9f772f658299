"""The errors of a registered raster as metadata: along the axes of its map, without the matching noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.correction.error_statistics import ErrorStatistics, FloatPair, float_pair
from pcwlad_geo.raster import Grid, at_mean_height
from pcwlad_geo.raster.grid import metres_between
from pcwlad_geo.types import Float64

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.registration import Registration

M_DIGITS: Final = 4
"""Decimals of metres in metadata."""


@dataclass(frozen=True, slots=True)
class GeometricAccuracy:
    """Errors of a registered raster along x and y of its map, metres.

    An error is where the raster shows the ground, less where the ground is.
    """

    evidence: Literal["check points", "adjustment"]
    """From what they are known: check points that the fit has not seen, less the matching noise in their
    scatter, or the covariance of an adjustment, which knows no bias."""
    stddev_m: FloatPair
    bias_m: FloatPair | None = None
    noise_m: FloatPair | None = None
    """Standard deviation of the matching noise that was taken out of the scatter."""
    points: int | None = None
    """Number of check points."""

    @staticmethod
    def of(registration: Registration, crs: CRS | None) -> GeometricAccuracy | None:
        """Return the errors at the check points along the axes of a CRS; None without check points or CRS."""
        correction, points = registration.model, registration.tie_points.select("check")
        reference, target = registration.reference, registration.target
        # the predicted pixels of a target without georeferencing are the reference's
        grid = at_mean_height((target if target.grid.located else reference).grid)
        if correction is None or crs is None or grid.crs is None:
            return None
        truth_px = points.predicted_px
        errors_m = metres_between(grid, truth_px, correction.inverse(points.target_px), crs)
        axes_m = _axes_m(grid, truth_px, crs)
        covariance_m2 = axes_m @ points.covariance_px2 @ axes_m.transpose(0, 2, 1)
        sigma_m = np.sqrt(np.diagonal(covariance_m2, axis1=1, axis2=2))
        statistics = ErrorStatistics.of(errors_m, sigma_m)
        if statistics is None:
            return None
        net, bias_m = statistics.net, (statistics.col.mean, statistics.row.mean)
        return GeometricAccuracy("check points", net.std_xy, bias_m, net.noise_xy, statistics.n)

    @staticmethod
    def of_position(sigma_px: FloatPair, grid: Grid, crs: CRS | None) -> GeometricAccuracy | None:
        """Return the errors of an image, from the standard deviation (col, row) of its position."""
        if crs is None or grid.crs is None:
            return None
        (axes_m,) = _axes_m(at_mean_height(grid), grid.middle_px, crs)
        return GeometricAccuracy("adjustment", float_pair(np.sqrt(axes_m**2 @ np.square(sigma_px))))

    @property
    def rmse_m(self) -> float:
        """Radial root mean square error."""
        return float(np.hypot(np.hypot(*(self.bias_m or (0.0, 0.0))), np.hypot(*self.stddev_m)))

    def fields(self) -> dict[str, Any]:
        """Return the fields of STAC's extension *accuracy*, and our own about their evidence."""
        values: dict[str, Any] = {"accuracy:geometric_rmse": round(self.rmse_m, M_DIGITS)}
        for name, pair in (("bias", self.bias_m), ("stddev", self.stddev_m)):
            for axis, value in zip("xy", pair or (), strict=False):
                values[f"accuracy:geometric_{axis}_{name}"] = round(value, M_DIGITS)
        values["pcwlad_geo:accuracy_evidence"] = self.evidence
        if self.noise_m is not None:
            values["pcwlad_geo:matching_noise_m"] = [round(value, M_DIGITS) for value in self.noise_m]
            values["pcwlad_geo:check_points"] = self.points
        return values

    def tags(self) -> dict[str, str]:
        """Return the same as metadata of a raster, all texts, in whose names GDAL allows no colon."""
        return {
            name.replace(":", "_").upper(): " ".join(map(str, value))
            if isinstance(value, list)
            else str(value)
            for name, value in self.fields().items()
        }


def _axes_m(grid: Grid, at_px: Float64, crs: CRS) -> Float64:
    """Return the (n, 2, 2) metres along x, y of a CRS (first axis) per column and row (second axis)."""
    steps = (np.array([0.5, 0.0]), np.array([0.0, 0.5]))
    return np.stack([metres_between(grid, at_px - step, at_px + step, crs) for step in steps], axis=2)
