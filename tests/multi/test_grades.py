"""The grades of images: what pairs say for and against a place, and what becomes of images without one."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.cli.app import run as run_command
from pcwlad_geo.errors import OutputError
from pcwlad_geo.events import ignore
from pcwlad_geo.multi.stack.adjustment import adjust
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.page import stack_page
from pcwlad_geo.multi.stack.pair import StackPair
from pcwlad_geo.multi.stack.pairs import MeasuredPair, measured_pair
from pcwlad_geo.multi.stack.positions import stack_of
from pcwlad_geo.multi.stack.quality import StackQuality, image_qualities, residual_ce90
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.multi.stack.verdict import grade_images, judge_stack
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import RasterInfo
from pcwlad_geo.requirements import parse_requirements
from tests.multi.test_adjustment import GRID, make
from tests.multi.test_stack import write_images
from tests.scenes import make_grid

ALL = list(combinations("abcde", 2))


def pair(one: str, other: str, **other_values: object) -> StackPair:
    """A pair that agrees with the others, unless told otherwise."""
    whole = StackPair(one, other, "used", None, Path("x"), 100, (0.02, 0.0), 0.03, 0.5, 0.1, ce90_px=0.1)
    return replace(whole, **other_values)  # type: ignore[arg-type]  # by name


def away(one: str, other: str, off: tuple[float, float] = (9.0, 9.0)) -> StackPair:
    return pair(one, other, status="left out", offset_px=off, redundancy=1.0)


def grades(pairs: list[StackPair], sigma: float = 0.05, anchors: str = "a") -> dict[str, StackQuality]:
    names = sorted({name for each in pairs for name in (each.reference, each.target)})
    return image_qualities(pairs, dict.fromkeys(names, sigma), dict.fromkeys(names, 1.0), anchors, {})


def letters(found: dict[str, StackQuality]) -> str:
    return " ".join(each.grade for each in found.values())


MOTION = {"displacement_px": [1.0, 2.0], "points": 20, "share": 0.5, "places": 9, "significance": 8.0}


@pytest.fixture(scope="module")
def without_pictures() -> None:
    """Draw them: one of these pages shows its images before and after."""


@pytest.mark.parametrize(
    "motions", [5, ["far"], [{"displacement_px": [1.0, 2.0]}], [{**MOTION, "displacement_px": ["a", "b"]}]]
)
def test_damaged_motions_of_a_pair_are_told_of(tmp_path: Path, motions: object) -> None:
    frame = StackFrame(["a", "b"], [], make_grid(), True)
    report = {"schema_version": 1, "settings": {}, "status": "rejected", "reason": "clouds"}
    (tmp_path / "report.json").write_text(json.dumps({**report, "motions": [MOTION]}))
    found = measured_pair(frame, (0, 1), tmp_path, None, ignore).pair
    assert (found.status, found.reason, len(found.motions)) == ("refused", "clouds", 1)
    (tmp_path / "report.json").write_text(json.dumps({**report, "motions": motions}))
    with pytest.raises(OutputError, match=r"has a damaged report \(.*remove the folder, and run again"):
        measured_pair(frame, (0, 1), tmp_path, None, ignore)


def test_images_whose_pairs_agree_are_good() -> None:
    found = grades([pair(*ends) for ends in ALL])
    assert letters(found) == "good good good good good"
    assert found["b"].reasons == ()
    assert found["b"].expected_ce90_px == pytest.approx(np.hypot(2.146 * 0.05, 0.1))


def test_what_no_other_pair_checks_is_not_good() -> None:
    chain = [pair("a", "b", redundancy=0.0), pair("b", "c", redundancy=0.0)]
    found = grades(chain)
    assert letters(found) == "fair fair fair"
    assert found["c"].reasons == ("no other pair checks those that place it",)


@pytest.mark.parametrize(("sigma", "grade"), [(0.2, "good"), (0.3, "fair"), (0.6, "poor")])
def test_the_limits_of_sigma_are_those_of_a_pair(sigma: float, grade: str) -> None:
    assert {each.grade for each in grades([pair(*ends) for ends in ALL], sigma).values()} == {grade}


def test_what_pairs_leave_over_the_ground_counts() -> None:
    pairs = [pair(*ends, ce90_px=0.8 if "e" in ends else 0.1) for ends in ALL]
    assert letters(grades(pairs)) == "good good good good fair"


def test_jitter_is_of_the_image_all_of_whose_pairs_show_it() -> None:
    pairs = [pair(*ends, jitter_px=0.7 if "e" in ends else 0.0) for ends in ALL]
    found = grades(pairs)
    assert letters(found) == "good good good good poor"
    assert "1.06 px by rows or columns that move" in found["e"].reasons[0]


def test_jitter_that_two_images_share_is_told_against_the_datum() -> None:
    """The pair of d and e shows none, and b and c, which have none, are in pairs that do."""
    pairs = [pair(*ends, jitter_px=0.7 if len({"d", "e"} & set(ends)) == 1 else 0.0) for ends in ALL]
    assert letters(grades(pairs)) == "good good good poor poor"
    mean = image_qualities(pairs, dict.fromkeys("abcde", 0.05), dict.fromkeys("abcde", 1.0), "", {})
    assert letters(mean) == "good good good good good"


def test_what_a_dem_beside_its_place_does_to_an_image_counts() -> None:
    names = dict.fromkeys("abcde", 1.0)
    found = image_qualities(
        [pair(*ends) for ends in ALL], dict.fromkeys("abcde", 0.05), names, "a", {"d": 0.8}
    )
    assert letters(found) == "good good good fair good"
    assert "0.80 px by heights of a DEM" in found["d"].reasons[0]
    doubted = found["a"].doubted("wrong")
    assert (doubted.grade, doubted.reasons) == ("fair", ("wrong",))
    assert found["d"].doubted("wrong").reasons[1:] == ("wrong",)


def test_the_grades_of_pairs_and_ground_without_points_count() -> None:
    poor = [
        pair(*ends, quality="poor" if "e" in ends else "good", quality_reasons=("clouds moved",))
        for ends in ALL
    ]
    found = grades(poor)
    assert letters(found) == "good good good good poor"
    assert "4 of the 4 pairs that place it are not good: clouds moved" in found["e"].reasons
    empty = grades([pair(*ends, empty_share=0.6 if "e" in ends else 0.1) for ends in ALL])
    assert letters(empty) == "good good good good fair"
    assert "60 % of the common ground has no tie point" in empty["e"].reasons[0]


def test_an_image_that_half_of_its_pairs_contradict_is_refused_and_the_others_are_not() -> None:
    against = [away(*ends) if ends in (("a", "e"), ("b", "e")) else pair(*ends) for ends in ALL]
    found = grades(against)
    assert letters(found) == "good good good good refused"
    assert "50 % of its pairs lie more than 1 px off" in found["e"].reasons[0]
    whole = StackQuality.of_all(found)
    assert whole.grade == "poor"
    assert whole.reasons[0].startswith("e: 50 %")


def test_a_pair_in_use_that_lies_far_off_contradicts_as_well() -> None:
    far = {("a", "e"): (9.0, 0.0), ("b", "e"): (12.0, 0.0)}
    pairs = [pair(*ends, offset_px=far.get(ends, (0.02, 0.0)), redundancy=0.9) for ends in ALL]
    assert grades(pairs)["e"].grade == "refused"


def test_a_single_wrong_pair_of_many_is_outvoted_and_one_of_three_leaves_a_doubt() -> None:
    one_of_four = grades([away(*ends) if ends == ("d", "e") else pair(*ends) for ends in ALL])
    assert letters(one_of_four) == "good good good good good"
    few = list(combinations("abcd", 2))
    one_of_three = grades([away(*ends) if ends == ("c", "d") else pair(*ends) for ends in few])
    assert letters(one_of_three) == "good good fair fair"


def test_contradictions_within_what_all_pairs_err_by_refuse_nothing() -> None:
    noisy = [pair(*ends, sigma_px=0.5, redundancy=0.5, offset_px=(1.2, 0.0)) for ends in ALL]
    assert "refused" not in letters(grades(noisy))


def test_what_hangs_on_a_refused_image_is_refused_too() -> None:
    pairs = [
        *(pair(*ends) for ends in combinations("abc", 2)),
        away("a", "x"), away("b", "x"), pair("c", "x"), pair("x", "y", redundancy=0.0),
    ]  # fmt: skip
    found = grades(pairs)
    assert found["x"].grade == found["y"].grade == "refused"
    assert "only x, which cannot be placed, would connect it" in found["y"].reasons[0]
    assert {found[name].grade for name in "abc"} == {"good"}


def test_where_the_reference_is_contradicted_nothing_is_placed() -> None:
    against = [away(*ends) if ends in (("a", "d"), ("a", "e")) else pair(*ends) for ends in ALL]
    assert set(letters(grades(against)).split()) == {"refused"}
    by_mean = grades(against, anchors="")
    assert letters(by_mean) == "refused good good good good"


def test_noise_of_single_points_is_not_what_a_pair_leaves() -> None:
    rng = np.random.default_rng(3)
    at_px = rng.uniform(0.0, 2000.0, (600, 2))
    assert residual_ce90(at_px, rng.normal(0.0, 0.4, at_px.shape)) < 0.35
    waves = 0.8 * np.sin(at_px / 300.0)
    assert residual_ce90(at_px, waves + rng.normal(0.0, 0.1, at_px.shape)) == pytest.approx(
        np.percentile(np.hypot(*waves.T), 90), rel=0.2
    )


def simulated(seed: int, wrong: dict[tuple[int, int], tuple[float, float]]) -> tuple[Stack, list[float]]:
    """A stack of five images of known truth, and by how much each is off (CE90)."""
    rng = np.random.default_rng(seed)
    truth = make(rng, 5)
    truth.terms[0] = 0.0
    ends = list(combinations(range(5), 2))
    edges = [
        truth.edge(rng, *each, shared=0.05, sigma=0.1, off=np.array(wrong.get(each, (0.0, 0.0))))
        for each in ends
    ]
    names, folder = [f"band{number}" for number in range(5)], Path("/out")
    info = RasterInfo("/data/x.tif", 1, 1, make_grid((1000, 1000)), True, "uint16", 0.0, None)
    measured = [
        MeasuredPair(
            StackPair(names[one], names[other], "used", None, folder / "pairs" / f"{one}_{other}"), edge
        )
        for edge, (one, other) in zip(edges, ends, strict=True)
    ]
    found = adjust(edges, 5)
    result = stack_of(
        StackFrame(names, [info] * 5, info.grid, True), measured, found, folder, Settings(), [], {}
    )
    off = [
        float(np.percentile(np.hypot(*(found.displacement(k, GRID) - truth.displacement(k, GRID)).T), 90))
        for k in range(5)
    ]
    return grade_images(result), off


@pytest.mark.parametrize("seed", range(4))
def test_clouds_that_two_pairs_follow_place_no_image_and_right_stacks_stay_good(seed: int) -> None:
    right, off = simulated(seed, {})
    assert {image.quality.grade for image in right.images} == {"good"}
    assert max(off) < 0.5
    clouds = {(2, 4): (4.7, -11.5), (3, 4): (4.9, -11.4)}
    found, off = simulated(seed, clouds)
    assert found.images[4].refused
    assert {image.quality.grade for image in found.written.images} == {"good"}
    assert max(off[:4]) < 0.5


def test_requirements_and_the_page_tell_the_grade() -> None:
    found, _ = simulated(0, {(2, 4): (4.7, -11.5), (3, 4): (4.9, -11.4)})
    (result,) = judge_stack(found, parse_requirements(["quality>=fair"], "stack"))
    assert result.text == "quality >= fair: not met (poor)"
    right, _ = simulated(0, {})
    assert judge_stack(right, parse_requirements(["quality=good"], "stack"))[0].met
    text = stack_page(found)
    assert '<h1 class="bad"><span aria-hidden="true">✗</span> 4 of 5 images in one frame, 1 refused' in text
    assert '<td class="bad"><strong>refused</strong></td>' in text
    assert "band4 is refused: 50 % of its pairs" in text
    assert text.index("<h1") < text.index("band4 is refused") < text.index("The net")
    assert '<h1 class="good"><span aria-hidden="true">✓</span> 5 images in one frame' in stack_page(right)


def shift_points(folder: Path, shift_px: float) -> None:
    """Displace the tie points of a pair that was matched, as if they were of clouds."""
    with (folder / "tiepoints.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    column = rows[0].index("tgt_col")
    for row in rows[1:]:
        row[column] = str(float(row[column]) + shift_px)
    with (folder / "tiepoints.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)


@pytest.mark.gate
@pytest.mark.slow
def test_a_refused_image_has_no_raster_and_the_run_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = [str(path) for path in write_images(tmp_path, 4)]
    out = tmp_path / "out"
    command = ["stack", *images, "-o", str(out), "--jobs", "1", "--progress", "none"]
    assert run_command(command) == 0
    assert "quality: good" in capsys.readouterr().out
    assert (out / "date3_registered.tif").is_file()
    assert (out / "stack.html").read_text(encoding="utf-8").count('class="pile"') >= 2  # before and after
    shift_points(out / "pairs/date1__date3", 12.0)
    shift_points(out / "pairs/date2__date3", -9.0)
    assert run_command(command) == 3
    printed = capsys.readouterr()
    assert "warning: date3: refused: 67 % of its pairs" in printed.err
    assert "quality: poor; date3: 67 % of its pairs" in printed.out
    numbers = json.loads((out / "stack.json").read_text())
    assert [image["quality"]["grade"] for image in numbers["images"]] == ["good", "good", "good", "refused"]
    assert numbers["images"][3]["registered"] is None
    assert numbers["quality"]["grade"] == "poor"
    assert any(text.startswith("date3: refused") for text in numbers["warnings"])
    assert not (out / "date3_registered.tif").exists()  # that of the run before
    assert not (out / "item_date3.json").exists()
    assert (out / "date2_registered.tif").is_file()
    item = json.loads((out / "item_date2.json").read_text())
    assert item["assets"]["data"]["pcwlad_geo:quality"] == "good"
    with (out / "stack.csv").open(newline="") as file:
        assert [row["quality"] for row in csv.DictReader(file)] == ["good", "good", "good", "refused"]
    assert run_command([*command, "--require", "quality>=fair"]) == 4
    assert run_command([*command, "--reference", "date3"]) == 3
    assert "no image can be placed" in capsys.readouterr().err
