"""The rational polynomial camera model (RPC): from longitude, latitude, height to pixel, and back.

Terms in the order of RPC00B (STDI-0002, NGA), as GDAL's metadata domain RPC has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Coefficients = tuple[float, ...]

TERMS = 20
CHUNK = 1 << 16
"""Points at a time: the terms of more would leave the processor's cache."""
INVERSE_TOLERANCE_PX = 1e-7
ITERATIONS = 30
STEP = 1e-4
"""Half of the step of numerical derivatives, of the normalised coordinates."""


@dataclass(frozen=True, slots=True)
class RpcModel:
    """Sample and line as ratios of cubic polynomials of normalised longitude, latitude, height."""

    line_off: float
    """Line 0 is the centre of the first row."""
    samp_off: float
    lat_off: float
    """Degrees, WGS 84."""
    long_off: float
    height_off: float
    """Metres above the ellipsoid."""
    line_scale: float
    samp_scale: float
    lat_scale: float
    long_scale: float
    height_scale: float
    line_num_coeff: Coefficients
    line_den_coeff: Coefficients
    samp_num_coeff: Coefficients
    samp_den_coeff: Coefficients

    def to_px(self, ground: Array) -> Array:
        """Map (n, 3) longitude, latitude (degrees), height (m) to (n, 2) pixels (col, row), corner-based."""
        normalised = self.normalised(ground)
        result = np.empty((len(normalised), 2))
        for begin in range(0, len(normalised), CHUNK):
            part = slice(begin, begin + CHUNK)
            result[part] = self._to_px(normalised[part])
        return result

    def to_ground(self, pixel_xy_px: Array, height_m: Array | float) -> Array:
        """Map (n, 2) pixels (col, row) at heights (n,) or one to (n, 2) longitude, latitude; NaN where none.

        Newton's method from the middle of the scene, to 1e-7 px.
        """
        pixel_xy_px = np.asarray(pixel_xy_px, dtype=np.float64)
        u = np.zeros((len(pixel_xy_px), 3))
        u[:, 2] = (np.asarray(height_m, dtype=np.float64) - self.height_off) / self.height_scale
        for _ in range(ITERATIONS):
            miss = pixel_xy_px - self._to_px(u)
            worst = np.abs(miss).max(initial=0.0, where=np.isfinite(miss))
            if worst <= INVERSE_TOLERANCE_PX:
                break
            u[:, :2] += np.clip(_solved(self._slopes(u), miss), -1.0, 1.0)
        found = np.abs(miss).max(axis=1) <= 100 * INVERSE_TOLERANCE_PX
        lon_lat = u[:, :2] * [self.long_scale, self.lat_scale] + [self.long_off, self.lat_off]
        return np.where(found[:, None], lon_lat, np.nan)

    def px_per_metre_of_height(self, ground: Array) -> Array:
        """Return (n, 2): how far a metre of height moves the pixel (col, row) of (n, 3) ground points."""
        step = np.array([0.0, 0.0, 0.5])
        return self.to_px(ground + step) - self.to_px(ground - step)

    def normalised(self, ground: Array) -> Array:
        """Return (n, 3) longitude, latitude, height as the polynomials take them: -1 to 1 in the scene."""
        offset = np.array([self.long_off, self.lat_off, self.height_off])
        moved: Array = np.asarray(ground, dtype=np.float64) - offset
        moved[:, 0] = (moved[:, 0] + 180.0) % 360.0 - 180.0  # scenes at the date line
        return np.asarray(moved / [self.long_scale, self.lat_scale, self.height_scale])

    def _to_px(self, normalised: Array) -> Array:
        terms = polynomial_terms(normalised)
        coefficients = (self.samp_num_coeff, self.samp_den_coeff, self.line_num_coeff, self.line_den_coeff)
        samp_num, samp_den, line_num, line_den = np.array(coefficients) @ terms
        ratio = np.stack([samp_num / samp_den, line_num / line_den], axis=1)
        # the RPC counts from the centre of the first pixel
        return ratio * [self.samp_scale, self.line_scale] + [self.samp_off + 0.5, self.line_off + 0.5]

    def _slopes(self, normalised: Array) -> Array:
        """(n, 2, 2): derivatives of (col, row) by normalised longitude and latitude."""
        steps = STEP * np.eye(3)[:2]
        sides = [self._to_px(normalised + step) - self._to_px(normalised - step) for step in steps]
        return np.stack(sides, axis=2) / (2 * STEP)


def polynomial_terms(normalised: Array) -> Array:
    """Return the (20, n) terms of (n, 3) normalised longitude, latitude, height."""
    lon, lat, h = normalised.T
    one = np.ones_like(lon)
    lon2, lat2, h2 = lon * lon, lat * lat, h * h
    return np.stack(
        [
            *(one, lon, lat, h, lon * lat, lon * h, lat * h, lon2, lat2, h2),
            *(lat * lon * h, lon2 * lon, lon * lat2, lon * h2, lon2 * lat),
            *(lat2 * lat, lat * h2, lon2 * h, lat2 * h, h2 * h),
        ]
    )


def _solved(slopes: Array, miss: Array) -> Array:
    """Solve the 2 x 2 systems of Newton steps; NaN where there is no solution."""
    determinant = slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (slopes[:, 1, 1] * miss[:, 0] - slopes[:, 0, 1] * miss[:, 1]) / determinant
        y = (slopes[:, 0, 0] * miss[:, 1] - slopes[:, 1, 0] * miss[:, 0]) / determinant
    return np.stack([x, y], axis=1)
