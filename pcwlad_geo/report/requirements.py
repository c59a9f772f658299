"""A registration held against requirements on its figures: those that the report shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from pcwlad_geo.registration.result import Registration
from pcwlad_geo.report.coverage import SHARE_DIGITS, coverage_of
from pcwlad_geo.report.statistics import DIGITS, KEPT, statistics_of
from pcwlad_geo.requirements import Requirement, RequirementResult, value_of

NO_CHECK_POINTS: Final = "there are too few tie points to keep some out of the fit as check points"
NO_METRES: Final = "metres are not known without a CRS"
NO_NATIVE_PX: Final = "the native pixel is not known: the file names do not tell it"


def judge_requirements(
    registration: Registration, requirements: Sequence[Requirement]
) -> tuple[RequirementResult, ...]:
    """Hold a finished job against its requirements.

    Parameters
    ----------
    registration : Registration
        With status ``registered`` or ``matched``; one that is rejected meets nothing.
    requirements : sequence of Requirement
        Of the command ``register`` or ``match``.
    """
    return tuple(_judge(registration, requirement) for requirement in requirements)


def _judge(registration: Registration, requirement: Requirement) -> RequirementResult:
    if registration.status == "rejected":
        return RequirementResult(requirement, None, "the pair was refused")
    if requirement.unit is not None:
        found = _length(registration, requirement)
        value, reason = (None, found) if isinstance(found, str) else (round(found, DIGITS), None)
        return RequirementResult(requirement, value, reason)
    figure = _figure(registration, requirement.statistic)
    return RequirementResult(requirement, figure, None if figure is not None else "it is not known")


def _figure(registration: Registration, name: str) -> float | str | None:
    """Return a figure without a unit."""
    table = registration.tie_points
    if name == "points":
        return len(table.select(*KEPT))
    if name == "coverage":
        empty = coverage_of(table, registration.reference.grid.shape, registration.record).empty_share
        return round(1.0 - empty, SHARE_DIGITS)
    if name == "model":
        return registration.correction.name.rstrip("23") if registration.correction else None
    return registration.quality.grade if registration.quality else None


def _length(registration: Registration, requirement: Requirement) -> float | str:
    """Return a figure in its unit, or why it is not known: of all points before, or of residuals."""
    name, unit = requirement.statistic, str(requirement.unit).replace(" ", "_")
    of_all = name in ("displacement", "sigma")
    group = "all" if of_all else requirement.group or "check"
    by_unit = statistics_of(registration, "before" if of_all else "after", group)
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
