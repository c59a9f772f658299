"""Blocks of rasters that GDAL warps while they are read, in a few threads, of damaged files too."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager, ExitStack
from contextvars import copy_context
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader
from rasterio.windows import Window

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause
from pcwlad_geo.raster.grid import Window as PixelWindow
from pcwlad_geo.types import Bool


@dataclass(frozen=True, slots=True)
class ReadingParameters:
    """How a raster is read of which parts may be unreadable."""

    min_part: tuple[int, int] = (64, 64)
    """Rows and columns of the smallest part that is read on its own."""
    max_lost: float = 0.5
    """Largest share of a raster that may be unreadable; beyond it the file cannot be used."""
    max_parts: int = 2000
    """Largest number of unreadable parts, beyond which the file cannot be used."""
    stride_px: int = 8
    """Distance of the pixels by which readable ones with data are counted."""
    max_threads: int = 4
    """Largest number of reading threads; more would wait for the thread that writes."""


READING: Final = ReadingParameters()
"""Those in use."""
REMOTE: Final = (
    *(f"/vsi{kind}" for kind in ("curl", "s3", "gs", "az", "adls", "oss", "swift")),
    *("http:", "https:"),
)
"""Prefixes of remote files, whose failures may be temporary and are therefore errors, not gaps."""

Block = NDArray[np.generic]
ReadBlock = Callable[[Window], Block]


@dataclass(slots=True)
class UnreadableParts:
    """Counts the unreadable pixels of a raster; safe to use from several threads."""

    name: str
    """Name of the raster, for messages."""
    area_px2: int
    """Number of all pixels to be read."""
    lost_px2: int = 0
    read_px2: int = 0
    """Approximate number of readable pixels with data."""
    _parts: int = 0
    _reason: str = ""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def warning(self) -> str | None:
        """Return the warning to show after all is read; None if everything was readable.

        Raises `InputError` if fewer pixels have data than are unreadable.
        """
        if self.lost_px2 == 0:
            return None
        if self.lost_px2 > self.read_px2:
            raise self._error()
        share = 100 * self.lost_px2 / (self.lost_px2 + self.read_px2)
        return (
            f"about {share:.2g} % of the warped raster is empty, as {self.name} cannot be read there: it may "
            f"be damaged ({self._reason})"
        )

    def read(
        self, read: ReadBlock, window: Window, nothing: ReadBlock, least: tuple[int, int] = READING.min_part
    ) -> Block:
        """Read a block; unreadable parts of it are filled by `nothing`.

        Both it and `read` return the (bands, rows, cols) block of a window; `read` may raise one of
        `GDAL_ERRORS`. Parts of the `least` rows and columns are not divided any further. The result is a
        (bands, rows, cols) array. Raises `InputError` if too much of the raster is unreadable, or the raster
        is remote.
        """
        try:
            block = read(window)
        except GDAL_ERRORS as error:
            self._fail(root_cause(error))
            if window.height <= least[0] and window.width <= least[1]:
                self._lose(window)
                return nothing(window)
        else:
            self._count_read(block, nothing(Window(0, 0, 1, 1)))
            return block
        col, row, cols, rows = (int(value) for value in window.flatten())
        halves = [
            Window(half.col, half.row, half.cols, half.rows)
            for half in PixelWindow(row, col, rows, cols).halves()
        ]
        parts = [self.read(read, half, nothing, least) for half in halves]
        return np.concatenate(parts, 1 if rows >= cols else 2)

    def _count_read(self, block: Block, nothing: Block) -> None:
        sampled = block[:, :: READING.stride_px, :: READING.stride_px]
        same = _empty(sampled, nothing)
        with self._lock:
            self.read_px2 += int((~same.all(axis=0)).sum()) * READING.stride_px**2

    def _fail(self, reason: str) -> None:
        with self._lock:
            self._reason = self._reason or reason
            self._parts += 1
        if self._parts > READING.max_parts or self.name.startswith(REMOTE):
            raise self._error()

    def _lose(self, window: Window) -> None:
        with self._lock:
            self.lost_px2 += int(window.width * window.height)
        if self.lost_px2 > READING.max_lost * self.area_px2:
            raise self._error()

    def _error(self) -> InputError:
        return InputError(f"{self.name} cannot be read: {self._reason}")


def _empty(block: Block, nothing: Block) -> Bool:
    """Return where the values of a block are those of nothing; NaN counts as equal to NaN."""
    return np.asarray((block == nothing) | ((block != block) & (nothing != nothing)))


def filled(values: list[float], dtype: np.dtype[Any]) -> ReadBlock:
    """Return a function that fills a (bands, rows, cols) block of `dtype` with one of `values` per band."""

    def nothing(window: Window) -> Block:
        column = np.array(values).astype(dtype)[:, None, None]
        return np.broadcast_to(column, (len(values), int(window.height), int(window.width))).copy()

    return nothing


def warped_blocks(
    unreadable: UnreadableParts,
    views: Sequence[Callable[[], AbstractContextManager[DatasetReader]]],
    windows: Sequence[Window],
) -> Generator[tuple[Window, Block], None, None]:
    """Yield the windows of a warped raster, each row of windows read by one thread from left to right.

    GDAL works without Python's lock, and each thread opens the file for itself, by `views`: what the first is
    empty in, the next ones may hold. At most one block per thread waits to be consumed. The windows come in
    no defined order, each with its (bands, rows, cols) array of pixels. Raises `InputError` if the raster
    cannot be opened, or too much of it cannot be read.
    """
    rows = [list(row) for _, row in groupby(windows, key=lambda window: window.row_off)]
    count = min(os.cpu_count() or 1, READING.max_threads, len(rows))
    blocks: queue.Queue[tuple[Window, Block] | BaseException] = queue.Queue(maxsize=count)
    stop = threading.Event()

    def read(share: Sequence[Window]) -> None:
        try:
            with ExitStack() as stack:
                warped, *fallbacks = [stack.enter_context(view()) for view in views]
                nothing = filled(_values_of_nothing(warped), np.dtype(np.result_type(*warped.dtypes)))
                least = warped.block_shapes[0]  # GDAL warps whole blocks: smaller parts would fail too

                def part(window: Window) -> Block:
                    block = np.asarray(warped.read(window=window))
                    for other in fallbacks:
                        empty = _empty(block, nothing(Window(0, 0, 1, 1)))
                        block = np.where(empty, other.read(window=window), block)
                    return block

                for window in share:
                    blocks.put((window, unreadable.read(part, window, nothing, least)))
                    if stop.is_set():
                        return
        except GDAL_ERRORS as error:
            blocks.put(InputError(f"{unreadable.name} cannot be read: {root_cause(error)}"))
        except BaseException as error:  # raised in the thread that consumes the blocks
            blocks.put(error)

    shares = [[window for row in rows[first::count] for window in row] for first in range(count)]
    # each with the permissions of this thread, which threads do not inherit
    threads = [
        threading.Thread(target=copy_context().run, args=(read, share), daemon=True) for share in shares
    ]
    try:
        for thread in threads:
            thread.start()
        for _ in windows:
            yield _checked(blocks.get())
    finally:
        stop.set()
        _drain(blocks, threads)


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


def _drain(blocks: queue.Queue[Any], threads: Sequence[threading.Thread]) -> None:
    """Empty the queue until every thread has ended."""
    while any(thread.is_alive() for thread in threads):
        try:
            blocks.get(timeout=0.05)
        except queue.Empty:
            continue
