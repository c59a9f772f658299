"""Corrections: from predicted to observed target pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Correction(Protocol):
    """Maps the target pixel that the original georeferencing predicts to the one observed.

    Pixel coordinates are (col, row), corner-based, of the original target file.
    """

    @property
    def name(self) -> str:
        """The model's name, such as shift or affine."""

    def forward(self, predicted_px: Array) -> Array:
        """Map (n, 2) predicted to observed target pixels."""

    def inverse(self, observed_px: Array) -> Array:
        """Map (n, 2) observed to predicted target pixels."""

    def to_dict(self) -> dict[str, object]:
        """Return what report.json holds: enough, alone, to warp."""


@dataclass(frozen=True, slots=True, eq=False)
class AffineCorrection:
    """observed = matrix · (predicted col, predicted row, 1); a shift is the affine with identity."""

    name: str
    """shift or affine."""
    matrix: Array
    """(2, 3)."""

    def forward(self, predicted_px: Array) -> Array:
        """Map (n, 2) predicted to observed target pixels."""
        return np.asarray(predicted_px, dtype=np.float64) @ self.matrix[:, :2].T + self.matrix[:, 2]

    def inverse(self, observed_px: Array) -> Array:
        """Map (n, 2) observed to predicted target pixels."""
        moved = np.asarray(observed_px, dtype=np.float64) - self.matrix[:, 2]
        return moved @ np.linalg.inv(self.matrix[:, :2]).T

    def to_dict(self) -> dict[str, object]:
        """Return what report.json holds: enough, alone, to warp."""
        return {"name": self.name, "forward": {"type": "affine", "matrix": self.matrix.tolist()}}
