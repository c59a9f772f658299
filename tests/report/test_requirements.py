"""Registrations held against requirements: the figures are those of the report."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pcwlad_geo.cli.pair import Outcome
from pcwlad_geo.pair_requirements import judge_requirements
from pcwlad_geo.registration import Registration
from pcwlad_geo.report import page
from pcwlad_geo.report.summary import summarise
from pcwlad_geo.requirements import Command, RequirementResult, parse_requirement
from pcwlad_geo.text import plain
from tests.registrations import without_crs

Make = Callable[..., Registration]


def judged(made: Registration, text: str, command: Command = "register") -> RequirementResult:
    (result,) = judge_requirements(made, [parse_requirement(text, command)])
    return result


def test_each_figure_is_the_one_in_the_report(registration: Make) -> None:
    made = registration()
    summary: Any = plain(summarise(made, []))
    before, after = summary["statistics"]["before"]["all"], summary["statistics"]["after"]
    check, fit = after["check"], after["fit"]
    shift = math.hypot(*summary["displacement_px"]["median"])
    expected = {
        "CE90<=1px": summary["accuracy"]["check"]["px"]["ce90"],
        "check RMSE<=5m": check["m"]["radial"]["rmse"],
        "fit CE95<=1px": fit["px"]["radial"]["ce95"],
        "LE90<=1px": max(check["px"][axis]["le90"] for axis in ("col", "row")),
        "net std<=1px": max(check["px"]["net"]["std_xy"]),
        "sigma<=1px": max(before["px"]["net"]["noise_xy"]),
        "displacement<=2px": shift,
        "displacement<=99m": 30 / 0.9996 * shift,  # UTM's metres, on the ground
        "points>=1": 108,
        "coverage>=0.1": 1 - summary["coverage"]["empty_share"],
    }
    for text, value in expected.items():
        found = judged(made, text)
        assert found.value == pytest.approx(value, abs=2e-3 if text.endswith("99m") else 2e-5), text
    assert judged(made, "model=shift").value == "shift"
    assert judged(made, "points>=108").met
    assert not judged(made, "points>=109").met


def test_what_cannot_be_known_is_not_met_and_says_why(registration: Make) -> None:
    made = registration()
    flat = without_crs(made)
    few = replace(made, tie_points=made.tie_points.select("fit"))
    refused = registration("rejected")
    for case, text, why in (
        (flat, "CE90<=9m", "metres are not known without a CRS"),
        (made, "CE90<=9native px", "the native pixel is not known"),
        (few, "CE90<=9px", "too few tie points to keep some out of the fit"),
        (refused, "points>=1", "the pair was refused"),
    ):
        found = judged(case, text)
        assert not found.met, text
        assert found.value is None
        assert why in found.text
    assert judged(few, "fit CE90<=9px").met


def test_the_page_shows_them(registration: Make) -> None:
    made = registration()
    wanted = [parse_requirement(text, "register") for text in ("CE90<=0.01px", "points>=100")]
    made = replace(made, decision=replace(made.decision, requirements=judge_requirements(made, wanted)))
    report = summarise(made, [])
    shown = page.report_page(report, page.compose(made, report, None))
    assert "Registered, but a requirement is not met" in shown
    assert "CE90 &lt;= 0.01 px: not met (" in shown
    assert "px at the check points)" in shown  # not what is expected of all the ground
    assert "points &gt;= 100: met (108)" in shown


def test_met_by_the_points_of_ground_that_is_poor(registration: Make) -> None:
    made = registration()
    assert made.quality is not None
    quality = replace(made.quality.at_most("poor", "clouds"), expected_ce90_px=1.94)
    doubtful = replace(made, decision=replace(made.decision, quality=quality))
    found = judged(doubtful, "CE90<=1px")
    assert found.met
    assert found.text.endswith(
        "px at the check points; but the registration is poor, and 90 % of the ground is expected to lie "
        "within 1.94 px)"
    )
    assert judged(made, "CE90<=1px").caveat is None
    assert judged(doubtful, "CE90<=0.01px").caveat is None  # it is not met in any case
    assert judged(doubtful, "quality>=poor").caveat is None  # the grade itself was asked for
    assert judged(doubtful, "points>=1").caveat is None
    decision = replace(doubtful.decision, requirements=(found,))
    report = summarise(replace(doubtful, decision=decision), [])
    shown = page.report_page(report, page.compose(doubtful, report, None))
    assert '<li class="caution"><strong><span class="mark">!</span> CE90 &lt;= 1 px' in shown
    ending = Outcome(report, {"numbers": Path("report.json")}).text()
    assert ending.splitlines()[-2] == "PASSED at the tie points of a poor registration"
