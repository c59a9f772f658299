"""Requirements: read, applied to the pairs that they are about, judged."""

from __future__ import annotations

import math

import pytest

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.multi.qa.closure import Triangle
from pcwlad_geo.multi.qa.requirements import (
    BandRequirement,
    Judged,
    ceos_ard_row,
    check_applicable,
    judge_pairs,
    judge_triangles,
    preset_requirements,
    read_requirement,
)
from pcwlad_geo.requirements import Requirement
from tests.multi.measured_bands import make_band, make_pair, refused

RED, NIR = make_band("red"), make_band("nir")
THERMAL, THERMAL_2 = make_band("b10", native_m=100.0), make_band("b11", native_m=100.0)


@pytest.mark.parametrize(
    ("text", "statistic", "limit", "unit", "net"),
    [
        ("CE90<=0.3px", "CE90", 0.3, "px", False),
        ("ce95 < 3 m", "CE95", 3.0, "m", False),
        ("net LE90 ≤ .5 native px", "LE90", 0.5, "native px", True),
        ("NET  ce99.7<=1e-1 pixels", "CE99.7", 0.1, "px", True),
        ("rmse<=4.5 metres", "RMSE", 4.5, "m", False),
        ("mean<=0.05px", "mean", 0.05, "px", False),
        ("closure <= 0.05 px", "closure", 0.05, "px", False),
    ],
)
def test_reads(text: str, statistic: str, limit: float, unit: str, net: bool) -> None:
    found = read_requirement(text).rule
    assert (found.statistic, found.limit, found.unit, found.net) == (statistic, limit, unit, net)
    assert read_requirement(found.text).rule == found


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "give a statistic"),
        ("CE90", "give a statistic"),
        ("CE90>=0.3px", "write CE90 with <="),
        ("CE80<=0.3px", "no statistic 'CE80'; there are mean, median"),
        ("CE90<=0.3", "give the unit px, native px or m"),
        ("CE90<=0.3km", "give the unit px, native px or m"),
        ("CE90<=0px", "the limit 0 is no number above 0"),
        ("CE90<=-1px", "the limit -1 is no number above 0"),
        ("CE90<=1e999px", "no number above 0"),
        ("CE90<=1.2.3px", "no number above 0"),
        ("net mean<=1px", "no net mean"),
        ("closure<=1 native px", "give the unit px or m"),
        ("points>=30", "qa has no points; it has mean"),
        ("check CE90<=1px", "'check' cannot stand before CE90; before errors net can"),
    ],
)
def test_nonsense_is_told(text: str, said: str) -> None:
    with pytest.raises(SettingsError, match=r"require = ") as caught:
        read_requirement(text)
    assert said in str(caught.value)


def test_unknown_preset() -> None:
    with pytest.raises(SettingsError, match="give one of sentinel2, landsat-oli, landsat-tirs, ceos-ard"):
        preset_requirements("spot")


def test_each_statistic_is_the_one_of_its_name() -> None:
    pair = make_pair(RED, NIR, (0.3, -0.4), noise_px=0.1, sigma_px=0.06)
    px, m = pair.statistics["px"], pair.statistics["m"]
    assert px is not None
    assert m is not None
    expected = {
        "mean<=1px": math.hypot(px.col.mean, px.row.mean),
        "median<=1px": math.hypot(px.col.median, px.row.median),
        "std<=1px": max(px.col.std, px.row.std),
        "LE90<=1px": px.row.le90,  # the larger
        "RMSE<=1px": px.radial.rmse,
        "CE90<=1px": px.radial.ce90,
        "CE95<=1px": px.radial.ce95,
        "CE99.7<=1px": px.radial.ce99_7,
        "net CE90<=1px": px.net.ce90,
        "net LE90<=1px": max(px.net.le90_xy),
        "net std<=1px": max(px.net.std_xy),
        "net RMSE<=1px": px.net.rmse,
        "CE90<=1m": m.radial.ce90,
        "CE90<=1native px": px.radial.ce90,
    }
    for text, value in expected.items():
        judged = judge_pairs(read_requirement(text), [pair])
        assert judged.values == {"red – nir": pytest.approx(value)}, text
    assert px.row.le90 > px.col.le90
    assert m.radial.ce90 == pytest.approx(30 * px.radial.ce90, rel=1e-3)  # UTM's metres, nearly
    assert math.hypot(px.col.mean, px.row.mean) == pytest.approx(0.5, abs=0.02)


