"""Orthorectification: a raster with RPC and the ground's heights onto a grid on the ground."""

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
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, Resampling
from rasterio.io import DatasetReader
from rasterio.rpc import RPC
from rasterio.warp import reproject
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.dem import WGS84, ConstantHeight, Dem
from pcwlad_geo.raster.grid import Grid, jacobian, linear_part, map_px
from pcwlad_geo.raster.metadata import has_alpha
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.output_grid import GridRequest, lay_out, output_lattice
from pcwlad_geo.raster.output_size import snapped_size
from pcwlad_geo.raster.rpc_files import to_gdal
from pcwlad_geo.raster.rpc_grid import RpcGrid, footprint_px, lattice_px, levelled
from pcwlad_geo.raster.source import open_own_raster
from pcwlad_geo.raster.unread import Block, filled
from pcwlad_geo.raster.warped_blocks import MOST_THREADS
from pcwlad_geo.raster.warping import COG, BlockRequest, Blocks, ProgressCallback, kernel, write_warped
from pcwlad_geo.raster.windows import Window

Array = NDArray[np.float64]

LEVEL: Final = Grid((8, 8), Affine(100.0, 0.0, -400.0, 0.0, -25.0, 100.0), WGS84)
"""Around the whole earth."""
DEM_MARGIN_PX: Final = 2
EVERY_PIXEL: Final = {"SAMPLE_GRID": "YES", "SAMPLE_STEPS": "ALL"}
"""Has GDAL look at every pixel of a block to find what it needs of the source."""
SLIVER_PX: Final = 1e-3


def ortho_grid(reference: Grid, target: RpcGrid) -> Grid:
    """Return the grid of the orthorectified target: the reference's lattice at the target's pixel size.

    Pixels have the shape of the reference's and are as small as the target's along its finer axis, or the
    multiple or fraction of the reference's that is within 2 % of that. They reach as far as the target where
    its heights are known.

    Parameters
    ----------
    reference : Grid
    target : RpcGrid
        With the corrected RPC.

    Raises
    ------
    InputError
        If no part of the target can be placed in the reference's CRS.
    """
    placed = map_px(lattice_px(target.shape), target, reference)
    scales = jacobian(placed[np.isfinite(placed).all(axis=1)], reference, levelled(target))
    scales = scales[np.isfinite(scales).all(axis=(1, 2))]
    outline = footprint_px(target, reference)
    if len(scales) == 0 or outline.is_empty:
        raise InputError(
            f"the target's footprint cannot be placed in {name_of(reference.crs)} by its RPC: check RPC, "
            "DEM and the reference's CRS"
        )
    # how far a step along each axis of the target goes, in reference pixels
    lengths = np.hypot(*np.linalg.inv(scales).transpose(1, 0, 2))
    side = snapped_size(float(np.median(lengths.min(axis=1))))
    left, top, right, bottom = outline.bounds
    low = np.floor(np.array([left, top]) / side + SLIVER_PX).astype(int)
    high = np.ceil(np.array([right, bottom]) / side - SLIVER_PX).astype(int)
    out_cols, out_rows = (high - low).tolist()
    origin_px = (float(low[0] * side), float(low[1] * side))
    return reference.remade(((side, 0.0), (0.0, side)), origin_px, (out_rows, out_cols))


def requested_ortho_grids(
    reference: Grid, target: RpcGrid, request: GridRequest, siblings: Sequence[RpcGrid]
) -> list[Grid]:
    """Return the grids that the user asks for, see `ortho_grid`: one extent for all, whatever their pixels.

    Parameters
    ----------
    reference : Grid
    target : RpcGrid
        With the corrected RPC, as those of the siblings.
    request : GridRequest
    siblings : sequence of RpcGrid
        The target itself, or images taken with it.

    Raises
    ------
    InputError
        As `ortho_grid` does, or if a grid has no pixel, or too many.
    """
    fixed = request.fixed(reference)
    if fixed is not None:
        return [fixed] * len(siblings)
    lattice = output_lattice(reference, request)
    base = reference if lattice.crs == reference.crs else lattice
    owns = [ortho_grid(base, each) for each in (target, *siblings)]
    outlines = [map_px(own.boundary_px(), own, lattice) for own in owns]
    boxes = [(outline.min(axis=0), outline.max(axis=0)) for outline in outlines]
    return lay_out(lattice, request, boxes, [np.hypot(*linear_part(own.transform)) for own in owns])


def orthorectify(
    source_path: str | Path,
    out_path: Path,
    target: RpcGrid,
    grid: Grid,
    resampling: str = "lanczos",
    *,
    made: OutputFormat = COG,
    progress: ProgressCallback | None = None,
) -> str | None:
    """Resample all bands of a raster once, through its RPC and the ground's heights, and write it.

    GDAL takes RPC and height at every pixel. Where no height is known,
    nothing is written. All else is as for `warping.warp`.

    Parameters
    ----------
    source_path : str or pathlib.Path
    out_path : pathlib.Path
        The file to write; scratch files are made beside it.
    target : RpcGrid
        The raster's grid, with the corrected RPC.
    grid : Grid
        The output grid.
    resampling : str
        A name of `rasterio.enums.Resampling`.
    made : OutputFormat
        A COG by default; not a VRT.
    progress : callable, optional
        Receives done, total after each block; what it raises ends the work.

    Returns
    -------
    str or None
        A warning where parts of the raster could not be read.

    Raises
    ------
    InputError
        If the DEM, the raster, or half of it, cannot be read.
    OutputError
        If the result cannot be written.
    """

    def blocks_of(source: DatasetReader, method: Resampling, request: BlockRequest) -> Blocks:
        if request.nodata is None or not request.as_alpha:
            return _blocks(source, target, grid, method, request)
        # By an alpha band made of nodata GDAL's warper with an RPC loses most of the pixels.
        by_nodata = _blocks(source, target, grid, method, replace(request, as_alpha=False))
        return _with_alpha(by_nodata, request.nodata)

    return write_warped(source_path, out_path, grid, resampling, blocks_of, progress, made=made)


