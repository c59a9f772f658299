"""Heights of the ground above the WGS 84 ellipsoid: a DEM and what its heights are above, or one height."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.masks import valid_in_file
from pcwlad_geo.raster.source import open_raster
from pcwlad_geo.raster.windows import Window

Array = NDArray[np.float64]

WGS84: Final = CRS.from_epsg(4326)
MOST_PX_AT_ONCE: Final = 1 << 22
"""Of the DEM."""
ROUNDING_PX: Final = 1e-6
"""What map coordinates may be off by."""


class Heights(Protocol):
    """The ground's height."""

    def at(self, lon_lat: Array) -> Array:
        """Return the (n,) heights in metres above the ellipsoid at (n, 2) degrees; NaN where unknown."""

    def nearest(self, lon_lat: Array) -> Array:
        """Return the same, beyond the edge of what is known the height of the nearest place within."""


@dataclass(frozen=True, slots=True)
class ConstantHeight:
    """The same height everywhere."""

    height_m: float
    """Above the ellipsoid."""

    def at(self, lon_lat: Array) -> Array:
        """Return the (n,) heights in metres above the ellipsoid at (n, 2) degrees."""
        return np.full(len(lon_lat), self.height_m)

    def nearest(self, lon_lat: Array) -> Array:
        """Return the same: it has no edge."""
        return self.at(lon_lat)


@dataclass(frozen=True, slots=True)
class Undulation:
    """What is added to the heights of a DEM to count from the ellipsoid: a coarse lattice, small to send."""

    west: float
    south: float
    """Longitude and latitude of the first node, degrees."""
    step: tuple[float, float]
    """Degrees between nodes."""
    shape: tuple[int, int]
    """Nodes from south to north, from west to east."""
    values_m: tuple[float, ...]
    """Row by row."""

    @staticmethod
    def constant(value_m: float) -> Undulation:
        """Return the same undulation everywhere."""
        return Undulation(0.0, 0.0, (1.0, 1.0), (1, 1), (float(value_m),))

    @staticmethod
    def sampled(
        function: Callable[[Array], Array], bounds: tuple[float, float, float, float], step_deg: float
    ) -> Undulation:
        """Sample a function of (n, 2) longitude, latitude over (west, south, east, north)."""
        west, south, east, north = bounds
        counts = [int(np.ceil((north - south) / step_deg)) + 1, int(np.ceil((east - west) / step_deg)) + 1]
        rows, cols = np.clip(counts, 2, 65).tolist()
        lon, lat = np.meshgrid(np.linspace(west, east, cols), np.linspace(south, north, rows))
        values: list[float] = function(np.column_stack([lon.ravel(), lat.ravel()])).tolist()
        step = ((east - west) / (cols - 1), (north - south) / (rows - 1))
        return Undulation(west, south, step, (rows, cols), tuple(values))

    def at(self, lon_lat: Array) -> Array:
        """Return the (n,) undulation in metres at (n, 2) degrees, bilinear; NaN at NaN."""
        if len(self.values_m) == 1:
            return np.full(len(lon_lat), self.values_m[0])
        index = (lon_lat - [self.west, self.south]) / self.step
        index = np.clip(index, 0, np.array(self.shape[::-1]) - 1.0)  # the lattice holds the scene
        known = np.isfinite(index).all(axis=1)  # a place off the DEM has no coordinates
        found = np.full(len(index), np.nan)
        found[known] = _bilinear(np.array(self.values_m).reshape(self.shape), index[known])
        return found

    @property
    def mean_m(self) -> float:
        """Its mean."""
        return float(np.mean(self.values_m))


