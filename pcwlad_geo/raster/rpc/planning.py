"""The map grid on which a pair is matched of which a raster has an RPC."""

from __future__ import annotations

import numpy as np
import shapely
from affine import Affine

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_grid, check_pixel_ratio
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.grid import Grid, Window, jacobian
from pcwlad_geo.raster.matching_grid import MATCHING_GRIDS, ViewPair
from pcwlad_geo.raster.rpc.grid import RpcGrid, at_mean_height, footprint_px
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.view import View


def plan_rpc_views(reference: RasterInfo, target: RasterInfo) -> ViewPair:
    """Plan the matching on a map grid at the coarser pixel size, each raster resampled by its RPC.

    Raises `InputError` if the two do not overlap. Each of the two is georeferenced or the result of
    `place_by_rpc`, at least one of them the latter.
    """
    ground = ground_grid(reference.grid)
    rows, cols = ground.shape
    outline = footprint_px(target.grid, ground)
    common = outline.intersection(footprint_px(reference.grid, ground))
    if common.area < 1.0:
        raise InputError(_no_overlap(reference, target, ground, outline))
    centre = np.array([[common.centroid.x, common.centroid.y]])
    steps = jacobian(centre, ground, at_mean_height(target.grid))[0]
    if np.isfinite(steps).all():
        check_pixel_ratio(reference.uri, target.uri, np.linalg.svd(steps, compute_uv=False).tolist())
    size = np.sqrt(abs(np.linalg.det(steps)))
    coarser, factor = ground, 1.0 / float(size)
    if np.isfinite(size) and size < MATCHING_GRIDS.finer:
        coarser = ground.scaled((max(1, round(rows / factor)), max(1, round(cols / factor))))
    reference_view = View(reference, coarser, "none" if coarser is reference.grid else "cubic")
    scale = np.array([coarser.shape[1] / cols, coarser.shape[0] / rows])
    low, high = np.array(common.bounds).reshape(2, 2) * scale
    box = Window.around(low, high)
    around = box.padded(MATCHING_GRIDS.margin_px)
    view = View(target, coarser.part((around.col, around.row), around.shape), "cubic")
    offset = (float(-around.col), float(-around.row))
    return ViewPair(reference_view, view, offset, box.clipped(coarser.shape), ())


def ground_grid(grid: Grid) -> Grid:
    """Return the map grid onto which a raster with an RPC is orthorectified; other grids are unchanged.

    The grid is north up; its pixels are square, with the size of the raster's along its finer axis rounded to
    two digits, and are aligned to multiples of their size. Raises `InputError` if no part of the raster can
    be placed in its CRS.
    """
    if not isinstance(grid, RpcGrid):
        return grid
    unit = Grid((1, 1), Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0), grid.crs)
    outline = footprint_px(grid, unit)
    step = jacobian(grid.middle_px, at_mean_height(grid), unit)[0]
    size = float(np.hypot(*step).min())
    if outline.is_empty or not np.isfinite(size) or size <= 0.0:
        raise InputError(
            f"the raster's footprint cannot be placed in {name_of(grid.crs)} by its RPC: check RPC and DEM"
        )
    size = float(f"{size:.1e}")
    left, top, right, bottom = (np.array(outline.bounds) / size).tolist()
    low, high = np.floor([left, top]), np.ceil([right, bottom])
    check_grid(
        "the raster laid on the ground by its RPC", (high - low).tolist(), grid.shape[0] * grid.shape[1]
    )
    cols, rows = (high - low).astype(int).tolist()
    x, y = (low * size).tolist()
    return Grid((rows, cols), Affine(size, 0.0, x, 0.0, -size, -y), grid.crs)


def _no_overlap(reference: RasterInfo, target: RasterInfo, ground: Grid, outline: shapely.Geometry) -> str:
    """Return the message for rasters that do not overlap, with their positions."""
    rows, cols = ground.shape
    (left, top), (right, bottom) = ground.to_xy(np.array([[0.0, 0.0], [cols, rows]])).tolist()
    by_rpc = "by its RPC " if isinstance(target.grid, RpcGrid) else ""
    where = "nowhere"
    if not outline.is_empty:
        corners = np.array(outline.bounds).reshape(2, 2)
        (x0, y0), (x1, y1) = ground.to_xy(corners).tolist()
        where = f"at x {x0:.10g} to {x1:.10g}, y {y1:.10g} to {y0:.10g}"
    return (
        f"the rasters do not overlap: {reference.uri} covers x {left:.10g} to {right:.10g}, y "
        f"{bottom:.10g} to {top:.10g}, and {by_rpc}{target.uri} lies {where}: give two rasters of the same "
        "ground, and the RPC that belongs to the target as it is (not that of the image it was cropped from)"
    )
