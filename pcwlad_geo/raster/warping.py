"""The registered raster: all bands of the original target, resampled once, onto the output grid."""

from __future__ import annotations

import math
import mmap
import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import rasterio
import rasterio.shutil
from affine import Affine
from numpy.typing import NDArray
from rasterio._err import CPLE_BaseError
from rasterio.enums import Resampling
from rasterio.errors import RasterioError
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT
from rasterio.windows import Window

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.grid import Grid, jacobian, map_px
from pcwlad_geo.raster.metadata import has_alpha, has_mask_band, is_paletted, usable_nodata
from pcwlad_geo.raster.source import describe, open_raster

Array = NDArray[np.float64]
ProgressCallback = Callable[[int, int], None]
# What rasterio raises for failures of GDAL: not all of it has its own base class.
_GDAL_ERRORS = (RasterioError, CPLE_BaseError)
# GDAL interpolates the transformation along scan lines to this error; its default of 0.125 px is too coarse.
_TOLERANCE_PX = 0.01
_BLOCK_PX = 1024
# Slivers of the footprint thinner than this get no pixel of their own.
_SLIVER_PX = 1e-3
# Pixel sizes this close to a multiple or a fraction of the reference's are taken as such across CRSs.
_SAME_SIZE_ACROSS_CRS = 0.02
_SAME_SIZE = 1e-6

# With COPY_SRC_MDD=YES GDAL drops the default metadata domain of the bands (seen with 3.10), without
# it all other domains: so the band tags travel under this name.
_BAND_TAGS = "pcwlad-geo-band-tags"


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
    size = np.array([_snapped(1.0 / float(np.hypot(*column)), tolerance) for column in inverse.T])
    low = np.floor(boundary_px.min(axis=0) / size + _SLIVER_PX).astype(int)
    high = np.ceil(boundary_px.max(axis=0) / size - _SLIVER_PX).astype(int)
    cols, rows = (high - low).tolist()
    linear = ((float(size[0]), 0.0), (0.0, float(size[1])))
    origin_px = (float(low[0] * size[0]), float(low[1] * size[1]))
    return reference_grid.remade(linear, origin_px, (rows, cols))


def _snapped(size: float, tolerance: float) -> float:
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
    target pixel → sample, exact to 0.01 px. Data type, nodata, alpha, mask, scales, units,
    descriptions, colours and tags are kept. What the raster does not cover is nodata where it has
    a nodata value, transparent where it has an alpha band, NaN in floating-point bands, and
    masked by an internal mask otherwise: no nodata value is invented. Bands with a colour table
    are resampled nearest neighbour.

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
    with (
        open_raster(os.fspath(source_path)) as source,
        _scratch_folder(out_path) as scratch,
    ):
        own_grid = describe(os.fspath(source_path)).grid
        if target_grid is not None and target_grid.crs != own_grid.crs:
            raise InputError(
                f"{source_path} is in {name_of(own_grid.crs)}, the registered target in "
                f"{name_of(target_grid.crs)}: give a raster in the same CRS"
            )
        placed = _corrected_grid(own_grid, target_grid or own_grid, correction, grid)
        method = Resampling.nearest if is_paletted(source) else Resampling[resampling]
        pixels = _write_pixels(source, scratch / "pixels.tif", placed, grid, method, progress)
        _write_cog(source, scratch, pixels, grid, method).replace(out_path)


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
    except (*_GDAL_ERRORS, OSError) as error:
        raise OutputError(f"cannot write {out_path}: {_root_cause(error)}; is the disk full?") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _root_cause(error: BaseException) -> str:
    """Return GDAL's own words, which rasterio hangs below its "see previous exception"."""
    while error.__cause__ is not None:
        error = error.__cause__
    return " ".join(str(error).split())


def _write_pixels(
    source: DatasetReader,
    path: Path,
    placed: Grid,
    grid: Grid,
    method: Resampling,
    progress: ProgressCallback | None,
) -> vrt.PixelFile:
    """Write the resampled pixels, and nothing else, block by block."""
    nodata = _output_nodata(source)
    needs_mask = nodata is None and not has_alpha(source)
    dtype = np.result_type(*source.dtypes)
    profile = {
        "driver": "GTiff",
        "dtype": dtype.name,
        "count": source.count,
        "height": grid.shape[0],
        "width": grid.shape[1],
        "nodata": nodata,
        "tiled": True,
        "blockxsize": 512,
        "blockysize": 512,
        "BIGTIFF": "IF_SAFER",
        # Any but unit pixels, about which rasterio warns; the true one is in the VRT.
        "transform": Affine.scale(2.0, -2.0),
    }
    windows = list(_blocks(grid.shape))
    with (
        WarpedVRT(source, **_warp_options(source, placed, grid, method, nodata, needs_mask)) as warped,
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(path, "w", **profile) as sink,
    ):
        for done, window in enumerate(windows, start=1):
            block = _read_block(source, warped, window)
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


