"""The predicted sigma of a correction over the target, as the report shows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.registration.result import Registration

Array = NDArray[np.float64]

PLACES = 80
"""Along the longer side of the target."""


@dataclass(frozen=True, slots=True, eq=False)
class PrecisionMap:
    """Sigma on a lattice over the target."""

    target_shape: tuple[int, int]
    """Rows and columns of the target."""
    places_px: Array
    """(rows, columns, 2) places (col, row), target px."""
    sigma_px: Array
    """(rows, columns, 2) standard deviation (col, row), target px."""
    extrapolated: NDArray[np.bool_]
    """(rows, columns) True beyond the tie points."""

    @classmethod
    def of(cls, selection: Selection, target_shape: tuple[int, int]) -> PrecisionMap:
        """Evaluate a correction's precision."""
        step = max(target_shape) / PLACES
        rows, cols = ((np.arange(count) + 0.5) * side / count for side, count in _counts(target_shape, step))
        places = np.stack(np.meshgrid(cols, rows), axis=-1)
        flat = places.reshape(-1, 2)
        return cls(
            target_shape,
            places,
            selection.sigma(flat).reshape(places.shape),
            selection.extrapolated(flat).reshape(places.shape[:2]),
        )


def precision_of(registration: Registration) -> PrecisionMap | None:
    """Return the predicted sigma of a registration's correction; None where none was chosen."""
    selection = registration.selection
    return None if selection is None else PrecisionMap.of(selection, registration.target.grid.shape)


def _counts(shape: tuple[int, int], step: float) -> list[tuple[int, int]]:
    return [(side, max(round(side / step), 1)) for side in shape]
