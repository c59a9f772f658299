"""The evidence against chance, beside the sum it stands for."""

from math import comb, log10

import pytest

from pcwlad_geo.matching.chance import evidence_against_chance


@pytest.mark.parametrize(("agreeing", "places", "chance"), [(1, 5, 0.1), (7, 20, 0.02), (30, 40, 0.3)])
def test_it_is_the_tail_of_the_binomial_distribution(agreeing: int, places: int, chance: float) -> None:
    tail = sum(
        comb(places, k) * chance**k * (1 - chance) ** (places - k) for k in range(agreeing, places + 1)
    )
    assert evidence_against_chance(agreeing, places, chance) == pytest.approx(-log10(tail), rel=1e-9)


def test_none_agreeing_is_no_evidence_and_all_of_many_is_finite() -> None:
    assert evidence_against_chance(0, 10, 0.1) == 0.0
    assert evidence_against_chance(1000, 1000, 0.001) == 300.0
