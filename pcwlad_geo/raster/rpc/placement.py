"""Where a raster with an RPC lies on the ground, by its RPC and the heights of a DEM."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import shapely

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.rpc.dem import ConstantHeight, Dem, Vertical, in_words, open_dem
from pcwlad_geo.raster.rpc.domain import check_domain
from pcwlad_geo.raster.rpc.files import RpcSource
from pcwlad_geo.raster.rpc.grid import RpcGrid
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class PlacementParameters:
    """How a raster is placed on the ground by its RPC."""

    lattice: int = 33
    """Number of points along a side of a raster at which its ground position is computed."""
    margin: float = 0.05
    """Margin of the undulations around the scene, as a share of its extent."""
    stated_relief_m: float = 100.0
    """Relief whose displacement is stated in the warning about a missing DEM."""
    covered: float = 0.999
    """Share of a raster from which a DEM counts as covering all of it."""
    heights_m: tuple[float, float] = (-600.0, 9500.0)
    """Lowest and highest height of a DEM."""


PLACEMENT: Final = PlacementParameters()
"""Those in use."""


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
    """Place a raster on the ground by its RPC, with the heights of a DEM.

    Without a DEM all ground is `height_m` above the ellipsoid, by default the RPC's height offset; for
    `vertical` see `dem.open_dem`. The `side` is the role of the raster, for messages. The RPC is accepted
    without checking the position that it gives to the raster if `trusted`. Raises `InputError` if RPC, DEM
    and raster do not fit together, or the DEM's vertical datum is not known.
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
        grid = RpcGrid.of_file(shape, rpc, ground, shifts=source.shifts)
        span = (rpc.height_off - rpc.height_scale, rpc.height_off + rpc.height_scale)
        warnings: tuple[str, ...] = (_relief_warning(grid, side),)
    else:
        heights = open_dem(dem, vertical, _scene_bounds(source, info))
        grid, span, warnings = _heights_around(info, source, heights)
        check_domain(source, info.uri, shape, span, trusted=trusted)
    on_ground = replace(info, grid=grid, georeferenced=True, gcp_misfit_px=None)
    return RpcPlacement(on_ground, source, span, (*source.warnings, *warnings))


def _scene_bounds(source: RpcSource, info: RasterInfo) -> tuple[float, float, float, float]:
    """Return west, south, east, north in degrees of the image at all heights of its RPC, with a margin."""
    rpc, pixels = source.rpc, info.grid.lattice_px(PLACEMENT.lattice)
    lon_lat = np.concatenate(
        [rpc.to_ground(pixels, rpc.height_off + side * rpc.height_scale) for side in (-1.0, 0.0, 1.0)]
    )
    lon_lat = lon_lat[np.isfinite(lon_lat).all(axis=1)]
    if len(lon_lat) == 0:
        raise InputError(
            f"the RPC in {source.origin} places no pixel of {info.uri} on the ground: get it again"
        )
    low, high = lon_lat.min(axis=0), lon_lat.max(axis=0)
    margin = PLACEMENT.margin * (high - low)
    west, south, east, north = np.concatenate([low - margin, high + margin]).tolist()
    return west, south, east, north


def _heights_around(
    info: RasterInfo, source: RpcSource, dem: Dem
) -> tuple[RpcGrid, tuple[float, float], tuple[str, ...]]:
    """Return the grid of an image with a DEM, the lowest and highest ground, and warnings on its coverage.

    Raises `InputError` if the DEM does not overlap the image, or has holes below it.
    """
    rpc, pixels = source.rpc, info.grid.lattice_px(PLACEMENT.lattice)
    # nearest: ground far from the height offset would be sought beside the DEM
    first_heights = dem.nearest(rpc.to_ground(pixels, rpc.height_off))
    _check_heights(info, dem, first_heights)
    level_m = float(np.nanmedian(first_heights)) if np.isfinite(first_heights).any() else rpc.height_off
    grid = RpcGrid.of_file(info.grid.shape, rpc, dem, level_m=level_m, shifts=source.shifts)
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
    box = Window.around(*np.array(covered.bounds).reshape(2, 2)).clipped(dem.grid.shape)
    holes = dem.missing_in(box, covered)
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
    if share < PLACEMENT.covered:
        warnings.append(
            f"the DEM {dem.uri} covers {share:.0%} of {info.uri}: the rest is neither matched nor warped, as "
            f"its heights are not known; the image lies at {_in_words(lon_lat)}: give a DEM of all of it"
        )
    grid = replace(grid, level_m=float(np.nanmedian(heights)))
    return grid, (float(np.nanmin(heights)), float(np.nanmax(heights))), tuple(warnings)


def _check_heights(info: RasterInfo, dem: Dem, heights: Float64) -> None:
    finite = heights[np.isfinite(heights)]
    low, high = PLACEMENT.heights_m
    if len(finite) and not low <= finite.min() <= finite.max() <= high:
        raise InputError(
            f"the DEM {dem.uri} holds heights from {finite.min():.0f} to {finite.max():.0f} m below "
            f"{info.uri}: check its unit and its nodata value"
        )


def _in_words(lon_lat: Float64) -> str:
    return in_words((*np.nanmin(lon_lat, axis=0), *np.nanmax(lon_lat, axis=0)))


def _relief_warning(grid: RpcGrid, side: str) -> str:
    lon_lat, height = grid.line_of_sight(grid.middle_px)
    per_metre = grid.rpc.px_per_metre_of_height(np.column_stack([lon_lat, height]))
    col, row = (PLACEMENT.stated_relief_m * per_metre)[0].tolist()
    which = "the image" if side == "target" else "the reference"
    return (
        f"no DEM: all ground is taken to be {grid.level_m:.0f} m above the ellipsoid, the height "
        f"offset of the RPC; each {PLACEMENT.stated_relief_m:.0f} m of relief displaces {which} by "
        f"{float(np.hypot(col, row)):.2f} px ({col:.2f}, {row:.2f}; col, row): give --dem"
    )
