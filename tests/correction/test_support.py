from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.correction.fitted import Support

from .points import inside, scattered


def test_between_the_points_nothing_is_extrapolated() -> None:
    assert not Support.of(scattered(0, 400), 41).extrapolated(inside()).any()


def test_far_from_the_points_all_is() -> None:
    support = Support.of(scattered(1, 400, 100), 41)
    assert support.extrapolated(np.array([[400.0, 400.0], [160.0, 50.0], [50.0, -60.0]])).all()
    assert not support.extrapolated(np.array([[112.0, 50.0], [50.0, 50.0]])).any()


def test_a_wide_hole_is_beyond_the_points() -> None:
    points = scattered(2, 1000, 1000)
    points = points[np.hypot(*(points - 500).T) > 250]
    support = Support.of(points, 81)
    assert support.extrapolated(np.array([[500.0, 500.0]]))[0]
    assert not support.extrapolated(np.array([[500.0, 700.0]]))[0]


def test_a_window_tells_of_the_ground_in_it_only() -> None:
    points = scattered(2, 1000, 1000)
    points = points[np.hypot(*(points - 500).T) > 250]
    support = Support.of(points, 257)
    assert support.extrapolated(np.array([[500.0, 600.0]]))[0]
    assert not support.extrapolated(np.array([[500.0, 640.0]]))[0]


def test_sparse_points_reach_as_far_as_they_are_apart() -> None:
    corners = np.array([[0.0, 0.0], [1000.0, 0.0], [0.0, 1000.0], [1000.0, 1000.0]])
    assert not Support.of(corners, 81).extrapolated(np.array([[500.0, 500.0]]))[0]


@pytest.mark.parametrize("n", [1, 2, 50])
def test_points_on_a_line(n: int) -> None:
    points = np.column_stack([np.linspace(0, 1000, n), np.zeros(n)])
    support = Support.of(points, 81)
    assert not support.extrapolated(points).any()
    assert support.extrapolated(np.array([[500.0, 3000.0]]))[0]
