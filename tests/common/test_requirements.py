"""The grammar of requirements, and what is within a limit."""

from __future__ import annotations

import pytest

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.options import Settings
from pcwlad_geo.requirements import (
    Command,
    Figure,
    Requirement,
    all_met,
    judge,
    parse_requirement,
    parse_requirements,
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("CE90<=0.5px", Requirement("CE90", 0.5, "px")),
        ("check RMSE<=5m", Requirement("RMSE", 5.0, "m", group="check")),
        ("fit net le90 < .3 native px", Requirement("LE90", 0.3, "native px", net=True, group="fit")),
        ("NET Check CE95 ≤ 1 pixel", Requirement("CE95", 1.0, "px", net=True, group="check")),
        ("points>=100", Requirement("points", 100.0, None, ">=")),
        ("coverage >= 0.8", Requirement("coverage", 0.8, None, ">=")),
        ("coverage>80 %", Requirement("coverage", 0.8, None, ">=")),
        ("displacement<=3px", Requirement("displacement", 3.0, "px")),
        ("sigma <= 20 metres", Requirement("sigma", 20.0, "m")),
        ("model=shift", Requirement("model", "shift", None, "=")),
        ("Model == Affine", Requirement("model", "affine", None, "=")),
        ("model<=affine", Requirement("model", "affine", None, "<=")),
        ("quality>=fair", Requirement("quality", "fair", None, ">=")),
    ],
)
def test_reads_what_users_write(text: str, expected: Requirement) -> None:
    found = parse_requirement(text, "register")
    assert found == expected
    assert parse_requirement(found.text, "register") == expected


@pytest.mark.parametrize(
    ("text", "command", "said"),
    [
        ("", "register", "give a statistic, a comparison and a limit: 'CE90<=0.5px'"),
        ("CE90", "register", "'points>=100', 'coverage>=0.8' or 'model=shift'"),
        ("CE90<=", "register", "give a statistic, a comparison and a limit"),
        ("0.1<=CE90<=0.5px", "register", "give a statistic, a comparison and a limit"),
        ("CE91<=1px", "register", "no statistic 'CE91'; there are mean, median, std, RMSE, LE90, CE90,"),
        ("closure<=1px", "register", "register has no closure; it has mean, "),
        ("CE90<=1px", "match", "match has no CE90; it has displacement, sigma, points, coverage"),
        ("model=shift", "match", "match has no model"),
        ("model=shift", "qa", "qa has no model"),
        ("points<=100", "register", "write points with >="),
        ("CE90>=1px", "register", "write CE90 with <="),
        ("model>=shift", "register", "write model with = or <="),
        ("CE90<=1", "register", "give the unit px, native px or m"),
        ("points>=100px", "register", "the limit of points is a number without a unit"),
        ("coverage>=80", "register", "as a share up to 1, such as 0.8, or in per cent"),
        ("coverage>=x", "register", "the limit x is no number above 0"),
        (
            "model=quadratic",
            "register",
            "model is one of shift, drift, rigid, similarity, affine, projective, polynomial, jitter, tps, ",
        ),
        ("net sigma<=1px", "register", "there is no net sigma"),
        ("fit points>=9", "register", "'fit' cannot stand before points"),
        ("fit check CE90 of<=1px", "register", "no statistic 'of'"),
    ],
)
def test_tells_what_is_wrong_and_what_can_be_said(text: str, command: Command, said: str) -> None:
    with pytest.raises(SettingsError) as caught:
        parse_requirement(text, command)
    assert str(caught.value).startswith(f"require = {text!r}: ")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("CE90<=0.5px", {0.4: True, 0.5: True, 0.50001: False, float("nan"): False, None: False}),
        ("points>=100", {99: False, 100: True, None: False}),
        ("model=affine", {"shift": False, "affine": True, "tps": False, None: False}),
        ("model<=affine", {"shift": True, "affine": True, "tps": False, "unheard": False}),
        ("quality>=fair", {"poor": False, "fair": True, "good": True, None: False}),
    ],
)
def test_the_limit_is_within_and_what_is_unknown_is_not(
    text: str, values: dict[float | str | None, bool]
) -> None:
    requirement = parse_requirement(text, "register")
    assert {value: requirement.is_met(value) for value in values} == values


@pytest.mark.parametrize(
    "given", ["CE90<=1px; points>=9", ["CE90<=1px", "points>=9"], ("CE90<=1px;points>=9;",)]
)
def test_one_text_or_several(given: str | list[str]) -> None:
    settings = Settings(require=given)
    assert settings.require == ("CE90<=1px", "points>=9")
    assert len(parse_requirements(settings.require, "register")) == 2


@pytest.mark.parametrize("given", [3, [3], None])
def test_what_is_no_text_is_told(given: object) -> None:
    with pytest.raises(SettingsError, match=r"require = .*: give a text or a list"):
        Settings.from_options({"require": given})


def test_a_doubt_goes_with_met_limits_on_accuracy_alone() -> None:
    sigma, points = (parse_requirement(text, "stack") for text in ("sigma<=0.2px", "points>=10"))
    doubt = "but the stack is poor"
    assert judge(sigma, Figure(0.1, doubt=doubt)).caveat == doubt
    assert judge(sigma, Figure(0.3, doubt=doubt)).caveat is None
    assert judge(points, Figure(20.0, doubt=doubt)).caveat is None
    unknown = judge(sigma, Figure(None, "no sigma"))
    assert (unknown.met, unknown.reason) == (False, "no sigma")
    assert all_met([]) is None
    assert all_met([judge(points, Figure(20.0)), unknown]) is False
