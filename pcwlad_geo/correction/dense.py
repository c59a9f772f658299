"""Corrections evaluated on a lattice: the time of a warp does not grow with the number of tie points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.inversion import in_chunks
from pcwlad_geo.correction.lattice import Lattice
from pcwlad_geo.correction.models import Correction

Array = NDArray[np.float64]

FIRST_STEPS = 64
"""Steps along the longer side that are tried first: no correction has detail that falls between them."""
LEAST_STEP_PX = 1.0
BETWEEN = ((0.5, 0.5), (0.5, 0.0), (0.0, 0.5), (0.25, 0.25), (0.75, 0.25))
"""Places in a cell (col, row) where the interpolation is compared with the correction."""
SAFETY = 0.7
"""Share of the tolerance that the error at these places may take."""


@dataclass(frozen=True, slots=True, eq=False)
class DisplacementGrid:
    """A correction, or its inverse, as displacements on a lattice."""

    lattice: Lattice
    displacement_px: Array
    """(rows, columns, 2) displacement (col, row) at the nodes; NaN where the correction has none."""
    error_px: float
    """Largest interpolation error found, px; infinite where the correction has none in part of the box."""

    def __call__(self, at_px: Array) -> Array:
        """Map (n, 2) positions (col, row) within the box, px."""
        return in_chunks(lambda part: part + self.lattice.interpolated(self.displacement_px, part), at_px)


def displacement_grid(
    correction: Correction,
    low_px: tuple[float, float],
    high_px: tuple[float, float],
    *,
    tolerance_px: float = 0.01,
    inverse: bool = False,
) -> DisplacementGrid:
    """Evaluate a correction on a lattice fine enough to interpolate bilinearly.

    The step is halved until no place looked at between the nodes errs by more than the tolerance, or the step
    is one pixel.

    Parameters
    ----------
    correction : Correction
    low_px, high_px : (float, float)
        The box (col, row) to cover: of predicted px, or of observed px for the inverse.
    tolerance_px : float
        Largest interpolation error, along either axis.
    inverse : bool
        Map observed to predicted px instead of predicted to observed.
    """
    mapping = correction.inverse if inverse else correction.forward
    low, high = np.array(low_px, dtype=np.float64), np.array(high_px, dtype=np.float64)
    step = max(float((high - low).max()) / FIRST_STEPS, LEAST_STEP_PX)
    while True:
        lattice = Lattice.over(low, high, step)
        nodes = lattice.nodes_px()
        displacement = (mapping(nodes) - nodes).reshape(*lattice.shape, 2)
        grid = DisplacementGrid(lattice, displacement, 0.0)
        error = _largest_error(mapping, grid)
        if error <= SAFETY * tolerance_px or step <= LEAST_STEP_PX or not np.isfinite(error):
            return DisplacementGrid(lattice, displacement, error)
        step = max(step / 2, LEAST_STEP_PX)


def _largest_error(mapping: Callable[[Array], Array], grid: DisplacementGrid) -> float:
    rows, cols = grid.lattice.shape
    corner = grid.lattice.nodes_px().reshape(rows, cols, 2)[:-1, :-1].reshape(-1, 2)
    largest = 0.0
    for place in BETWEEN:
        at_px = corner + np.array(place) * grid.lattice.step_px
        error = np.abs(mapping(at_px) - grid(at_px)).max()
        largest = max(largest, float(error)) if np.isfinite(error) else np.inf
    return largest
