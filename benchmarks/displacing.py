"""Images displaced by a known field."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from benchmarks.pairs import Image
from benchmarks.runs import Array

Field = Callable[[Array], Array]
"""Positions (..., 2) px to displacements: what is at p moves to p + field(p)."""


def displace(image: Image, field: Field) -> Image:
    """Resample an image once, with a quintic spline, so that what was at p is at p + field(p)."""
    rows, cols = np.indices(image.shape, dtype=np.float64)
    wanted = np.stack([cols, rows], axis=-1) + 0.5
    source = wanted - field(wanted)
    for _ in range(8):
        source = wanted - field(source)
    index = np.moveaxis(source[..., ::-1] - 0.5, -1, 0)
    moved = ndimage.map_coordinates(image.astype(np.float64), index, order=5, mode="mirror")
    return np.asarray(moved, dtype=np.float32)
