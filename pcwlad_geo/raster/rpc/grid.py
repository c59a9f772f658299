"""Grids whose pixels are related to the ground by an RPC and heights instead of a geotransform."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import shapely
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.raster.crs import WGS84, transform_xy
from pcwlad_geo.raster.grid import Grid, Window, apply, apply_inverse, map_px
from pcwlad_geo.raster.resampling import sample_positions
from pcwlad_geo.raster.rpc.dem import ConstantHeight, Dem
from pcwlad_geo.raster.rpc.line_shifts import LineShifts
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.types import Float64

OUTLINE_NODES: Final = 65
"""Number of points along a side of an image with which its extent on the ground is determined."""


@dataclass(frozen=True, slots=True)
class RpcGrid(Grid):
    """A grid whose map coordinates, in its CRS, are those of the ground seen by its pixels."""

    rpc: RpcModel
    """RPC of the file's pixels, to which `transform` maps those of this grid (of an overview, a part)."""
    heights: ConstantHeight | Dem
    level_m: float
    """Approximate height of the ground, from which lines of sight start and at which pixels are measured."""
    shifts: LineShifts | None = field(default=None, compare=False, kw_only=True)
    """How far the lines of the file lie from the RPC, if they do."""

    @staticmethod
    def of_file(
        shape: tuple[int, int],
        rpc: RpcModel,
        heights: ConstantHeight | Dem,
        *,
        level_m: float | None = None,
        crs: CRS = WGS84,
        shifts: LineShifts | None = None,
    ) -> RpcGrid:
        """Return the grid of a file's own pixels.

        The ground is near `level_m` above the ellipsoid, by default the RPC's height offset; `crs` is that of
        the map coordinates.
        """
        if level_m is None:
            level_m = heights.height_m if isinstance(heights, ConstantHeight) else rpc.height_off
        return RpcGrid(shape, Affine.identity(), crs, rpc, heights, level_m, shifts=shifts)

    @property
    def turn(self) -> float:
        """Infinite: the RPC takes longitudes of any turn around the earth."""
        return math.inf

    def to_xy(self, pixel_xy_px: Float64) -> Float64:
        """Map (n, 2) `pixel_xy_px` (col, row) to the (n, 2) map coordinates (x, y) of the ground they see.

        Beyond the edge of a DEM the height of the edge is used; NaN in holes of the DEM.
        """
        lon_lat, height = self.line_of_sight(pixel_xy_px)
        return transform_xy(np.where(np.isnan(height)[:, None], np.nan, lon_lat), WGS84, self.crs)

    def to_px(self, xy: Float64) -> Float64:
        """Map (n, 2) map coordinates `xy` to the (n, 2) pixels (col, row) there; NaN without height."""
        lon_lat = transform_xy(np.asarray(xy, dtype=np.float64), self.crs, WGS84)
        return self.rpc_to_own_px(self.rpc.to_px(np.column_stack([lon_lat, self.heights.at(lon_lat)])))

    def line_of_sight(self, pixel_xy_px: Float64) -> tuple[Float64, Float64]:
        """Intersect lines of sight of the (n, 2) `pixel_xy_px` (col, row) with the ground, from `level_m` on.

        Return the (n, 2) longitude and latitude of the intersections, degrees, and the (n,) height of the
        ground there above the ellipsoid, metres; beyond the edge of a DEM that of the edge, NaN in holes of
        the DEM.
        """
        file_px = apply(self.transform, pixel_xy_px)
        file_px = self.shifts.to_rpc(file_px) if self.shifts else file_px
        height = np.full(len(file_px), self.level_m)
        lon_lat = self.rpc.to_ground(file_px, height)
        for _ in range(40):
            heights = self.heights.nearest(lon_lat)
            step = np.where(np.isnan(heights), 0.0, heights - height)  # a hole may be crossed
            height = height + step
            lon_lat = self.rpc.to_ground(file_px, height, lon_lat)
            if not np.any(np.abs(step) > 1e-4):
                break
        return lon_lat, np.where(np.isnan(heights), np.nan, height)

    def rpc_to_own_px(self, rpc_px: Float64) -> Float64:
        """Map (n, 2) pixels `rpc_px` (col, row) that the RPC gives to (n, 2) pixels of this grid."""
        return apply_inverse(self.transform, self.shifts.to_file(rpc_px) if self.shifts else rpc_px)


