"""What a damaged file still shows: blocks read by ever smaller parts, and what could not be read at all."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause

LEAST_PART_PX: Final = 64
"""Side of the smallest part that is tried on its own."""
MOST_LOST: Final = 0.5
"""Of a raster, that is a gap; beyond it the file cannot be used."""

Block = NDArray[np.generic]
ReadBlock = Callable[[Window], Block]


@dataclass(slots=True)
class Gaps:
    """Counts what of a raster cannot be read; many threads may do so."""

    name: str
    """Of the raster, for messages."""
    area_px2: int
    """Of all that is to be read."""
    lost_px2: int = 0
    _reason: str = ""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def warning(self) -> str | None:
        """What people should know; None where all could be read."""
        if self.lost_px2 == 0:
            return None
        share = 100 * self.lost_px2 / self.area_px2
        return (
            f"{share:.2g} % of the warped raster is empty, as {self.name} cannot be read there: it may be "
            f"damaged ({self._reason})"
        )

    def read(self, read: ReadBlock, window: Window, nothing: ReadBlock) -> Block:
        """Return a block; parts of it that cannot be read are as `nothing` makes them.

        Raises
        ------
        InputError
            If too much of the raster is lost.
        """
        try:
            return read(window)
        except GDAL_ERRORS as error:
            if max(window.width, window.height) <= LEAST_PART_PX:
                self._lose(window, root_cause(error))
                return nothing(window)
        axis = 1 if window.height >= window.width else 2
        return np.concatenate([self.read(read, half, nothing) for half in _halves(window)], axis)

    def _lose(self, window: Window, reason: str) -> None:
        with self._lock:
            self.lost_px2 += int(window.width * window.height)
            self._reason = self._reason or reason
            if self.lost_px2 > MOST_LOST * self.area_px2:
                raise InputError(f"{self.name} cannot be read: {reason}")


def filled(values: list[float], dtype: np.dtype[Any]) -> ReadBlock:
    """Return what makes blocks that hold one value a band."""

    def nothing(window: Window) -> Block:
        column = np.array(values).astype(dtype)[:, None, None]
        return np.broadcast_to(column, (len(values), int(window.height), int(window.width))).copy()

    return nothing


def _halves(window: Window) -> list[Window]:
    col, row, width, height = (int(each) for each in window.flatten())
    if height >= width:
        upper = height // 2
        return [Window(col, row, width, upper), Window(col, row + upper, width, height - upper)]
    left = width // 2
    return [Window(col, row, left, height), Window(col + left, row, width - left, height)]
