from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.matching import Candidates
from pcwlad_geo.matching.keypoints import OUTCOMES
from pcwlad_geo.registration import Registration
from pcwlad_geo.registration.match_record import PLACE_STATES, MatchRecord
from pcwlad_geo.report.maps import GAP_STYLES, coverage_figure, missing_kinds
from pcwlad_geo.report.statistics import REASONS, Coverage, coverage_of
from pcwlad_geo.report.summary import summarise

Make = Callable[..., Registration]
SHAPE = (400, 600)
"""Of the reference: squares of 50 px, 8 x 12."""


def record_of(
    ground: np.ndarray | None = None,
    windows: list[tuple[float, ...]] | None = None,
    without_structure: list[tuple[float, ...]] | None = None,
    lost: list[tuple[float, float, str]] | None = None,
    unread: list[bool] | None = None,
) -> MatchRecord:
    windows = [(0, 0, 600, 400)] if windows is None else windows
    lost = lost or []
    return MatchRecord(
        np.zeros((80, 120), np.uint8) if ground is None else ground,
        np.array(windows, float).reshape(-1, 4),
        np.array(unread or [False] * len(windows), bool),
        np.array(without_structure or [], float).reshape(-1, 4),
        Candidates(
            np.array([each[:2] for each in lost], float).reshape(-1, 2),
            np.array([OUTCOMES.index(each[2]) for each in lost], np.uint8),
        ),
    )


