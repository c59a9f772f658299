"""A target with RPCs: its place on the ground, and the grid that it is matched on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.dem import ConstantHeight, Dem
from pcwlad_geo.raster.dem_vertical import Vertical, open_dem
from pcwlad_geo.raster.grid import Grid, jacobian, map_px
from pcwlad_geo.raster.matching_grid import MARGIN_PX, ViewPair
from pcwlad_geo.raster.rpc_files import RpcSource, check_domain
from pcwlad_geo.raster.rpc_grid import RpcGrid, levelled
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.view import View
from pcwlad_geo.raster.windows import Window

Array = NDArray[np.float64]

LATTICE: Final = 33
"""Points along a side of the target at which its place on the ground is looked at."""
RELIEF_M: Final = 100.0
MARGIN_SHARE: Final = 0.05
"""Of the scene's extent, what an undulation is known around it."""
LOWEST_M: Final = -600.0
HIGHEST_M: Final = 9500.0
"""Of the ground, with room."""
ALL: Final = 0.999
"""Share of the target that a DEM covers whole."""
_FINER: Final = 0.99


@dataclass(frozen=True, slots=True)
class Placed:
    """A target that its RPC and the ground's height place."""

    info: RasterInfo
    """Its grid is an `RpcGrid`."""
    source: RpcSource
    heights_m: tuple[float, float]
    """Lowest and highest ground below it, above the ellipsoid; the RPC's own range without a DEM."""
    warnings: tuple[str, ...]


def place_by_rpc(info: RasterInfo, source: RpcSource, dem: str | None, vertical: Vertical) -> Placed:
    """Place a raster on the ground by its RPC.

    Parameters
    ----------
    info : RasterInfo
    source : RpcSource
        Its RPC.
    dem : str, optional
        Path or GDAL URI of a DEM; without it the ground is as high as the RPC's height offset.
    vertical : float, path-like or None
        See `dem_vertical.open_dem`.

    Raises
    ------
    InputError
        If RPC, DEM and raster do not fit together, or the DEM's heights mean nothing known.
    """
    check_domain(source, info.uri, info.grid.shape)
    if info.mask_grid is not None and info.mask_grid.crs is not None:
        raise InputError(
            f"the mask {info.mask_uri} lies on the ground and {info.uri} is in the sensor's geometry: give a "
            "mask of the target's own pixels, without georeferencing"
        )
    rpc = source.rpc
    if dem is None:
        heights: ConstantHeight | Dem = ConstantHeight(rpc.height_off)
    else:
        heights = open_dem(dem, vertical, _scene_bounds(source, info))
    grid = RpcGrid.of_file(info.grid.shape, rpc, heights)
    placed = replace(info, grid=grid, georeferenced=True)
    if isinstance(heights, ConstantHeight):
        span = (rpc.height_off - rpc.height_scale, rpc.height_off + rpc.height_scale)
        return Placed(placed, source, span, (*source.warnings, _relief_warning(grid)))
    lowest, highest, warnings = _look_at_dem(placed, grid, heights)
    return Placed(placed, source, (lowest, highest), (*source.warnings, *warnings))


def plan_rpc_views(reference: RasterInfo, target: RasterInfo) -> ViewPair:
    """Plan the matching in the reference's CRS, at the coarser pixel size, the target seen through its RPC.

    Parameters
    ----------
    reference : RasterInfo
        Georeferenced.
    target : RasterInfo
        Placed by `place_by_rpc`.

    Raises
    ------
    InputError
        If the two do not overlap.
    """
    lattice = map_px(_lattice_px(target.grid), target.grid, reference.grid)
    lattice = lattice[np.isfinite(lattice).all(axis=1)]
    rows, cols = reference.grid.shape
    common = shapely.MultiPoint(lattice).convex_hull.intersection(shapely.box(0, 0, cols, rows))
    if common.area < 1.0:
        (left, top), (right, bottom) = reference.grid.to_xy(np.array([[0.0, 0.0], [cols, rows]])).tolist()
        (x0, y0), (x1, y1) = (
            reference.grid.to_xy(side(lattice, axis=0)[None])[0] for side in (np.min, np.max)
        )
        raise InputError(
            f"the rasters do not overlap: {reference.uri} covers x {left:.10g} to {right:.10g}, y "
            f"{bottom:.10g} to {top:.10g}, and by its RPC {target.uri} lies at x {x0:.10g} to {x1:.10g}, y "
            f"{y1:.10g} to {y0:.10g}: give two rasters of the same ground, and the RPC that belongs to the "
            "target as it is (not that of the image it was cropped from)"
        )
    centre = np.array([[common.centroid.x, common.centroid.y]])
    size = np.sqrt(abs(np.linalg.det(jacobian(centre, reference.grid, levelled(target.grid))[0])))
    if np.isfinite(size) and size < _FINER:
        coarser = _coarser(reference.grid, 1.0 / float(size))
        own = View(reference, coarser, "cubic")
    else:
        coarser, own = reference.grid, View(reference, reference.grid, "none")
    scale = np.array([coarser.shape[1] / cols, coarser.shape[0] / rows])
    left, top, right, bottom = (np.array(common.bounds).reshape(2, 2) * scale).ravel().tolist()
    box = Window.from_bounds(
        int(np.floor(top)), int(np.floor(left)), int(np.ceil(bottom)), int(np.ceil(right))
    )
    around = box.padded(MARGIN_PX)
    view = View(target, coarser.part((around.col, around.row), around.shape), "cubic")
    offset = (float(-around.col), float(-around.row))
    return ViewPair(own, view, offset, box.clipped(coarser.shape), ())


