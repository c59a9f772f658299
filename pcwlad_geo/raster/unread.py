"""Reading of damaged files: blocks are read by ever smaller parts, and unreadable parts are counted."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause
from pcwlad_geo.raster.grid import Window

MIN_PART: Final = (64, 64)
"""Rows and columns of the smallest part that is read on its own."""
MAX_LOST: Final = 0.5
"""Largest share of a raster that may be unreadable; beyond it the file cannot be used."""
MAX_PARTS: Final = 2000
"""Largest number of unreadable parts, beyond which the file cannot be used."""
REMOTE: Final = (
    *(f"/vsi{kind}" for kind in ("curl", "s3", "gs", "az", "adls", "oss", "swift")),
    *("http:", "https:"),
)
"""Prefixes of remote files, whose failures may be temporary and are therefore errors, not gaps."""
_STRIDE: Final = 8

Block = NDArray[np.generic]
ReadBlock = Callable[[FileWindow], Block]


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
        self, read: ReadBlock, window: FileWindow, nothing: ReadBlock, least: tuple[int, int] = MIN_PART
    ) -> Block:
        """Read a block; unreadable parts of it are filled by `nothing`.

        Raises `InputError` if too much of the raster is unreadable, or the raster is remote.

        Parameters
        ----------
        read : callable
            Returns the (bands, rows, cols) block of a window, or raises one of `GDAL_ERRORS`.
        nothing : callable
            Returns the (bands, rows, cols) block of a window without data.
        least : (int, int)
            Rows and columns of parts that are not divided any further.

        Returns
        -------
        (bands, rows, cols) array
            The dtype and the units of the bands.
        """
        try:
            block = read(window)
        except GDAL_ERRORS as error:
            self._fail(root_cause(error))
            if window.height <= least[0] and window.width <= least[1]:
                self._lose(window)
                return nothing(window)
        else:
            self._see(block, nothing(FileWindow(0, 0, 1, 1)))
            return block
        col, row, cols, rows = (int(each) for each in window.flatten())
        halves = [
            FileWindow(half.col, half.row, half.cols, half.rows)
            for half in Window(row, col, rows, cols).halves()
        ]
        parts = [self.read(read, half, nothing, least) for half in halves]
        return np.concatenate(parts, 1 if rows >= cols else 2)

    def _see(self, block: Block, nothing: Block) -> None:
        some = block[:, ::_STRIDE, ::_STRIDE]
        same = (some == nothing) | ((some != some) & (nothing != nothing))  # NaN counts as equal to NaN
        with self._lock:
            self.read_px2 += int((~same.all(axis=0)).sum()) * _STRIDE**2

    def _fail(self, reason: str) -> None:
        with self._lock:
            self._reason = self._reason or reason
            self._parts += 1
        if self._parts > MAX_PARTS or self.name.startswith(REMOTE):
            raise self._error()

    def _lose(self, window: FileWindow) -> None:
        with self._lock:
            self.lost_px2 += int(window.width * window.height)
        if self.lost_px2 > MAX_LOST * self.area_px2:
            raise self._error()

    def _error(self) -> InputError:
        return InputError(f"{self.name} cannot be read: {self._reason}")


def filled(values: list[float], dtype: np.dtype[Any]) -> ReadBlock:
    """Return a function that fills a (bands, rows, cols) block of `dtype` with one of `values` per band."""

    def nothing(window: FileWindow) -> Block:
        column = np.array(values).astype(dtype)[:, None, None]
        return np.broadcast_to(column, (len(values), int(window.height), int(window.width))).copy()

    return nothing