def at_mean_height(grid: Grid) -> Grid:
    """Return a grid at a constant height, whose pixel sizes do not depend on the slope of the ground."""
    if not isinstance(grid, RpcGrid):
        return grid
    return replace(grid, heights=ConstantHeight(grid.level_m))


def with_height_offset(grid: Grid, by_m: float) -> Grid:
    """Return a grid with ground higher by so many metres; a grid without heights is unchanged."""
    if not isinstance(grid, RpcGrid):
        return grid
    if isinstance(grid.heights, ConstantHeight):
        return replace(grid, heights=ConstantHeight(grid.heights.height_m + by_m))
    heights: Dem = grid.heights
    values = tuple(value + by_m for value in heights.undulation.values_m)
    return replace(grid, heights=replace(heights, undulation=replace(heights.undulation, values_m=values)))


def image_px(grid: Grid, frame: Grid, ground_px: Float64, height_m: Float64 | None) -> Float64:
    """Return the (n, 2) px of an image that see the (n, 2) `ground_px` of the frame, at its own heights.

    The (n,) `height_m` are known ones above the ellipsoid; NaN where they are not.
    """
    at_px = map_px(ground_px, frame, grid)
    if height_m is None or not isinstance(grid, RpcGrid):
        return at_px
    lon_lat = transform_xy(frame.to_xy(ground_px), frame.crs, WGS84)
    from_heights = grid.rpc_to_own_px(grid.rpc.to_px(np.column_stack([lon_lat, height_m])))
    return np.where(np.isfinite(height_m)[:, None], from_heights, at_px)


def footprint_px(grid: Grid, onto: Grid) -> shapely.Geometry:
    """Return the footprint of a raster on the ground, as far as heights are known.

    It is a convex outline, px (col, row) of the grid `onto`; empty where there is none.
    """
    at_px = map_px(grid.lattice_px(OUTLINE_NODES), grid, onto)
    outline = shapely.MultiPoint(at_px[np.isfinite(at_px).all(axis=1)]).convex_hull
    if not (isinstance(grid, RpcGrid) and isinstance(grid.heights, Dem)):
        return outline
    dem = grid.heights.grid
    dem_outline = map_px(dem.boundary_px(), dem, onto)
    if not np.isfinite(dem_outline).all():  # the DEM covers half the earth
        return outline
    edge = shapely.Polygon(dem_outline)
    return outline.intersection(edge) if edge.is_valid else outline


def positions_on(grid: RpcGrid, view_grid: Grid, window: Window, per_px: int) -> Float64:
    """Return the positions in an RPC raster of the pixels of a view's window.

    The map projections are interpolated between nodes; heights and the RPC are evaluated at every position,
    `per_px` along a side of a view pixel, because relief displaces the image from pixel to pixel. The result,
    (2, rows * per_px, cols * per_px), holds rows and columns in the raster, px, corner-based; NaN where no
    height is known.
    """
    # in strips: heights and the RPC need many times the memory of the positions
    step = max(1, (1 << 18) // (window.cols * per_px**2))
    strips = [
        Window(row, window.col, min(step, window.row_stop - row), window.cols)
        for row in range(window.row, window.row_stop, step)
    ]
    return np.concatenate([_positions(grid, view_grid, strip, per_px) for strip in strips], axis=1)


def _positions(grid: RpcGrid, view_grid: Grid, window: Window, per_px: int) -> Float64:
    geographic = Grid(view_grid.shape, Affine.identity(), WGS84)

    def sampled(onto: Grid) -> Float64:
        rc = sample_positions(window, per_px, lambda px: map_px(px, view_grid, onto))
        return np.stack([rc[1].ravel(), rc[0].ravel()], axis=1)

    lon_lat = sampled(geographic)
    heights = grid.heights
    height = (
        heights.at_px(sampled(heights.grid), lon_lat) if isinstance(heights, Dem) else heights.at(lon_lat)
    )
    own_px = grid.rpc_to_own_px(grid.rpc.to_px(np.column_stack([lon_lat, height])))
    return np.ascontiguousarray(own_px[:, ::-1].T).reshape(2, window.rows * per_px, window.cols * per_px)