def _coarser(grid: Grid, factor: float) -> Grid:
    """Return the grid of the same corner and extent, its pixels so many times as large."""
    rows, cols = grid.shape
    return grid.scaled((max(1, round(rows / factor)), max(1, round(cols / factor))))


def _lattice_px(grid: Grid) -> Array:
    rows, cols = grid.shape
    col, row = np.meshgrid(np.linspace(0, cols, LATTICE), np.linspace(0, rows, LATTICE))
    return np.column_stack([col.ravel(), row.ravel()])


def _scene_bounds(source: RpcSource, info: RasterInfo) -> tuple[float, float, float, float]:
    """Return west, south, east, north of the image at any height that its RPC allows, with a margin."""
    rpc, pixels = source.rpc, _lattice_px(info.grid)
    found = np.concatenate(
        [rpc.to_ground(pixels, rpc.height_off + side * rpc.height_scale) for side in (-1.0, 0.0, 1.0)]
    )
    found = found[np.isfinite(found).all(axis=1)]
    if len(found) == 0:
        raise InputError(
            f"the RPC in {source.origin} places no pixel of {info.uri} on the ground: get it again"
        )
    low, high = found.min(axis=0), found.max(axis=0)
    margin = MARGIN_SHARE * (high - low)
    west, south, east, north = np.concatenate([low - margin, high + margin]).tolist()
    return west, south, east, north


def _look_at_dem(placed: RasterInfo, grid: RpcGrid, dem: Dem) -> tuple[float, float, tuple[str, ...]]:
    """Return lowest and highest ground below the image, and what the DEM does not cover.

    Raises
    ------
    InputError
        If the DEM does not overlap the image, or has holes below it.
    """
    rpc, pixels = grid.rpc, _lattice_px(grid)
    level = rpc.to_ground(pixels, rpc.height_off)
    dem_px = dem.to_px(level)
    size = np.array(dem.grid.shape[::-1])
    with np.errstate(invalid="ignore"):
        covered = ((dem_px >= 0) & (dem_px <= size)).all(axis=1)
    if not covered.any():
        (west, south), (east, north) = np.nanmin(level, axis=0), np.nanmax(level, axis=0)
        raise InputError(
            f"the DEM {dem.uri} and {placed.uri} do not overlap: by its RPC the image lies at longitude "
            f"{west:.4f} to {east:.4f}, latitude {south:.4f} to {north:.4f}; give the DEM of this ground"
        )
    holes = count_holes(dem, dem_px[covered])
    if holes:
        raise InputError(
            f"the DEM {dem.uri} has holes below {placed.uri}: {holes} of its pixels have no height; fill "
            "them first (gdal_fillnodata.py DEM FILLED), or give another DEM"
        )
    heights = dem.at_px(dem_px, level)
    lowest, highest = np.nanmin(heights), np.nanmax(heights)
    if not LOWEST_M <= lowest <= highest <= HIGHEST_M:
        raise InputError(
            f"the DEM {dem.uri} holds heights from {lowest:.0f} to {highest:.0f} m below {placed.uri}: check "
            "its unit and its nodata value"
        )
    heights = dem.at(grid.to_xy(pixels))
    if not np.isfinite(heights).any():
        raise InputError(
            f"the DEM {dem.uri} gives no height below {placed.uri}: give one that covers the image"
        )
    share = covered.mean()
    warnings = []
    if share < ALL:
        warnings.append(
            f"the DEM {dem.uri} covers {share:.0%} of {placed.uri}: the rest is neither matched nor warped"
        )
    return float(np.nanmin(heights)), float(np.nanmax(heights)), tuple(warnings)


def count_holes(dem: Dem, dem_px: Array) -> int:
    """Count the pixels of a DEM without height in the box around (n, 2) of its pixels (col, row)."""
    low = np.floor(dem_px.min(axis=0)).astype(int)
    high = np.ceil(dem_px.max(axis=0)).astype(int)
    box = Window.from_bounds(int(low[1]), int(low[0]), int(high[1]), int(high[0])).clipped(dem.grid.shape)
    return dem.missing_in(box, shapely.MultiPoint(dem_px).convex_hull)


def _relief_warning(grid: RpcGrid) -> str:
    rows, cols = grid.shape
    middle = np.array([[cols / 2, rows / 2]])
    ground = np.column_stack([grid.to_xy(middle), [grid.rpc.height_off]])
    col, row = (RELIEF_M * grid.rpc.px_per_metre_of_height(ground))[0].tolist()
    return (
        f"no DEM: all ground is taken to be {grid.rpc.height_off:.0f} m above the ellipsoid, the height "
        f"offset of the RPC; each {RELIEF_M:.0f} m of relief displaces the image by "
        f"{float(np.hypot(col, row)):.2f} px ({col:.2f}, {row:.2f}; col, row): give --dem"
    )
