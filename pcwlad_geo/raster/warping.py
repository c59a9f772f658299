"""Warping of rasters: resampling once onto the output grid, block by block, with validity and metadata."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT
from rasterio.windows import Window

from pcwlad_geo.correction.dense import dense_mapping
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.gdal import (
    raising_gdal_reports,
    small_block_cache,
)
from pcwlad_geo.raster.grid import Grid, jacobian, map_px
from pcwlad_geo.raster.matching_grid import grid_on_plane_of
from pcwlad_geo.raster.opening import open_raster, open_written_raster
from pcwlad_geo.raster.output_format import OutputFormat, write_described
from pcwlad_geo.raster.output_grid import mapped_parts, original_pixels
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.vrt import has_alpha, has_mask_band, is_paletted, usable_nodata
from pcwlad_geo.raster.warped_views import Block, UnreadableParts, warped_blocks
from pcwlad_geo.raster.warped_vrt import dense_view_in_memory, write_dense_view, write_warped_vrt
from pcwlad_geo.raster.writing import MemoryFolder, scratch_folder, sink
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class WarpParameters:
    """How GDAL warps."""

    tolerance_px: float = 0.001
    """Error to which GDAL interpolates the transformation along scan lines. Each block does so anew: blocks
    fit to twice as much. Its default is 0.125 px; this costs no more."""
    coarser: float = 0.95
    """Kernels are widened where an output pixel is larger than the source's divided by this."""
    block_px: int = 1024
    """Largest side of a block."""
    block_bytes: int = 2**24
    """Largest size of a block with all its bands, unless it has 256 px a side."""
    dense_tolerance_px: float = 0.01
    """Error of corrections that are evaluated on a lattice."""


WARPING: Final = WarpParameters()
"""Those in use."""
COG: Final = OutputFormat()
"""The default format, a cloud-optimised GeoTIFF."""
_PIXELS: Final = Affine.scale(1.0, -1.0)
"""Pixels as map units, for mappings between pixels; rasterio takes unit pixels without a flip for none."""


def validity(source: DatasetReader) -> tuple[float | None, bool, bool]:
    """Return the nodata value of the output, whether it is filled in here, and whether a mask is written."""
    nodata = usable_nodata(source)
    if nodata is None and not has_alpha(source) and not has_mask_band(source):
        nodata = math.nan if np.result_type(*source.dtypes).kind == "f" else None
    # GDAL's warper is almost three times as slow if it fills in nodata itself, but does so band by band
    fills = nodata is not None and source.count == 1 and not has_alpha(source)
    return nodata, fills, nodata is None and not has_alpha(source)


def fill(values: NDArray[Any], valid: Bool, nodata: float) -> None:
    """Write the nodata value where a band is not valid, and only there, in place.

    A valid pixel with that value becomes the next larger value, or the next smaller at the end of the range.
    The (rows, cols) `values`, in the dtype and unit of the band, are changed in place; `valid` is a (rows,
    cols) array of bool.
    """
    if values.dtype.kind == "f":
        neighbour = np.nextafter(values.dtype.type(nodata), values.dtype.type(np.inf))
    else:
        neighbour = int(nodata) + (1 if nodata < np.iinfo(values.dtype).max else -1)
    values[values == nodata] = neighbour
    values[~valid] = nodata


ProgressCallback = Callable[[int, int], None]
# A view of the warped raster that a thread opens for itself.
OpenView = Callable[[], AbstractContextManager[DatasetReader]]
Blocks = Generator[tuple[Window, Block], None, None]


@dataclass(frozen=True, slots=True)
class BlockRequest:
    """The requested blocks of a warped raster, and how they mark validity."""

    windows: Sequence[Window]
    nodata: float | None
    as_alpha: bool
    """Whether validity is marked by an additional alpha band, rather than by the nodata value."""
    scratch: Path | MemoryFolder
    """Folder for temporary files that are needed until the last block."""
    unreadable: UnreadableParts
    """Counts the parts that cannot be read."""

    def options(self) -> dict[str, object]:
        """Return the options of `rasterio.vrt.WarpedVRT` that mark validity."""
        options: dict[str, object] = {"add_alpha": self.as_alpha}
        if self.nodata is not None:
            options |= {"src_nodata": self.nodata}
            options |= {} if self.as_alpha else {"nodata": self.nodata}
        return options


BlocksOf = Callable[[DatasetReader, Resampling, BlockRequest], Blocks]


