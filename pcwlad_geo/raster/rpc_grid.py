"""The pixels of a raster that an RPC and the ground's height place, not a geotransform."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from pcwlad_geo.correction.rpc_model import RpcModel
from pcwlad_geo.raster.dem import WGS84, ConstantHeight, Dem
from pcwlad_geo.raster.grid import Grid, apply, apply_inverse, composed, map_px
from pcwlad_geo.raster.resample import sample_positions
from pcwlad_geo.raster.windows import Window

Array = NDArray[np.float64]

HEIGHT_TOLERANCE_M: Final = 1e-4
ITERATIONS: Final = 40
MOST_POSITIONS: Final = 1 << 18
"""At a time."""


@dataclass(frozen=True, slots=True)
class RpcGrid(Grid):
    """A grid whose map coordinates are longitude and latitude on the ground; NaN where no height is known."""

    rpc: RpcModel
    """Of the file's pixels, to which `transform` maps those of this grid (an overview's, a part's)."""
    heights: ConstantHeight | Dem

    @staticmethod
    def of_file(shape: tuple[int, int], rpc: RpcModel, heights: ConstantHeight | Dem) -> RpcGrid:
        """Return the grid of a file's own pixels."""
        return RpcGrid(shape, Affine.identity(), WGS84, rpc, heights)

    def to_xy(self, pixel_xy_px: Array) -> Array:
        """Map (n, 2) pixel coordinates (col, row) to (n, 2) longitude, latitude of the ground they show."""
        file_px = apply(self.transform, pixel_xy_px)
        height = np.full(len(file_px), self.rpc.height_off)
        lon_lat = self.rpc.to_ground(file_px, height)
        for _ in range(ITERATIONS):
            found = self.heights.at(lon_lat)
            step = found - height
            height = found
            lon_lat = self.rpc.to_ground(file_px, height)
            if not np.any(np.abs(step) > HEIGHT_TOLERANCE_M):  # NaN: no height there
                break
        return lon_lat

    def to_px(self, xy: Array) -> Array:
        """Map (n, 2) longitude, latitude to (n, 2) pixel coordinates (col, row) of the ground there."""
        xy = np.asarray(xy, dtype=np.float64)
        return self.file_to_own_px(self.rpc.to_px(np.column_stack([xy, self.heights.at(xy)])))

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
    return replace(grid, heights=ConstantHeight(grid.rpc.height_off))


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
    geographic = Grid(view_grid.shape, Affine.identity(), grid.crs)

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
