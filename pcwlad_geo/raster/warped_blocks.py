"""Blocks of a warped raster, read by a few threads while the caller works on those that are done."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager
from contextvars import copy_context
from itertools import groupby
from typing import Any, Final

import numpy as np
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader
from rasterio.windows import Window

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause
from pcwlad_geo.raster.unread import Block, Gaps, filled

MOST_THREADS: Final = 4
"""More would wait for the one that writes."""


def warped_blocks(
    gaps: Gaps, view: Callable[[], AbstractContextManager[DatasetReader]], windows: Sequence[Window]
) -> Generator[tuple[Window, Block], None, None]:
    """Yield the windows of a warped raster, each row of windows read by one thread from left to right.

    GDAL works without Python's lock, and each thread has the file open for itself. No more than one block
    a thread waits to be taken.

    Parameters
    ----------
    gaps : Gaps
        Takes note of what cannot be read.
    view : callable
        Opens the warped raster.
    windows : sequence of Window

    Yields
    ------
    Window
        In no order that could be relied on.
    (bands, rows, cols) array
        Its pixels.

    Raises
    ------
    InputError
        If the raster cannot be opened, or too much of it cannot be read.
    """
    rows = [list(row) for _, row in groupby(windows, key=lambda window: window.row_off)]
    count = min(os.cpu_count() or 1, MOST_THREADS, len(rows))
    done: queue.Queue[tuple[Window, Block] | BaseException] = queue.Queue(maxsize=count)
    stop = threading.Event()

    def read(own: Sequence[Window]) -> None:
        try:
            with view() as warped:
                nothing = filled(_values_of_nothing(warped), np.dtype(np.result_type(*warped.dtypes)))
                least = warped.block_shapes[0]  # GDAL warps whole blocks: smaller parts would fail alike

                def part(window: Window) -> Block:
                    return np.asarray(warped.read(window=window))

                for window in own:
                    done.put((window, gaps.read(part, window, nothing, least)))
                    if stop.is_set():
                        return
        except GDAL_ERRORS as error:
            done.put(InputError(f"{gaps.name} cannot be read: {root_cause(error)}"))
        except BaseException as error:  # for the thread that takes the blocks
            done.put(error)

    shares = [[window for row in rows[first::count] for window in row] for first in range(count)]
    # each with what the user trusts here: threads do not inherit it
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
    """Return for each band what stands where nothing is known."""
    return [
        0.0 if kind == ColorInterp.alpha or nodata is None else nodata
        for kind, nodata in zip(warped.colorinterp, warped.nodatavals, strict=True)
    ]


def _checked(item: tuple[Window, Block] | BaseException) -> tuple[Window, Block]:
    if isinstance(item, BaseException):
        raise item
    return item


def _drain(done: queue.Queue[Any], threads: Sequence[threading.Thread]) -> None:
    """Make room until every thread has seen that it shall stop."""
    while any(thread.is_alive() for thread in threads):
        try:
            done.get(timeout=0.05)
        except queue.Empty:
            continue
