"""A pose that the search proposes, and the evidence for it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pcwlad_geo.estimation.transforms import scale_of
from pcwlad_geo.matching.pose.parameters import POSE, EvidenceParameters
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True, eq=False)
class PoseProposal:
    """A similarity or an affine transformation that the search proposes, and its support."""

    matrix: Float64
    """(2, 3): target px (col, row) = matrix · (col, row, 1) of the reference, array indices."""
    score: float
    """Correlation times the root of the overlap in cells, which is fair between large and small overlaps."""
    evidence: float
    """-log10 of the probability, as measured, that unrelated images give as much: a score that stands out as
    far, or as many patches that agree."""
    agreeing: int = 0
    """Number of patches that agree on the transformation."""
    spread_px: float = 0.0
    """Distance from it within which 95 % of the agreeing patches lie, reference px."""
    homography: Float64 | None = None
    """(3, 3) the same as `matrix`, in perspective; None unless the patches agree clearly better on that."""
    least_evidence: float = POSE.evidence.least
    """Evidence from which the proposal is accepted."""

    @property
    def accepted(self) -> bool:
        """Whether the score stands out of all others, or more patches agree than by chance."""
        return self.evidence >= self.least_evidence

    @property
    def scale(self) -> float:
        """Target px per reference px."""
        return scale_of(self.matrix)


def evidence_of_ratio(score: float, rival: float, per_ratio: float, parameters: EvidenceParameters) -> float:
    """Return the evidence for a pose that the ratio of its score to that of its best rival gives."""
    return min(per_ratio * (score / rival - 1), parameters.most) if rival > 0 else parameters.most


def combined_evidence(total: float) -> float:
    """Return the evidence of two independent probabilities whose evidence adds up to `total` (Fisher)."""
    return total - math.log10(1 + total * math.log(10))
