"""The registered raster: all bands of the original target, resampled once, onto the output grid."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

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
from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.dense_view import write_dense_view
from pcwlad_geo.raster.described_copy import write_described
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause, small_block_cache
from pcwlad_geo.raster.grid import Grid, jacobian, map_px
from pcwlad_geo.raster.metadata import is_paletted
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.output_grid import original_pixels
from pcwlad_geo.raster.shared_plane import grid_beside
from pcwlad_geo.raster.source import describe, open_own_raster, open_raster
from pcwlad_geo.raster.unread import Block, Gaps
from pcwlad_geo.raster.validity import fill, validity
from pcwlad_geo.raster.warped_blocks import warped_blocks
from pcwlad_geo.raster.warped_vrt import write_warped_vrt

Array = NDArray[np.float64]
ProgressCallback = Callable[[int, int], None]
COG = OutputFormat()
# GDAL interpolates the transformation along scan lines to this error, and each block does so anew: blocks fit
# to twice as much. Its default is 0.125 px; this costs no more.
_TOLERANCE_PX = 0.001
# Kernels are widened where an output pixel is larger than the source's by more than this.
_COARSER = 0.95
_BLOCK_PX = 1024
_BLOCK_BYTES = 2**24
# The same of corrections that are evaluated on a lattice.
_DENSE_TOLERANCE_PX = 0.01
# Pixels as map units, for mappings that end in pixels; unit pixels without a flip rasterio takes for none.
_PIXELS = Affine.scale(1.0, -1.0)
# A view of the warped raster that a thread opens for itself.
View = Callable[[], AbstractContextManager[DatasetReader]]
Blocks = Generator[tuple[Window, Block], None, None]


@dataclass(frozen=True, slots=True)
class BlockRequest:
    """Which blocks of a warped raster are wanted, and how they tell what is valid."""

    windows: Sequence[Window]
    nodata: float | None
    as_alpha: bool
    """By an additional alpha band, or else by the nodata value where nothing is known."""
    scratch: Path
    """Folder for files that are needed until the last block."""
    gaps: Gaps
    """Takes note of what cannot be read."""

    def options(self) -> dict[str, object]:
        """Return what is valid as options of `rasterio.vrt.WarpedVRT`."""
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
    made: OutputFormat = COG,
    final_path: Path | None = None,
    progress: ProgressCallback | None = None,
) -> str | None:
    """Resample all bands of a raster once onto the output grid and write it, as a COG by default.

    The inverse of georeferencing ∘ correction: output pixel → predicted target pixel → observed
    target pixel → sample, exact to 0.001 px. Data type, nodata, alpha, mask, scales, units,
    descriptions, colours and tags are kept. What the raster does not cover is nodata where it has
    a nodata value, transparent where it has an alpha band, NaN in floating-point bands, and
    masked by an internal mask otherwise: no nodata value is invented. Bands with a colour table
    are resampled nearest neighbour. Blocks are read and warped in a few threads; memory does not
    grow with the raster. Parts of a damaged file that cannot be read are left empty.

    Parameters
    ----------
    source_path : str or pathlib.Path
        The original target, or another raster of the same sensor geometry.
    out_path : pathlib.Path
        The file to write; scratch files of the same size are made beside it.
    correction : Correction
        Maps predicted to observed target pixels.
    grid : Grid
        The output grid. Where it or the source has no place, its pixels are the predicted ones.
    resampling : str
        A name of `rasterio.enums.Resampling`.
    target_grid : Grid, optional
        The grid whose pixels the correction speaks of; that of source_path by default.
    made : OutputFormat
        A VRT holds no pixels, but how to warp those of the source by a shift or an affine.
    final_path : pathlib.Path, optional
        Where the file will live, if not where it is written: a VRT's path to the source is relative to that.
    progress : callable, optional
        Receives done, total after each block; what it raises ends the work.

    Returns
    -------
    str or None
        A warning where parts of the source could not be read.

    Raises
    ------
    InputError
        If the source, or half of it, cannot be read, or lies in another CRS than target_grid, or the
        correction is too much for a VRT.
    OutputError
        If the result cannot be written.
    """
    info = describe(os.fspath(source_path))
    own_grid = info.grid if target_grid is None else grid_beside(info, target_grid)
    target_grid = target_grid or own_grid
    check_geometry(source_path, own_grid, target_grid)
    grids = (own_grid, target_grid, grid)
    if made.is_vrt:
        _write_vrt(source_path, out_path, grids, correction, resampling, final_path or out_path)
        return None

    def blocks_of(source: DatasetReader, method: Resampling, request: BlockRequest) -> Blocks:
        view = _view(source, grids, correction, method, request)
        return warped_blocks(request.gaps, view, request.windows)

    return write_warped(source_path, out_path, grid, resampling, blocks_of, progress, made=made)


def write_warped(
    source_path: str | Path,
    out_path: Path,
    grid: Grid,
    resampling: str,
    blocks_of: BlocksOf,
    progress: ProgressCallback | None = None,
    *,
    made: OutputFormat = COG,
) -> str | None:
    """Write the blocks of a warped raster with all that the raster carries beside its pixels.

    Parameters
    ----------
    source_path, out_path, grid, resampling, progress, made
        As for `warp`; not a VRT.
    blocks_of : callable
        Resamples the windows of the output that it is asked for.

    Returns
    -------
    str or None
        A warning where parts of the source could not be read.

    Raises
    ------
    InputError
        If the source, or half of it, cannot be read.
    OutputError
        If the result cannot be written.
    """
    with (
        open_raster(os.fspath(source_path)) as source,
        _scratch_folder(out_path) as scratch,
        small_block_cache(),
    ):
        method = Resampling.nearest if is_paletted(source) else Resampling[resampling]
        gaps = Gaps(source.name, grid.shape[0] * grid.shape[1])
        pixels = _write_pixels(source, scratch / "pixels.tif", gaps, grid.shape, method, blocks_of, progress)
        warning = gaps.warning()
        interpolated = method != Resampling.nearest
        files = write_described(source, pixels, grid, made, scratch, out_path.name, interpolated=interpolated)
        for file in reversed(files):  # the raster itself last
            file.replace(out_path.with_name(file.name))
    return warning


def check_geometry(source_path: str | Path, own: Grid, target: Grid) -> None:
    """Check that a correction of the target's pixels can speak of a raster's.

    Raises
    ------
    InputError
        If the two are in different CRSs, or have different sizes and no CRS.
    """
    if own.crs != target.crs:
        raise InputError(
            f"{source_path} is in {name_of(own.crs)}, the registered target in {name_of(target.crs)}: "
            "give a raster in the same CRS"
        )
    if target.located and not own.located:
        raise InputError(
            f"{source_path} has no geotransform in the plane of the registered target: give it one "
            "(gdal_edit.py -a_ullr), or a raster that has one"
        )
    if not own.located and own.shape != target.shape:
        raise InputError(
            f"{source_path} has {own.shape[1]} x {own.shape[0]} pixels and no georeferencing, the registered "
            f"target {target.shape[1]} x {target.shape[0]}: give one of the same size, or georeference it"
        )


def _view(
    source: DatasetReader,
    grids: tuple[Grid, Grid, Grid],
    correction: Correction,
    method: Resampling,
    request: BlockRequest,
) -> View:
    """Return how to open the warped raster; the grids are the source's own, the target's, the output's."""
    uri = source.name
    if isinstance(correction, AffineCorrection):
        options = _affine_options(source, grids, correction, method) | request.options()
        return lambda: _warped(uri, options)
    own, target, out = grids
    mapping = original_pixels(own, target, correction, out)
    rows, cols = out.shape
    ends = np.array([cols, rows]) / 2 + 0.5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    moved = mapping(ends)
    step = np.stack([moved[0] - moved[1], moved[2] - moved[3]], axis=1)
    own_px, out_px = (Grid(grid.shape, _PIXELS, None) for grid in (own, out))
    options = _warp_options(source, own_px, out_px, method, step) | request.options()
    dense = dense_mapping(mapping, (0.0, 0.0), (cols, rows), tolerance_px=_DENSE_TOLERANCE_PX)
    path = os.fspath(write_dense_view(source, request.scratch, dense, options))
    return lambda: open_own_raster(path)


