"""A grid: shape, geotransform and CRS of a raster; pixel coordinates to map coordinates and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.raster.crs import transform_xy

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Grid:
    """Where the pixels of a raster lie."""

    shape: tuple[int, int]
    """Rows, columns."""
    transform: Affine
    """Geotransform: (col, row), corner-based, to (x, y). Identity without georeferencing."""
    crs: CRS | None
    """Coordinate reference system of x, y; None also where they are those of a plane without one."""

    @property
    def located(self) -> bool:
        """Whether the pixels have a place: in a CRS, or in a plane shared with another raster."""
        return self.crs is not None or self.transform != Affine.identity()

    def to_xy(self, pixel_xy_px: Array) -> Array:
        """Map (n, 2) pixel coordinates (col, row) to (n, 2) map coordinates (x, y)."""
        return apply(self.transform, pixel_xy_px)

    def to_px(self, xy: Array) -> Array:
        """Map (n, 2) map coordinates (x, y) to (n, 2) pixel coordinates (col, row)."""
        return apply_inverse(self.transform, xy)

    def part(self, origin_px: tuple[float, float], shape: tuple[int, int]) -> Grid:
        """Return the grid of the same pixels that starts at (col, row) and has another shape."""
        return self.remade(((1.0, 0.0), (0.0, 1.0)), origin_px, shape)

    def scaled(self, shape: tuple[int, int]) -> Grid:
        """Return the grid of the same extent with another number of pixels."""
        factors = (self.shape[1] / shape[1], self.shape[0] / shape[0])
        return self.remade(((factors[0], 0.0), (0.0, factors[1])), (0.0, 0.0), shape)

    def remade(
        self,
        linear: tuple[tuple[float, float], tuple[float, float]],
        origin_px: tuple[float, float],
        shape: tuple[int, int],
    ) -> Grid:
        """Return the grid whose pixel p lies at linear · p + origin of this grid's pixels (col, row)."""
        return Grid(shape, composed(self.transform, linear, origin_px), self.crs)

    def boundary_px(self, points_per_side: int = 32) -> Array:
        """Return (n, 2) points around the outer edge of the pixels, in order, not closed."""
        rows, cols = self.shape
        corners = np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], dtype=np.float64)
        steps = np.linspace(0, 1, points_per_side, endpoint=False)[:, None]
        sides = [a + (b - a) * steps for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        return np.concatenate(sides)


def linear_part(transform: Affine) -> Array:
    """Return the (2, 2) linear part of a geotransform."""
    return np.array([[transform.a, transform.b], [transform.d, transform.e]])


def apply(transform: Affine, points_xy: Array) -> Array:
    """Map (n, 2) points by an affine transformation."""
    points_xy = np.asarray(points_xy, dtype=np.float64)
    return np.asarray(points_xy @ linear_part(transform).T + np.array([transform.c, transform.f]))


def apply_inverse(transform: Affine, points_xy: Array) -> Array:
    """Map (n, 2) points by the inverse of an affine transformation."""
    # Differences first: eastings and northings have more digits than the inverse geotransform keeps.
    origin = np.array([transform.c, transform.f])
    inverse = np.linalg.inv(linear_part(transform))
    return np.asarray((np.asarray(points_xy, dtype=np.float64) - origin) @ inverse.T)


def composed(
    transform: Affine, linear: tuple[tuple[float, float], tuple[float, float]], origin_px: tuple[float, float]
) -> Affine:
    """Return the transform of pixels p that lie at linear · p + origin of another's pixels (col, row)."""
    a, b, d, e = (linear_part(transform) @ np.array(linear)).ravel().tolist()
    x, y = apply(transform, np.array([origin_px], dtype=np.float64))[0].tolist()
    return Affine(a, b, x, d, e, y)


def map_px(points_px: Array, from_grid: Grid, to_grid: Grid) -> Array:
    """Map (n, 2) pixel coordinates (col, row) of one grid to the same ground in another.

    NaN where the CRSs cannot be transformed at that place.

    Raises
    ------
    InputError
        If no transformation exists between the CRSs, or only one grid has a CRS.
    """
    points_px = np.asarray(points_px, dtype=np.float64)
    plain = type(from_grid) is Grid and type(to_grid) is Grid
    if plain and from_grid.transform == to_grid.transform and from_grid.crs == to_grid.crs:
        return points_px
    return to_grid.to_px(transform_xy(from_grid.to_xy(points_px), from_grid.crs, to_grid.crs))


def jacobian(points_px: Array, from_grid: Grid, to_grid: Grid) -> Array:
    """Return (n, 2, 2): how `map_px` moves the pixel per pixel of step, [i, j] = d(to)_i / d(from)_j."""
    points_px = np.asarray(points_px, dtype=np.float64)
    steps = np.array([[0.5, 0.0], [0.0, 0.5]])
    sides = [
        map_px(points_px + step, from_grid, to_grid) - map_px(points_px - step, from_grid, to_grid)
        for step in steps
    ]
    return np.stack(sides, axis=2)