def _warp_options(
    source: DatasetReader, placed: Grid, grid: Grid, method: Resampling, nodata: float | None, alpha: bool
) -> dict[str, object]:
    options: dict[str, object] = {
        "src_transform": placed.transform,
        "src_crs": placed.crs,
        "crs": grid.crs,
        "transform": grid.transform,
        "height": grid.shape[0],
        "width": grid.shape[1],
        "resampling": method,
        "tolerance": _TOLERANCE_PX,
        "add_alpha": alpha,
        "dtype": np.result_type(*source.dtypes).name,
        **_kernel_scale(placed, grid),
    }
    if nodata is not None:
        options |= {"src_nodata": nodata, "nodata": nodata}
    return options


def _kernel_scale(placed: Grid, grid: Grid) -> dict[str, float]:
    """Return GDAL's XSCALE, YSCALE: below 1 the kernel is widened against aliasing.

    Left to itself GDAL derives them per block, with seams, and from bounding boxes, which blurs
    rotated grids.
    """
    centre_px = np.array([[placed.shape[1] / 2, placed.shape[0] / 2]])
    step = jacobian(map_px(centre_px, placed, grid), grid, placed)[0]
    x, y = (1.0 / max(1.0, float(np.hypot(*row))) for row in step)
    return {"XSCALE": x if x < 0.95 else 1.0, "YSCALE": y if y < 0.95 else 1.0}


def _blocks(shape: tuple[int, int]) -> Iterator[Window]:
    rows, cols = shape
    for row in range(0, rows, _BLOCK_PX):
        for col in range(0, cols, _BLOCK_PX):
            yield Window(col, row, min(_BLOCK_PX, cols - col), min(_BLOCK_PX, rows - row))


def _read_block(source: DatasetReader, warped: WarpedVRT, window: Window) -> NDArray[np.generic]:
    try:
        block: NDArray[np.generic] = warped.read(window=window)
    except _GDAL_ERRORS as error:
        raise InputError(f"{source.name} cannot be read: {_root_cause(error)}") from error
    return block


def _write_cog(
    source: DatasetReader, scratch: Path, pixels: vrt.PixelFile, grid: Grid, method: Resampling
) -> Path:
    """Wrap the pixels in a VRT that carries all the rest, and let GDAL make a COG of it."""
    description, cog = scratch / "described.vrt", scratch / "cog.tif"
    tree = vrt.describe_pixels(source, pixels, grid.shape)
    for metadata in tree.findall("VRTRasterBand/Metadata"):
        if "domain" not in metadata.attrib:
            metadata.set("domain", _BAND_TAGS)
    if grid.crs is not None:
        vrt.add_georeferencing(tree, grid.transform, grid.crs)
    vrt.write(tree, description)
    options = {
        "driver": "COG",
        "COMPRESS": "DEFLATE",
        "PREDICTOR": "YES",
        "BIGTIFF": "IF_SAFER",
        "COPY_SRC_MDD": "YES",
        "NUM_THREADS": "ALL_CPUS",
        # Means, unlike cubic overviews, never overshoot into the nodata value.
        "OVERVIEW_RESAMPLING": "NEAREST" if method == Resampling.nearest else "AVERAGE",
    }

    def copy() -> None:
        # Settings of GDAL belong to a thread.
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
            rasterio.shutil.copy(os.fspath(description), os.fspath(cog), **options)

    _interruptible(copy)
    _rename_band_tags(cog)
    return cog


def _rename_band_tags(path: Path) -> None:
    """Make the band tags plain tags again, in place: the layout of a COG must not change."""
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as content:
        start = content.find(b"<GDALMetadata>")
        end = content.find(b"</GDALMetadata>", start)
        if start >= 0 and end >= 0:
            attribute = f' domain="{_BAND_TAGS}"'.encode()
            # Blanks between attributes mean nothing in XML.
            content[start:end] = content[start:end].replace(attribute, b" " * len(attribute))


def _interruptible(work: Callable[[], None]) -> None:
    """Run one long GDAL call in a thread, so that Ctrl-C need not wait for its end."""
    errors: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.1)
    if errors:
        raise errors[0]
