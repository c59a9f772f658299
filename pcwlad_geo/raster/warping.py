"""The registered raster: all bands of the original target, resampled once, onto the output grid."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.io import DatasetReader
from rasterio.windows import Window

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.cog import write_cog
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause, small_block_cache
from pcwlad_geo.raster.grid import Grid, jacobian, map_px
from pcwlad_geo.raster.metadata import has_alpha, has_mask_band, is_paletted, usable_nodata
from pcwlad_geo.raster.source import describe, open_raster
from pcwlad_geo.raster.warped_blocks import Block, warped_blocks

Array = NDArray[np.float64]
ProgressCallback = Callable[[int, int], None]
# GDAL interpolates the transformation along scan lines to this error, and each block does so anew: blocks fit
# to twice as much. Its default is 0.125 px; this costs no more.
_TOLERANCE_PX = 0.001
_BLOCK_PX = 1024
_BLOCK_BYTES = 2**24
# Slivers of the footprint thinner than this get no pixel of their own.
_SLIVER_PX = 1e-3
# Pixel sizes this close to a multiple or a fraction of the reference's are taken as such across CRSs.
_SAME_SIZE_ACROSS_CRS = 0.02
_SAME_SIZE = 1e-6


Blocks = Generator[tuple[Window, Block], None, None]


@dataclass(frozen=True, slots=True)
class BlockRequest:
    """Which blocks of a warped raster are wanted, and how they tell what is valid."""

    windows: Sequence[Window]
    nodata: float | None
    as_alpha: bool
    """By an additional alpha band, or else by the nodata value where nothing is known."""

    def options(self) -> dict[str, object]:
        """Return the same as options of `rasterio.vrt.WarpedVRT`."""
        options: dict[str, object] = {"add_alpha": self.as_alpha}
        if self.nodata is not None:
            options |= {"src_nodata": self.nodata}
            options |= {} if self.as_alpha else {"nodata": self.nodata}
        return options


BlocksOf = Callable[[DatasetReader, Resampling, BlockRequest], Blocks]


def output_grid(
    reference_grid: Grid,
    target_grid: Grid,
    correction: Correction,
    mode: Literal["reference", "target"] = "reference",
) -> Grid:
    """Return the grid of the registered raster.

    Parameters
    ----------
    reference_grid, target_grid : Grid
        The original grids.
    correction : Correction
        Maps predicted to observed target pixels.
    mode : {"reference", "target"}
        ``target``: the target's own grid. ``reference``: CRS, axes and pixel corners of the
        reference with the target's pixel size, over the whole corrected footprint of the
        target; with equal pixel sizes that is the reference's own pixel lattice. Across CRSs a
        pixel size within 2 % of a multiple or fraction of the reference's becomes that.
        Where either has no CRS: the reference's pixels.

    Raises
    ------
    InputError
        If the footprint cannot be transformed to the reference CRS.
    """
    if mode == "target":
        return target_grid
    if reference_grid.crs is None or target_grid.crs is None:
        return reference_grid
    centre_px = np.array([[target_grid.shape[1] / 2, target_grid.shape[0] / 2]])
    boundary_px = map_px(correction.inverse(target_grid.boundary_px()), target_grid, reference_grid)
    inverse = jacobian(map_px(centre_px, target_grid, reference_grid), reference_grid, target_grid)[0]
    if not (np.isfinite(boundary_px).all() and np.isfinite(inverse).all()):
        raise InputError(
            f"the target's footprint cannot be transformed from {name_of(target_grid.crs)} to "
            f"{name_of(reference_grid.crs)}: crop it to where that CRS is valid, or use --grid target"
        )
    tolerance = _SAME_SIZE if reference_grid.crs == target_grid.crs else _SAME_SIZE_ACROSS_CRS
    # A step along an axis of the reference that crosses one target pixel, in reference pixels.
    size = np.array([snapped_size(1.0 / float(np.hypot(*column)), tolerance) for column in inverse.T])
    low = np.floor(boundary_px.min(axis=0) / size + _SLIVER_PX).astype(int)
    high = np.ceil(boundary_px.max(axis=0) / size - _SLIVER_PX).astype(int)
    cols, rows = (high - low).tolist()
    linear = ((float(size[0]), 0.0), (0.0, float(size[1])))
    origin_px = (float(low[0] * size[0]), float(low[1] * size[1]))
    return reference_grid.remade(linear, origin_px, (rows, cols))


def snapped_size(size: float, tolerance: float = _SAME_SIZE_ACROSS_CRS) -> float:
    """Return the whole multiple or fraction of 1 that a size agrees with, or the size itself."""
    whole = max(1, round(max(size, 1.0 / size)))
    nearest = float(whole) if size >= 1.0 else 1.0 / whole
    return nearest if abs(size / nearest - 1.0) <= tolerance else size


def warp(
    source_path: str | Path,
    out_path: Path,
    correction: AffineCorrection,
    grid: Grid,
    resampling: str = "cubic",
    *,
    target_grid: Grid | None = None,
    progress: ProgressCallback | None = None,
) -> None:
    """Resample all bands of a raster once onto the output grid and write a COG.

    The inverse of georeferencing ∘ correction: output pixel → predicted target pixel → observed
    target pixel → sample, exact to 0.001 px. Data type, nodata, alpha, mask, scales, units,
    descriptions, colours and tags are kept. What the raster does not cover is nodata where it has
    a nodata value, transparent where it has an alpha band, NaN in floating-point bands, and
    masked by an internal mask otherwise: no nodata value is invented. Bands with a colour table
    are resampled nearest neighbour. Blocks are read and warped in a few threads; memory does not
    grow with the raster.

    Parameters
    ----------
    source_path : str or pathlib.Path
        The original target, or another raster of the same sensor geometry.
    out_path : pathlib.Path
        The GeoTIFF to write; scratch files of the same size are made beside it.
    correction : AffineCorrection
        Maps predicted to observed target pixels.
    grid : Grid
        The output grid. Where it or the source has no CRS, its pixels are the predicted ones.
    resampling : str
        A name of `rasterio.enums.Resampling`.
    target_grid : Grid, optional
        The grid whose pixels the correction speaks of; that of source_path by default.
    progress : callable, optional
        Receives done, total after each block; what it raises ends the work.

    Raises
    ------
    InputError
        If the source cannot be read, or lies in another CRS than target_grid.
    OutputError
        If the result cannot be written.
    """
    own_grid = describe(os.fspath(source_path)).grid
    if target_grid is not None and target_grid.crs != own_grid.crs:
        raise InputError(
            f"{source_path} is in {name_of(own_grid.crs)}, the registered target in "
            f"{name_of(target_grid.crs)}: give a raster in the same CRS"
        )
    placed = _corrected_grid(own_grid, target_grid or own_grid, correction, grid)

    def blocks_of(source: DatasetReader, method: Resampling, request: BlockRequest) -> Blocks:
        options = _warp_options(source, placed, grid, method) | request.options()
        return warped_blocks(source.name, options, request.windows)

    write_warped(source_path, out_path, grid, resampling, blocks_of, progress)


def write_warped(
    source_path: str | Path,
    out_path: Path,
    grid: Grid,
    resampling: str,
    blocks_of: BlocksOf,
    progress: ProgressCallback | None = None,
) -> None:
    """Write the blocks of a warped raster as a COG with all that the raster carries beside its pixels.

    Parameters
    ----------
    source_path, out_path, grid, resampling, progress
        As for `warp`.
    blocks_of : callable
        Resamples the windows of the output that it is asked for.

    Raises
    ------
    InputError
        If the source cannot be read.
    OutputError
        If the result cannot be written.
    """
    with (
        open_raster(os.fspath(source_path)) as source,
        _scratch_folder(out_path) as scratch,
        small_block_cache(),
    ):
        method = Resampling.nearest if is_paletted(source) else Resampling[resampling]
        pixels = _write_pixels(source, scratch / "pixels.tif", grid, method, blocks_of, progress)
        interpolated = method != Resampling.nearest
        write_cog(source, scratch, pixels, grid, interpolated=interpolated).replace(out_path)


def _corrected_grid(own: Grid, target: Grid, correction: AffineCorrection, out: Grid) -> Grid:
    """Return the source's pixels where they belong, in the CRS of the source or of the output."""
    if own.crs is None or out.crs is None:
        # Without georeferencing the predicted target pixel is the output pixel.
        target = Grid(target.shape, out.transform, out.crs)
        return Grid(own.shape, vrt.corrected_transform(target, correction), out.crs)
    transform = vrt.corrected_transform(target, correction)
    if own.transform != target.transform:
        # Another pixel size of the same sensor: the correction moves the ground, T·A⁻¹·T⁻¹.
        transform = vrt.compose(transform, ~target.transform, own.transform)
    return Grid(own.shape, transform, own.crs)


