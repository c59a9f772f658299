"""Which pixels of a file count."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, MaskFlags, Resampling
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.plausible import is_plausible
from pcwlad_geo.in_memory import equals_nodata
from pcwlad_geo.raster.gdal import GDAL_ERRORS
from pcwlad_geo.raster.grid import Grid, Window
from pcwlad_geo.raster.masks import FLAGS_ONLY, accepted, bands_of, files_of_mask
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.source import RasterInfo, mask_on_pixels
from pcwlad_geo.types import Bool


def read_nearest(
    dataset: DatasetReader, band: int, window: Window, shape: tuple[int, int]
) -> NDArray[np.generic]:
    """Return a window of a band, by nearest neighbour, in an array of `shape` (rows, cols)."""
    file_window = FileWindow(window.col, window.row, window.cols, window.rows)
    return np.asarray(dataset.read(band, window=file_window, out_shape=shape))


def valid_in_file(
    dataset: DatasetReader, band: int, values: NDArray[np.generic], file_window: FileWindow
) -> Bool:
    """Return the (rows, cols) validity of a window by the file itself: all kinds of masks that it has.

    The (rows, cols) `values` of the window are in the dtype of `band`, a number from 1. Values that nothing
    measures are not valid.
    """
    valid = is_plausible(values) & ~equals_nodata(values, dataset.nodatavals[band - 1])
    # In GDAL nodata takes precedence over a mask, and a mask over alpha; here they are combined.
    flags = dataset.mask_flag_enums[band - 1]
    if MaskFlags.all_valid not in flags and flags != [MaskFlags.nodata]:
        valid &= dataset.read_masks(band, window=file_window) != 0
    alphas = [i for i, colour in enumerate(dataset.colorinterp, start=1) if colour == ColorInterp.alpha]
    if alphas and band not in alphas and MaskFlags.alpha not in flags:
        valid &= dataset.read(alphas[0], window=file_window) != 0
    return np.asarray(valid)


def valid_in_mask_file(info: RasterInfo, window: Window) -> Bool:
    """Return the (rows, cols) pixels of a window, inside the raster, that its mask file does not exclude.

    A mask of another grid is sampled at the pixel centres (nearest); outside of it nothing is valid. Without
    a mask file all is. Raises `InputError` if the mask file cannot be read.
    """
    if info.mask_uri is None or info.mask_grid is None:
        return np.ones(window.shape, dtype=bool)
    files = files_of_mask(info.mask_kind, info.mask_uri)
    return np.asarray(np.all([_valid_in(uri, info, info.mask_grid, window) for uri in files], axis=0))


def _valid_in(uri: str, info: RasterInfo, mask_grid: Grid, window: Window) -> Bool:
    """Return the pixels of a window that one of the files of a mask does not exclude."""
    file_window = FileWindow(window.col, window.row, window.cols, window.rows)
    bands = list(bands_of(info.mask_kind))
    with open_raster(uri) as dataset:
        try:
            if mask_on_pixels(info, mask_grid):
                values = dataset.read(bands, window=file_window)
                clear = accepted(info.mask_kind, values)
                if info.mask_kind in FLAGS_ONLY:
                    return clear
                return clear & valid_in_file(dataset, bands[0], values[0], file_window)
            grid, (rows, cols) = info.grid, info.grid.shape
            mask = mask_grid.in_turn_of(grid)
            place = {"crs": grid.crs, "transform": grid.transform, "height": rows, "width": cols}
            place |= {"src_crs": mask.crs, "src_transform": mask.transform, "resampling": Resampling.nearest}
            if info.mask_kind in FLAGS_ONLY:
                place["src_nodata"] = None
            with WarpedVRT(dataset, **place, tolerance=0.02, add_alpha=True) as warped:
                inside = warped.read(warped.count, window=file_window) != 0
                return np.asarray(inside & accepted(info.mask_kind, warped.read(bands, window=file_window)))
        except GDAL_ERRORS as error:
            raise InputError(
                f"the mask {uri} cannot be read: it may be truncated or corrupt ({error})"
            ) from error