def _blocks(
    source: DatasetReader, target: RpcGrid, grid: Grid, method: Resampling, request: BlockRequest
) -> Blocks:
    """Warp blocks that say what is valid by the nodata value, or by an alpha band, not by both."""
    count = source.count + request.as_alpha
    dtype = np.result_type(*source.dtypes)
    options = {
        "rpcs": RPC.from_gdal(to_gdal(target.rpc)),
        "src_crs": WGS84,
        "dst_crs": grid.crs,
        "num_threads": min(os.cpu_count() or 1, MOST_THREADS),
        "src_nodata": request.nodata,
        "dst_nodata": request.nodata,
        **_alpha(source, request),
        **kernel(method, _step(target, grid)),
    }
    # GDAL takes the RPC from the metadata of what it reads, whatever it is told
    tree = vrt.with_rpc(source, to_gdal(target.rpc), mask_as_alpha=request.as_alpha)
    with open_own_raster(ET.tostring(tree, encoding="unicode")) as seen:
        bands = rasterio.band(seen, list(range(1, count + 1)))
        nothing = filled([request.nodata or 0.0] * count, np.dtype(dtype))

        def warped(window: FileWindow) -> Block:
            part = grid.part((window.col_off, window.row_off), (window.height, window.width))
            block = nothing(window)
            with _ground_below(target, part) as heights:
                if heights is not None:
                    reproject(bands, block, dst_transform=part.transform, **options, **heights)
            return block

        for window in request.windows:
            yield window, request.gaps.read(warped, window, nothing)


def _with_alpha(blocks: Blocks, nodata: float) -> Blocks:
    """Add the band that tells what is valid to blocks that say so by their nodata value."""
    for window, block in blocks:
        invalid = np.isnan(block[0]) if np.isnan(nodata) else block[0] == nodata
        alpha = np.where(invalid, 0, 255).astype(block.dtype)
        yield window, np.concatenate([block, alpha[None]])


def _alpha(source: DatasetReader, request: BlockRequest) -> dict[str, int]:
    """Say which band tells what is valid."""
    if request.as_alpha:
        return {"src_alpha": source.count + 1, "dst_alpha": source.count + 1}
    if has_alpha(source):
        band = source.colorinterp.index(ColorInterp.alpha) + 1
        return {"src_alpha": band, "dst_alpha": band}
    return {}


@contextmanager
def _ground_below(target: RpcGrid, part: Grid) -> Iterator[dict[str, object] | None]:
    """Give GDAL the ground of a block: heights above the ellipsoid, in memory; None where the DEM has none.

    GDAL would take those of an orthometric DEM as they are. And only where it has a DEM does it compute each
    position; else it interpolates along rows, to 0.1 px. Where the DEM does not cover a block, the few
    positions that GDAL looks at first would tell it too little of what it needs.
    """
    more: dict[str, str] = {}
    if isinstance(target.heights, ConstantHeight):
        place, heights = LEVEL, np.full((8, 8), target.heights.height_m)
    else:
        wanted = _dem_window(target.heights, part)
        window = wanted.clipped(target.heights.grid.shape)
        if window.empty:
            yield None
            return
        place = target.heights.grid.part((window.col, window.row), window.shape)
        heights = target.heights.ellipsoidal(window)
        if window != wanted or np.isnan(heights).any():
            more = EVERY_PIXEL
    rows, cols = heights.shape
    profile = {"driver": "GTiff", "dtype": "float32", "count": 1, "nodata": np.nan, "crs": place.crs}
    with rasterio.MemoryFile(ext=".tif") as memory:
        with memory.open(height=rows, width=cols, transform=place.transform, **profile) as file:
            file.write(heights.astype(np.float32), 1)
        yield {"RPC_DEM": memory.name, **more}


def _dem_window(dem: Dem, part: Grid) -> Window:
    """Return the window below a block, px of the DEM, with what the interpolation needs around."""
    rows, cols = part.shape
    col, row = np.meshgrid(np.linspace(0, cols, 33), np.linspace(0, rows, 33))
    dem_px = map_px(np.column_stack([col.ravel(), row.ravel()]), part, dem.grid)
    dem_px = dem_px[np.isfinite(dem_px).all(axis=1)]
    if len(dem_px) == 0:
        return Window(0, 0, 0, 0)
    low, high = np.floor(dem_px.min(axis=0)).astype(int), np.ceil(dem_px.max(axis=0)).astype(int)
    box = Window.from_bounds(int(low[1]), int(low[0]), int(high[1]), int(high[0]))
    return box.padded(DEM_MARGIN_PX)


def _step(target: RpcGrid, grid: Grid) -> Array:
    rows, cols = grid.shape
    return np.asarray(jacobian(np.array([[cols / 2, rows / 2]]), grid, levelled(target))[0])