@contextmanager
def _scratch_folder(out_path: Path) -> Iterator[Path]:
    try:
        folder = Path(tempfile.mkdtemp(prefix=".warping-", dir=out_path.parent))
    except OSError as error:
        raise OutputError(f"cannot write in {out_path.parent}: {error.strerror}") from error
    try:
        yield folder
    except (*GDAL_ERRORS, OSError) as error:
        raise OutputError(f"cannot write {out_path}: {root_cause(error)}; is the disk full?") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write_pixels(
    source: DatasetReader,
    path: Path,
    grid: Grid,
    method: Resampling,
    blocks_of: BlocksOf,
    progress: ProgressCallback | None,
) -> vrt.PixelFile:
    """Write the resampled pixels, and nothing else, block by block."""
    nodata = _output_nodata(source)
    needs_mask = nodata is None and not has_alpha(source)
    # GDAL's warper is almost three times as slow where it fills in nodata itself, but knows it band by band
    fills = nodata is not None and source.count == 1 and not has_alpha(source)
    dtype = np.result_type(*source.dtypes)
    profile = {
        "driver": "GTiff",
        "dtype": dtype.name,
        "count": source.count,
        "height": grid.shape[0],
        "width": grid.shape[1],
        "nodata": nodata,
        "tiled": True,
        "blockxsize": 256,
        "blockysize": 256,
        "interleave": "band",
        "BIGTIFF": "IF_SAFER",
        # Any but unit pixels, about which rasterio warns; the true one is in the VRT.
        "transform": Affine.scale(2.0, -2.0),
    }
    windows = list(_blocks(grid.shape, (source.count + 1) * dtype.itemsize))
    request = BlockRequest(windows, nodata, needs_mask or fills)
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(path, "w", **profile) as sink,
        closing(blocks_of(source, method, request)) as blocks,
    ):
        for done, (window, block) in enumerate(blocks, start=1):
            if fills and nodata is not None:
                _fill(block[0], block[1] != 0, nodata)
            sink.write(block[: source.count], window=window)
            if needs_mask:
                sink.write_mask(np.where(block[source.count] != 0, 255, 0).astype(np.uint8), window=window)
            if progress is not None:
                progress(done, len(windows))
    return vrt.PixelFile(path.name, True, (nodata,) * source.count, needs_mask)


