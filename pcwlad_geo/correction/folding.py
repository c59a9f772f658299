"""Corrections that fold the image: two places become one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.lattice import Lattice
from pcwlad_geo.correction.models import Correction

Array = NDArray[np.float64]

CELLS = 160
"""Cells along the longer side in which the orientation is looked at: four a cell of the finest spline."""


def folds(correction: Correction, low_px: Array, high_px: Array) -> bool:
    """Return whether a correction turns over, or has no value, anywhere in a box (col, row) of predicted px.

    Parameters
    ----------
    correction : Correction
    low_px, high_px : (2,) array of float
        Corners of the box (col, row).
    """
    lattice = Lattice.over(low_px, high_px, float((high_px - low_px).max()) / CELLS)
    moved = correction.forward(lattice.nodes_px()).reshape(*lattice.shape, 2)
    along_cols, along_rows = np.diff(moved, axis=1), np.diff(moved, axis=0)
    for cols in (along_cols[:-1], along_cols[1:]):
        for rows in (along_rows[:, :-1], along_rows[:, 1:]):
            area = cols[..., 0] * rows[..., 1] - cols[..., 1] * rows[..., 0]
            if not (area > 0).all():
                return True
    return False
