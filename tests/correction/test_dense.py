from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcwlad_geo.correction.dense import Lattice, dense_mapping
from pcwlad_geo.correction.models import Correction

from .points import affine, polynomial, projective, scattered, spline


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize(
    "correction",
    [affine(3.0), projective(), polynomial(2), polynomial(3), spline(), spline(cells=30, size_px=0.1)],
)
def test_the_grid_is_the_correction_to_a_hundredth_of_a_pixel(correction: Correction, inverse: bool) -> None:
    mapping = correction.inverse if inverse else correction.forward
    grid = dense_mapping(mapping, (-100.0, 0.0), (600.0, 550.0))
    points = scattered(0, 20000) * [700 / 512, 550 / 512] - [100, 0]
    assert np.abs(grid(points) - mapping(points)).max() <= 0.01
    assert 0 <= grid.error_px <= 0.01


def test_a_smooth_correction_needs_a_coarse_grid() -> None:
    correction = spline(side_px=10000.0)
    grid = dense_mapping(correction.forward, (0.0, 0.0), (10000.0, 10000.0))
    assert grid.moved_px.size < 200_000
    fine = dense_mapping(correction.forward, (0.0, 0.0), (10000.0, 10000.0), tolerance_px=1e-3)
    assert fine.moved_px.size > 3 * grid.moved_px.size


def test_an_affine_needs_no_refinement() -> None:
    grid = dense_mapping(affine(3.0).forward, (0.0, 0.0), (512.0, 256.0))
    assert grid.lattice.shape == (33, 65)
    assert grid.error_px < 1e-9


def test_where_the_mapping_has_no_value_the_grid_has_none_and_the_rest_is_as_good() -> None:
    smooth = spline()

    def half(at_px: np.ndarray) -> np.ndarray:
        return np.where(at_px[:, :1] < 200, np.nan, smooth.forward(at_px))

    grid = dense_mapping(half, (0.0, 0.0), (512.0, 512.0))
    assert 0 < grid.error_px <= 0.01
    points = scattered(0, 5000)
    moved = grid(points)
    assert np.isnan(moved[points[:, 0] < 200]).all()
    beside = points[:, 0] > 200 + grid.lattice.step_px[0]
    assert np.abs(moved - smooth.forward(points))[beside].max() <= 0.01


@given(
    st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(1, 3000), st.floats(1, 3000), st.floats(0.5, 500)
)
def test_a_lattice_interpolates_bilinear_functions_exactly(
    col: float, row: float, width: float, height: float, step: float
) -> None:
    low, high = np.array([col, row]), np.array([col + width, row + height])
    lattice = Lattice.over(low, high, step, most=60)

    def function(at_px: np.ndarray) -> np.ndarray:
        x, y = ((at_px - low) / 1000).T
        return np.stack([2 + 3 * x - y + 4 * x * y, x - 5], axis=1)

    values = function(lattice.nodes_px()).reshape(*lattice.shape, 2)
    points = low + np.random.default_rng(0).uniform(0, 1, (50, 2)) * (high - low)
    np.testing.assert_allclose(lattice.interpolated(values, points), function(points), atol=1e-6)
    assert max(lattice.shape) <= 60
    np.testing.assert_allclose(lattice.nodes_px()[[0, -1]], [low, high], rtol=1e-12, atol=1e-9)