def warp(
    source_path: str | Path,
    out_path: Path,
    correction: Correction,
    grid: Grid,
    resampling: str = "lanczos",
    *,
    target_grid: Grid | None = None,
    fmt: OutputFormat = COG,
    final_path: Path | None = None,
    progress: ProgressCallback | None = None,
) -> str | None:
    """Resample all bands of a raster once onto the output grid and write it, as a COG by default.

    Each output pixel is mapped to its predicted and then to its observed target pixel, to 0.001 px, and
    sampled there. Data type, nodata, alpha, mask, scales, units, descriptions, colours and tags are kept.
    Pixels that the raster does not cover are nodata if it has a nodata value, transparent if it has an alpha
    band, NaN in floating-point bands, and otherwise excluded by an internal mask: no nodata value is
    introduced. Bands with a colour table are resampled by nearest neighbour. Blocks are read and warped in a
    few threads; memory does not grow with the raster. Unreadable parts of a damaged file are left empty.
    Raises `InputError` if the source, or half of it, cannot be read, or its CRS is not that of target_grid,
    or a VRT cannot represent the correction; `OutputError` if the result cannot be written.

    Parameters
    ----------
    source_path : str or pathlib.Path
        The original target, or another raster of the same sensor geometry.
    out_path : pathlib.Path
        The file to write; scratch files of the same size are made beside it.
    correction : Correction
        Maps predicted to observed target pixels.
    grid : Grid
        The output grid. Where it or the source has no map coordinates, its pixels are the predicted ones.
    resampling : str
        A name of `rasterio.enums.Resampling`.
    target_grid : Grid, optional
        The grid whose pixels the correction maps; that of source_path by default.
    fmt : OutputFormat
        The format; a VRT holds no pixels but warps those of the source by a shift or an affine correction.
    final_path : pathlib.Path, optional
        Final path of the file if it differs from out_path: a VRT's path to the source is relative to it.
    progress : callable, optional
        Receives (done, total) after each block; an exception that it raises ends the work.

    Returns
    -------
    str or None
        A warning where parts of the source could not be read.
    """
    info = describe(os.fspath(source_path), part=True)
    own_grid = info.grid if target_grid is None else grid_on_plane_of(info, target_grid)
    target_grid = target_grid or own_grid
    check_geometry(source_path, own_grid, target_grid)
    grids = (own_grid, target_grid, grid)
    if fmt.is_vrt:
        _write_vrt(source_path, out_path, grids, correction, resampling, final_path or out_path)
        return None

    blocks_of = blocks_by(grids, correction)
    return write_warped(source_path, out_path, grid, resampling, blocks_of, progress, fmt=fmt)


def blocks_by(grids: tuple[Grid, Grid, Grid], correction: Correction) -> BlocksOf:
    """Return what yields the blocks of a raster warped by a correction; the grids are as for `_views`."""

    def blocks_of(source: DatasetReader, method: Resampling, request: BlockRequest) -> Blocks:
        views = _views(source, grids, correction, method, request)
        return warped_blocks(request.unreadable, views, request.windows)

    return blocks_of


def write_warped(
    source_path: str | Path,
    out_path: Path,
    grid: Grid,
    resampling: str,
    blocks_of: BlocksOf,
    progress: ProgressCallback | None = None,
    *,
    fmt: OutputFormat = COG,
) -> str | None:
    """Write the blocks of a warped raster with the metadata of its source.

    `blocks_of` yields windows of the output with their (bands, rows, cols) blocks, given the open source, the
    resampling and a `BlockRequest`. The rest is as for `warp`, but that the format is no VRT. Return a
    warning where parts of the source could not be read. Raises `InputError` if the source, or half of it,
    cannot be read, and `OutputError` if the result cannot be written.
    """
    with (
        open_raster(os.fspath(source_path)) as source,
        scratch_folder(out_path) as scratch,
        small_block_cache(),
    ):
        method = Resampling.nearest if is_paletted(source) else Resampling[resampling]
        unreadable = UnreadableParts(source.name, grid.shape[0] * grid.shape[1])
        place = str(scratch / "pixels.tif"), scratch
        pixels = write_pixels(source, place, unreadable, grid.shape, method, blocks_of, progress)
        warning = unreadable.warning()
        interpolated = method != Resampling.nearest
        files = write_described(source, pixels, grid, fmt, scratch, out_path.name, interpolated=interpolated)
        for file in reversed(files):  # the raster itself last
            file.replace(out_path.with_name(file.name))
    return warning


def check_geometry(source_path: str | Path, raster: Grid, target: Grid) -> None:
    """Check that a correction of the target's pixels can be applied to a raster.

    Raises `InputError` if the two are in different CRSs, or have different sizes and no CRS.
    """
    if raster.crs != target.crs:
        raise InputError(
            f"{source_path} is in {name_of(raster.crs)}, the registered target in {name_of(target.crs)}: "
            "give a raster in the same CRS"
        )
    if target.located and not raster.located:
        raise InputError(
            f"{source_path} has no geotransform in the plane of the registered target: give it one "
            "(gdal_edit.py -a_ullr), or a raster that has one"
        )
    if not raster.located and raster.shape != target.shape:
        raise InputError(
            f"{source_path} has {raster.shape[1]} x {raster.shape[0]} pixels and no georeferencing, the "
            f"registered target {target.shape[1]} x {target.shape[0]}: give one of the same size, "
            "or georeference it"
        )


