"""The pixels of a raster that an RPC and the ground's height place, not a geotransform."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.correction.rpc_model import RpcModel
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.dem import WGS84, ConstantHeight, Dem
from pcwlad_geo.raster.grid import Grid, apply, apply_inverse, composed, map_px
from pcwlad_geo.raster.resample import sample_positions
from pcwlad_geo.raster.windows import Window

Array = NDArray[np.float64]

HEIGHT_TOLERANCE_M: Final = 1e-4
ITERATIONS: Final = 40
MOST_POSITIONS: Final = 1 << 18
"""At a time."""
LATTICE: Final = 65
"""Points along a side of an image that tell how far it reaches on the ground."""


@dataclass(frozen=True, slots=True)
class RpcGrid(Grid):
    """A grid whose map coordinates, in its CRS, are those of the ground that its pixels show."""

    rpc: RpcModel
    """Of the file's pixels, to which `transform` maps those of this grid (an overview's, a part's)."""
    heights: ConstantHeight | Dem
    level_m: float
    """About how high the ground is: where lines of sight are followed from, and pixels are measured."""

    @staticmethod
    def of_file(
        shape: tuple[int, int],
        rpc: RpcModel,
        heights: ConstantHeight | Dem,
        *,
        level_m: float | None = None,
        crs: CRS = WGS84,
    ) -> RpcGrid:
        """Return the grid of a file's own pixels; the ground is about as high as the RPC's height offset."""
        if level_m is None:
            level_m = heights.height_m if isinstance(heights, ConstantHeight) else rpc.height_off
        return RpcGrid(shape, Affine.identity(), crs, rpc, heights, level_m)

    def to_xy(self, pixel_xy_px: Array) -> Array:
        """Map (n, 2) pixel coordinates (col, row) to (n, 2) map coordinates of the ground that they show.

        Beyond the edge of a DEM the ground is taken to be as high as at the edge; NaN in holes of the DEM.
        """
        lon_lat, height = self.line_of_sight(pixel_xy_px)
        return transform_xy(np.where(np.isnan(height)[:, None], np.nan, lon_lat), WGS84, self.crs)

    def to_px(self, xy: Array) -> Array:
        """Map (n, 2) map coordinates to (n, 2) pixels (col, row) of the ground there; NaN without height."""
        lon_lat = transform_xy(np.asarray(xy, dtype=np.float64), self.crs, WGS84)
        return self.file_to_own_px(self.rpc.to_px(np.column_stack([lon_lat, self.heights.at(lon_lat)])))

    def line_of_sight(self, pixel_xy_px: Array) -> tuple[Array, Array]:
        """Follow lines of sight to the ground, from `level_m` on.

        Returns
        -------
        lon_lat : (n, 2) array
            Longitude, latitude.
        height_m : (n,) array
            Of the ground there, that of the DEM's edge beyond it; NaN in holes of the DEM.
        """
        file_px = apply(self.transform, pixel_xy_px)
        height = np.full(len(file_px), self.level_m)
        lon_lat = self.rpc.to_ground(file_px, height)
        for _ in range(ITERATIONS):
            found = self.heights.nearest(lon_lat)
            step = np.where(np.isnan(found), 0.0, found - height)  # a hole may lie on the way
            height = height + step
            lon_lat = self.rpc.to_ground(file_px, height)
            if not np.any(np.abs(step) > HEIGHT_TOLERANCE_M):
                break
        return lon_lat, np.where(np.isnan(found), np.nan, height)

    def file_to_own_px(self, file_px: Array) -> Array:
        """Map (n, 2) pixels of the file to those of this grid."""
        return apply_inverse(self.transform, file_px)

    def remade(
        self,
        linear: tuple[tuple[float, float], tuple[float, float]],
        origin_px: tuple[float, float],
        shape: tuple[int, int],
    ) -> RpcGrid:
        """Return the grid whose pixel p lies at linear · p + origin of this grid's pixels (col, row)."""
        return replace(self, shape=shape, transform=composed(self.transform, linear, origin_px))


def levelled(grid: Grid) -> Grid:
    """Return a grid without the relief below it: its pixel sizes are those of the sensor, not of a slope."""
    if not isinstance(grid, RpcGrid):
        return grid
    return replace(grid, heights=ConstantHeight(grid.level_m))


def footprint_px(grid: Grid, onto: Grid) -> shapely.Geometry:
    """Return what a raster shows of the ground, as far as its heights are known.

    Parameters
    ----------
    grid : Grid
        Of the raster.
    onto : Grid
        In whose pixels the outline is wanted.

    Returns
    -------
    shapely.Geometry
        A convex outline, (col, row); empty where there is none.
    """
    placed = map_px(lattice_px(grid.shape), grid, onto)
    outline = shapely.MultiPoint(placed[np.isfinite(placed).all(axis=1)]).convex_hull
    if not (isinstance(grid, RpcGrid) and isinstance(grid.heights, Dem)):
        return outline
    dem = grid.heights.grid
    known = map_px(dem.boundary_px(), dem, onto)
    if not np.isfinite(known).all():  # a DEM of half the earth
        return outline
    edge = shapely.Polygon(known)
    return outline.intersection(edge) if edge.is_valid else outline


def lattice_px(shape: tuple[int, int], points_per_side: int = LATTICE) -> Array:
    """Return (n, 2) pixels (col, row) spread evenly over a raster of (rows, cols), edges included."""
    rows, cols = shape
    col, row = np.meshgrid(np.linspace(0, cols, points_per_side), np.linspace(0, rows, points_per_side))
    return np.column_stack([col.ravel(), row.ravel()])


def positions_on(grid: RpcGrid, view_grid: Grid, window: Window, per_px: int) -> Array:
    """Return where the pixels of a view's window lie in an RPC raster.

    The map projections are interpolated between nodes; heights and RPC are taken at every position, as
    relief bends the image from pixel to pixel.

    Parameters
    ----------
    grid : RpcGrid
        Of the raster.
    view_grid : Grid
    window : Window
        Of the view.
    per_px : int
        Positions along a side of a view pixel.

    Returns
    -------
    (2, rows * per_px, cols * per_px) array
        Rows and columns, corner-based; NaN where no height is known.
    """
    # in strips: heights and RPC take many times the memory of the positions
    step = max(1, MOST_POSITIONS // (window.cols * per_px**2))
    strips = [
        Window(row, window.col, min(step, window.row_stop - row), window.cols)
        for row in range(window.row, window.row_stop, step)
    ]
    return np.concatenate([_positions(grid, view_grid, strip, per_px) for strip in strips], axis=1)


def _positions(grid: RpcGrid, view_grid: Grid, window: Window, per_px: int) -> Array:
    geographic = Grid(view_grid.shape, Affine.identity(), WGS84)

    def sampled(onto: Grid) -> Array:
        rc = sample_positions(window, per_px, lambda px: map_px(px, view_grid, onto))
        return np.stack([rc[1].ravel(), rc[0].ravel()], axis=1)

    lon_lat = sampled(geographic)
    heights = grid.heights
    height = (
        heights.at_px(sampled(heights.grid), lon_lat) if isinstance(heights, Dem) else heights.at(lon_lat)
    )
    own = grid.file_to_own_px(grid.rpc.to_px(np.column_stack([lon_lat, height])))
    return np.ascontiguousarray(own[:, ::-1].T).reshape(2, window.rows * per_px, window.cols * per_px)
