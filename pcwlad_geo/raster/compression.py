"""The blocks that lossy compression leaves in the pixels of a band."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.gdal import GDAL_ERRORS
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.pixels import read_nearest
from pcwlad_geo.raster.source import RasterInfo, is_huge
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class CompressionParameters:
    """When the blocks of lossy compression count as visible."""

    min_ratio: float = 1.1
    """Least ratio of the steps at the edges of blocks to those inside. Bands without loss show 1.00 to 1.06
    along both axes, JPEGs 1.05 to 2.1, those of low quality most."""
    min_lead: float = 1.05
    """Least ratio of these steps to the largest at any other position in a block."""
    common_percent: float = 98.0
    """Percentile of the steps of a sample to which larger ones, which are the scene's edges, are cut down."""
    sample_px: int = 256
    """Side of the samples."""
    samples_across: int = 3
    """Number of samples along rows and along columns."""


BLOCK_PX: Final = 8
"""Side of a block of JPEG (ITU-T T.81, Annex A): phase congruency sees the grid of blocks where a scene is
flat, and two images of different places would agree on it."""
COMPRESSION: Final = CompressionParameters()
"""Those in use."""


def with_compression_blocks(info: RasterInfo) -> RasterInfo:
    """Return a band that says whether the blocks of lossy compression show in its pixels.

    Only bands of 8 bits are looked at, in nine samples. Whether it is a JPEG does not matter: many a TIFF was
    one. A band that cannot be read here is returned as it is: whoever reads it next reports that.
    """
    if info.dtype != "uint8" or is_huge(info.grid):
        return info
    with suppress(InputError, *GDAL_ERRORS), open_raster(info.uri) as dataset:

        def read(window: Window) -> tuple[NDArray[np.generic], Bool]:
            values = read_nearest(dataset, info.band, window, window.shape)
            return values, values != info.nodata

        return replace(info, shows_blocks=find_blocks(read, dataset.shape) is not None)
    return info


def find_blocks(
    read: Callable[[Window], tuple[NDArray[Any], Bool]], shape: tuple[int, int]
) -> tuple[int, int] | None:
    """Find the blocks of a band of `shape` (rows, cols) in nine samples; None if it shows none.

    `read` returns the (rows, cols) values and validity of a window. The result is the row and the column,
    modulo 8, at which blocks begin.
    """
    if min(*shape, COMPRESSION.sample_px) < 4 * BLOCK_PX:
        return None
    windows = Window.spread(shape, COMPRESSION.sample_px, COMPRESSION.samples_across)
    samples = [(read(window), window) for window in windows]
    by_row = _mean_steps((values, valid, window.row) for (values, valid), window in samples)
    by_col = _mean_steps((values.T, valid.T, window.col) for (values, valid), window in samples)
    row, col = _first_px(by_row), _first_px(by_col)
    return None if row is None or col is None else (row, col)


def _mean_steps(samples: Iterable[tuple[NDArray[Any], Bool, int]]) -> Float64:
    """Return the (8,) mean absolute steps into rows of each number modulo 8; the scene's edges are capped."""
    total, count = np.zeros(BLOCK_PX), np.zeros(BLOCK_PX)
    for values, valid, first in samples:
        slopes = np.diff(values.astype(np.float64), axis=0)
        size = np.abs(slopes[1:-1] - (slopes[:-2] + slopes[2:]) / 2)  # less the slopes beside the step
        good = valid[:-3] & valid[1:-2] & valid[2:-1] & valid[3:]  # the four pixels of each step
        if not good.any():
            continue
        size = np.minimum(size, np.percentile(size[good], COMPRESSION.common_percent)) * good
        row = (first + 2 + np.arange(len(size))) % BLOCK_PX
        total += np.bincount(row, size.sum(axis=1), BLOCK_PX)
        count += np.bincount(row, good.sum(axis=1), BLOCK_PX)
    return np.divide(total, count, out=np.zeros(BLOCK_PX), where=count > 0)


def _first_px(steps: Float64) -> int | None:
    """Return where blocks begin, from the (8,) mean steps; None if they do not show."""
    first = int(np.argmax(steps))
    inside = np.delete(steps, first)
    least = max(COMPRESSION.min_ratio * inside.mean(), COMPRESSION.min_lead * inside.max())
    return first if steps[first] >= least and steps[first] > 0 else None
