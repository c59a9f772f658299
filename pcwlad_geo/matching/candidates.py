"""Candidates of the first pass, and what became of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FATES: Final = (
    "matched",
    "not_comparable",
    "not_similar",
    "at_search_border",
    "not_converged",
    "directions_disagree",
)
"""A match, or the stage that lost the candidate, in the order of the stages."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Corners that were looked for in the target."""

    reference_xy_px: Array
    """(n, 2) positions in the reference image (col, row), corner-based."""
    fate: NDArray[np.uint8]
    """(n,) index into `FATES`."""

    def __len__(self) -> int:
        return len(self.fate)

    @property
    def lost(self) -> Candidates:
        """Those that found no match."""
        some = self.fate > 0
        return Candidates(self.reference_xy_px[some], self.fate[some])

    @property
    def counts(self) -> dict[str, int]:
        """How many there are, and how many each stage lost."""
        number = np.bincount(self.fate, minlength=len(FATES)).tolist()
        return {"candidates": len(self), **dict(zip(FATES[1:], number[1:], strict=True))}

    def shifted(self, xy_px: Array) -> Candidates:
        """Return the candidates with a constant (col, row) added."""
        return replace(self, reference_xy_px=self.reference_xy_px + xy_px)

    @staticmethod
    def empty() -> Candidates:
        """Return zero candidates."""
        return Candidates(np.empty((0, 2)), np.empty(0, np.uint8))

    @staticmethod
    def concatenate(parts: Sequence[Candidates]) -> Candidates:
        """Return the candidates of all parts in their order."""
        every = [Candidates.empty(), *parts]
        return Candidates(
            np.concatenate([part.reference_xy_px for part in every]),
            np.concatenate([part.fate for part in every]),
        )
