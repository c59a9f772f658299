"""A refusal advises what has not been tried."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pcwlad_geo.registration.judge import Verdict, refusal
from pcwlad_geo.registration.prealign import Pose, Prealignment

FACTS = "only 7 of 900 candidates agree"


def reason(method: str, *, beyond: bool, searched: bool) -> str:
    start = Prealignment(method, (3.0, 4.0), 18, searched)
    return refusal(Verdict(False, FACTS, 9, 1, 0.0, beyond), start)


@pytest.mark.parametrize("beyond", [True, False])
def test_a_search_that_was_not_made_is_advised(beyond: bool) -> None:
    said = reason("georeferencing", beyond=beyond, searched=False)
    assert said.startswith(FACTS)
    assert "search radius of 18 px" in said
    assert "raise --search-radius" in said
    assert "give --prealign search" in said
    assert ("many best matches lie on the edge" in said) is beyond
    assert ("clouds may hide the ground" in said) is not beyond


@pytest.mark.parametrize("beyond", [True, False])
def test_where_it_found_nothing_no_option_is_advised(beyond: bool) -> None:
    said = reason("georeferencing", beyond=beyond, searched=True)
    assert "a search over the whole image found no start that holds" in said
    assert "--" not in said


def test_where_it_found_a_start_a_larger_radius_about_that_is_advised() -> None:
    said = reason("search", beyond=True, searched=True)
    assert "around the shift that a search over the whole image found" in said
    assert "give --prealign search with --search-radius 36" in said
    said = reason("search", beyond=False, searched=True)
    assert said.startswith(
        f"{FACTS}: this is from the shift that a search over the whole image found; clouds"
    )
    assert said.endswith("check bands and masks")
    assert "--" not in said


def test_the_best_pose_is_named_with_the_number_of_starts() -> None:
    pose = Pose(5.04, (1.02, 1.01), 0.3, (12.0, -7.0))
    start = Prealignment("pose", (0.0, 0.0), 11, True, pose, 1.2, tried=4)
    said = refusal(Verdict(False, FACTS, 40, 9, 3.0, False), start)
    assert said.startswith(FACTS)
    assert "the best of 4 starts" in said
    assert "rotation 5.0 degrees, scale 1.020 x 1.010" in said


def test_what_is_no_matter_of_the_search_stays_as_it_is() -> None:
    verdict = Verdict(False, "no structure to match", 0, 0, 0.0)
    start = Prealignment("georeferencing", (0.0, 0.0), 12)
    assert refusal(verdict, start) == "no structure to match"
    assert refusal(replace(verdict, reason=None), start) == ""
