from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pcwlad_geo.correction.points import hold_out

from .points import scattered


def gap(points: NDArray[np.float64], status: NDArray[np.str_]) -> float:
    """Return the smallest Chebyshev distance between a fit and a check point, px."""
    between = points[status == "fit"][:, None] - points[status == "check"][None]
    return float(np.abs(between).max(axis=2).min())


@given(st.integers(0, 400), st.integers(0, 200), st.integers(0, 50), st.floats(64, 4000))
@settings(max_examples=50)
def test_numbers_of_points(n: int, footprint: int, seed: int, side: float) -> None:
    status = hold_out(scattered(seed, n, side), footprint)
    check, fit = np.sum(status == "check"), np.sum(status == "fit")
    assert set(status) <= {"fit", "check", "unused"}
    assert fit >= min(0.75 * n, n - check)
    if n < 10:
        assert check == 0
    elif n < 100:
        assert check == n // 5
    else:
        assert check == 30


def test_1000_points_of_overlapping_windows() -> None:
    points = scattered(0, 1000)
    status = hold_out(points, 81)
    assert np.sum(status == "check") == 30
    assert np.sum(status == "fit") >= 750
    assert gap(points, status) > 20


def test_no_windows_overlap_where_there_is_room() -> None:
    points = scattered(1, 2000, 8000)
    status = hold_out(points, 81)
    assert np.sum(status == "check") == 100
    assert gap(points, status) >= 81
    # Nothing is given away: every unused point overlaps a check point.
    unused = (
        np.abs(points[status == "unused"][:, None] - points[status == "check"][None]).max(axis=2).min(axis=1)
    )
    assert unused.max() < 81


def test_check_points_lie_in_all_parts_of_the_image() -> None:
    points = scattered(2, 1000)
    part = (points[hold_out(points, 81) == "check"] // 128).astype(int)
    assert len(np.unique(part[:, 0] * 4 + part[:, 1])) == 16


def test_the_order_of_the_points_does_not_matter() -> None:
    points = scattered(3, 300)
    order = np.random.default_rng(3).permutation(300)
    np.testing.assert_array_equal(hold_out(points[order], 81), hold_out(points, 81)[order])


@pytest.mark.parametrize("wanted", [0, 50])
def test_the_number_wanted(wanted: int) -> None:
    assert np.sum(hold_out(scattered(4, 400, 4000), 81, wanted) == "check") == wanted


def test_points_in_one_place() -> None:
    status = hold_out(np.full((150, 2), 5.0), 81)
    assert np.sum(status == "check") == 30
    assert np.sum(status == "fit") == 120
