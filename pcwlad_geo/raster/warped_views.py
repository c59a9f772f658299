"""Rasters that GDAL warps while they are read: VRTs, lattices of positions, blocks read by threads."""

from __future__ import annotations

import os
import queue
import threading
import xml.etree.ElementTree as ET
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager
from contextvars import copy_context
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT
from rasterio.windows import Window

from pcwlad_geo.correction.dense import DenseMapping
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause
from pcwlad_geo.raster.unread import Block, UnreadableParts, filled

_ELEMENTS: Final = (
    "Metadata",
    "Description",
    "UnitType",
    "Offset",
    "Scale",
    "ColorInterp",
    "ColorTable",
)
"""Elements of a band beside its pixels, in the order of the VRT's schema."""


def write_warped_vrt(
    path: Path, source: DatasetReader, options: Mapping[str, object], *, final_path: Path
) -> None:
    """Write a VRT that warps a raster by its geotransform.

    It is written to `path` now; the path in it to the original is relative to the folder of `final_path`. The
    `options` are those of `rasterio.vrt.WarpedVRT`, with the corrected geotransform.
    """
    with WarpedVRT(source, **options) as view:
        rasterio.shutil.copy(view, os.fspath(path), driver="VRT")
    tree = ET.parse(path).getroot()
    pixels = vrt.reference_to(source, final_path)
    for element in tree.iter("SourceDataset"):
        element.text = pixels.name
        element.set("relativeToVRT", "1" if pixels.relative else "0")
    described = vrt.describe_pixels(source, pixels, source.shape)
    for number, tags in enumerate(described.findall("Metadata")):
        tree.insert(number, tags)
    bands = zip(tree.findall("VRTRasterBand"), described.findall("VRTRasterBand"), strict=False)
    for band, original in bands:  # an additional alpha band is left unchanged
        for old in [element for element in band if element.tag in _ELEMENTS]:
            band.remove(old)
        for number, element in enumerate(e for e in original if e.tag in _ELEMENTS):
            band.insert(number, element)
    vrt.write(tree, path)


_NOWHERE = -1e30


def write_dense_view(
    source: DatasetReader, folder: Path, mapping: DenseMapping, options: Mapping[str, object]
) -> Path:
    """Write a VRT that resamples a raster by a mapping, and return its path.

    The mapping goes from the pixels (col, row) of the VRT to those of the raster; its nodes are written into
    `folder` too. The `options` are those of `rasterio.vrt.WarpedVRT`, except those of the mapping.
    """
    nodes = _write_nodes(folder / "nodes.tif", mapping)
    path = folder / "view.vrt"
    with WarpedVRT(source, **options) as view:
        rasterio.shutil.copy(view, os.fspath(path), driver="VRT")
    tree = ET.parse(path)
    for base in tree.iter("BaseTransformer"):
        base.clear()
        base.append(_transformer(mapping, nodes))
    tree.write(path, encoding="utf-8")
    return path


def _write_nodes(path: Path, mapping: DenseMapping) -> Path:
    rows, cols = mapping.lattice.shape
    profile = {"driver": "GTiff", "height": rows, "width": cols, "count": 2, "dtype": "float64"}
    # Any but unit pixels, about which rasterio warns.
    place = rasterio.Affine.scale(2.0, -2.0)
    with rasterio.open(path, "w", **profile, nodata=_NOWHERE, transform=place) as file:
        file.write(np.nan_to_num(np.moveaxis(mapping.moved_px, 2, 0), nan=_NOWHERE))
    return path


