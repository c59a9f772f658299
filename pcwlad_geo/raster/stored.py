"""Whether a raster file can hold what it declares: its pixels, its bands, its blocks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import CHECKED_PX, LEAST_STORED, check_block, check_shape, check_stored

_SAMPLES: Final = 16
"""Blocks looked at along each side of a large TIFF."""


def check_dataset(uri: str, dataset: DatasetReader, band: int) -> None:
    """Raise where a raster declares more than its files can hold, or than fits into memory.

    Parameters
    ----------
    uri : str
        Its name, for the message.
    dataset : rasterio dataset
        Open for reading.
    band : int
        The one that is read.

    Raises
    ------
    InputError
        Then.
    """
    shape = dataset.shape
    check_shape(uri, shape, dataset.count)
    _ = dataset.overviews(band), dataset.colorinterp  # GDAL looks for them: better now than after all work
    rows, cols = dataset.block_shapes[band - 1]
    size = np.dtype(dataset.dtypes[band - 1]).itemsize
    together = dataset.count if dataset.tags(ns="IMAGE_STRUCTURE").get("INTERLEAVE") == "PIXEL" else 1
    check_block(uri, (rows, cols), size * together)
    if shape[0] * shape[1] <= CHECKED_PX:
        return
    sizes = list(_file_sizes(dataset))
    if sizes:  # on this machine
        check_stored(uri, shape, sum(sizes))
    if dataset.driver == "GTiff" and _stored_share(dataset, band) < LEAST_STORED:
        raise InputError(
            f"{uri} declares {shape[1]} x {shape[0]} pixels, and hardly a block of them is in the file "
            f"(less than {LEAST_STORED:.1%}): it is empty; crop it to where it holds data"
        )


def _file_sizes(dataset: DatasetReader) -> Iterator[int]:
    """Give the bytes of the files of a raster."""
    for name in dataset.files:
        try:
            yield Path(name).stat().st_size
        except (OSError, ValueError):
            continue


def _stored_share(dataset: DatasetReader, band: int) -> float:
    """Return which share of some blocks of a TIFF, spread evenly, is in the file."""
    rows, cols = dataset.block_shapes[band - 1]
    counts = -(-dataset.height // rows), -(-dataset.width // cols)
    places = [np.unique(np.linspace(0, count - 1, _SAMPLES).astype(int)).tolist() for count in counts]
    found = [
        dataset.get_tag_item(f"BLOCK_OFFSET_{col}_{row}", "TIFF", bidx=band) is not None
        for row in places[0]
        for col in places[1]
    ]
    return sum(found) / len(found)
