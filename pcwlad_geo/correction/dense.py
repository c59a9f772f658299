"""Mappings evaluated on a lattice: the time of a warp does not grow with the number of tie points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.inversion import in_chunks
from pcwlad_geo.correction.lattice import Lattice

Array = NDArray[np.float64]
Mapping = Callable[[Array], Array]
"""(n, 2) positions to (n, 2) positions, px; NaN where there is none."""

FIRST_STEPS = 64
"""Steps along the longer side that are tried first: no correction has detail that falls between them."""
LEAST_STEP_PX = 1.0
BETWEEN = ((0.5, 0.5), (0.5, 0.0), (0.0, 0.5), (0.25, 0.25), (0.75, 0.25))
"""Places in a cell (col, row) where the interpolation is compared with the mapping."""
SAFETY = 0.7
"""Share of the tolerance that the error at these places may take."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseMapping:
    """A mapping given by its values on a lattice."""

    lattice: Lattice
    moved_px: Array
    """(rows, columns, 2) where the nodes (col, row) go; NaN where the mapping has no value."""
    error_px: float
    """Largest interpolation error found, px."""

    def __call__(self, at_px: Array) -> Array:
        """Map (n, 2) positions (col, row) within the box, px."""
        return in_chunks(lambda part: self.lattice.interpolated(self.moved_px, part), at_px)


def dense_mapping(
    mapping: Mapping, low_px: tuple[float, float], high_px: tuple[float, float], *, tolerance_px: float = 0.01
) -> DenseMapping:
    """Evaluate a mapping on a lattice fine enough to interpolate bilinearly.

    The step is halved until no place looked at between the nodes errs by more than the tolerance, or the step
    is one pixel.

    Parameters
    ----------
    mapping : callable
        Such as `Correction.forward`.
    low_px, high_px : (float, float)
        The box (col, row) to cover.
    tolerance_px : float
        Largest interpolation error, along either axis.
    """
    low, high = np.array(low_px, dtype=np.float64), np.array(high_px, dtype=np.float64)
    step = max(float((high - low).max()) / FIRST_STEPS, LEAST_STEP_PX)
    while True:
        lattice = Lattice.over(low, high, step)
        moved = in_chunks(mapping, lattice.nodes_px()).reshape(*lattice.shape, 2)
        error = _largest_error(mapping, lattice, moved)
        if error <= SAFETY * tolerance_px or step <= LEAST_STEP_PX:
            return DenseMapping(lattice, moved, error)
        step = max(step / 2, LEAST_STEP_PX)


def _largest_error(mapping: Mapping, lattice: Lattice, moved_px: Array) -> float:
    """Return the largest error in the cells whose corners have a value; 0 where there is no such cell."""
    rows, cols = lattice.shape
    known = np.asarray(np.isfinite(moved_px).all(axis=2))
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    corner = lattice.nodes_px().reshape(rows, cols, 2)[:-1, :-1][whole]
    largest = 0.0
    for place in BETWEEN:
        at_px = corner + np.array(place) * lattice.step_px
        error = np.abs(in_chunks(mapping, at_px) - lattice.interpolated(moved_px, at_px))
        largest = max(largest, float(np.nan_to_num(error).max(initial=0.0)))
    return largest
