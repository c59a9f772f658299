"""The judge's figures and limits, to the point: matches are set into its cells one by one."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest

from pcwlad_geo.matching import TiePoints
from pcwlad_geo.registration.decision import Decision
from pcwlad_geo.registration.judge import JudgeParameters, judge

WINDOW_PX, CELL_PX = 40, 30.0
"""Places lie more than half a window apart."""
RIGHT, WRONG = (3.0, -2.0), (-9.0, 9.0)

Moves = Iterable[tuple[float, float]]


def verdict(
    cells: Iterable[Moves],
    *,
    radius_px: int = 12,
    kept: Moves = (RIGHT,),
    parameters: JudgeParameters = JudgeParameters(),
    **counts: int,
) -> Decision:
    """Judge matches of these displacements, cell by cell; those listed as kept are the consistent ones."""
    placed = [
        ((CELL_PX * number + 0.1 * i, 0.0), move)
        for number, moves in enumerate(map(list, cells))
        for i, move in enumerate(moves)
    ]
    xy = np.array([place for place, _ in placed]).reshape(-1, 2)
    moved = np.array([move for _, move in placed]).reshape(-1, 2)
    n = len(xy)
    points = TiePoints(xy, xy + moved, np.tile(0.01 * np.eye(2), (n, 1, 1)), np.full(n, 0.5), np.zeros(n))
    consistent = np.array([tuple(move) in list(kept) for move in moved.tolist()], bool)
    counts = counts or {"candidates": 200}
    return judge(points, consistent, counts, WINDOW_PX, radius_px, parameters=parameters)


def by_hand(agreeing: int, cells: int, radius_px: int) -> float:
    """-log10 of the binomial tail at twice the share of the search window, of the best of 1 / share moves."""
    share = min(1.0, math.pi * 2.0**2 / (2 * radius_px + 1) ** 2)
    chance = min(0.5, 2 * share)
    tail = sum(
        math.comb(cells, k) * chance**k * (1 - chance) ** (cells - k) for k in range(agreeing, cells + 1)
    )
    return max(0.0, -math.log10(tail) + math.log10(share))


@pytest.mark.parametrize("radius_px", [1, 5, 12, 100])
@pytest.mark.parametrize(("agreeing", "cells"), [(1, 20), (8, 8), (12, 20)])
def test_the_significance_is_the_one_by_hand(agreeing: int, cells: int, radius_px: int) -> None:
    found = verdict([[RIGHT]] * agreeing + [[WRONG]] * (cells - agreeing), radius_px=radius_px)
    assert (found.evidence.cells, found.evidence.agreeing_cells) == (cells, agreeing)
    assert found.significance == pytest.approx(by_hand(agreeing, cells, radius_px), abs=1e-9)


def test_four_separate_places_must_agree() -> None:
    """However significant three would be: the search is so wide that two would do."""
    for cells, accepted in ((3, False), (4, True), (5, True)):
        found = verdict([[RIGHT] * 8] * cells, radius_px=500)
        assert found.significance > JudgeParameters().least_significance
        assert found.accepted is accepted
        assert found.evidence.agreeing_cells == cells


def test_the_significance_decides_where_places_are_enough() -> None:
    for cells, accepted in ((5, False), (6, True)):  # 5.3 and 6.7
        found = verdict([[RIGHT] * 4] * cells)
        assert found.significance == pytest.approx(6.0, abs=0.8)
        assert found.accepted is accepted


def test_a_significance_at_the_limit_suffices() -> None:
    cells = [[RIGHT] * 4] * 6
    limit = JudgeParameters(least_significance=verdict(cells).significance)
    assert verdict(cells, parameters=limit).accepted


@pytest.mark.parametrize(
    ("off_px", "agrees"), [(1.9, True), (2.0, False), (2.1, False), (-1.9, True), (-2.0, False)]
)
def test_a_place_agrees_within_two_pixels(off_px: float, agrees: bool) -> None:
    found = verdict([[(0.0, 0.0)] * 3] * 4 + [[(off_px, 0.0)]], kept=[(0.0, 0.0)])
    assert found.evidence.agreeing_cells == 4 + agrees


@pytest.mark.parametrize(("right", "of", "agrees"), [(1, 1, 1), (1, 2, 1), (1, 3, 0), (2, 3, 1), (2, 5, 0)])
def test_half_of_the_matches_of_a_place_must_agree(right: int, of: int, agrees: int) -> None:
    found = verdict([[RIGHT] * 3] * 4 + [[RIGHT] * right + [WRONG] * (of - right)])
    assert (found.evidence.cells, found.evidence.agreeing_cells) == (5, 4 + agrees)


def test_the_common_displacement_is_the_median_of_the_consistent_ones() -> None:
    far = (100.0, 100.0)
    assert (
        verdict([[RIGHT]] * 9 + [[far]] * 3 + [[WRONG]] * 30, kept=[RIGHT, far]).evidence.agreeing_cells == 9
    )
    assert verdict([[RIGHT]] * 3 + [[far]] * 2, kept=[]).evidence.agreeing_cells == 3, (
        "of all, where none is kept"
    )


@pytest.mark.parametrize(("points", "agreeing"), [(35, 3), (36, 36)])
def test_the_common_displacement_is_a_plane_from_36_points_on(points: int, agreeing: int) -> None:
    """Each place has moved 1.5 px further than the one before."""
    moves = [(1.5 * number, 0.0) for number in range(points)]
    assert verdict([[move] for move in moves], kept=moves).evidence.agreeing_cells == agreeing


def test_a_steep_plane_is_one_of_many_and_says_less_than_a_level_one() -> None:
    level = verdict([[RIGHT]] * 36, kept=[RIGHT])
    moves = [(1.5 * number, 0.0) for number in range(36)]
    steep = verdict([[move] for move in moves], kept=moves)
    rise_px = 1.5 * 35 / 2
    assert steep.evidence.agreeing_cells == level.evidence.agreeing_cells == 36
    assert level.significance - steep.significance == pytest.approx(np.log10(1 + rise_px / 2.0))


def test_the_displacement_of_all_counts_where_wrong_points_tilt_the_plane() -> None:
    far = (12.0, 0.0)
    found = verdict([[RIGHT] * 2] * 30 + [[far] * 2] * 8, kept=[RIGHT, far])
    assert found.evidence.agreeing_cells == 30


@pytest.mark.parametrize(
    ("agreeing", "cells", "few"), [(3, 4, True), (2, 3, False), (1, 1, True), (2, 4, False)]
)
def test_places_that_mostly_agree_are_too_few_and_not_chance(agreeing: int, cells: int, few: bool) -> None:
    reason = verdict([[RIGHT]] * agreeing + [[WRONG]] * (cells - agreeing)).refusal or ""
    assert ("tie points agree" in reason) is few
    assert ("no better than chance" in reason) is not few


def test_many_points_in_few_places_are_told_to_lack_places() -> None:
    """Not to be fewer than the least number of points, which they exceed."""
    reason = verdict([[RIGHT] * 30] * 3).refusal or ""
    assert reason.startswith("90 tie points agree, in 3 of 3 separate places")
    assert "more places are needed" in reason
    assert "at least" not in reason
    assert "at least 12 are needed" in (verdict([[RIGHT]] * 3).refusal or "")


def test_no_point_at_all_is_no_agreement() -> None:
    found = verdict([])
    assert (found.refusal or "").startswith("none of the 200 candidates agrees")
    assert (found.evidence.agreeing_cells, found.evidence.cells) == (0, 0)


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        ({"matched": 1}, "no structure to match"),
        ({"candidates": 200, "not_comparable": 181}, "almost no window"),
        ({"candidates": 200, "not_comparable": 180}, "no better than chance"),
        ({"candidates": 1}, "no better than chance"),
    ],
)
def test_what_cannot_be_matched_at_all_is_said_first(counts: dict[str, int], said: str) -> None:
    assert said in (verdict([[RIGHT]] * 2 + [[WRONG]] * 8, **counts).refusal or "")


@pytest.mark.parametrize(
    ("counts", "past_border"),
    [
        ({"candidates": 200, "at_search_border": 50}, False),
        ({"candidates": 200, "at_search_border": 51}, True),
        ({"candidates": 2}, False),
    ],
)
def test_a_quarter_on_the_edge_of_the_search_is_not_many(counts: dict[str, int], past_border: bool) -> None:
    assert verdict([[RIGHT]] * 2 + [[WRONG]] * 8, **counts).evidence.past_search_border is past_border
