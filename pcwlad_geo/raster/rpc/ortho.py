"""Orthorectification: the grid of the output, and the raster resampled onto it by its RPC and heights."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from affine import Affine
from rasterio.enums import ColorInterp, Resampling
from rasterio.io import DatasetReader
from rasterio.rpc import RPC
from rasterio.warp import reproject
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.crs import WGS84, name_of
from pcwlad_geo.raster.grid import Grid, Window, jacobian, linear_part, map_px
from pcwlad_geo.raster.opening import open_written_raster
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.output_grid import OUTPUT_GRIDS, GridRequest, lay_out, output_lattice, snapped_size
from pcwlad_geo.raster.pixels import valid_in_file
from pcwlad_geo.raster.resampling import cell_means, spline_samples
from pcwlad_geo.raster.rpc.dem import ConstantHeight, Dem
from pcwlad_geo.raster.rpc.files import to_gdal
from pcwlad_geo.raster.rpc.grid import OUTLINE_NODES, RpcGrid, at_mean_height, footprint_px, positions_on
from pcwlad_geo.raster.vrt import has_alpha
from pcwlad_geo.raster.warped_views import READING, Block, filled
from pcwlad_geo.raster.warping import COG, BlockRequest, Blocks, ProgressCallback, kernel, write_warped

LEVEL: Final = Grid((8, 8), Affine(100.0, 0.0, -400.0, 0.0, -25.0, 100.0), WGS84)
"""Grid of a DEM of constant height around the whole earth."""


def ortho_grid(reference: Grid, target: RpcGrid) -> Grid:
    """Return the grid of the orthorectified target: the reference's lattice at the target's pixel size.

    Pixels have the proportions of the reference's and the size of the target's along its finer axis, or the
    multiple or fraction of the reference's that is within 2 % of it. The grid covers the target where heights
    are known. Raises `InputError` if no part of the target can be placed in the reference's CRS. The `target`
    has the corrected RPC.
    """
    lattice_px = map_px(target.lattice_px(OUTLINE_NODES), target, reference)
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
    low = np.floor(np.array([left, top]) / side + OUTPUT_GRIDS.sliver_px).astype(int)
    high = np.ceil(np.array([right, bottom]) / side - OUTPUT_GRIDS.sliver_px).astype(int)
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

    GDAL evaluates RPC and height at every pixel; those of a raster whose lines lie beside its RPC are sampled
    by cubic spline, or by nearest neighbour. Pixels without height are empty. `target` is the raster's
    grid, with the corrected RPC. Everything else is as for `warping.warp`, but that the format is no VRT.
    Return a warning where parts of the raster could not be read. Raises `InputError` if the DEM, the raster,
    or half of it, cannot be read, and `OutputError` if the result cannot be written.
    """

    def blocks_of(source: DatasetReader, method: Resampling, request: BlockRequest) -> Blocks:
        if target.shifts is not None:
            return _sampled(source, target, grid, method, request)
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
        "num_threads": min(os.cpu_count() or 1, READING.max_threads),
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


def _sampled(
    source: DatasetReader, target: RpcGrid, grid: Grid, method: Resampling, request: BlockRequest
) -> Blocks:
    """Sample blocks at positions of their own, which GDAL's warper does not take."""
    dtype = np.dtype(np.result_type(*source.dtypes))
    step = jacobian(grid.middle_px, grid, at_mean_height(target))[0]
    per_px = 1 if method == Resampling.nearest else max(1, round(float(np.linalg.norm(step, axis=1).max())))
    nothing = filled([request.nodata or 0.0] * (source.count + request.as_alpha), dtype)

    def sampled(window: FileWindow) -> Block:
        block = nothing(window)
        part = Window(window.row_off, window.col_off, window.height, window.width)
        at_rc = positions_on(target, grid, part, per_px)
        if method == Resampling.nearest:
            at_rc = np.floor(at_rc) + 0.5
        known = at_rc[:, np.isfinite(at_rc).all(axis=0)]
        if known.size == 0:
            return block
        needed = Window.around(*(end(known, axis=1)[::-1] for end in (np.min, np.max))).padded(8)
        needed = needed.clipped(source.shape)
        if needed.empty:
            return block
        place = FileWindow(needed.col, needed.row, needed.cols, needed.rows)
        away_rc = at_rc - np.array([needed.row, needed.col])[:, None, None]
        for band in range(source.count):
            values = source.read(band + 1, window=place)
            valid = valid_in_file(source, band + 1, values, place).astype(np.float64)
            samples, shares = spline_samples(values.astype(np.float64), valid, away_rc)
            mean = cell_means(samples, per_px)
            shown = cell_means(shares, per_px) >= 0.5
            if dtype.kind in "iu":
                mean = np.clip(np.rint(mean), np.iinfo(dtype).min, np.iinfo(dtype).max)
            block[band] = np.where(shown, mean, block[band])
            if request.as_alpha:
                block[source.count] = np.maximum(block[source.count], 255 * shown)
        return block

    for window in request.windows:
        yield window, request.unreadable.read(sampled, window, nothing)


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
