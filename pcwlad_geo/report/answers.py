"""The verdict of a registration in words: the headline of the page, and answers to its main questions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from pcwlad_geo.registration import FAIR_PX, GOOD_PX, Grade, QualityParameters, RegistrationStatus
from pcwlad_geo.report.content import GroupStatistics, Report

State = Literal["good", "caution", "bad"]
MARKS: Final[Mapping[State, str]] = {"good": "✓", "caution": "!", "bad": "✗"}
"""Signs of the states, independent of colour."""


@dataclass(frozen=True, slots=True)
class AnswerParameters:
    """Thresholds of the words of a page."""

    enough_check_points: int = 30
    """Least number of check points of the ASPRS Positional Accuracy Standards (2023)."""
    uneven_ratio: float = 1.5
    """Ratio of net check-point to fit-point errors from which the model is doubtful between its points."""
    noisy_ratio: float = 0.3
    """Ratio of net CE90 to CE90 below which the matching noise explains most of the error."""
    caution_share: float = 0.2
    """Share of the image beyond the tie points, or without any, from which the page gives a caution."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to one of the page's main questions."""

    question: str
    text: str
    state: State


@dataclass(frozen=True, slots=True)
class Headline:
    """The verdict at the top of the page."""

    text: str
    state: State


HEADLINES: Final[Mapping[Grade, Headline]] = {
    "good": Headline("Registered", "good"),
    "fair": Headline("Registered, with care", "caution"),
    "poor": Headline("Registered, poorly", "bad"),
}
"""Headlines by the grade of a registered pair."""
ANSWERS: Final = AnswerParameters()
"""As pages are written."""


def headline(status: RegistrationStatus, grade: Grade | None, passed: bool | None = None) -> Headline:
    """Return the verdict by `status`, and for a registered pair by `grade`.

    `passed` is whether the requirements are met, None if there are none.
    """
    if status == "rejected":
        return Headline("Could not be registered reliably", "bad")
    if passed is False:
        return Headline(f"{status.capitalize()}, but a requirement is not met", "bad")
    if status == "matched":
        return Headline("Tie points matched", "good")
    return HEADLINES[grade or "fair"]


def answers(report: Report, parameters: AnswerParameters = ANSWERS) -> list[Answer]:
    """Return the answers for a registered pair; none for others."""
    judged, before = report.statistics.judged, report.statistics.before["all"]
    if report.status != "registered" or judged is None or before is None:
        return []
    return [
        _accuracy_answer(report, judged, before.px.radial.ce90, parameters),
        _coverage_answer(report, parameters),
        _reliability_answer(report, parameters),
    ]


def _accuracy_answer(
    report: Report, judged: GroupStatistics, before: float, parameters: AnswerParameters
) -> Answer:
    ce90, net = judged.px.radial.ce90, judged.px.net.ce90
    text = f"CE90 {_px(before)} before, {_px(ce90)} after the correction"
    if judged.m:
        text += f" ({judged.m.radial.ce90:.2f} m)"
    if net < parameters.noisy_ratio * ce90:
        text += "; nearly all of what is left is noise of the matching itself."
    else:
        text += f"; {_px(net)} of it once the noise of the matching is taken out."
    if report.quality:
        expected, whole = report.quality.expected_ce90_px, report.quality.whole_ce90_px
        ground = "common ground" if whole is None else "ground that was compared"
        text += f" 90 % of the {ground} is expected to lie within {_px(expected)}"
        text += "." if whole is None else f", and of all that both show within {_px(whole)}."
    if report.reference.basemap:
        text += f" All this is relative to the basemap {report.reference.basemap.text}."
    state: State = "good" if ce90 <= GOOD_PX else "caution" if ce90 <= FAIR_PX else "bad"
    if ce90 >= before:
        state = "bad" if state == "bad" else "caution"
        text += " The correction improves nothing."
    return Answer("How well?", text, state)


def _coverage_answer(report: Report, parameters: AnswerParameters) -> Answer:
    empty_share = report.coverage.empty_share
    sigma = report.model and report.model.predicted_sigma_px
    extrapolated = sigma.extrapolated_share if sigma else 0.0
    parts = []
    if extrapolated > 0:
        parts.append(f"{percent(extrapolated)} of the target lies beyond the tie points (hatched below)")
    if empty_share > 0:
        parts.append(f"{percent(empty_share)} of the image has no tie point near (see Coverage)")
    if not parts:
        return Answer("Where not?", "Tie points cover the whole common area.", "good")
    text = "; ".join(parts) + "."
    return Answer(
        "Where not?",
        text[0].upper() + text[1:],
        "caution" if max(extrapolated, empty_share) > parameters.caution_share else "good",
    )


def _reliability_answer(report: Report, parameters: AnswerParameters) -> Answer:
    fit, check = report.statistics.after["fit"], report.statistics.after["check"]
    if check is None:
        return Answer(
            "Can I trust the figure?",
            "With care: there were too few points to keep some out of the fit.",
            "caution",
        )
    doubts = []
    if check.n < (enough := parameters.enough_check_points):
        doubts.append(f"only {check.n} check points, {enough} are asked for (ASPRS 2023)")
    if fit and check.px.net.ce90 > max(
        parameters.uneven_ratio * fit.px.radial.ce90, QualityParameters().noticeable_px
    ):
        doubts.append(
            "check points are much worse than fit points: the model does not hold between its points"
        )
    if report.warnings:
        doubts.append("there are warnings below")
    if doubts:
        return Answer("Can I trust the figure?", "With care: " + "; ".join(doubts) + ".", "caution")
    text = f"Yes: it is counted at {check.n} check points that the fit has not seen."
    return Answer("Can I trust the figure?", text, "good")


def percent(share: float) -> str:
    """Return a share as a percentage in text."""
    return f"{100 * share:.0f} %" if share >= 0.005 else "less than 1 %"


def _px(value: float) -> str:
    return f"{value:.3f} px"
