"""What a damaged file still shows: blocks read by ever smaller parts, and what could not be read at all."""

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
from pcwlad_geo.raster.windows import Window

LEAST_PART: Final = (64, 64)
"""Rows and columns of the smallest part that is tried on its own."""
MOST_LOST: Final = 0.5
"""Of a raster, that is a gap; beyond it, or where less is seen than lost, the file cannot be used."""
MOST_PARTS: Final = 2000
"""That fail, before the file is given up."""
REMOTE: Final = (
    *(f"/vsi{kind}" for kind in ("curl", "s3", "gs", "az", "adls", "oss", "swift")),
    *("http:", "https:"),
)
"""What cannot be read from there may be readable in a minute: no reason for a gap."""
_STRIDE: Final = 8

Block = NDArray[np.generic]
ReadBlock = Callable[[FileWindow], Block]


@dataclass(slots=True)
class Gaps:
    """Counts what of a raster cannot be read; many threads may do so."""

    name: str
    """Of the raster, for messages."""
    area_px2: int
    """Of all that is to be read."""
    lost_px2: int = 0
    seen_px2: int = 0
    """About so many pixels show something."""
    _parts: int = 0
    _reason: str = ""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def warning(self) -> str | None:
        """Return what people should know, when all is read; None where all could be.

        Raises
        ------
        InputError
            If less is seen than lost.
        """
        if self.lost_px2 == 0:
            return None
        if self.lost_px2 > self.seen_px2:
            raise self._error()
        share = 100 * self.lost_px2 / (self.lost_px2 + self.seen_px2)
        return (
            f"about {share:.2g} % of the warped raster is empty, as {self.name} cannot be read there: it may "
            f"be damaged ({self._reason})"
        )

    def read(
        self, read: ReadBlock, window: FileWindow, nothing: ReadBlock, least: tuple[int, int] = LEAST_PART
    ) -> Block:
        """Return a block; parts of it that cannot be read are as `nothing` makes them.

        Parameters
        ----------
        read : callable
            Reads a block, or raises one of `GDAL_ERRORS`.
        window : rasterio.windows.Window
        nothing : callable
            Makes a block that shows nothing.
        least : (int, int)
            Rows and columns of parts that are not divided any further.

        Raises
        ------
        InputError
            If too much of the raster is lost, or it is on another machine.
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
        same = (some == nothing) | ((some != some) & (nothing != nothing))  # NaN is as good as NaN
        with self._lock:
            self.seen_px2 += int((~same.all(axis=0)).sum()) * _STRIDE**2

    def _fail(self, reason: str) -> None:
        with self._lock:
            self._reason = self._reason or reason
            self._parts += 1
        if self._parts > MOST_PARTS or self.name.startswith(REMOTE):
            raise self._error()

    def _lose(self, window: FileWindow) -> None:
        with self._lock:
            self.lost_px2 += int(window.width * window.height)
        if self.lost_px2 > MOST_LOST * self.area_px2:
            raise self._error()

    def _error(self) -> InputError:
        return InputError(f"{self.name} cannot be read: {self._reason}")


def filled(values: list[float], dtype: np.dtype[Any]) -> ReadBlock:
    """Return what makes blocks that hold one value a band."""

    def nothing(window: FileWindow) -> Block:
        column = np.array(values).astype(dtype)[:, None, None]
        return np.broadcast_to(column, (len(values), int(window.height), int(window.width))).copy()

    return nothing
