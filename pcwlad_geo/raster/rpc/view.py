"""Placement of a raster with an RPC on the ground, and the grid on which a pair with one is matched."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import shapely
from affine import Affine

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_grid, check_pixel_ratio
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.grid import Grid, Window, jacobian
from pcwlad_geo.raster.matching_grid import MARGIN_PX, ViewPair
from pcwlad_geo.raster.rpc.dem import ConstantHeight, Dem, Vertical, in_words, open_dem
from pcwlad_geo.raster.rpc.files import RpcSource, check_domain
from pcwlad_geo.raster.rpc.grid import RpcGrid, at_mean_height, footprint_px
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.view import View
from pcwlad_geo.types import Float64

LATTICE: Final = 33
"""Number of points along a side of a raster at which its ground position is computed."""
RELIEF_M: Final = 100.0
"""Relief whose displacement is stated in the warning about a missing DEM."""
MARGIN_SHARE: Final = 0.05
"""Margin around the scene within which undulations are sampled, as a share of its extent."""
LOWEST_M: Final = -600.0
"""Lowest plausible height of the ground above the ellipsoid, with a margin."""
HIGHEST_M: Final = 9500.0
"""Highest plausible height of the ground above the ellipsoid, with a margin."""
ALL: Final = 0.999
"""Share of a raster from which a DEM counts as covering all of it."""
_FINER: Final = 0.99


@dataclass(frozen=True, slots=True)
class RpcPlacement:
    """A raster with its position on the ground by RPC and heights."""

    info: RasterInfo
    """The raster, with an `RpcGrid` as its grid."""
    source: RpcSource
    heights_m: tuple[float, float]
    """Lowest and highest ground in the raster, above the ellipsoid; the RPC's own range without a DEM."""
    warnings: tuple[str, ...]


def place_by_rpc(
    info: RasterInfo,
    source: RpcSource,
    dem: str | None,
    vertical: Vertical,
    *,
    side: Literal["reference", "target"] = "target",
    height_m: float | None = None,
    trusted: bool = False,
) -> RpcPlacement:
    """Place a raster on the ground by its RPC.

    Raises `InputError` if RPC, DEM and raster do not fit together, or the DEM's vertical datum is not known.

    Parameters
    ----------
    source : RpcSource
        Its RPC.
    dem : str, optional
        Path or GDAL URI of a DEM.
    vertical : float, path-like or None
        See `dem.open_dem`.
    side : {"reference", "target"}
        The role of the raster, for messages.
    height_m : float, optional
        Height of all ground above the ellipsoid without a DEM; the RPC's height offset by default.
    trusted : bool
        Accept the RPC without checking the position that it gives to the raster.
    """
    if info.mask_grid is not None and info.mask_grid.crs is not None:
        raise InputError(
            f"the mask {info.mask_uri} lies on the ground and {info.uri} is in the sensor's geometry: give a "
            f"mask of the {side}'s own pixels, without georeferencing"
        )
    rpc, shape = source.rpc, info.grid.shape
    check_domain(source, info.uri, shape, trusted=trusted)
    if dem is None:
        ground = ConstantHeight(rpc.height_off if height_m is None else height_m)
        grid = RpcGrid.of_file(shape, rpc, ground)
        span = (rpc.height_off - rpc.height_scale, rpc.height_off + rpc.height_scale)
        warnings: tuple[str, ...] = (_relief_warning(grid, side),)
    else:
        heights = open_dem(dem, vertical, _scene_bounds(source, info))
        grid, span, warnings = _heights_around(info, rpc, heights)
        check_domain(source, info.uri, shape, span, trusted=trusted)
    placed = replace(info, grid=grid, georeferenced=True)
    return RpcPlacement(placed, source, span, (*source.warnings, *warnings))


