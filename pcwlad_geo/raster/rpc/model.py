"""The rational polynomial camera model (RPC): longitude, latitude, height to pixel, and the inverse.

Terms in the order of RPC00B (STDI-0002, NGA), as GDAL's metadata domain RPC has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.correction.dense import solve_2x2
from pcwlad_geo.types import Float64

Coefficients = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class EvaluationParameters:
    """How an RPC and its inverse are evaluated."""

    points_at_once: int = 1 << 16
    """Number of points evaluated at a time, so that their terms fit into the processor's cache."""
    tolerance_px: float = 1e-7
    """Residual at which the inverse has converged."""
    accepted_px: float = 100 * 1e-7
    """Largest residual of a solution."""
    steps: int = 30
    """Most steps of Newton's method."""


TERMS: Final = 20
"""Number of terms of a cubic polynomial of three variables."""
EVALUATION: Final = EvaluationParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True)
class RpcModel:
    """Sample and line as ratios of cubic polynomials of normalised longitude, latitude, height.

    Ground coordinates are arrays (n, 3) of longitude and latitude (degrees, WGS 84) and height (m above the
    ellipsoid); pixels are arrays (n, 2) of (col, row), corner-based.
    """

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

    def to_px(self, ground: Float64) -> Float64:
        """Map (n, 3) `ground`, longitude, latitude (degrees), height (m), to (n, 2) pixels (col, row)."""
        normalised = self.normalised(ground)
        result = np.empty((len(normalised), 2))
        count = EVALUATION.points_at_once
        for begin in range(0, len(normalised), count):
            part = slice(begin, begin + count)
            numerators, denominators = self._fractions(polynomial_terms(normalised[part]))
            # the RPC counts from the centre of the first pixel
            result[part] = (numerators / denominators).T * self._scale + self._offset
        return result

    def to_ground(
        self, pixel_xy_px: Float64, height_m: Float64 | float, start: Float64 | None = None
    ) -> Float64:
        """Map the (n, 2) `pixel_xy_px` (col, row) at given heights to the ground, by Newton's method.

        The (n,) or single `height_m` are metres above the ellipsoid; (n, 2) ground places `start` near
        the solution save steps. The result is (n, 2) longitude and latitude, degrees, to 1e-7 px; NaN
        where there is no solution.
        """
        pixel_xy_px = np.asarray(pixel_xy_px, dtype=np.float64)
        u = np.zeros((len(pixel_xy_px), 3))
        if start is not None:
            u[:, :2] = np.nan_to_num(self.normalised(np.column_stack([start, u[:, 2]]))[:, :2])
        u[:, 2] = (np.asarray(height_m, dtype=np.float64) - self.height_off) / self.height_scale
        miss_px = np.full(len(u), np.inf)
        pending = np.arange(len(u))
        for _ in range(EVALUATION.steps):
            px, slopes = self._linearised(u[pending])
            miss = pixel_xy_px[pending] - px
            miss_px[pending] = np.abs(miss).max(axis=1, initial=0.0)
            # the others go on: of a wild RPC most pixels never get there
            going_on = miss_px[pending] > EVALUATION.tolerance_px
            going_on &= np.isfinite(miss_px[pending])
            pending = pending[going_on]
            if not pending.size:
                break
            u[pending, :2] += np.clip(solve_2x2(slopes[going_on], miss[going_on]), -1.0, 1.0)
        converged = miss_px <= EVALUATION.accepted_px
        lon_lat = u[:, :2] * [self.long_scale, self.lat_scale] + [self.long_off, self.lat_off]
        return np.where(converged[:, None], lon_lat, np.nan)

    def px_per_metre_of_height(self, ground: Float64) -> Float64:
        """Return the (n, 2) displacement (col, row) in px per metre of height at (n, 3) `ground` points."""
        step = np.array([0.0, 0.0, 0.5])
        return self.to_px(ground + step) - self.to_px(ground - step)

    def normalised(self, ground: Float64) -> Float64:
        """Return the (n, 3) normalised coordinates of `ground` (n, 3): -1 to 1 within the scene."""
        offset = np.array([self.long_off, self.lat_off, self.height_off])
        relative: Float64 = np.asarray(ground, dtype=np.float64) - offset
        relative[:, 0] = (relative[:, 0] + 180.0) % 360.0 - 180.0  # scenes at the date line
        return relative / [self.long_scale, self.lat_scale, self.height_scale]

    def _linearised(self, normalised: Float64) -> tuple[Float64, Float64]:
        """Return (n, 2) pixels (col, row), and (n, 2, 2) derivatives by normalised longitude, latitude."""
        terms = polynomial_terms(normalised)
        fractions = self._fractions(np.hstack([terms, *derived_terms(terms)]))
        (upper, *uppers), (lower, *lowers) = (np.split(part, 3, axis=1) for part in fractions)
        ratios = upper / lower
        slopes = [(u - ratios * d) / lower for u, d in zip(uppers, lowers, strict=True)]
        return ratios.T * self._scale + self._offset, np.array(slopes).T * self._scale[:, None]

    def _fractions(self, terms: Float64) -> tuple[Float64, Float64]:
        """Return the (2, n) numerators and denominators of col and row from (20, n) terms."""
        numerators = np.array([self.samp_num_coeff, self.line_num_coeff])
        denominators = np.array([self.samp_den_coeff, self.line_den_coeff])
        return numerators @ terms, denominators @ terms

    @property
    def _scale(self) -> Float64:
        return np.array([self.samp_scale, self.line_scale])

    @property
    def _offset(self) -> Float64:
        return np.array([self.samp_off + 0.5, self.line_off + 0.5])


def polynomial_terms(normalised: Float64) -> Float64:
    """Return the (20, n) polynomial terms, in the order of RPC00B, of (n, 3) `normalised` coordinates.

    These are normalised longitude, latitude and height, without unit.
    """
    lon, lat, h = normalised.T
    one = np.ones_like(lon)
    lon2, lat2, h2 = lon * lon, lat * lat, h * h
    return np.array(
        [
            *(one, lon, lat, h, lon * lat, lon * h, lat * h, lon2, lat2, h2),
            *(lat * lon * h, lon2 * lon, lon * lat2, lon * h2, lon2 * lat),
            *(lat2 * lat, lat * h2, lon2 * h, lat2 * h, h2 * h),
        ]
    )


def derived_terms(terms: Float64) -> tuple[Float64, Float64]:
    """Return the (20, n) derivatives of `terms`, those of `polynomial_terms`, by longitude and latitude."""
    one, lon, lat, h, lon_lat, lon_h, lat_h, lon2, lat2, h2 = terms[:10]
    by_lon, by_lat = np.zeros_like(terms), np.zeros_like(terms)
    by_lon[[1, 4, 5, 7]] = one, lat, h, 2 * lon
    by_lon[[10, 11, 12, 13, 14, 17]] = lat_h, 3 * lon2, lat2, h2, 2 * lon_lat, 2 * lon_h
    by_lat[[2, 4, 6, 8]] = one, lon, h, 2 * lat
    by_lat[[10, 12, 14, 15, 16, 18]] = lon_h, 2 * lon_lat, lon2, 3 * lat2, h2, 2 * lat_h
    return by_lon, by_lat
