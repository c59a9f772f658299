"""Rasters with an RPC on the ground: their place by heights, the grid of a pair, and orthorectification."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
import rasterio
import shapely
from affine import Affine
from rasterio.enums import ColorInterp, Resampling
from rasterio.io import DatasetReader
from rasterio.rpc import RPC
from rasterio.warp import reproject
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.limits import check_grid, check_pixel_ratio
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.crs import WGS84, name_of
from pcwlad_geo.raster.grid import Grid, Window, jacobian, linear_part, map_px
from pcwlad_geo.raster.matching_grid import FINER, MARGIN_PX, ViewPair
from pcwlad_geo.raster.opening import open_written_raster
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.output_grid import SLIVER_PX, GridRequest, lay_out, output_lattice, snapped_size
from pcwlad_geo.raster.rpc.dem import ConstantHeight, Dem, Vertical, in_words, open_dem
from pcwlad_geo.raster.rpc.domain import check_domain
from pcwlad_geo.raster.rpc.files import RpcSource, to_gdal
from pcwlad_geo.raster.rpc.grid import LATTICE, RpcGrid, at_mean_height, footprint_px
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.view import View
from pcwlad_geo.raster.vrt import has_alpha
from pcwlad_geo.raster.warped_views import MAX_THREADS, Block, filled
from pcwlad_geo.raster.warping import COG, BlockRequest, Blocks, ProgressCallback, kernel, write_warped
from pcwlad_geo.types import Float64

PLACED_LATTICE: Final = 33
"""Number of points along a side of a raster at which its ground position is computed."""
RELIEF_M: Final = 100.0
"""Relief whose displacement is stated in the warning about a missing DEM."""
ALL: Final = 0.999
"""Share of a raster from which a DEM counts as covering all of it."""


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
        grid = RpcGrid.of_file(shape, rpc, ground)
        span = (rpc.height_off - rpc.height_scale, rpc.height_off + rpc.height_scale)
        warnings: tuple[str, ...] = (_relief_warning(grid, side),)
    else:
        heights = open_dem(dem, vertical, _scene_bounds(source, info))
        grid, span, warnings = _heights_around(info, rpc, heights)
        check_domain(source, info.uri, shape, span, trusted=trusted)
    on_ground = replace(info, grid=grid, georeferenced=True)
    return RpcPlacement(on_ground, source, span, (*source.warnings, *warnings))


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
    if np.isfinite(size) and size < FINER:
        coarser = ground.scaled((max(1, round(rows / factor)), max(1, round(cols / factor))))
    reference_view = View(reference, coarser, "none" if coarser is reference.grid else "cubic")
    scale = np.array([coarser.shape[1] / cols, coarser.shape[0] / rows])
    low, high = np.array(common.bounds).reshape(2, 2) * scale
    box = Window.around(low, high)
    around = box.padded(MARGIN_PX)
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


def _scene_bounds(source: RpcSource, info: RasterInfo) -> tuple[float, float, float, float]:
    """Return west, south, east, north in degrees of the image at all heights of its RPC, with a margin."""
    rpc, pixels = source.rpc, info.grid.lattice_px(PLACED_LATTICE)
    lon_lat = np.concatenate(
        [rpc.to_ground(pixels, rpc.height_off + side * rpc.height_scale) for side in (-1.0, 0.0, 1.0)]
    )
    lon_lat = lon_lat[np.isfinite(lon_lat).all(axis=1)]
    if len(lon_lat) == 0:
        raise InputError(
            f"the RPC in {source.origin} places no pixel of {info.uri} on the ground: get it again"
        )
    low, high = lon_lat.min(axis=0), lon_lat.max(axis=0)
    margin = 0.05 * (high - low)
    west, south, east, north = np.concatenate([low - margin, high + margin]).tolist()
    return west, south, east, north


def _heights_around(
    info: RasterInfo, rpc: RpcModel, dem: Dem
) -> tuple[RpcGrid, tuple[float, float], tuple[str, ...]]:
    """Return the grid of an image with a DEM, the lowest and highest ground, and warnings on its coverage.

    Raises `InputError` if the DEM does not overlap the image, or has holes below it.
    """
    pixels = info.grid.lattice_px(PLACED_LATTICE)
    # nearest: ground far from the height offset would be sought beside the DEM
    first_heights = dem.nearest(rpc.to_ground(pixels, rpc.height_off))
    _check_heights(info, dem, first_heights)
    level_m = float(np.nanmedian(first_heights)) if np.isfinite(first_heights).any() else rpc.height_off
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
    if share < ALL:
        warnings.append(
            f"the DEM {dem.uri} covers {share:.0%} of {info.uri}: the rest is neither matched nor warped, as "
            f"its heights are not known; the image lies at {_in_words(lon_lat)}: give a DEM of all of it"
        )
    grid = replace(grid, level_m=float(np.nanmedian(heights)))
    return grid, (float(np.nanmin(heights)), float(np.nanmax(heights))), tuple(warnings)


def _check_heights(info: RasterInfo, dem: Dem, heights: Float64) -> None:
    finite = heights[np.isfinite(heights)]
    if len(finite) and not -600.0 <= finite.min() <= finite.max() <= 9500.0:
        raise InputError(
            f"the DEM {dem.uri} holds heights from {finite.min():.0f} to {finite.max():.0f} m below "
            f"{info.uri}: check its unit and its nodata value"
        )


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


LEVEL: Final = Grid((8, 8), Affine(100.0, 0.0, -400.0, 0.0, -25.0, 100.0), WGS84)
"""Grid of a DEM of constant height around the whole earth."""


def ortho_grid(reference: Grid, target: RpcGrid) -> Grid:
    """Return the grid of the orthorectified target: the reference's lattice at the target's pixel size.

    Pixels have the proportions of the reference's and the size of the target's along its finer axis, or the
    multiple or fraction of the reference's that is within 2 % of it. The grid covers the target where heights
    are known. Raises `InputError` if no part of the target can be placed in the reference's CRS. The `target`
    has the corrected RPC.
    """
    lattice_px = map_px(target.lattice_px(LATTICE), target, reference)
    scales = jacobian(lattice_px[np.isfinite(lattice_px).all(axis=1)], reference, at_mean_height(target))
    scales = scales[np.isfinite(scales).all(axis=(1, 2))]
    outline = footprint_px(target, reference)
    if len(scales) == 0 or outline.is_empty:
        raise InputError(
            f"the target's footprint cannot be placed in {name_of(reference.crs)} by its RPC: check RPC, "
            "DEM and the reference's CRS"
        )
    # lengths in reference pixels of a step along each axis of the target
    lengths = np.hypot(*inverse(scales).transpose(1, 0, 2))
    side = snapped_size(float(np.median(lengths.min(axis=1))))
    left, top, right, bottom = outline.bounds
    low = np.floor(np.array([left, top]) / side + SLIVER_PX).astype(int)
    high = np.ceil(np.array([right, bottom]) / side - SLIVER_PX).astype(int)
    out_cols, out_rows = (high - low).tolist()
    origin_px = (float(low[0] * side), float(low[1] * side))
    return reference.resampled_grid(((side, 0.0), (0.0, side)), origin_px, (out_rows, out_cols))


def requested_ortho_grids(
    reference: Grid, target: RpcGrid, request: GridRequest, siblings: Sequence[RpcGrid]
) -> list[Grid]:
    """Return the grids that the user requests, see `ortho_grid`: one extent for all pixel sizes.

    Raises `InputError` as for `ortho_grid`, or if a grid has no pixel, or too many. The target's grid, and
    those of its `siblings` (the target itself, or images taken with it), have corrected RPCs.
    """
    fixed = request.fixed(reference)
    if fixed is not None:
        return [fixed] * len(siblings)
    lattice = output_lattice(reference, request)
    base = reference if lattice.crs == reference.crs else lattice
    grids = [ortho_grid(base, grid) for grid in (target, *siblings)]
    outlines = [map_px(grid.boundary_px(), grid, lattice) for grid in grids]
    boxes = [(outline.min(axis=0), outline.max(axis=0)) for outline in outlines]
    return lay_out(lattice, request, boxes, [np.hypot(*linear_part(grid.transform)) for grid in grids])


def orthorectify(
    source_path: str | Path,
    out_path: Path,
    target: RpcGrid,
    grid: Grid,
    resampling: str = "lanczos",
    *,
    fmt: OutputFormat = COG,
    progress: ProgressCallback | None = None,
) -> str | None:
    """Resample all bands of a raster once, by its RPC and the heights of the ground, and write it.

    GDAL evaluates RPC and height at every pixel. Pixels without height are empty. `target` is the raster's
    grid, with the corrected RPC. Everything else is as for `warping.warp`, but that the format is no VRT.
    Return a warning where parts of the raster could not be read. Raises `InputError` if the DEM, the raster,
    or half of it, cannot be read, and `OutputError` if the result cannot be written.
    """

    def blocks_of(source: DatasetReader, method: Resampling, request: BlockRequest) -> Blocks:
        if request.nodata is None or not request.as_alpha:
            return _blocks(source, target, grid, method, request)
        # With an RPC and an alpha band made of nodata, GDAL's warper loses most of the pixels.
        by_nodata = _blocks(source, target, grid, method, replace(request, as_alpha=False))
        return _with_alpha(by_nodata, request.nodata)

    return write_warped(source_path, out_path, grid, resampling, blocks_of, progress, fmt=fmt)


def _blocks(
    source: DatasetReader, target: RpcGrid, grid: Grid, method: Resampling, request: BlockRequest
) -> Blocks:
    """Warp blocks whose validity is marked by the nodata value or by an alpha band, not by both."""
    count = source.count + request.as_alpha
    dtype = np.result_type(*source.dtypes)
    options = {
        "rpcs": RPC.from_gdal(to_gdal(target.rpc)),
        "src_crs": WGS84,
        "dst_crs": grid.crs,
        "num_threads": min(os.cpu_count() or 1, MAX_THREADS),
        "src_nodata": request.nodata,
        "dst_nodata": request.nodata,
        **_alpha(source, request),
        **kernel(method, jacobian(grid.middle_px, grid, at_mean_height(target))[0]),
    }
    # GDAL takes the RPC from the metadata of the source, whatever the options say
    tree = vrt.with_rpc(source, to_gdal(target.rpc), mask_as_alpha=request.as_alpha)
    with open_written_raster(ET.tostring(tree, encoding="unicode")) as view:
        bands = rasterio.band(view, list(range(1, count + 1)))
        nothing = filled([request.nodata or 0.0] * count, np.dtype(dtype))

        def warped(window: FileWindow) -> Block:
            part = grid.part((window.col_off, window.row_off), (window.height, window.width))
            block = nothing(window)
            with _ground_below(target, part) as heights:
                if heights is not None:
                    reproject(bands, block, dst_transform=part.transform, **options, **heights)
            return block

        for window in request.windows:
            yield window, request.unreadable.read(warped, window, nothing)


def _with_alpha(blocks: Blocks, nodata: float) -> Blocks:
    """Add an alpha band to blocks whose validity is marked by the nodata value."""
    for window, block in blocks:
        invalid = np.isnan(block[0]) if np.isnan(nodata) else block[0] == nodata
        alpha = np.where(invalid, 0, 255).astype(block.dtype)
        yield window, np.concatenate([block, alpha[None]])


def _alpha(source: DatasetReader, request: BlockRequest) -> dict[str, int]:
    """Return the warp options that name the alpha band."""
    if request.as_alpha:
        return {"src_alpha": source.count + 1, "dst_alpha": source.count + 1}
    if has_alpha(source):
        band = source.colorinterp.index(ColorInterp.alpha) + 1
        return {"src_alpha": band, "dst_alpha": band}
    return {}


@contextmanager
def _ground_below(target: RpcGrid, part: Grid) -> Iterator[dict[str, object] | None]:
    """Yield the options for GDAL with the ellipsoidal heights of a block, in memory; None if it has none.

    GDAL would use the heights of an orthometric DEM unchanged. Only with a DEM does it compute each position;
    otherwise it interpolates along rows, to 0.1 px. Where the DEM does not cover a block, the few positions
    by which GDAL determines the window of the source would not suffice.
    """
    more: dict[str, str] = {}
    if isinstance(target.heights, ConstantHeight):
        place, heights = LEVEL, np.full((8, 8), target.heights.height_m)
    else:
        needed = _dem_window(target.heights, part)
        window = needed.clipped(target.heights.grid.shape)
        if window.empty:
            yield None
            return
        place = target.heights.grid.part((window.col, window.row), window.shape)
        heights = target.heights.ellipsoidal(window)
        if window != needed or np.isnan(heights).any():
            more = {"SAMPLE_GRID": "YES", "SAMPLE_STEPS": "ALL"}
    rows, cols = heights.shape
    profile = {"driver": "GTiff", "dtype": "float32", "count": 1, "nodata": np.nan, "crs": place.crs}
    with rasterio.MemoryFile(ext=".tif") as memory:
        with memory.open(height=rows, width=cols, transform=place.transform, **profile) as file:
            file.write(heights.astype(np.float32), 1)
        yield {"RPC_DEM": memory.name, **more}


def _dem_window(dem: Dem, part: Grid) -> Window:
    """Return the window of the DEM below a block, px of the DEM, with the margin for interpolation."""
    dem_px = map_px(part.lattice_px(33), part, dem.grid)
    dem_px = dem_px[np.isfinite(dem_px).all(axis=1)]
    if len(dem_px) == 0:
        return Window(0, 0, 0, 0)
    return Window.around(dem_px.min(axis=0), dem_px.max(axis=0)).padded(2)  # for the interpolation of heights