def _output_nodata(source: DatasetReader) -> float | None:
    nodata = usable_nodata(source)
    if nodata is None and not has_alpha(source) and not has_mask_band(source):
        floating = np.result_type(*source.dtypes).kind == "f"
        return math.nan if floating else None
    return nodata


def _warp_options(source: DatasetReader, placed: Grid, grid: Grid, method: Resampling) -> dict[str, object]:
    return {
        "src_transform": placed.transform,
        "src_crs": placed.crs,
        "crs": grid.crs,
        "transform": grid.transform,
        "height": grid.shape[0],
        "width": grid.shape[1],
        "resampling": method,
        "tolerance": _TOLERANCE_PX,
        "dtype": np.result_type(*source.dtypes).name,
        **_kernel_scale(placed, grid),
    }


def _fill(values: NDArray[Any], valid: NDArray[np.bool_], nodata: float) -> None:
    """Write the nodata value where a band is not valid, and only there; in place.

    A valid pixel that happens to be as large becomes the next larger value, or smaller where there is none.
    """
    if values.dtype.kind == "f":
        beside = np.nextafter(values.dtype.type(nodata), values.dtype.type(np.inf))
    else:
        beside = int(nodata) + (1 if nodata < np.iinfo(values.dtype).max else -1)
    values[values == nodata] = beside
    values[~valid] = nodata


def _kernel_scale(placed: Grid, grid: Grid) -> dict[str, float]:
    """Return GDAL's XSCALE, YSCALE: below 1 the kernel is widened against aliasing.

    Left to itself GDAL derives them per block, with seams, and from bounding boxes, which blurs
    rotated grids.
    """
    centre_px = np.array([[placed.shape[1] / 2, placed.shape[0] / 2]])
    step = jacobian(map_px(centre_px, placed, grid), grid, placed)[0]
    x, y = (1.0 / max(1.0, float(np.hypot(*row))) for row in step)
    return {"XSCALE": x if x < 0.95 else 1.0, "YSCALE": y if y < 0.95 else 1.0}


def _blocks(shape: tuple[int, int], bytes_per_px: int) -> Iterator[Window]:
    """Yield windows that cover the raster, row by row, smaller ones where there are many bands."""
    rows, cols = shape
    side = _BLOCK_PX
    while side > 256 and side * side * bytes_per_px > _BLOCK_BYTES:
        side //= 2
    for row in range(0, rows, side):
        for col in range(0, cols, side):
            yield Window(col, row, min(side, cols - col), min(side, rows - row))
