"""The verdict in words: registered or not, how well, where not, and whether to trust the figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from pcwlad_geo.registration.quality import FAIR_PX, GOOD_PX, Grade
from pcwlad_geo.registration.result import Status

ENOUGH_CHECK_POINTS: Final = 30
"""ASPRS Positional Accuracy Standards, 2023."""
UNEVEN: Final = 1.5
"""Check points so many times worse than fit points tell of a model that does not hold between them."""
NOISY: Final = 0.3
"""Net CE90 below such a part of CE90 says that noise explains the rest."""
MUCH: Final = 0.2
"""Share of the image beyond the tie points, or without any, that is worth a word of caution."""

State = Literal["good", "caution", "bad"]
MARKS: Final[Mapping[State, str]] = {"good": "✓", "caution": "!", "bad": "✗"}


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer to a question that every reader has."""

    question: str
    text: str
    state: State

    @property
    def mark(self) -> str:
        """A sign for those who see no colour."""
        return MARKS[self.state]


@dataclass(frozen=True, slots=True)
class Headline:
    """What a reader must know if they read nothing else."""

    text: str
    state: State

    @property
    def mark(self) -> str:
        """A sign for those who see no colour."""
        return MARKS[self.state]


HEADLINES: Final[Mapping[Grade, Headline]] = {
    "good": Headline("Registered", "good"),
    "fair": Headline("Registered, with care", "caution"),
    "poor": Headline("Registered, poorly", "bad"),
}


def headline(status: Status, grade: Grade | None, passed: bool | None = None) -> Headline:
    """Return the verdict: that of the grade for a registered pair.

    `passed` is whether the requirements are met, None where there are none.
    """
    if status == "rejected":
        return Headline("Could not be registered reliably", "bad")
    if passed is False:
        return Headline(f"{status.capitalize()}, but a requirement is not met", "bad")
    if status == "matched":
        return Headline("Tie points matched", "good")
    return HEADLINES[grade or "fair"]


def answers(summary: Mapping[str, Any]) -> list[Answer]:
    """Return the answers for a registered pair; none for others.

    Parameters
    ----------
    summary : dict
        What `summarise` made.
    """
    after = summary["statistics"]["after"]
    judged = after["check"] or after["fit"]
    if summary["status"] != "registered" or judged is None:
        return []
    return [_how_well(summary, judged), _where_not(summary), _trust(summary)]


def _how_well(summary: Mapping[str, Any], judged: Mapping[str, Any]) -> Answer:
    ce90, net = judged["px"]["radial"]["ce90"], judged["px"]["net"]["ce90"]
    before = summary["statistics"]["before"]["all"]["px"]["radial"]["ce90"]
    text = f"CE90 {_px(before)} before, {_px(ce90)} after the correction"
    if judged["m"]:
        text += f" ({judged['m']['radial']['ce90']:.2f} m)"
    if net < NOISY * ce90:
        text += "; nearly all of what is left is noise of the matching itself."
    else:
        text += f"; {_px(net)} of it once the noise of the matching is taken out."
    if summary["quality"]:
        expected = _px(summary["quality"]["expected_ce90_px"])
        text += f" 90 % of the common ground is expected to lie within {expected}."
    state: State = "good" if ce90 <= GOOD_PX else "caution" if ce90 <= FAIR_PX else "bad"
    if ce90 >= before:
        state = "bad" if state == "bad" else "caution"
        text += " The correction improves nothing."
    return Answer("How well?", text, state)


def _where_not(summary: Mapping[str, Any]) -> Answer:
    empty_share = summary["coverage"]["empty_share"]
    sigma = (summary["model"] or {}).get("predicted_sigma_px")
    beyond = sigma["extrapolated_share"] if sigma else 0.0
    parts = []
    if beyond > 0:
        parts.append(f"{percent(beyond)} of the target lies beyond the tie points (hatched below)")
    if empty_share > 0:
        parts.append(f"{percent(empty_share)} of the image has no tie point near (see Coverage)")
    if not parts:
        return Answer("Where not?", "Tie points cover the whole common area.", "good")
    text = "; ".join(parts) + "."
    return Answer(
        "Where not?", text[0].upper() + text[1:], "caution" if max(beyond, empty_share) > MUCH else "good"
    )


def _trust(summary: Mapping[str, Any]) -> Answer:
    after = summary["statistics"]["after"]
    fit, check = after["fit"], after["check"]
    if check is None:
        return Answer(
            "Can I trust the figure?",
            "With care: there were too few points to keep some out of the fit.",
            "caution",
        )
    doubts = []
    if check["n"] < ENOUGH_CHECK_POINTS:
        doubts.append(f"only {check['n']} check points, {ENOUGH_CHECK_POINTS} are asked for (ASPRS 2023)")
    if fit and check["px"]["radial"]["ce90"] > UNEVEN * fit["px"]["radial"]["ce90"]:
        doubts.append(
            "check points are much worse than fit points: the model does not hold between its points"
        )
    if summary["warnings"]:
        doubts.append("there are warnings below")
    if doubts:
        return Answer("Can I trust the figure?", "With care: " + "; ".join(doubts) + ".", "caution")
    text = f"Yes: it is counted at {check['n']} check points that the fit has not seen."
    return Answer("Can I trust the figure?", text, "good")


def percent(share: float) -> str:
    """Return a share in words."""
    return f"{100 * share:.0f} %" if share >= 0.005 else "less than 1 %"


def _px(value: float) -> str:
    return f"{value:.3f} px"
