"""Blocks of lossy compression, found in a band's pixels.

JPEG codes squares of 8 x 8 pixels on their own, so that small steps remain between them. Phase congruency
sees structure however weak it is: where a scene is flat, it sees the grid of blocks, and two images of
different places would agree on it.

References
----------
.. [1] ITU-T Recommendation T.81 (1992), Annex A (JPEG's blocks).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.raster.grid import Window
from pcwlad_geo.types import Bool, Float64

BLOCK_PX: Final = 8
"""Side of a block."""
MIN_RATIO: Final = 1.1
"""Steps at the edges of blocks over those inside, from which a band counts as compressed. Bands
without loss show 1.00 to 1.06 along both axes, JPEGs 1.05 to 2.1, those of low quality most."""
MIN_LEAD: Final = 1.05
"""Steps at the edges of blocks over the largest at any other position in a block."""
COMMON: Final = 98
"""Percentile of the steps of a sample to which larger ones, which are the scene's edges, are cut down."""
SAMPLE_PX: Final = 256
"""Side of the samples in which blocks are looked for."""
SAMPLES_ACROSS: Final = 3
"""Number of samples along rows and along columns."""


def find_blocks(
    read: Callable[[Window], tuple[NDArray[Any], Bool]], shape: tuple[int, int]
) -> tuple[int, int] | None:
    """Find the blocks of a band of `shape` (rows, cols) in nine samples; None if it shows none.

    `read` returns the (rows, cols) values and validity of a window. The result is the row and the column,
    modulo 8, at which blocks begin.
    """
    samples = [(read(window), window) for window in _samples(shape)]
    if not samples:
        return None
    by_row = _mean_steps((values, valid, window.row) for (values, valid), window in samples)
    by_col = _mean_steps((values.T, valid.T, window.col) for (values, valid), window in samples)
    row, col = _first_px(by_row), _first_px(by_col)
    return None if row is None or col is None else (row, col)


def _samples(shape: tuple[int, int]) -> list[Window]:
    side_r, side_c = min(shape[0], SAMPLE_PX), min(shape[1], SAMPLE_PX)
    if min(side_r, side_c) < 4 * BLOCK_PX:
        return []
    rows = np.unique(np.linspace(0, shape[0] - side_r, SAMPLES_ACROSS).astype(int)).tolist()
    cols = np.unique(np.linspace(0, shape[1] - side_c, SAMPLES_ACROSS).astype(int)).tolist()
    return [Window(row, col, side_r, side_c) for row in rows for col in cols]


def _steps(values: NDArray[Any]) -> NDArray[Any]:
    """Return (rows - 3, cols) steps from row i + 1 to row i + 2, less the mean of the slopes beside them."""
    slopes = np.diff(values, axis=0)
    return np.asarray(slopes[1:-1] - (slopes[:-2] + slopes[2:]) / 2)


def _all_valid(valid: Bool) -> Bool:
    """Return (rows - 3, cols), whether the four pixels of each step are valid."""
    return np.asarray(valid[:-3] & valid[1:-2] & valid[2:-1] & valid[3:])


def _mean_steps(samples: Iterable[tuple[NDArray[Any], Bool, int]]) -> Float64:
    """Return the (8,) mean absolute steps into rows of each number modulo 8; the scene's edges are capped."""
    total, count = np.zeros(BLOCK_PX), np.zeros(BLOCK_PX)
    for values, valid, first in samples:
        size, good = np.abs(_steps(values.astype(np.float64))), _all_valid(valid)
        if not good.any():
            continue
        size = np.minimum(size, np.percentile(size[good], COMMON)) * good
        row = (first + 2 + np.arange(len(size))) % BLOCK_PX
        total += np.bincount(row, size.sum(axis=1), BLOCK_PX)
        count += np.bincount(row, good.sum(axis=1), BLOCK_PX)
    return np.divide(total, count, out=np.zeros(BLOCK_PX), where=count > 0)


def _first_px(steps: Float64) -> int | None:
    """Return where blocks begin, from the (8,) mean steps; None if they do not show."""
    first = int(np.argmax(steps))
    others = np.delete(steps, first)
    shown = steps[first] >= max(MIN_RATIO * others.mean(), MIN_LEAD * others.max())
    return first if shown and steps[first] > 0 else None