@dataclass(frozen=True, slots=True)
class Dem:
    """A raster of heights; picklable, holds no open file."""

    uri: str
    grid: Grid
    """With the horizontal part of its CRS."""
    metres_per_unit: float
    undulation: Undulation

    def at(self, lon_lat: Array) -> Array:
        """Return the (n,) heights in metres above the ellipsoid at (n, 2) degrees; NaN where unknown.

        Raises
        ------
        InputError
            If the file cannot be read there.
        """
        return self.at_px(self.to_px(lon_lat), lon_lat)

    def nearest(self, lon_lat: Array) -> Array:
        """Return the (n,) heights at the nearest places within the DEM's edge; NaN in its holes."""
        return self.at_px(np.clip(self.to_px(lon_lat), 0.0, np.array(self.grid.shape[::-1])), lon_lat)

    def to_px(self, lon_lat: Array) -> Array:
        """Map (n, 2) longitude, latitude to the DEM's pixels (col, row)."""
        return self.grid.to_px(transform_xy(lon_lat, WGS84, self.grid.crs))

    def at_px(self, dem_px: Array, lon_lat: Array) -> Array:
        """Return the same as `at` where the (n, 2) DEM pixels are known too."""
        return self._own(dem_px) * self.metres_per_unit + self.undulation.at(lon_lat)

    def ellipsoidal(self, window: Window) -> Array:
        """Return the heights above the ellipsoid, m, of a window of the file; NaN where there are none."""
        row, col = np.mgrid[window.row : window.row_stop, window.col : window.col_stop]
        pixels = np.column_stack([col.ravel(), row.ravel()]) + 0.5
        added = self.undulation.at(transform_xy(self.grid.to_xy(pixels), self.grid.crs, WGS84))
        return self._read(window) * self.metres_per_unit + added.reshape(window.shape)

    def missing_in(self, window: Window, outline_px: shapely.Geometry) -> int:
        """Count the pixels without height in a window whose centres lie within an outline (px)."""
        if window.area_px2 > MOST_PX_AT_ONCE and max(window.shape) > 1:
            return sum(self.missing_in(half, outline_px) for half in window.halves())
        row, col = np.nonzero(np.isnan(self._read(window)))
        return int(shapely.contains_xy(outline_px, col + window.col + 0.5, row + window.row + 0.5).sum())

    def _own(self, dem_px: Array) -> Array:
        """(n,) heights as the file has them, bilinear between pixel centres; NaN where one is missing."""
        heights = np.full(len(dem_px), np.nan)
        size = np.array(self.grid.shape[::-1])
        with np.errstate(invalid="ignore"):
            inside = np.flatnonzero(((dem_px >= -ROUNDING_PX) & (dem_px <= size + ROUNDING_PX)).all(axis=1))
        if len(inside) == 0:
            return heights
        # the outer half of the outermost pixels is as high as their centres
        index = np.clip(dem_px[inside] - 0.5, 0, size - 1.0)
        first = np.floor(index.min(axis=0)).astype(int)
        last = np.minimum(np.floor(index.max(axis=0)).astype(int) + 2, size)
        window = Window.from_bounds(int(first[1]), int(first[0]), int(last[1]), int(last[0]))
        if window.area_px2 > MOST_PX_AT_ONCE and max(window.shape) > 2:
            axis = 0 if window.cols >= window.rows else 1
            near = index[:, axis] < first[axis] + max(window.shape) // 2
            for half in (inside[near], inside[~near]):
                heights[half] = self._own(dem_px[half])
            return heights
        heights[inside] = _bilinear(self._read(window), index - first)
        return heights

    def _read(self, window: Window) -> Array:
        file_window = FileWindow(window.col, window.row, window.cols, window.rows)
        with open_raster(self.uri) as dataset:
            try:
                values = dataset.read(1, window=file_window)
                valid = valid_in_file(dataset, 1, values, file_window)
            except GDAL_ERRORS as error:
                raise InputError(f"the DEM {self.uri} cannot be read: {root_cause(error)}") from error
            scaled = values.astype(np.float64) * dataset.scales[0] + dataset.offsets[0]
        return np.where(valid, scaled, np.nan)


def _bilinear(values: Array, index_xy: Array) -> Array:
    """Interpolate (rows, cols) values at (n, 2) indices inside; NaN where a neighbour that counts is NaN."""
    rows, cols = values.shape
    low = np.minimum(np.floor(index_xy).astype(np.intp), np.maximum([cols - 2, rows - 2], 0))
    (x, y), (col, row) = (index_xy - low).T, low.T
    result = np.zeros(len(index_xy))
    for down in (0, 1):
        for right in (0, 1):
            weight = (x if right else 1 - x) * (y if down else 1 - y)
            neighbour = values[np.minimum(row + down, rows - 1), np.minimum(col + right, cols - 1)]
            result += np.where(weight > 0, weight * neighbour, 0.0)
    return result
