"""A refusal advises what has not been tried."""

from __future__ import annotations

import pytest

from pcwlad_geo.registration.advice import refusal
from pcwlad_geo.registration.judge import Verdict
from pcwlad_geo.registration.result import Prealignment

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


@pytest.mark.parametrize("beyond", [True, False])
def test_where_it_found_nothing_no_option_is_advised(beyond: bool) -> None:
    said = reason("georeferencing", beyond=beyond, searched=True)
    assert "a search over the whole image found no start that holds" in said
    assert "--" not in said


def test_where_it_found_a_start_a_larger_radius_about_that_is_advised() -> None:
    said = reason("search", beyond=True, searched=True)
    assert "around the shift that a search over the whole image found" in said
    assert "give --prealign search with --search-radius 36" in said
    assert "--" not in reason("search", beyond=False, searched=True)


def test_what_is_no_matter_of_the_search_stays_as_it_is() -> None:
    verdict = Verdict(False, "no structure to match", 0, 0, 0.0)
    assert refusal(verdict, Prealignment("georeferencing", (0.0, 0.0), 12)) == "no structure to match"
