"""The check that a raster has no more pixels than its files can hold and fit into memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS, check_block, check_shape, check_stored
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.opening import open_for_reading
from pcwlad_geo.raster.trust.file_kinds import NETWORK_DRIVERS


def check_dataset(uri: str, dataset: DatasetReader, band: int, part: tuple[int, int] | None = None) -> None:
    """Check that what is read of a raster has no more pixels than its files can hold and fit into memory.

    Raises `InputError` if it has. The `band` that is read counts from 1; `uri` is the name for the message.
    All is read, or a `part` of so many rows and columns.
    """
    _check_pixels(uri, dataset, band, part)
    _check_sources(dataset, {dataset.name}, part)


def _check_sources(dataset: DatasetReader, visited: set[str], part: tuple[int, int] | None) -> None:
    """Check the source rasters of a VRT, about which its own size says nothing."""
    if dataset.driver != "VRT":
        return
    for name in dataset.files:
        if name in visited:
            continue
        visited.add(name)
        with (
            suppress(RasterioError),  # it is no raster, or reading it will raise
            ignoring(NotGeoreferencedWarning),
            open_for_reading(name) as source,
        ):
            if source.count:
                _check_pixels(name, source, 1, part)
            _check_sources(source, visited, part)


def _check_pixels(uri: str, dataset: DatasetReader, band: int, part: tuple[int, int] | None) -> None:
    shape = part or dataset.shape
    check_shape(uri, shape, dataset.count)
    _ = dataset.overviews(band), dataset.colorinterp  # GDAL searches for them: better now than after the work
    rows, cols = dataset.block_shapes[band - 1]
    size = np.dtype(dataset.dtypes[band - 1]).itemsize
    together = dataset.count if dataset.tags(ns="IMAGE_STRUCTURE").get("INTERLEAVE") == "PIXEL" else 1
    check_block(uri, (rows, cols), size * together)
    if shape[0] * shape[1] <= LIMITS.checked_px:
        return
    sizes = list(_file_sizes(dataset))
    if sizes and dataset.driver not in NETWORK_DRIVERS:  # on this machine
        check_stored(uri, shape, sum(sizes))
    if dataset.driver == "GTiff" and _stored_share(dataset, band) < LIMITS.min_stored:
        raise InputError(
            f"{uri} declares {shape[1]} x {shape[0]} pixels, and hardly a block of them is in the file "
            f"(less than {LIMITS.min_stored:.1%}): it is empty; crop it to where it holds data"
        )


def _file_sizes(dataset: DatasetReader) -> Iterator[int]:
    """Yield the sizes in bytes of the files of a raster."""
    for name in dataset.files:
        try:
            yield Path(name).stat().st_size
        except (OSError, ValueError):
            continue


def _stored_share(dataset: DatasetReader, band: int) -> float:
    """Return the share of evenly spread sample blocks of a TIFF that are stored in the file."""
    rows, cols = dataset.block_shapes[band - 1]
    counts = -(-dataset.height // rows), -(-dataset.width // cols)
    is_stored = [
        dataset.get_tag_item(f"BLOCK_OFFSET_{block.col}_{block.row}", "TIFF", bidx=band) is not None
        for block in Window.spread(counts, 1, 16)
    ]
    return sum(is_stored) / len(is_stored)