def test_every_point_is_counted_in_its_square(registration: Make) -> None:
    table = registration(n=300).tie_points
    coverage = coverage_of(table, SHAPE, None)
    assert coverage.points.shape == (8, 12)
    assert coverage.points.sum() == np.count_nonzero(table.status != "rejected") == 270
    here = (table.reference_px // 50 == [3, 5]).all(axis=1) & (table.status != "rejected")
    assert coverage.points[5, 3] == here.sum()
    assert (coverage.reason == "unknown").sum() == (coverage.points == 0).sum()


def test_squares_without_data_are_not_missed(registration: Make) -> None:
    table = registration(n=300).tie_points
    table = table[table.reference_px[:, 0] > 300]
    ground = np.zeros((80, 120), np.uint8)
    ground[:, :50] = PLACE_STATES.index("reference_without_data")
    coverage = coverage_of(table, SHAPE, record_of(ground))
    assert (coverage.reason[:, :5] == "reference_without_data").all()
    assert (coverage.reason[:, 5] == "no_texture").all()
    empty = int((coverage.points == 0).sum()) - 40
    assert coverage.empty_share == empty / 56


def test_the_reason_is_what_lost_most_of_the_candidates(registration: Make) -> None:
    table = registration("rejected", n=0).tie_points
    lost = [(25.0, 25.0, "at_search_border")] * 2 + [(26.0, 20.0, "not_converged")] * 3
    lost += [(75.0, 25.0, "not_comparable"), (125.0, 25.0, "directions_disagree")]
    coverage = coverage_of(table, SHAPE, record_of(lost=lost))
    assert coverage.reason[0, :4].tolist() == [
        "not_converged",
        "not_comparable",
        "directions_disagree",
        "no_texture",
    ]


def test_rejected_points_are_a_reason(registration: Make) -> None:
    table = registration().tie_points
    table = replace(table, status=np.full(len(table), "rejected"))
    coverage = coverage_of(table, SHAPE, record_of())
    col, row = (table.reference_px[0] // 50).astype(int)
    assert coverage.reason[row, col] == "rejected"
    assert set(coverage.without) == {"rejected", "no_texture"}


def test_ground_decides_first(registration: Make) -> None:
    ground = np.zeros((80, 120), np.uint8)
    ground[:10, :10] = PLACE_STATES.index("edge")
    ground[:10, 10:20] = PLACE_STATES.index("target_without_data")
    ground[:9, 20:30] = PLACE_STATES.index("edge")  # a tenth of the square can be matched: that is no edge
    ground[:10, 30:40] = PLACE_STATES.index("no_texture")  # whatever became of candidates in noise
    ground[:9, 30:40] = PLACE_STATES.index("edge")
    lost = [(75.0, 25.0, "not_converged")] * 9 + [(175.0, 25.0, "not_converged")] * 9
    table = registration("rejected", n=0).tie_points
    coverage = coverage_of(table, SHAPE, record_of(ground, lost=lost))
    assert coverage.reason[0, :4].tolist() == ["edge", "target_without_data", "no_texture", "no_texture"]


def test_windows_that_were_not_asked_for_are_told_from_flat_ground(registration: Make) -> None:
    table = registration("rejected", n=0).tie_points
    windows = [(110.0, 110.0, 140.0, 140.0)] + [
        (200.0, 200.0, 300.0, 250.0)
    ] * 3  # joined: squares stay small
    record = record_of(
        windows=windows, without_structure=[(0.0, 0.0, 100.0, 100.0)], unread=[False, True, True, True]
    )
    reason = coverage_of(table, SHAPE, record).reason
    assert reason[2, 2] == "no_texture"  # asked, no candidate
    assert (reason[:2, :2] == "no_texture").all()  # never asked, as there is nothing
    assert (reason[4, 4:6] == "unread").all()
    told = np.zeros((8, 12), bool)
    told[2, 2] = told[4, 4] = told[4, 5] = True
    told[:2, :2] = True
    assert (reason[~told] == "not_asked").all()


def test_squares_are_as_large_as_small_windows_lie_apart(registration: Make) -> None:
    """Ten windows of 20 px in 500 x 240 px: each has 110 px to itself."""
    table = registration("rejected", n=0).tie_points
    corners = [(120.0 * col + 50, 220.0 * row + 80) for row in range(2) for col in range(5)]
    coverage = coverage_of(table, SHAPE, record_of(windows=[(x, y, x + 20, y + 20) for x, y in corners]))
    assert coverage.points.shape == (4, 5)
    assert set(coverage.without) == {"no_texture", "not_asked"}


def test_where_none_was_asked_for_the_neighbours_will_do(registration: Make) -> None:
    points = np.zeros((3, 4), int)
    points[1, 1] = 7
    reason = np.full((3, 4), "not_asked", dtype="<U24")
    reason[1, 1], reason[0, 0] = "", "rejected"
    coverage = Coverage((300, 400), points, reason)
    assert coverage.empty_share == (1 + 3) / 12  # what was rejected, and the far column
    assert coverage.without == {"not_asked": 10, "rejected": 1}


def test_a_box_beyond_the_image_touches_what_it_covers(registration: Make) -> None:
    table = registration("rejected", n=0).tie_points
    windows = [(-500.0, -500.0, 55.0, 55.0), (np.nan, 0.0, 10.0, 10.0), (590.0, 390.0, 900.0, 900.0)] + [
        (-500.0, -500.0, 55.0, 55.0)
    ] * 3
    reason = coverage_of(table, SHAPE, record_of(windows=windows)).reason
    assert reason[0, 0] == "no_texture"
    assert np.count_nonzero(reason == "not_asked") == 8 * 12 - 1  # a tenth of the last one is not half


def test_a_strip_and_no_points(registration: Make) -> None:
    made = registration("rejected", n=0)
    coverage = coverage_of(made.tie_points, (10, 5000), None)
    assert coverage.points.shape == (1, 12)
    assert coverage.empty_share == 1.0


def test_every_reason_has_a_kind_once() -> None:
    named = [reason for kind in GAP_STYLES for reason in kind.reasons]
    assert sorted(named) == sorted(REASONS)


@pytest.mark.parametrize("n", [0, 300])
def test_summary_holds_it_and_the_figure_reads_the_summary(registration: Make, n: int) -> None:
    made = registration("registered" if n else "rejected", n=n)
    lost = [(25.0 + 50 * k, 25.0, name) for k, name in enumerate(OUTCOMES[1:])]
    coverage = summarise(replace(made, record=record_of(lost=lost)), []).coverage
    assert coverage.squares == (8, 12)
    assert sum(map(sum, coverage.points)) == np.count_nonzero(made.tie_points.status != "rejected")
    empty = [reason for row in coverage.reason for reason in row if reason]
    assert coverage.without_points == {name: empty.count(name) for name in REASONS if name in empty}
    assert sum(count for _, count in missing_kinds(coverage)) == len(empty)
    assert coverage_figure(coverage, SHAPE).count("</text>") > 12
