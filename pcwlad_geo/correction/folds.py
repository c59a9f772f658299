"""Spatial folds: what cross-validation leaves out together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FOLDS = 16
MOST_BLOCKS = 1024
POINTS_PER_BLOCK = 3


@dataclass(frozen=True, slots=True, eq=False)
class Folds:
    """A division of points for cross-validation."""

    block: NDArray[np.intp]
    """(n,) number of the compact block each point lies in."""
    tests: tuple[Mask, ...]
    """(n,) masks, one a fold: the points that are predicted from all others. Every point is in one."""


def spatial_folds(xy_px: Array, footprint_px: float) -> Folds:
    """Divide points into compact blocks of equal numbers, and the blocks into at most 16 folds.

    The blocks are one matching window wide, so that those of a fold, which lie far apart, are predicted over
    a distance that corrections bridge in use; there are at least 16 of them, where there are points enough.

    Parameters
    ----------
    xy_px : (n, 2) array of float
        Positions (col, row), px; n ≥ 3.
    footprint_px : float
        Side of the matching window, px; 0 for independent errors.
    """
    area = float(np.prod(np.ptp(xy_px, axis=0)))
    room = min(area / footprint_px**2, MOST_BLOCKS) if footprint_px > 0 else MOST_BLOCKS
    block = spatial_blocks(xy_px, int(min(max(FOLDS, room), len(xy_px) // POINTS_PER_BLOCK)))
    # The last four halvings number 16 neighbours: equal remainders are 16 blocks apart.
    fold = block % FOLDS
    return Folds(block, tuple(fold == number for number in np.unique(fold)))


def spatial_blocks(xy_px: Array, count: int) -> NDArray[np.intp]:
    """Divide (n, 2) points into compact blocks of equal numbers: (n,) block numbers from 0.

    The points are halved at the median along the longer side of their bounding box, and the halves again,
    until there are `count` blocks (or the next lower power of two).
    """
    block = np.zeros(len(xy_px), dtype=np.intp)
    number = 1
    while 2 * number <= count:
        halves = np.zeros(len(xy_px), dtype=np.intp)
        for index in range(number):
            members = np.flatnonzero(block == index)
            axis = int(np.argmax(np.ptp(xy_px[members], axis=0)))
            order = np.argsort(xy_px[members, axis], kind="stable")
            halves[members[order[len(members) // 2 :]]] = 1
        block = 2 * block + halves
        number *= 2
    return block
