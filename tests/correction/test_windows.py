from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.estimation.shared_errors import Overlaps, random_signs

from .points import scattered

Array = NDArray[np.float64]


def exact(xy_px: Array, side_px: float) -> Array:
    """Return the (n, n) shared parts of windows: the plain twin."""
    lag = np.abs(xy_px[:, None] - xy_px[None]) / side_px
    return np.asarray(np.maximum(1 - lag, 0).prod(axis=2))


@pytest.mark.parametrize(("n", "side_px"), [(300, 81), (300, 17), (60, 400)])
def test_the_overlaps_are_the_shared_parts_of_the_windows(n: int, side_px: float) -> None:
    points = scattered(0, n) + 1e6
    overlaps, plain = Overlaps.of(points, side_px).times(np.eye(n)), exact(points, side_px)
    np.testing.assert_allclose(overlaps, plain, atol=0.15)
    assert np.sqrt(np.mean((overlaps - plain)[plain > 0] ** 2)) < 0.04
    assert overlaps.sum() == pytest.approx(plain.sum(), rel=0.03)
    np.testing.assert_allclose(np.diag(overlaps), 1)
    np.testing.assert_array_equal(overlaps[plain == 0] < 0.05, True)


def test_many_columns_at_once() -> None:
    points, overlaps = scattered(1, 50), Overlaps.of(scattered(1, 50), 81)
    vectors = np.random.default_rng(1).normal(size=(50, 2, 3))
    together = overlaps.times(vectors)
    assert together.shape == vectors.shape
    np.testing.assert_allclose(together[:, 1, 2], overlaps.times(vectors[:, 1, 2]), atol=1e-12)
    assert len(points) == overlaps.n


def test_windows_of_no_size_do_not_overlap() -> None:
    overlaps = Overlaps.of(scattered(2, 40), 0.0)
    np.testing.assert_array_equal(overlaps.times(np.eye(40)), np.eye(40))
    assert overlaps.patches() == 40


def test_windows_side_by_side_are_so_many_looks() -> None:
    # 6.3 windows a side; borders add half a window each.
    assert 40 < Overlaps.of(scattered(3, 2000), 81).patches() < 48


def test_random_signs_go_with_the_points() -> None:
    points = scattered(4, 100)
    order = np.random.default_rng(4).permutation(100)
    np.testing.assert_array_equal(random_signs(points[order], 5), random_signs(points, 5)[order])
    np.testing.assert_array_equal(random_signs(points[1:], 5), random_signs(points, 5)[1:])
    assert abs(random_signs(points, 200).mean()) < 0.02
    assert set(np.unique(random_signs(points, 5))) == {-1.0, 1.0}
