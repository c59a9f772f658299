"""The figures of a pair that requirements limit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from pcwlad_geo.registration import Registration
from pcwlad_geo.report.json_content import PX_DIGITS, SHARE_DIGITS
from pcwlad_geo.report.statistics import KEPT, PointGroup, coverage_of, statistics_of, target_px_m
from pcwlad_geo.requirements import Figure, Requirement, RequirementResult, judge, value_of

NO_CHECK_POINTS: Final = "there are too few tie points to keep some out of the fit as check points"
"""Reason why the accuracy at check points is not known."""
CHOSEN: Final = "the points of the fit were chosen, perhaps by their residuals"
"""Reason why the residuals of a fit say nothing."""
OF_UNKNOWN_ORIGIN: Final = "nothing tells whether the points of the file were chosen by their residuals"
"""Reason why errors at points of a file are not known."""
NO_METRES: Final = "metres are not known without a CRS"
"""Reason why a length in metres is not known."""
NO_NATIVE_PX: Final = "the native pixel is not known: the file names do not tell it"
"""Reason why a length in native pixels is not known."""


def judge_requirements(
    registration: Registration, requirements: Sequence[Requirement]
) -> tuple[RequirementResult, ...]:
    """Compare a finished job with the requirements for its command; a rejected one meets none."""
    return tuple(judge(requirement, _figure(registration, requirement)) for requirement in requirements)


def _figure(registration: Registration, requirement: Requirement) -> Figure:
    if registration.status == "rejected":
        return Figure(None, "the pair was refused")
    if requirement.unit is None:
        value = _number_or_word(registration, requirement.statistic)
        return Figure(value, "it is not known" if value is None else None)
    length = _length(registration, requirement)
    if isinstance(length, str):
        return Figure(None, length)
    return Figure(round(length, PX_DIGITS), doubt=_doubt(registration))


def _doubt(registration: Registration) -> str | None:
    """Return what contradicts accurate tie points: the grade of the ground; None where that is good."""
    quality = registration.quality
    if quality is None or quality.grade == "good":
        return None
    return (
        f"but the registration is {quality.grade}, and 90 % of the ground is expected to lie within "
        f"{quality.expected_ce90_px:.2f} px"
    )


def _selection_bias(registration: Registration, requirement: Requirement) -> str:
    """Return why points of a file do not tell a length; empty where they do."""
    origin = registration.origin
    if origin is None or requirement.statistic == "displacement":
        return ""
    if origin.folder is None:
        return OF_UNKNOWN_ORIGIN
    return CHOSEN if requirement.group == "fit" and origin.left_out else ""


def _number_or_word(registration: Registration, name: str) -> float | str | None:
    """Return a figure without a unit; None if it is not known."""
    table = registration.tie_points
    if name == "points":
        return len(table.select(*KEPT))
    if name == "coverage":
        empty = coverage_of(table, registration.reference.grid.shape, registration.record).empty_share
        return round(1.0 - empty, SHARE_DIGITS)
    if name == "model":
        return registration.model.name.rstrip("23") if registration.model else None
    return registration.quality.grade if registration.quality else None


def _length(registration: Registration, requirement: Requirement) -> float | str:
    """Return a figure in its unit, of displacements or of residuals, or the reason why it is not known."""
    name, unit = requirement.statistic, str(requirement.unit).replace(" ", "_")
    unknown = _selection_bias(registration, requirement)
    if unknown:
        return unknown
    of_all = name in ("displacement", "sigma")
    group: PointGroup = "all" if of_all else requirement.group or "check"
    by_unit = statistics_of(registration, "before" if of_all else "after", group, target_px_m(registration))
    if by_unit["px"] is None:
        return NO_CHECK_POINTS if group == "check" else "there are no tie points"
    statistics = by_unit[unit]
    if statistics is None:
        return NO_METRES if unit == "m" else NO_NATIVE_PX
    if name == "displacement":
        return math.hypot(statistics.col.median, statistics.row.median)
    if name == "sigma":
        return max(statistics.net.noise_xy)
    return value_of(requirement, statistics)