def _transformer(mapping: DenseMapping, nodes: Path) -> ET.Element:
    """Return GDAL's description of the mapping from the VRT's pixels to the raster's."""
    element = ET.Element("GenImgProjTransformer")
    for name in ("SrcGeoTransform", "SrcInvGeoTransform"):
        ET.SubElement(element, name).text = "0,1,0,0,0,1"
    array = ET.SubElement(ET.SubElement(element, "DstGeoLocTransformer"), "GeoLocTransformer")
    ET.SubElement(array, "Reversed").text = "0"
    (col, row), (col_step, row_step) = mapping.lattice.origin_px, mapping.lattice.step_px
    place = {
        "X_DATASET": str(nodes.resolve()),
        "X_BAND": 1,
        "Y_DATASET": str(nodes.resolve()),
        "Y_BAND": 2,
        "PIXEL_OFFSET": col,
        "PIXEL_STEP": col_step,
        "LINE_OFFSET": row,
        "LINE_STEP": row_step,
        "GEOREFERENCING_CONVENTION": "TOP_LEFT_CORNER",
    }
    metadata = ET.SubElement(array, "Metadata")
    for key, value in place.items():
        ET.SubElement(metadata, "MDI", key=key).text = str(value)
    return element


MAX_THREADS: Final = 4
"""Largest number of reading threads; more would wait for the thread that writes."""


def warped_blocks(
    unreadable: UnreadableParts,
    view: Callable[[], AbstractContextManager[DatasetReader]],
    windows: Sequence[Window],
) -> Generator[tuple[Window, Block], None, None]:
    """Yield the windows of a warped raster, each row of windows read by one thread from left to right.

    GDAL works without Python's lock, and each thread opens the file for itself. At most one block per thread
    waits to be consumed. Raises `InputError` if the raster cannot be opened, or too much of it cannot be
    read.

    Parameters
    ----------
    unreadable : UnreadableParts
        Counts the parts that cannot be read.
    view : callable
        Opens the warped raster.

    Yields
    ------
    Window
        The windows, in no defined order.
    (bands, rows, cols) array
        The pixels of the window, in the dtype and the units of the raster.
    """
    rows = [list(row) for _, row in groupby(windows, key=lambda window: window.row_off)]
    count = min(os.cpu_count() or 1, MAX_THREADS, len(rows))
    done: queue.Queue[tuple[Window, Block] | BaseException] = queue.Queue(maxsize=count)
    stop = threading.Event()

    def read(own: Sequence[Window]) -> None:
        try:
            with view() as warped:
                nothing = filled(_values_of_nothing(warped), np.dtype(np.result_type(*warped.dtypes)))
                least = warped.block_shapes[0]  # GDAL warps whole blocks: smaller parts would fail too

                def part(window: Window) -> Block:
                    return np.asarray(warped.read(window=window))

                for window in own:
                    done.put((window, unreadable.read(part, window, nothing, least)))
                    if stop.is_set():
                        return
        except GDAL_ERRORS as error:
            done.put(InputError(f"{unreadable.name} cannot be read: {root_cause(error)}"))
        except BaseException as error:  # raised in the thread that consumes the blocks
            done.put(error)

    shares = [[window for row in rows[first::count] for window in row] for first in range(count)]
    # each with the permissions of this thread, which threads do not inherit
    threads = [
        threading.Thread(target=copy_context().run, args=(read, share), daemon=True) for share in shares
    ]
    try:
        for thread in threads:
            thread.start()
        for _ in windows:
            yield _checked(done.get())
    finally:
        stop.set()
        _drain(done, threads)


def _values_of_nothing(warped: DatasetReader) -> list[float]:
    """Return the value of each band where there is no data."""
    return [
        0.0 if kind == ColorInterp.alpha or nodata is None else nodata
        for kind, nodata in zip(warped.colorinterp, warped.nodatavals, strict=True)
    ]


def _checked(item: tuple[Window, Block] | BaseException) -> tuple[Window, Block]:
    if isinstance(item, BaseException):
        raise item
    return item


def _drain(done: queue.Queue[Any], threads: Sequence[threading.Thread]) -> None:
    """Empty the queue until every thread has ended."""
    while any(thread.is_alive() for thread in threads):
        try:
            done.get(timeout=0.05)
        except queue.Empty:
            continue
