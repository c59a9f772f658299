"""Heights of the ground above the WGS 84 ellipsoid: a DEM with its vertical datum, or one height."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyproj
import shapely
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup
from rasterio.crs import CRS
from rasterio.windows import Window as FileWindow

from pcwlad_geo.correction.dense import positions
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import WGS84, name_of, to_pyproj, transform_xy, with_arrays
from pcwlad_geo.raster.gdal import GDAL_ERRORS, ignoring, root_cause
from pcwlad_geo.raster.grid import Grid, Window, jacobian, map_px
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.pixels import valid_in_file
from pcwlad_geo.raster.source import RasterInfo, describe
from pcwlad_geo.types import Float64

Bounds = tuple[float, float, float, float]
Vertical = float | str | os.PathLike[str] | None


@dataclass(frozen=True, slots=True)
class DemParameters:
    """How a DEM is read."""

    max_px_at_once: int = 1 << 22
    """Largest number of pixels that are read at a time."""
    max_px_held: int = 1 << 24
    """Largest number of pixels that are held in memory."""
    rounding_px: float = 1e-6
    """Tolerance of the rounding errors of map coordinates."""
    undulation_step_deg: float = 0.02
    """Spacing of the nodes of an undulation; geoid grids have 0.016 to 0.25 degrees."""
    undulation_nodes: int = 65
    """Most nodes of an undulation a side."""
    max_undulation_m: float = 150.0
    """Largest distance of a geoid from the ellipsoid."""


DEMS: Final = DemParameters()
"""Those in use."""
ELLIPSOIDAL: Final = pyproj.CRS.from_epsg(4979)
"""CRS of longitude, latitude and height above the WGS 84 ellipsoid."""
_UNITS_M: Final = {
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), 0.3048),
    **dict.fromkeys(("us survey foot", "us-ft", "ftus", "us foot", "foot_us"), 1200 / 3937),
}
"""Units of heights."""


@dataclass(frozen=True, slots=True)
class ConstantHeight:
    """The same height everywhere."""

    height_m: float
    """Height above the ellipsoid."""

    def at(self, lon_lat: Float64) -> Float64:
        """Return the (n,) heights in metres above the ellipsoid at (n, 2) `lon_lat`, degrees."""
        return np.full(len(lon_lat), self.height_m)

    def nearest(self, lon_lat: Float64) -> Float64:
        """Return the (n,) heights in metres as `at`, at (n, 2) `lon_lat` in degrees: there is no edge."""
        return self.at(lon_lat)


@dataclass(frozen=True, slots=True)
class Undulation:
    """Undulations, added to the heights of a DEM to give ellipsoidal heights: a coarse, picklable lattice."""

    west: float
    south: float
    """Longitude and latitude of the first node, degrees."""
    step: tuple[float, float]
    """Spacing of the nodes in longitude and latitude, degrees."""
    shape: tuple[int, int]
    """Number of nodes in latitude and in longitude."""
    values_m: tuple[float, ...]
    """Undulations row by row, from south to north and from west to east."""

    @staticmethod
    def constant(value_m: float) -> Undulation:
        """Return an undulation that is the same everywhere."""
        return Undulation(0.0, 0.0, (1.0, 1.0), (1, 1), (float(value_m),))

    @staticmethod
    def sampled(function: Callable[[Float64], Float64], bounds: Bounds, step_deg: float) -> Undulation:
        """Sample a function on a lattice over `bounds`, degrees: west, south, east, north.

        The spacing of the nodes is at most `step_deg`, and there are at most 65 a side. The function returns
        the (n,) undulations in metres at (n, 2) longitudes and latitudes in degrees.
        """
        west, south, east, north = bounds
        counts = [int(np.ceil((north - south) / step_deg)) + 1, int(np.ceil((east - west) / step_deg)) + 1]
        rows, cols = np.clip(counts, 2, DEMS.undulation_nodes).tolist()
        nodes = positions(np.linspace(west, east, cols), np.linspace(south, north, rows))
        values: list[float] = function(nodes).tolist()
        step = ((east - west) / (cols - 1), (north - south) / (rows - 1))
        return Undulation(west, south, step, (rows, cols), tuple(values))

    def at(self, lon_lat: Float64) -> Float64:
        """Return the (n,) bilinear undulations in metres at (n, 2) `lon_lat`, degrees; NaN at NaN."""
        if len(self.values_m) == 1:
            return np.full(len(lon_lat), self.values_m[0])
        index = (lon_lat - [self.west, self.south]) / self.step
        index = np.clip(index, 0, np.array(self.shape[::-1]) - 1.0)  # the lattice covers the scene
        finite = np.isfinite(index).all(axis=1)  # a position outside the DEM has no coordinates
        undulations = np.full(len(index), np.nan)
        undulations[finite] = bilinear(np.array(self.values_m).reshape(self.shape), index[finite])
        return undulations

    @property
    def mean_m(self) -> float:
        """Mean of the undulations."""
        return float(np.mean(self.values_m))


@dataclass(frozen=True, slots=True)
class Dem:
    """A raster of heights; picklable, holds no open file."""

    uri: str
    grid: Grid
    """Grid with the horizontal part of the DEM's CRS."""
    metres_per_unit: float
    undulation: Undulation

    def at(self, lon_lat: Float64) -> Float64:
        """Return the (n,) heights in metres above the ellipsoid at (n, 2) `lon_lat`; NaN where unknown.

        Longitude and latitude are in degrees, WGS 84. Raises `InputError` if the file cannot be read there.
        """
        return self.at_px(self.to_px(lon_lat), lon_lat)

    def nearest(self, lon_lat: Float64) -> Float64:
        """Return the (n,) heights in metres at the points of the DEM nearest to (n, 2) `lon_lat`, degrees.

        They are NaN in holes of the DEM.
        """
        return self.at_px(np.clip(self.to_px(lon_lat), 0.0, np.array(self.grid.shape[::-1])), lon_lat)

    def to_px(self, lon_lat: Float64) -> Float64:
        """Map (n, 2) `lon_lat` in degrees to (n, 2) pixels of the DEM (col, row), corner-based."""
        return self.grid.to_px(self.grid.in_turn(transform_xy(lon_lat, WGS84, self.grid.crs)))

    def at_px(self, dem_px: Float64, lon_lat: Float64) -> Float64:
        """Return the (n,) heights as `at`, given (n, 2) `dem_px` (col, row) and (n, 2) `lon_lat`, degrees."""
        return self._own(dem_px) * self.metres_per_unit + self.undulation.at(lon_lat)

    def held(self, lon_lat: Float64) -> Dem:
        """Return the DEM with its heights around the (n, 2) `lon_lat`, degrees, held in memory.

        Where these are too many, or none, it is the DEM as it is.
        """
        at_px = self.to_px(lon_lat)
        at_px = at_px[np.isfinite(at_px).all(axis=1)]
        if not len(at_px):
            return self
        window = Window.around(at_px.min(axis=0), at_px.max(axis=0)).padded(64).clipped(self.grid.shape)
        if window.empty or window.area_px2 > DEMS.max_px_held:
            return self
        return HeldDem(self.uri, self.grid, self.metres_per_unit, self.undulation, window, self._read(window))

    def ellipsoidal(self, window: Window) -> Float64:
        """Return the (rows, cols) heights above the ellipsoid, m, of a window of the file; NaN in holes."""
        cols, rows = np.arange(window.col, window.col_stop), np.arange(window.row, window.row_stop)
        pixels = positions(cols + 0.5, rows + 0.5)
        added = self.undulation.at(transform_xy(self.grid.to_xy(pixels), self.grid.crs, WGS84))
        return self._read(window) * self.metres_per_unit + added.reshape(window.shape)

    def missing_in(self, window: Window, outline_px: shapely.Geometry) -> int:
        """Count the pixels without height in `window` whose centres are within `outline_px` (col, row)."""
        if window.area_px2 > DEMS.max_px_at_once and max(window.shape) > 1:
            return sum(self.missing_in(half, outline_px) for half in window.halves())
        row, col = np.nonzero(np.isnan(self._read(window)))
        return int(shapely.contains_xy(outline_px, col + window.col + 0.5, row + window.row + 0.5).sum())

    def _own(self, dem_px: Float64) -> Float64:
        """Return (n,) heights in the file's unit, bilinear between pixel centres; NaN if one is missing."""
        heights = np.full(len(dem_px), np.nan)
        size = np.array(self.grid.shape[::-1])
        with np.errstate(invalid="ignore"):
            inside = np.flatnonzero(
                ((dem_px >= -DEMS.rounding_px) & (dem_px <= size + DEMS.rounding_px)).all(axis=1)
            )
        if len(inside) == 0:
            return heights
        # the outer half of the outermost pixels has the height of their centres
        index = np.clip(dem_px[inside] - 0.5, 0, size - 1.0)
        first = np.floor(index.min(axis=0)).astype(int)
        last = np.minimum(np.floor(index.max(axis=0)).astype(int) + 2, size)
        window = Window.from_bounds(int(first[1]), int(first[0]), int(last[1]), int(last[0]))
        if window.area_px2 > DEMS.max_px_at_once and max(window.shape) > 2:
            axis = 0 if window.cols >= window.rows else 1
            in_first = index[:, axis] < first[axis] + max(window.shape) // 2
            for half in (inside[in_first], inside[~in_first]):
                heights[half] = self._own(dem_px[half])
            return heights
        heights[inside] = bilinear(self._read(window), index - first)
        return heights

    def _read(self, window: Window) -> Float64:
        file_window = FileWindow(window.col, window.row, window.cols, window.rows)
        with open_raster(self.uri) as dataset:
            try:
                values = dataset.read(1, window=file_window)
                valid = valid_in_file(dataset, 1, values, file_window)
            except GDAL_ERRORS as error:
                raise InputError(f"the DEM {self.uri} cannot be read: {root_cause(error)}") from error
            scaled = values.astype(np.float64) * dataset.scales[0] + dataset.offsets[0]
        return np.where(valid, scaled, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class HeldDem(Dem):
    """A DEM a window of which is held in memory: lines of sight are followed without reading it again."""

    window: Window
    values: Float64
    """(rows, cols) heights in the file's unit; NaN in holes."""

    def _read(self, window: Window) -> Float64:
        if window.intersection(self.window) != window:
            return Dem._read(self, window)
        return self.values[window.slices_in(self.window)]


def bilinear(values: Float64, index_xy: Float64) -> Float64:
    """Interpolate the (rows, cols) `values` at (n, 2) indices `index_xy` inside, (n,) numbers.

    They are NaN where a neighbour with a weight is.
    """
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


def open_dem(path: str | os.PathLike[str], vertical: Vertical, bounds: Bounds) -> Dem:
    """Describe a DEM and determine its vertical datum.

    Band 1 holds the heights, in metres unless its CRS or its unit says feet. `vertical` is the height of the
    DEM's vertical datum above the ellipsoid in metres (a geoid's undulation; 0 for ellipsoidal heights), a
    raster of such heights, or None: the vertical datum of the DEM's CRS. The `bounds` of the scene are west,
    south, east, north in degrees. Raises `InputError` if the DEM cannot be used, or its vertical datum is not
    known or cannot be transformed.
    """
    info = describe(path)
    if not info.georeferenced or info.grid.crs is None:
        raise InputError(f"the DEM {info.uri} has no georeferencing (CRS and geotransform): assign it")
    crs, horizontal = to_pyproj(info.grid.crs), info.grid.crs
    if crs.is_compound:
        code = crs.sub_crs_list[0].to_epsg()
        horizontal = CRS.from_epsg(code) if code else CRS.from_wkt(crs.sub_crs_list[0].to_wkt())
    grid = Grid(info.grid.shape, info.grid.transform, horizontal)
    return Dem(info.uri, grid, _metres_per_unit(info, crs), _undulation(info, crs, vertical, bounds))


def _metres_per_unit(info: RasterInfo, crs: pyproj.CRS) -> float:
    vertical = crs.sub_crs_list[1] if crs.is_compound else crs
    up = [axis for axis in vertical.axis_info if axis.direction == "up"]
    if up:
        return float(up[0].unit_conversion_factor)
    with open_raster(info.uri) as dataset:
        unit = (dataset.units[0] or "").strip().lower()
    return _UNITS_M.get(unit, 1.0)


def _undulation(info: RasterInfo, crs: pyproj.CRS, vertical: Vertical, bounds: Bounds) -> Undulation:
    if isinstance(vertical, int | float):
        return Undulation.constant(vertical)
    if vertical is not None:
        return _from_grid(os.fspath(vertical), bounds)
    if crs.is_compound:
        return _from_crs(info, crs, bounds)
    if any(axis.direction == "up" for axis in crs.axis_info):  # three-dimensional: ellipsoidal
        return Undulation.constant(0.0)
    raise InputError(
        f"the CRS of the DEM {info.uri} ({name_of(info.grid.crs)}) does not say what its heights are above: "
        "give --dem-vertical 0 if it is the WGS 84 ellipsoid, else the geoid's height above the ellipsoid "
        "there in metres (about -100 to 85), or a geoid grid file"
    )


def _from_grid(path: str, bounds: Bounds) -> Undulation:
    """Sample a file of undulations, whose longitudes may extend to 180 or to 360 degrees."""
    if not Path(path).exists() and ":" not in path and not path.startswith("/vsi"):
        raise InputError(f"--dem-vertical {path}: neither a number of metres nor a file that exists")
    info = describe(path)
    if not info.georeferenced:
        raise InputError(f"the geoid grid {path} has no georeferencing (CRS and geotransform): assign it")
    geoid = Dem(info.uri, info.grid, 1.0, Undulation.constant(0.0))
    undulation = Undulation.sampled(geoid.at, bounds, DEMS.undulation_step_deg)
    if not np.isfinite(undulation.values_m).all():
        raise InputError(
            f"the geoid grid {path} does not cover the target ({in_words(bounds)}): give one that does, or "
            "the undulation in metres"
        )
    if np.abs(undulation.values_m).max() > DEMS.max_undulation_m:
        raise InputError(
            f"the geoid grid {path} holds {np.abs(undulation.values_m).max():.0f} m: no geoid is as far from "
            "the ellipsoid; give a file of undulations, not of heights"
        )
    return undulation


def _from_crs(info: RasterInfo, crs: pyproj.CRS, bounds: Bounds) -> Undulation:
    """Determine the height of the vertical datum above the ellipsoid by PROJ, never by a ballpark one."""
    advice = (
        "give --dem-vertical: the geoid's height above the ellipsoid there in metres, or a geoid grid file"
    )
    what = f"the heights of the DEM {info.uri} ({crs.name}) cannot be transformed to the ellipsoid"
    # from geographic coordinates: only the vertical part is needed
    geographic = pyproj.CRS.from_epsg(4326)
    source = pyproj.crs.CompoundCRS("DEM", [geographic, crs.sub_crs_list[1]])
    try:
        with ignoring(UserWarning):  # pyproj's own warning about missing grids
            group = TransformerGroup(source, ELLIPSOIDAL, always_xy=True, allow_ballpark=False)
    except ProjError as error:
        raise InputError(f"{what}: {error}; {advice}") from error
    if not group.transformers:
        grids = sorted({grid.short_name for op in group.unavailable_operations for grid in op.grids})
        missing = f"PROJ lacks the grid {' or '.join(grids)}" if grids else "PROJ knows no transformation"
        raise InputError(f"{what}: {missing} (a ballpark one would be off by the undulation); {advice}")
    transformer = group.transformers[0]

    def at(lon_lat: Float64) -> Float64:
        return with_arrays(transformer.transform, lon_lat[:, 0], lon_lat[:, 1], np.zeros(len(lon_lat)))[2]

    undulation = Undulation.sampled(at, bounds, DEMS.undulation_step_deg)
    if not np.isfinite(undulation.values_m).all():
        raise InputError(f"{what} at {in_words(bounds)}; {advice}")
    return undulation


def in_words(bounds: Bounds) -> str:
    """Return west, south, east and north, degrees, as text for messages."""
    west, south, east, north = bounds
    return f"longitude {west:.4f} to {east:.4f}, latitude {south:.4f} to {north:.4f}"


def relief(
    dem: Dem | None, frame: Grid, ground_px: Float64, window_px: float, dem_px: Float64
) -> tuple[Float64, Float64]:
    """Return what moving a DEM does to the heights at the (n, 2) `ground_px` of the `frame`.

    Returned are the (n,) metres by which it is higher there once moved by the (2,) `dem_px` (col, row), its
    px, and its (n, 2) slope then, m per px of the DEM. Both are medians over windows of `window_px`: the
    place of least absolute deviation is that of most of a window.
    """
    if dem is None:
        return np.zeros(len(ground_px)), np.zeros((len(ground_px), 2))
    lon_lat = transform_xy(frame.to_xy(ground_px), frame.crs, WGS84)
    rate = jacobian(frame.middle_px, frame, dem.grid)[0]
    at_px = map_px(ground_px, frame, dem.grid)
    count = 5 if window_px > 0 else 1
    parts = (np.arange(count) + 0.5) / count - 0.5
    offsets_px = np.stack(np.meshgrid(parts, parts), axis=-1).reshape(-1, 2) * window_px @ rate.T
    step_px = max(1.0, 0.5 * window_px / count * float(np.sqrt(abs(np.linalg.det(rate)))))
    unmoved = [dem.at_px(at_px + offset_px, lon_lat) for offset_px in offsets_px]

    def higher(by_px: Float64) -> Float64:
        heights = [dem.at_px(at_px + offset_px - by_px, lon_lat) for offset_px in offsets_px]
        change = np.stack(heights) - np.stack(unmoved)
        finite = np.isfinite(change).any(axis=0)
        result = np.zeros(len(at_px))
        result[finite] = np.nanmedian(change[:, finite], axis=0)
        return result

    # higher where the ground rises against the direction in which the DEM is moved
    ends = [higher(dem_px - step) - higher(dem_px + step) for step in step_px * np.eye(2)]
    return higher(dem_px), np.stack(ends, axis=1) / (2 * step_px)
