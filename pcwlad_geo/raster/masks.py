"""Which pixels of a file count: nodata, NaN, internal mask, alpha, per-dataset mask, user's mask file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, MaskFlags, Resampling
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.gdal import GDAL_ERRORS
from pcwlad_geo.raster.mask_kinds import accepted, bands_of
from pcwlad_geo.raster.source import RasterInfo, mask_on_pixels, open_raster
from pcwlad_geo.raster.windows import Window

Bool = NDArray[np.bool_]


def valid_in_file(
    dataset: DatasetReader, band: int, values: NDArray[np.generic], file_window: FileWindow
) -> Bool:
    """Say which values of a window the file itself counts as data: every kind of mask it has, taken together.

    Parameters
    ----------
    dataset : rasterio dataset
        Open for reading.
    band : int
        From 1.
    values : (rows, cols) array
        The window's values in the band's own dtype.
    file_window : rasterio window
        Inside the raster.
    """
    valid = np.isfinite(values) & ~_equals(values, dataset.nodatavals[band - 1])
    # GDAL lets nodata hide a mask, and a mask an alpha band; here they add up.
    flags = dataset.mask_flag_enums[band - 1]
    if MaskFlags.all_valid not in flags and flags != [MaskFlags.nodata]:
        valid &= dataset.read_masks(band, window=file_window) != 0
    alphas = [i for i, colour in enumerate(dataset.colorinterp, start=1) if colour == ColorInterp.alpha]
    if alphas and band not in alphas and MaskFlags.alpha not in flags:
        valid &= dataset.read(alphas[0], window=file_window) != 0
    return np.asarray(valid)


def valid_in_mask_file(info: RasterInfo, window: Window) -> Bool:
    """Read the mask given for a raster on a window inside it: (rows, cols), False = excluded.

    A mask of another grid is taken at the pixel centres (nearest); outside of it nothing is valid.

    Raises
    ------
    InputError
        If the mask file cannot be read.
    """
    if info.mask_uri is None or info.mask_grid is None:
        return np.ones(window.shape, dtype=bool)
    file_window = FileWindow(window.col, window.row, window.cols, window.rows)
    bands = list(bands_of(info.mask_kind))
    with open_raster(info.mask_uri) as dataset:
        try:
            if mask_on_pixels(info, info.mask_grid):
                values = dataset.read(bands, window=file_window)
                inside = valid_in_file(dataset, bands[0], values[0], file_window)
                return np.asarray(inside & accepted(info.mask_kind, values))
            rows, cols = info.grid.shape
            with WarpedVRT(
                dataset,
                crs=info.grid.crs,
                transform=info.grid.transform,
                height=rows,
                width=cols,
                resampling=Resampling.nearest,
                tolerance=0.02,
                add_alpha=True,
            ) as warped:
                inside = warped.read(warped.count, window=file_window) != 0
                return np.asarray(inside & accepted(info.mask_kind, warped.read(bands, window=file_window)))
        except GDAL_ERRORS as error:
            raise InputError(
                f"the mask {info.mask_uri} cannot be read: it may be truncated or corrupt ({error})"
            ) from error


def _equals(values: NDArray[np.generic], nodata: float | None) -> Bool:
    """Compare with a nodata value that the dtype may not be able to hold."""
    if nodata is None or np.isnan(nodata):
        return np.zeros(values.shape, dtype=bool)
    if np.issubdtype(values.dtype, np.integer):
        limits = np.iinfo(str(values.dtype))
        if not float(nodata).is_integer() or not limits.min <= nodata <= limits.max:
            return np.zeros(values.shape, dtype=bool)
        return np.asarray(values == values.dtype.type(int(nodata)))
    with np.errstate(over="ignore"):
        return np.asarray(values == values.dtype.type(nodata))
