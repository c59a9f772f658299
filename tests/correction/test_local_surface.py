from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.correction.local_surface import local_surface

from .points import scattered


def bent(xy: np.ndarray) -> np.ndarray:
    x, y = (xy / 256 - 1).T
    return np.stack([1 + 2 * x - y + 3 * x * y, x * x - 2 * y * y], axis=1)


def test_a_quadratic_field_is_seen_through_outliers_also_at_the_corners() -> None:
    points = scattered(0, 400)
    values = bent(points)
    values[::5] += np.random.default_rng(1).uniform(-20, 20, (80, 2))
    error = local_surface(points, values) - bent(points)
    assert np.median(np.hypot(*error.T)) < 1e-3
    assert np.percentile(np.hypot(*error.T), 98) < 0.2


@pytest.mark.parametrize("n", [3, 12, 39])
def test_few_points_give_a_plane(n: int) -> None:
    points = scattered(2, n)
    plane = points @ np.array([[0.01, 0.0], [-0.02, 0.005]]) + 3
    np.testing.assert_allclose(local_surface(points, plane), plane, atol=1e-3)


def test_points_in_one_place_or_on_a_line_are_no_error() -> None:
    line = np.column_stack([np.arange(60.0), np.full(60, 5.0)])
    np.testing.assert_allclose(local_surface(line, bent(line)), bent(line), atol=1e-3)
    same = np.full((50, 2), 7.0)
    np.testing.assert_allclose(local_surface(same, same), same, atol=1e-6)
