"""Pixels from all over a band, by which its fill, its border and its impossible values are recognised."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window as FileWindow

from pcwlad_geo.estimation.plausible import is_plausible
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.pixels import valid_in_file
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.types import Bool


@dataclass(frozen=True, slots=True)
class SampleParameters:
    """Which pixels of a band are looked at."""

    overview_px: int = 1024
    """Largest side of the overview."""
    whole_px: int = 2**22
    """Number of pixels up to which a file without overviews is read whole; of larger ones windows are."""
    windows: int = 10
    """Number of such windows along rows and along columns."""
    window_px: int = 32
    """Side of such a window."""


SAMPLES: Final = SampleParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Pixels of a band."""

    values: NDArray[np.generic]
    """(rows, cols) values; those of several windows lie one below the other."""
    valid: Bool
    """(rows, cols) validity by the file itself."""
    windows: tuple[Window, ...]
    """Where they lie in a raster of `shape`: the file or its overview."""
    shape: tuple[int, int]

    def unmarked(self, info: RasterInfo) -> Bool:
        """Return the (rows, cols) pixels that are valid, and neither of a collar nor impossible nor fill."""
        valid = self.valid & is_plausible(self.values, info.limits)
        if info.collar is not None:
            valid &= np.concatenate([info.collar.valid(window, self.shape) for window in self.windows])
        for fill in info.fills:
            valid &= fill.is_data(self.values)
        return valid


@dataclass(frozen=True, eq=False)
class BandPixels:
    """The pixels of a band that are looked at; they are read when they are first asked for, and once.

    Reading raises `InputError` if the file cannot be read.
    """

    info: RasterInfo

    @property
    def overview_shape(self) -> tuple[int, int]:
        """Rows and columns of the overview."""
        rows, cols = self.info.grid.shape
        factor = max(1.0, max(rows, cols) / SAMPLES.overview_px)
        return round(rows / factor) or 1, round(cols / factor) or 1

    @cached_property
    def overview(self) -> Sample:
        """The whole band, reduced by nearest neighbour."""
        shape = self.overview_shape
        with open_raster(self.info.uri) as dataset:
            values = dataset.read(self.info.band, out_shape=shape)
            valid = np.isfinite(values) & (dataset.read_masks(self.info.band, out_shape=shape) != 0)
        return Sample(values, valid, (Window.whole(shape),), shape)

    @cached_property
    def sample(self) -> Sample:
        """The overview; of a large file without overviews windows that are spread over it."""
        shape, band = self.info.grid.shape, self.info.band
        with open_raster(self.info.uri) as dataset:
            if shape[0] * shape[1] <= SAMPLES.whole_px or dataset.overviews(band):
                return self.overview
            windows = Window.spread(shape, SAMPLES.window_px, SAMPLES.windows)
            values, valid = [], []
            for window in windows:
                place = FileWindow(window.col, window.row, window.cols, window.rows)
                values.append(dataset.read(band, window=place))
                valid.append(valid_in_file(dataset, band, values[-1], place))
        return Sample(np.concatenate(values), np.concatenate(valid), tuple(windows), shape)