def _views(
    source: DatasetReader,
    grids: tuple[Grid, Grid, Grid],
    correction: Correction,
    method: Resampling,
    request: BlockRequest,
) -> list[OpenView]:
    """Return what opens the warped raster, or parts of it; the grids are those of source, target, output."""
    uri, target = source.name, grids[1]
    if isinstance(correction, AffineCorrection) and _by_geotransforms(grids, correction):
        options = _affine_options(source, grids, correction, method) | request.options()
        return [lambda: _warped(uri, options)]
    paths = [_dense_view(source, grids, correction, method, request, turns) for turns in mapped_parts(target)]
    return [partial(open_written_raster, path) for path in paths]


def _dense_view(
    source: DatasetReader,
    grids: tuple[Grid, Grid, Grid],
    correction: Correction,
    method: Resampling,
    request: BlockRequest,
    turns: float,
) -> str:
    """Write the VRT of a warped raster, see `original_pixels`, and return its path."""
    source_grid, target, out = grids
    mapping = original_pixels(source_grid, target, correction, out, turns=turns)
    rows, cols = out.shape
    ends = np.array([cols, rows]) / 2 + 0.5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    mapped = mapping(ends)
    step = np.stack([mapped[0] - mapped[1], mapped[2] - mapped[3]], axis=1)
    own_px, out_px = (Grid(grid.shape, _PIXELS, None) for grid in (source_grid, out))
    options = _warp_options(source, own_px, out_px, method, step) | request.options()
    dense = dense_mapping(mapping, (0.0, 0.0), (cols, rows), tolerance_px=WARPING.dense_tolerance_px)
    if isinstance(request.scratch, MemoryFolder):
        return dense_view_in_memory(source, request.scratch, dense, options)
    folder = request.scratch / f"{turns:g}"
    folder.mkdir()
    return os.fspath(write_dense_view(source, folder, dense, options))


def _by_geotransforms(grids: tuple[Grid, Grid, Grid], correction: AffineCorrection) -> bool:
    """Whether GDAL maps all of a raster to the output by geotransforms, which a swath has not.

    To GDAL, 180 degrees east and west are two places.
    """
    if not all(type(grid) is Grid for grid in grids):
        return False
    corrected, out = _corrected_grid(*grids[:2], correction, grids[2]), grids[2]
    turn = corrected.turn
    x, out_x = (grid.to_xy(grid.boundary_px())[:, 0] for grid in (corrected, out))
    if np.isinf(turn) or corrected.crs == out.crs:  # no other turn of the raster is in the output
        return bool(x.max() - turn <= out_x.min() and out_x.max() <= x.min() + turn)
    return bool((np.abs(x) <= turn / 2 * (1 + 1e-9)).all() and (np.abs(out_x) <= out.turn / 2).all())


def _affine_options(
    source: DatasetReader, grids: tuple[Grid, Grid, Grid], correction: AffineCorrection, method: Resampling
) -> dict[str, object]:
    """Return the options by which GDAL's warper applies a correction that a geotransform can represent."""
    source_grid, target, out = grids
    corrected = _corrected_grid(source_grid, target, correction, out)
    step = jacobian(map_px(source_grid.middle_px, corrected, out), out, corrected)[0]
    return _warp_options(source, corrected, out, method, step)


def _write_vrt(
    source_path: str | Path,
    path: Path,
    grids: tuple[Grid, Grid, Grid],
    correction: Correction,
    resampling: str,
    final_path: Path,
) -> None:
    if not isinstance(correction, AffineCorrection):
        raise InputError(
            f"a VRT cannot hold a {correction.name} correction: give --model affine, or --of COG or GTiff"
        )
    if not _by_geotransforms(grids, correction):
        raise InputError(
            "a VRT cannot hold a swath, or a raster whose longitudes are not the output's: give --of COG or "
            "GTiff"
        )
    with open_raster(os.fspath(source_path)) as source:
        method = Resampling.nearest if is_paletted(source) else Resampling[resampling]
        nodata, _, needs_mask = validity(source)
        request = BlockRequest((), nodata, needs_mask, path.parent, UnreadableParts(source.name, 1))
        options = _affine_options(source, grids, correction, method) | request.options()
        write_warped_vrt(path, source, options, final_path=final_path)


