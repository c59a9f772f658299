"""A refusal advises what has not been tried."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.raster import Patch
from pcwlad_geo.registration.advice import refusal
from pcwlad_geo.registration.decision import Decision, Evidence
from pcwlad_geo.registration.starts.alignment import Prealignment
from pcwlad_geo.registration.starts.overviews import has_few_values
from pcwlad_geo.registration.starts.pose import Pose

FACTS = "only 7 of 900 candidates agree"


def reason(method: str, *, beyond: bool, searched: bool, georeferenced: bool = True) -> str:
    start = Prealignment(method, (3.0, 4.0), 18, searched)
    return refusal(Decision(FACTS, Evidence(9, 1, 0.0, beyond)), start, georeferenced=georeferenced)


@pytest.mark.parametrize("beyond", [True, False])
def test_a_search_that_was_not_made_is_advised_first(beyond: bool) -> None:
    said = reason("georeferencing", beyond=beyond, searched=False)
    assert said.startswith(FACTS)
    assert "search radius of 18 px" in said
    assert "raise --search-radius" in said
    assert said.index("give --prealign search") < said.index("bands that look alike")
    assert ("many best matches lie on the edge" in said) is beyond


@pytest.mark.parametrize("beyond", [True, False])
def test_where_it_found_nothing_no_option_is_advised(beyond: bool) -> None:
    said = reason("georeferencing", beyond=beyond, searched=True)
    assert "a search over the whole image found no start that holds" in said
    assert said.index("bands that look alike") < said.index("mask clouds") < said.index("the same place")
    assert "geotransform" not in said
    assert "--" not in said


def test_frames_without_a_start_need_a_rough_geotransform() -> None:
    said = reason("identity", beyond=False, searched=True, georeferenced=False)
    assert said.index("rough geotransform") < said.index("bands that look alike")
    assert "share a small part only" in said


def test_gaps_are_filled_first() -> None:
    start = Prealignment("georeferencing", (0.0, 0.0), 18, True)
    said = refusal(Decision(FACTS, Evidence(9, 1, 0.0, False, few_valid=True)), start)
    assert said.index("gdal_fillnodata.py") < said.index("bands that look alike")


def test_where_it_found_a_start_a_larger_radius_about_that_is_advised() -> None:
    said = reason("search", beyond=True, searched=True)
    assert "around the shift that a search over the whole image found" in said
    assert "give --prealign search with --search-radius 36" in said
    said = reason("search", beyond=False, searched=True)
    assert said.startswith(
        f"{FACTS}: this is from the shift that a search over the whole image found; choose"
    )
    assert "--" not in said


def test_the_best_pose_is_named_with_the_number_of_starts() -> None:
    pose = Pose(5.04, (1.02, 1.01), 0.3, (12.0, -7.0))
    start = Prealignment("pose", (0.0, 0.0), 11, True, pose, 1.2, tried=4)
    said = refusal(Decision(FACTS, Evidence(40, 9, 3.0, False)), start)
    assert said.startswith(FACTS)
    assert "the best of 4 starts" in said
    assert "rotation 5.0 degrees, scale 1.020 x 1.010" in said


def test_what_the_search_found_is_told_with_its_chance_although_nothing_matches() -> None:
    pose = Pose(0.0, (1.0, 1.0), 0.0, (-66.1, 38.0))
    start = Prealignment("pose", (0.0, 0.0), 11, True, pose, 3.2)
    verdict = Decision("no structure to match", Evidence(0, 0, 0.0))
    said = refusal(verdict, start, few_values=["water.tif"])
    assert said.startswith("no structure to match: ")
    assert "(-66, +38) px" in said
    assert "in one of 1585 pairs" in said
    assert "water.tif has little more than two values" in said


def test_what_is_no_matter_of_the_search_stays_as_it_is() -> None:
    verdict = Decision("no structure to match", Evidence(0, 0, 0.0))
    start = Prealignment("georeferencing", (0.0, 0.0), 12)
    assert refusal(verdict, start) == "no structure to match"
    assert refusal(replace(verdict, refusal=None), start) == ""


def test_two_values_are_a_mask_and_a_picture_is_none() -> None:
    valid = np.ones((40, 40), bool)
    valid[:5] = False
    mask = (np.indices((40, 40))[1] > 30).astype(np.float32)
    picture = np.random.default_rng(0).normal(size=(40, 40)).astype(np.float32)
    assert has_few_values(Patch(mask, valid))
    assert not has_few_values(Patch(picture, valid))


def test_a_pose_is_told_beside_what_the_projections_make() -> None:
    """A sinusoidal grid is sheared against UTM by itself."""
    own = np.array([[1.1, 0.6], [0.2, 0.9]])
    angle = np.radians(2.0)
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = np.eye(3)
    matrix[:2, :2] = turned @ own
    pose = Pose.of(matrix, (100, 100))
    assert abs(pose.shear_deg) > 20
    beside = pose.beside(own)
    assert beside.rotation_deg == pytest.approx(2.0)
    assert beside.scale == pytest.approx((1.0, 1.0))
    assert beside.shear_deg == pytest.approx(0.0, abs=1e-9)
    assert beside.shift_px == pose.shift_px
    assert pose.beside(np.full((2, 2), np.nan)) == pose
