"""The decision on a pair: all that speaks for and against it, from its matching to what the user requires."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pcwlad_geo.registration.quality import Doubt, Quality
from pcwlad_geo.requirements import RequirementResult, all_met


@dataclass(frozen=True, slots=True)
class Evidence:
    """How far more tie points of a pair agree than would by chance."""

    cells: int
    """Number of cells with a match of any kind."""
    agreeing_cells: int
    """Number of cells that agree with the common displacement."""
    significance: float
    """-log10 of the probability that unrelated images agree as much."""
    past_search_border: bool | None = None
    """Whether many best matches lie on the edge of the search; None unless the points agree by chance."""
    few_valid: bool = False
    """Whether many candidates had too few valid pixels around them."""
    smaller_windows: bool = False
    """Whether smaller windows may give the places that are missing: the points agree, in too few of them."""


@dataclass(frozen=True, slots=True)
class Decision:
    """Whether a pair is accepted, and why; each step adds what it knows."""

    refusal: str | None = None
    """Why it is refused, and what to do; None if it is accepted."""
    evidence: Evidence | None = None
    """That of the tie points; None of points of a file."""
    doubts: tuple[Doubt, ...] = ()
    """Why it may be wrong or hold for a part only: by the search and the matching, the latest first."""
    quality: Quality | None = None
    """The grade, with the reasons of all steps; None before the fit."""
    requirements: tuple[RequirementResult, ...] = ()
    """What became of each requirement of the user."""

    @property
    def accepted(self) -> bool:
        """Whether nothing has refused it."""
        return self.refusal is None

    @property
    def significance(self) -> float:
        """That of the evidence; 0 where there is none."""
        return 0.0 if self.evidence is None else self.evidence.significance

    @property
    def passed(self) -> bool | None:
        """Whether all requirements are met; None where nothing was required."""
        return all_met(self.requirements)

    def refused(self, text: str | None) -> Decision:
        """Return the decision with another refusal; accepted if it is None."""
        return replace(self, refusal=text)


def with_doubts(decision: Decision, *doubts: Doubt) -> Decision:
    """Return a decision with more doubts."""
    return replace(decision, doubts=(*doubts, *decision.doubts))
