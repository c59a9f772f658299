"""The table that ends `register`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pcwlad_geo.cli.pair import Outcome
from pcwlad_geo.registration import Decision
from tests.registrations import make_registration, summary_of, without_crs


def test_the_table_has_displacement_before_and_residuals_after() -> None:
    made = make_registration()
    lines = Outcome(summary_of(made), {"numbers": Path("report.json")}).text().splitlines()
    header, before, fit, check = (
        line for line in lines if line.startswith((" ", "displacement", "residual"))
    )
    assert header.split()[-5:] == ["RMSE", "CE90", "net", "CE90", "m"]
    assert before.split()[3:5] == [
        "108",
        f"{made.tie_points.select('fit', 'check').displacement_px[:, 0].mean():+.3f}",
    ]
    assert fit.startswith("residual after, fit, px")
    assert check.split()[-3] == f"{made.accuracy['check_px'].ce90:.3f}"
    assert check.split()[-1] == f"{made.accuracy['check_m'].ce90:.2f}"


def test_there_is_no_column_of_metres_where_they_are_not_known() -> None:
    made = without_crs(make_registration())
    text = Outcome(summary_of(made), {"numbers": Path("report.json")}).text()
    (header,) = (line for line in text.splitlines() if line.startswith(" "))
    assert header.split()[-3:] == ["RMSE", "CE90", "net"]
    check = next(line for line in text.splitlines() if line.startswith("residual after, check"))
    assert check.split()[-2] == f"{made.accuracy['check_px'].ce90:.3f}"


def test_the_quality_of_a_part_is_told_beside_that_of_all() -> None:
    made = make_registration()
    assert made.quality is not None
    of_all = Outcome(summary_of(made), {"numbers": Path("report.json")}).text()
    assert "90 % of the common ground is expected to lie within 0.12 px (" in of_all
    part = replace(made, decision=Decision(quality=replace(made.quality, whole=(0.77, 0.226))))
    text = Outcome(summary_of(part), {"numbers": Path("report.json")}).text()
    assert "90 % of the ground that was compared is expected to lie within 0.12 px (" in text
    assert ", and of all that both show within 0.77 px (" in text
    part = replace(made, decision=Decision(quality=replace(made.quality, whole=(0.0014, 0.0004))))
    assert "within 0.001 px (" in Outcome(summary_of(part), {"numbers": Path("report.json")}).text()


def test_what_was_only_matched_has_no_residuals() -> None:
    lines = Outcome(summary_of(make_registration("matched")), {"numbers": Path("report.json")}).text()
    assert "displacement before" in lines
    assert "residual" not in lines
    without = summary_of(make_registration("rejected", n=0))
    assert "LE90" not in Outcome(without, {"numbers": Path("report.json")}).text()