@contextmanager
def _warped(uri: str, options: dict[str, object]) -> Iterator[DatasetReader]:
    with open_raster(uri) as source, WarpedVRT(source, **options) as view:
        yield view


def _corrected_grid(source_grid: Grid, target: Grid, correction: AffineCorrection, out: Grid) -> Grid:
    """Return the corrected grid of the source's pixels, in the CRS of the source or of the output."""
    if not (source_grid.located and out.located):
        # Without georeferencing the predicted target pixel is the output pixel.
        target = Grid(target.shape, out.transform, out.crs)
        return Grid(source_grid.shape, vrt.corrected_transform(target, correction), out.crs)
    transform = vrt.corrected_transform(target, correction)
    if source_grid.transform != target.transform:
        # Another pixel size of the same sensor: the correction moves the ground, T·A⁻¹·T⁻¹.
        transform = vrt.compose(transform, ~target.transform, source_grid.transform)
    return Grid(source_grid.shape, transform, source_grid.crs).in_turn_of(
        out if source_grid.crs == out.crs else source_grid
    )


def write_pixels(
    source: DatasetReader,
    place: tuple[str, Path | MemoryFolder],
    unreadable: UnreadableParts,
    shape: tuple[int, int],
    method: Resampling,
    blocks_of: BlocksOf,
    progress: ProgressCallback | None,
) -> vrt.PixelFile:
    """Write the resampled pixels without metadata, block by block, to the path and folder of a `place`."""
    path, scratch = place
    nodata, fills, needs_mask = validity(source)
    dtype = np.result_type(*source.dtypes)
    profile = {"driver": "GTiff", "dtype": dtype.name, "count": source.count, "nodata": nodata}
    profile |= {"height": shape[0], "width": shape[1], "tiled": True, "blockxsize": 256, "blockysize": 256}
    # Not unit pixels, for which rasterio issues a warning; the true transform is in the VRT.
    profile |= {"interleave": "band", "BIGTIFF": "IF_SAFER", "transform": Affine.scale(2.0, -2.0)}
    windows = list(_blocks(shape, (source.count + 1) * dtype.itemsize))
    request = BlockRequest(windows, nodata, needs_mask or fills, scratch, unreadable)
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        sink(path, profile) as written,
        closing(blocks_of(source, method, request)) as blocks,
    ):
        for count, (window, block) in enumerate(blocks, start=1):
            if fills and nodata is not None:
                fill(block[0], block[1] != 0, nodata)
            with raising_gdal_reports():
                written.write(block[: source.count], window=window)
                if needs_mask:
                    mask = np.where(block[source.count] != 0, 255, 0).astype(np.uint8)
                    written.write_mask(mask, window=window)
            if progress is not None:
                progress(count, len(windows))
    return vrt.PixelFile(Path(path).name, True, needs_mask, (nodata,) * source.count)


def _warp_options(
    source: DatasetReader, source_grid: Grid, grid: Grid, method: Resampling, step: Float64
) -> dict[str, object]:
    """Return the options of GDAL's warper; `step` is the (2, 2) source px per output px."""
    source_place = {"src_transform": source_grid.transform, "src_crs": source_grid.crs}
    place = {"crs": grid.crs, "transform": grid.transform, "height": grid.shape[0], "width": grid.shape[1]}
    how = {"tolerance": WARPING.tolerance_px, "dtype": np.result_type(*source.dtypes).name}
    return source_place | place | how | kernel(method, step)


def kernel(method: Resampling, step: Float64) -> dict[str, object]:
    """Return the resampling with GDAL's XSCALE, YSCALE: below 1 the kernel is widened against aliasing.

    Lanczos becomes cubic in that case, because GDAL's widened Lanczos kernel still aliases. By default GDAL
    derives the scales per block, which leaves seams, and from bounding boxes, which blurs rotated grids. The
    (2, 2) `step` holds the derivatives of source (col, row) by output (col, row), px per px; NaN where
    unknown.
    """
    x, y = (1.0 / np.fmax(1.0, np.hypot(*row)) for row in step)
    x, y = (scale if scale < WARPING.coarser else 1.0 for scale in (x, y))
    coarser = method == Resampling.lanczos and min(x, y) < 1
    return {"resampling": Resampling.cubic if coarser else method, "XSCALE": x, "YSCALE": y}


def _blocks(shape: tuple[int, int], bytes_per_px: int) -> Iterator[Window]:
    """Yield windows that cover the raster, row by row, smaller ones where there are many bands."""
    rows, cols = shape
    side = WARPING.block_px
    while side > 256 and side * side * bytes_per_px > WARPING.block_bytes:
        side //= 2
    for row in range(0, rows, side):
        for col in range(0, cols, side):
            yield Window(col, row, min(side, cols - col), min(side, rows - row))
