from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcwlad_geo.correction.points import thin

from .points import scattered


@given(st.integers(0, 200), st.integers(0, 250), st.integers(0, 100))
@settings(max_examples=50)
def test_as_many_as_asked_for_and_there_are(n: int, count: int, seed: int) -> None:
    assert thin(scattered(seed, n), np.ones(n), count).sum() == min(n, count)


def test_none_keeps_all() -> None:
    assert thin(scattered(0, 30), np.ones(30), None).all()


def test_the_points_kept_are_spread_though_most_lie_in_one_corner() -> None:
    points = np.concatenate([scattered(1, 2000, 100), scattered(2, 400, 512)])
    keep = thin(points, np.ones(len(points)), 64)
    quarter = (points[keep] // 128).astype(int)
    assert len(np.unique(quarter[:, 0] * 4 + quarter[:, 1])) == 16
    assert (points[keep] < 100).all(axis=1).sum() < 12


def test_the_most_precise_of_every_cell() -> None:
    # A regular 8 × 8 arrangement of five points each: 64 cells.
    centre = np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=-1).reshape(-1, 1, 2) * 64.0 + 32
    around = np.array([[0, 0], [-30, -30], [30, -30], [-30, 30], [30, 30]])
    points = (centre + around).reshape(-1, 2)
    sigma = np.random.default_rng(0).permutation(len(points)).astype(float)
    keep = thin(points, sigma, 64).reshape(64, 5)
    np.testing.assert_array_equal(keep.argmax(axis=1), sigma.reshape(64, 5).argmin(axis=1))
    assert (keep.sum(axis=1) == 1).all()


def test_points_without_sigma_come_last() -> None:
    points, sigma = scattered(3, 100), np.full(100, 0.1)
    sigma[:50] = np.nan
    spots = np.concatenate([points[:50], points[:50] + 0.01])
    assert not thin(spots, sigma, 5)[:50].any()


def test_the_order_of_the_points_does_not_matter() -> None:
    points, sigma = scattered(4, 500), np.random.default_rng(4).uniform(0.1, 1, 500)
    order = np.random.default_rng(5).permutation(500)
    np.testing.assert_array_equal(thin(points[order], sigma[order], 77), thin(points, sigma, 77)[order])


@pytest.mark.parametrize("count", [1, 7])
def test_points_in_one_place(count: int) -> None:
    assert thin(np.full((20, 2), 5.0), np.ones(20), count).sum() == count
