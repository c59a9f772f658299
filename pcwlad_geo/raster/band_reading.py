"""The pixels of a window of a file, of one band or the weighted sum of several, with their validity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray
from rasterio.io import DatasetReader
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.plausible import is_plausible
from pcwlad_geo.raster.bands import BandPart, Bands
from pcwlad_geo.raster.gdal import GDAL_ERRORS
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.pixels import valid_in_file, valid_in_mask_file
from pcwlad_geo.raster.source import Fill, RasterInfo, bands_of
from pcwlad_geo.raster.trust.file_kinds import NETWORK_DRIVERS
from pcwlad_geo.types import Bool


def read_window(info: RasterInfo, window: Window, overview: int | None) -> tuple[NDArray[np.generic], Bool]:
    """Read the (rows, cols) pixels of a window in the band's dtype, with their validity, False outside.

    Of several bands it is their weighted sum, float64, valid where each of them is. Indices of a colour table
    become the brightness of their colours.
    """
    inside = window.clipped(info.grid.shape)
    values = np.zeros(window.shape, dtype=np.float64 if info.several else info.dtype)
    valid = np.zeros(window.shape, dtype=bool)
    if inside.empty:
        return values, valid
    slices = inside.slices_in(window)
    values[slices], valid[slices] = _read_bands(bands_of(info), info.fills, inside, overview)
    valid[slices] &= valid_in_mask_file(info, inside)
    if info.areas is not None:
        valid[slices] &= info.areas.valid(inside, info.grid)
    if info.collar is not None:
        valid[slices] &= info.collar.valid(inside, info.grid.shape)
    if info.brightness is not None:
        values = np.frombuffer(info.brightness, np.uint8)[values]
    values[~valid] = 0
    return values, valid


def _read_bands(
    bands: Bands, fills: Sequence[Fill], inside: Window, overview: int | None
) -> tuple[NDArray[np.generic], Bool]:
    """Read the (rows, cols) values of a window within a raster, and their validity by the files."""
    options = {} if overview is None else {"OVERVIEW_LEVEL": overview}
    total, valid = np.zeros(inside.shape), np.ones(inside.shape, bool)
    for path, group in groupby(bands.parts, key=attrgetter("path")):
        parts = list(group)
        with open_raster(path, **options) as dataset:
            for window, read, good in read_layers(dataset, parts, fills, inside):
                if len(bands.parts) == 1:
                    return read[0], good[0]
                slices = window.slices_in(inside)
                valid[slices] &= np.logical_and.reduce(good)
                for part, layer, mask in zip(parts, read, good, strict=True):
                    total[slices] += part.weight * np.where(mask, layer, 0).astype(np.float64)
    return total, valid


def read_layers(
    dataset: DatasetReader,
    parts: Sequence[BandPart],
    fills: Sequence[Fill],
    inside: Window,
    max_values: int = 1 << 25,
) -> Iterator[tuple[Window, list[NDArray[np.generic]], list[Bool]]]:
    """Yield windows of a file with the (rows, cols) values and validities of its bands.

    They have as many rows as fit into memory: at most `max_values` of several bands, 64 MB as 16 bits.
    """
    numbers = [part.band for part in parts]
    one_dtype = len({dataset.dtypes[number - 1] for number in numbers}) == 1
    count = inside.rows if len(parts) == 1 else max(1, max_values // (len(parts) * inside.cols))
    for row in range(inside.row, inside.row_stop, count):
        window = Window(row, inside.col, min(count, inside.row_stop - row), inside.cols)
        place = FileWindow(window.col, window.row, window.cols, window.rows)
        try:
            read = list(
                dataset.read(numbers, window=place)
                if one_dtype
                else (dataset.read(number, window=place) for number in numbers)
            )
            good = [
                is_plausible(layer, part.limits) & valid_in_file(dataset, part.band, layer, place)
                for part, layer in zip(parts, read, strict=True)
            ]
            for fill in fills:
                good = [mask & fill.is_data(layer) for mask, layer in zip(good, read, strict=True)]
        except GDAL_ERRORS as error:
            cause = "the file may be truncated or corrupt"
            if dataset.driver in NETWORK_DRIVERS:
                cause = "its server gives no pixels there: check the address and the network"
            raise InputError(
                f"{parts[0].path}: {Bands(tuple(parts)).numbers} cannot be read at rows {window.row} to "
                f"{window.row_stop}, columns {window.col} to {window.col_stop}: {cause}"
            ) from error
        yield window, read, good