def test_native_pixels_are_the_coarser_of_the_two() -> None:
    pair = make_pair(RED, THERMAL, (1.0, 0.0))
    native, px = pair.statistics["native px"], pair.statistics["px"]
    assert native is not None
    assert px is not None
    assert native.col.mean == pytest.approx(0.3 * px.col.mean)


def test_passes_up_to_the_limit_and_not_beyond() -> None:
    value = judge_pairs(read_requirement("CE90<=1px"), [make_pair(RED, NIR)]).values["red – nir"]
    assert Judged(BandRequirement(Requirement("CE90", value, "px")), {"red – nir": value}).passed
    over = Judged(BandRequirement(Requirement("CE90", value * 0.999, "px")), {"red – nir": value})
    assert not over.passed
    assert over.failed == ("red – nir",)


def test_a_refused_pair_fails_and_nothing_measured_is_no_pass() -> None:
    requirement = read_requirement("CE90<=1px")
    judged = judge_pairs(requirement, [make_pair(RED, NIR), refused(RED, THERMAL)])
    assert judged.failed == ("red – b10",)
    assert not judge_pairs(requirement, []).passed
    assert judge_pairs(requirement, []).worst is None


def test_landsat_presets_are_about_their_pairs() -> None:
    pairs = [make_pair(RED, NIR), make_pair(RED, THERMAL), make_pair(THERMAL, THERMAL_2)]
    oli, both, one = *preset_requirements("landsat-oli"), *preset_requirements("landsat-tirs")
    assert [list(judge_pairs(each, pairs).values) for each in (oli, both, one)] == [
        ["red – nir"],
        ["b10 – b11"],
        ["red – b10"],
    ]


@pytest.mark.parametrize(("shift_px", "word"), [((0.28, -0.4), "met"), ((0.32, -0.4), "not met")])
def test_the_row_of_ceos_ard(shift_px: tuple[float, float], word: str) -> None:
    """Half a pixel, radial, of the displacement without the noise: 0.49 px meets it, 0.51 px does not."""
    (threshold,) = preset_requirements("ceos-ard")
    judged = judge_pairs(threshold, [make_pair(RED, NIR, shift_px, noise_px=0.1, sigma_px=0.1)])
    assert judged.passed is (word == "met")
    assert abs(judged.values["red – nir"] - math.hypot(*shift_px)) < 0.01
    row = ceos_ard_row(judged)
    assert f"rRMSE <= 0.5 px | {word} | worst rRMSE 0.{'49' if word == 'met' else '51'} px, red – nir" in row
    assert "not measured" in ceos_ard_row(judge_pairs(threshold, []))


def test_a_preset_is_judged_as_far_as_the_bands_go() -> None:
    wanted = preset_requirements("landsat-tirs")
    assert [each.scope for each in check_applicable(wanted, [(RED, THERMAL)], False)] == ["one thermal"]
    with pytest.raises(SettingsError, match="landsat-tirs needs a thermal band"):
        check_applicable(wanted, [(RED, NIR)], False)
    with pytest.raises(SettingsError, match="landsat-oli needs two bands that are not thermal"):
        check_applicable(preset_requirements("landsat-oli"), [(THERMAL, THERMAL_2)], False)


def test_what_cannot_be_judged_is_told_before() -> None:
    bare = make_band("bare", georeferenced=False), make_band("other", georeferenced=False)
    with pytest.raises(SettingsError, match="no CRS, so metres are not known: give px"):
        check_applicable([read_requirement("CE90<=3m")], [bare], False)
    with pytest.raises(SettingsError, match="needs all pairs of three bands or more"):
        check_applicable([read_requirement("closure<=1px")], [(RED, NIR)], False)


def test_closure_is_judged_on_its_larger_axis() -> None:
    def triangle(name: str, mean: tuple[float, float] | None) -> Triangle:
        return Triangle(("a", "b", name), 9 if mean else 0, mean, None, mean, (30.0, 30.0))

    triangles = [triangle("c", (0.01, -0.04)), triangle("d", (-0.02, 0.01))]
    judged = judge_triangles(read_requirement("closure<=0.03px"), triangles)
    assert judged.failed == ("a – b – c",)
    assert judged.worst == ("a – b – c", 0.04)
    metres = judge_triangles(read_requirement("closure<=1.3m"), triangles)
    assert metres.passed
    assert metres.values["a – b – c"] == pytest.approx(1.2)
    unknown = judge_triangles(read_requirement("closure<=1px"), [triangle("c", None)])
    assert unknown.failed == ("a – b – c",)
