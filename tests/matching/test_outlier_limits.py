"""The limits of the local consistency, to the point: a match, its twelve neighbours, and nothing random."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching import outliers
from pcwlad_geo.matching.outliers import consistent

Float64 = NDArray[np.float64]

FAR = 60
"""So many matches elsewhere have not moved: the scatter of all is zero, and sigma sets the limits."""


def moved_px(columns: Sequence[float]) -> Float64:
    return np.array([(column, 0.0) for column in columns])


def stays(
    own: float, neighbours: Sequence[float], *, narrow: bool = False, sigma_px: float = 0.01, far: int = FAR
) -> bool:
    """Tell whether a match that moved so many columns outlives a round; its neighbours by distance."""
    angle = np.arange(len(neighbours))
    distance = 1.0 + 0.1 * angle
    ring = distance[:, None] * np.c_[np.cos(angle), np.sin(angle)]
    elsewhere = np.c_[1000 + 10.0 * np.arange(far), np.zeros(far)]
    xy = np.concatenate([[(0.0, 0.0)], ring, elsewhere])
    moved = moved_px([own, *neighbours, *[0.0] * far])
    n = len(xy)
    return bool(outliers._one_round(xy, moved, np.full(n, sigma_px), np.ones(n, bool), narrow)[0])


@pytest.mark.parametrize(("own_px", "kept"), [(5.9, True), (6.0, False), (-5.9, True), (-6.1, False)])
def test_the_wide_limit_is_six_pixels(own_px: float, kept: bool) -> None:
    assert stays(own_px, [0.0] * 12) is kept


@pytest.mark.parametrize(
    ("sigma_px", "limit_px"), [(0.01, 0.25), (0.1, 0.3), (0.2, 0.6), (0.6, 1.8), (0.7, 2.0), (5.0, 2.0)]
)
def test_the_narrow_limit_is_three_sigmas_between_a_quarter_and_two_pixels(
    sigma_px: float, limit_px: float
) -> None:
    assert stays(limit_px - 0.01, [0.0] * 12, narrow=True, sigma_px=sigma_px)
    assert not stays(limit_px + 0.01, [0.0] * 12, narrow=True, sigma_px=sigma_px)


def test_a_match_on_the_narrow_limit_goes() -> None:
    assert not stays(0.25, [0.0] * 12, narrow=True)


def test_twelve_neighbours_count_and_the_match_itself_does_not() -> None:
    """Six against six: one more or less on either side would let it stay."""
    even = [12.0, 0, 12, 0, 12, 0, 12, 0, 12, 0, 0, 12]
    assert not stays(0.0, [*even, 0.0, 0.0])
    assert stays(0.0, [0.0, *even[1:]])


@pytest.mark.parametrize(("alike", "kept"), [(4, True), (3, False)])
def test_a_third_of_the_neighbours_must_have_moved_alike(alike: int, kept: bool) -> None:
    """The median of the neighbours is where the match is."""
    assert stays(0.0, [0.0] * alike + [-8.0] * 4 + [8.0] * (8 - alike)) is kept


def test_neighbours_on_the_limit_have_not_moved_alike() -> None:
    assert not stays(0.0, [0.0] * 3 + [-6.0] * 4 + [6.0] * 5)


@pytest.mark.parametrize(("nearly_px", "kept"), [(0.9, True), (1.0, False), (1.1, False)])
def test_neighbours_are_alike_within_a_pixel_at_least(nearly_px: float, kept: bool) -> None:
    neighbours = [0.0] * 3 + [nearly_px] + [-3.0] * 4 + [3.0] * 4
    assert stays(0.0, neighbours, narrow=True) is kept


def test_few_matches_are_all_neighbours_of_each_other() -> None:
    assert stays(0.0, [0.0, 13.0, 0.0], far=0)
    assert not stays(0.0, [0.0, 13.0, 13.0], far=0)


def test_four_matches_can_vouch_for_each_other() -> None:
    xy, still = np.array([(0.0, 0), (100, 0), (0, 100), (100, 100)]), np.zeros((4, 2))
    assert consistent(xy, still, np.full(4, 0.1), 81).all()
    assert not consistent(xy[:3], still[:3], np.full(3, 0.1), 81).any()


def test_three_matches_vouch_for_nothing_in_either_test() -> None:
    assert not stays(0.0, [0.0, 0.0], far=0)
    assert not surrounded([[0.0], [0.0], [0.0]], far=0)


@pytest.mark.parametrize(("lost_a_round", "rounds"), [(1, [False] * 6 + [True] * 6), (0, [False, True])])
def test_rounds_go_on_while_matches_go_but_six_at_most(
    lost_a_round: int, rounds: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    called = []

    def one_round(
        xy: Float64, moved: Float64, sigma: Float64, kept: NDArray[np.bool_], narrow: bool
    ) -> object:
        called.append(narrow)
        kept = kept.copy()
        kept[np.flatnonzero(kept)[:lost_a_round]] = False
        return kept

    monkeypatch.setattr(outliers, "_one_round", one_round)
    kept = consistent(np.zeros((20, 2)), np.zeros((20, 2)), np.ones(20), 80)
    assert called == rounds
    assert kept.sum() == 20 - lost_a_round * len(rounds)


def cloud(offset_px: float) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    """Matches every 20 px, and 49 within a cell at the middle that have moved so much further, all alike."""
    row, col = np.mgrid[:400:20, :400:20]
    ground = np.c_[col.ravel(), row.ravel()].astype(float)
    row, col = np.mgrid[202:228:4, 202:228:4]
    xy = np.concatenate([ground, np.c_[col.ravel(), row.ravel()]])
    of_cloud = np.arange(len(xy)) >= len(ground)
    inside = of_cloud & (np.abs(xy - 214) <= 4).all(axis=1)
    return xy, np.where(of_cloud[:, None], (offset_px, 0.0), 0.0), inside


@pytest.mark.parametrize("offset_px", [1.0, 3.0, 5.0])
def test_a_moved_cloud_goes_although_it_agrees_with_itself(
    offset_px: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    xy, moved, inside = cloud(offset_px)
    sigma = np.full(len(xy), 0.05)
    kept = consistent(xy, moved, sigma, 80)
    assert not kept[moved[:, 0] > 0].any()
    assert kept[np.abs(xy - 214).max(axis=1) > 70].all()
    monkeypatch.setattr(outliers, "_with_their_surroundings", lambda xy, moved, sigma, kept, cell_px: kept)
    assert consistent(xy, moved, sigma, 80)[inside].all(), "its neighbours alone do not give it away"


@pytest.mark.parametrize(
    ("sigma_px", "limit_px"), [(0.01, 0.25), (0.2, 0.6), (1.0, 3.0), (1.9, 5.7), (2.1, 6.0), (9.0, 6.0)]
)
def test_a_cloud_may_differ_by_three_sigmas_between_a_quarter_and_six_pixels(
    sigma_px: float, limit_px: float
) -> None:
    for off_px, stays_there in ((-0.01, True), (0.01, False)):
        xy, moved, inside = cloud(limit_px + off_px)
        kept = consistent(xy, moved, np.full(len(xy), sigma_px), 80)
        assert kept[inside].all() if stays_there else not kept[inside].any()


def in_cells(cells: Sequence[Sequence[float]], far: int = 40) -> tuple[Float64, Float64]:
    """Return matches in cells of 10 px, the first at the origin, the others ever further from it."""
    steps = [(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1), (2, 0), (0, 2)]
    lean = 0.3 * np.arange(len(cells))  # no two at the same distance
    xy, moved = [], []
    for number, columns in enumerate(cells):
        for i, column in enumerate(columns):
            step = np.array(steps[number]) * 10.0
            xy.append(step + 3 + np.sign(step) * lean[number] + 0.01 * i)
            moved.append(column)
    elsewhere = [(1000.0 + 10 * i, 0.0) for i in range(far)]
    return np.array([*xy, *elsewhere]), moved_px([*moved, *[0.0] * far])


def surrounded(cells: Sequence[Sequence[float]], far: int = 40) -> bool:
    """Tell whether all of the first cell's matches stay."""
    xy, moved = in_cells(cells, far)
    n = len(xy)
    kept = outliers._with_their_surroundings(xy, moved, np.full(n, 0.01), np.ones(n, bool), 10.0)
    return bool(kept[: len(cells[0])].all())