def _affine_options(
    source: DatasetReader, grids: tuple[Grid, Grid, Grid], correction: AffineCorrection, method: Resampling
) -> dict[str, object]:
    """Return how GDAL's warper applies a correction that a geotransform holds."""
    own, target, out = grids
    placed = _corrected_grid(own, target, correction, out)
    centre_px = np.array([[own.shape[1] / 2, own.shape[0] / 2]])
    step = jacobian(map_px(centre_px, placed, out), out, placed)[0]
    return _warp_options(source, placed, out, method, step)


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
    with open_raster(os.fspath(source_path)) as source:
        method = Resampling.nearest if is_paletted(source) else Resampling[resampling]
        nodata, _, needs_mask = validity(source)
        request = BlockRequest((), nodata, needs_mask, path.parent, Gaps(source.name, 1))
        options = _affine_options(source, grids, correction, method) | request.options()
        write_warped_vrt(path, source, options, final_path=final_path)


@contextmanager
def _warped(uri: str, options: dict[str, object]) -> Iterator[DatasetReader]:
    with open_raster(uri) as source, WarpedVRT(source, **options) as view:
        yield view


def _corrected_grid(own: Grid, target: Grid, correction: AffineCorrection, out: Grid) -> Grid:
    """Return the source's pixels where they belong, in the CRS of the source or of the output."""
    if not (own.located and out.located):
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
    gaps: Gaps,
    shape: tuple[int, int],
    method: Resampling,
    blocks_of: BlocksOf,
    progress: ProgressCallback | None,
) -> vrt.PixelFile:
    """Write the resampled pixels, and nothing else, block by block."""
    nodata, fills, needs_mask = validity(source)
    dtype = np.result_type(*source.dtypes)
    profile = {
        "driver": "GTiff",
        "dtype": dtype.name,
        "count": source.count,
        "height": shape[0],
        "width": shape[1],
        "nodata": nodata,
        "tiled": True,
        "blockxsize": 256,
        "blockysize": 256,
        "interleave": "band",
        "BIGTIFF": "IF_SAFER",
        # Any but unit pixels, about which rasterio warns; the true one is in the VRT.
        "transform": Affine.scale(2.0, -2.0),
    }
    windows = list(_blocks(shape, (source.count + 1) * dtype.itemsize))
    request = BlockRequest(windows, nodata, needs_mask or fills, path.parent, gaps)
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(path, "w", **profile) as sink,
        closing(blocks_of(source, method, request)) as blocks,
    ):
        for done, (window, block) in enumerate(blocks, start=1):
            if fills and nodata is not None:
                fill(block[0], block[1] != 0, nodata)
            sink.write(block[: source.count], window=window)
            if needs_mask:
                sink.write_mask(np.where(block[source.count] != 0, 255, 0).astype(np.uint8), window=window)
            if progress is not None:
                progress(done, len(windows))
    return vrt.PixelFile(path.name, True, (nodata,) * source.count, needs_mask)


