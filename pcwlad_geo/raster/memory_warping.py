"""The warping of a raster whose pixels stay in memory."""

from __future__ import annotations

from rasterio.enums import Resampling

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.raster import warping
from pcwlad_geo.raster.gdal import small_block_cache
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.matching_grid import grid_on_plane_of
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.raster import Raster, read_raster
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.vrt import is_paletted
from pcwlad_geo.raster.warped_views import UnreadableParts
from pcwlad_geo.raster.writing import MemoryFolder


def warp_in_memory(
    source_path: str,
    correction: Correction,
    grid: Grid,
    resampling: str,
    target_grid: Grid,
    progress: warping.ProgressCallback | None = None,
) -> tuple[Raster, str | None]:
    """Return what `warp` writes as a raster of (bands, rows, cols), and its warning; no file is written."""
    grids = (grid_on_plane_of(describe(source_path, part=True), target_grid), target_grid, grid)
    warping.check_geometry(source_path, *grids[:2])
    memory = MemoryFolder()
    with open_raster(source_path) as source, small_block_cache():
        method = Resampling.nearest if is_paletted(source) else Resampling[resampling]
        unreadable = UnreadableParts(source.name, grid.shape[0] * grid.shape[1])
        path, blocks_of = memory.path("pixels.tif"), warping.blocks_by(grids, correction)
        warping.write_pixels(source, (path, memory), unreadable, grid.shape, method, blocks_of, progress)
        pixels = read_raster(path)
    return Raster(pixels.array, grid, nodata=pixels.nodata), unreadable.warning()