def plan_rpc_views(reference: RasterInfo, target: RasterInfo) -> ViewPair:
    """Plan the matching on a map grid at the coarser pixel size, each raster resampled by its RPC.

    Raises `InputError` if the two do not overlap.

    Parameters
    ----------
    reference, target : RasterInfo
        Georeferenced, or the result of `place_by_rpc`; at least one of them the latter.
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
    coarser = _coarser(ground, 1.0 / float(size)) if np.isfinite(size) and size < _FINER else ground
    own = View(reference, coarser, "none" if coarser is reference.grid else "cubic")
    scale = np.array([coarser.shape[1] / cols, coarser.shape[0] / rows])
    low, high = np.array(common.bounds).reshape(2, 2) * scale
    box = Window.around(low, high)
    around = box.padded(MARGIN_PX)
    view = View(target, coarser.part((around.col, around.row), around.shape), "cubic")
    offset = (float(-around.col), float(-around.row))
    return ViewPair(own, view, offset, box.clipped(coarser.shape), ())


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
    placed = "by its RPC " if isinstance(target.grid, RpcGrid) else ""
    where = "nowhere"
    if not outline.is_empty:
        corners = np.array(outline.bounds).reshape(2, 2)
        (x0, y0), (x1, y1) = ground.to_xy(corners).tolist()
        where = f"at x {x0:.10g} to {x1:.10g}, y {y1:.10g} to {y0:.10g}"
    return (
        f"the rasters do not overlap: {reference.uri} covers x {left:.10g} to {right:.10g}, y "
        f"{bottom:.10g} to {top:.10g}, and {placed}{target.uri} lies {where}: give two rasters of the same "
        "ground, and the RPC that belongs to the target as it is (not that of the image it was cropped from)"
    )


def _coarser(grid: Grid, factor: float) -> Grid:
    """Return the grid of the same corner and extent with pixels larger by a factor."""
    rows, cols = grid.shape
    return grid.scaled((max(1, round(rows / factor)), max(1, round(cols / factor))))


def _scene_bounds(source: RpcSource, info: RasterInfo) -> tuple[float, float, float, float]:
    """Return west, south, east, north in degrees of the image at all heights of its RPC, with a margin."""
    rpc, pixels = source.rpc, info.grid.lattice_px(LATTICE)
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


def _heights_around(
    info: RasterInfo, rpc: RpcModel, dem: Dem
) -> tuple[RpcGrid, tuple[float, float], tuple[str, ...]]:
    """Return the grid of an image with a DEM, the lowest and highest ground, and warnings on its coverage.

    Raises `InputError` if the DEM does not overlap the image, or has holes below it.
    """
    pixels = info.grid.lattice_px(LATTICE)
    # nearest: ground far from the height offset would be sought beside the DEM
    near = dem.nearest(rpc.to_ground(pixels, rpc.height_off))
    _check_heights(info, dem, near)
    level_m = float(np.nanmedian(near)) if np.isfinite(near).any() else rpc.height_off
    grid = RpcGrid.of_file(info.grid.shape, rpc, dem, level_m=level_m)
    lon_lat, _ = grid.line_of_sight(pixels)
    dem_px = dem.to_px(lon_lat)
    rows, cols = dem.grid.shape
    whole = shapely.MultiPoint(dem_px[np.isfinite(dem_px).all(axis=1)]).convex_hull
    covered = whole.intersection(shapely.box(0, 0, cols, rows))
    if covered.area == 0:
        raise InputError(
            f"the DEM {dem.uri} and {info.uri} do not overlap: by its RPC the image lies at "
            f"{_in_words(lon_lat)}; give the DEM of this ground"
        )
    holes = _count_holes(dem, covered)
    if holes:
        raise InputError(
            f"the DEM {dem.uri} has holes below {info.uri}: {holes} of its pixels have no height; fill "
            "them first (gdal_fillnodata.py DEM FILLED; where they are NaN and the file has no nodata value, "
            "gdal_edit.py -a_nodata nan DEM before it), or give another DEM"
        )
    heights = dem.nearest(lon_lat)
    _check_heights(info, dem, heights)
    if not np.isfinite(heights).any():
        raise InputError(
            f"the DEM {dem.uri} gives no height below {info.uri}: give one that covers the image"
        )
    share = covered.area / whole.area
    warnings = []
    if share < ALL:
        warnings.append(
            f"the DEM {dem.uri} covers {share:.0%} of {info.uri}: the rest is neither matched nor warped, as "
            f"its heights are not known; the image lies at {_in_words(lon_lat)}: give a DEM of all of it"
        )
    grid = replace(grid, level_m=float(np.nanmedian(heights)))
    return grid, (float(np.nanmin(heights)), float(np.nanmax(heights))), tuple(warnings)


def _check_heights(info: RasterInfo, dem: Dem, heights: Float64) -> None:
    known = heights[np.isfinite(heights)]
    if len(known) and not LOWEST_M <= known.min() <= known.max() <= HIGHEST_M:
        raise InputError(
            f"the DEM {dem.uri} holds heights from {known.min():.0f} to {known.max():.0f} m below "
            f"{info.uri}: check its unit and its nodata value"
        )


def _count_holes(dem: Dem, outline_px: shapely.Geometry) -> int:
    """Count the pixels of a DEM without height within an outline of its pixels (col, row)."""
    box = Window.around(*np.array(outline_px.bounds).reshape(2, 2))
    return dem.missing_in(box.clipped(dem.grid.shape), outline_px)


def _in_words(lon_lat: Float64) -> str:
    return in_words((*np.nanmin(lon_lat, axis=0), *np.nanmax(lon_lat, axis=0)))


def _relief_warning(grid: RpcGrid, side: str) -> str:
    lon_lat, height = grid.line_of_sight(grid.middle_px)
    per_metre = grid.rpc.px_per_metre_of_height(np.column_stack([lon_lat, height]))
    col, row = (RELIEF_M * per_metre)[0].tolist()
    which = "the image" if side == "target" else "the reference"
    return (
        f"no DEM: all ground is taken to be {grid.level_m:.0f} m above the ellipsoid, the height "
        f"offset of the RPC; each {RELIEF_M:.0f} m of relief displaces {which} by "
        f"{float(np.hypot(col, row)):.2f} px ({col:.2f}, {row:.2f}; col, row): give --dem"
    )