def _warp_options(
    source: DatasetReader, placed: Grid, grid: Grid, method: Resampling, step: Array
) -> dict[str, object]:
    """Return what GDAL's warper needs to know; `step` is how far a source pixel goes per output pixel."""
    return {
        "src_transform": placed.transform,
        "src_crs": placed.crs,
        "crs": grid.crs,
        "transform": grid.transform,
        "height": grid.shape[0],
        "width": grid.shape[1],
        "tolerance": _TOLERANCE_PX,
        "dtype": np.result_type(*source.dtypes).name,
        **kernel(method, step),
    }


def kernel(method: Resampling, step: Array) -> dict[str, object]:
    """Return the resampling with GDAL's XSCALE, YSCALE: below 1 the kernel is widened against aliasing.

    Lanczos becomes cubic there: GDAL's aliases however wide. Left to itself GDAL derives scales per block,
    with seams, and from bounding boxes, which blurs rotated grids. `step` is (2, 2): source (col, row) by
    output (col, row), NaN where unknown.
    """
    x, y = (1.0 / np.fmax(1.0, np.hypot(*row)) for row in step)
    x, y = (scale if scale < _COARSER else 1.0 for scale in (x, y))
    coarser = method == Resampling.lanczos and min(x, y) < 1
    return {"resampling": Resampling.cubic if coarser else method, "XSCALE": x, "YSCALE": y}


def _blocks(shape: tuple[int, int], bytes_per_px: int) -> Iterator[Window]:
    """Yield windows that cover the raster, row by row, smaller ones where there are many bands."""
    rows, cols = shape
    side = _BLOCK_PX
    while side > 256 and side * side * bytes_per_px > _BLOCK_BYTES:
        side //= 2
    for row in range(0, rows, side):
        for col in range(0, cols, side):
            yield Window(col, row, min(side, cols - col), min(side, rows - row))