def test_the_eight_nearest_cells_count_and_the_own_one_does_not() -> None:
    """Four against four."""
    even = [[4.0], [0.0], [4.0], [0.0], [0.0], [0.0], [4.0], [4.0]]
    assert not surrounded([[0.0], *even, [0.0], [0.0]])
    assert surrounded([[0.0], [0.0], *even[1:], [4.0], [4.0]])


def test_a_cell_speaks_by_its_median() -> None:
    assert surrounded([[0.0], *[[0.0, 0.0, 0.0, 9.0, 9.0]] * 8])
    assert not surrounded([[0.0], *[[0.0, 0.0, 9.0, 9.0, 9.0]] * 8])


@pytest.mark.parametrize(("off_px", "kept"), [(0.24, True), (0.25, False)])
def test_a_cell_on_the_limit_goes(off_px: float, kept: bool) -> None:
    assert surrounded([[off_px], *[[0.0]] * 8]) is kept


@pytest.mark.parametrize(("cells", "kept"), [(7, True), (8, False)])
def test_seven_cells_are_too_few_to_tell_a_cloud(cells: int, kept: bool) -> None:
    assert surrounded([[3.0], *[[0.0]] * (cells - 1)], far=0) is kept


def test_a_cell_is_half_a_window() -> None:
    """Eight cells of 40 px, and a window of 80 px: with any other size there are more or fewer of them."""
    columns = 40.0 * np.repeat(np.arange(8), 13) + np.tile(np.linspace(0, 39.9, 13), 8)
    xy = np.c_[columns, np.tile([0.0, 30.0], 52)]
    moved = np.where(xy[:, :1] >= 280, (2.0, 0.0), 0.0)
    kept = consistent(xy, moved, np.full(len(xy), 0.05), 80)
    assert not kept[xy[:, 0] >= 280].any()
    assert consistent(xy, moved, np.full(len(xy), 0.05), 100)[xy[:, 0] >= 310].all(), "seven cells of 50 px"
