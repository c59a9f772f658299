"""Polynomials and splines inside the box of their points and beyond it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from pcwlad_geo.correction.polynomials import PolynomialCorrection
from pcwlad_geo.correction.splines import SplineCorrection, cubic_b_splines

from .points import inside, polynomial, scattered, spline

Array = NDArray[np.float64]
MODELS = [polynomial(2), polynomial(3), spline()]


def displacement(correction: PolynomialCorrection | SplineCorrection, at_px: Array) -> Array:
    return correction.forward(at_px) - at_px


@pytest.mark.parametrize("correction", MODELS)
def test_it_is_continued_by_its_tangent(correction: PolynomialCorrection | SplineCorrection) -> None:
    row = np.linspace(20, 490, 30)

    def column(col: float) -> Array:
        return np.column_stack([np.full(30, col), row])

    edge, step = displacement(correction, column(512.0)), 1e-3
    slope = (edge - displacement(correction, column(512.0 - step))) / step
    for beyond in (1.0, 50.0, 400.0):
        far = displacement(correction, column(512.0 + beyond))
        np.testing.assert_allclose(far, edge + slope * beyond, atol=1e-4 * beyond)


@pytest.mark.parametrize("correction", MODELS)
def test_it_has_no_steps_and_no_kinks(correction: PolynomialCorrection | SplineCorrection) -> None:
    points, step = scattered(0, 4000, 900) - 200, 1e-4
    for axis in np.eye(2):
        left, middle, right = (displacement(correction, points + sign * step * axis) for sign in (-1, 0, 1))
        np.testing.assert_allclose((right - middle) / step, (middle - left) / step, atol=1e-4)


def test_a_cubic_does_not_run_away() -> None:
    correction = polynomial(3)
    u = 6.0  # two and a half images to the right of the box, at half its height
    moved = displacement(correction, np.array([[256.0 * (u + 1), 256.0]]))[0]
    along = np.array([[1, u, u**2, u**3], [1, u, 1 + 2 * (u - 1), 1 + 3 * (u - 1)]])
    terms = [correction.basis.exponents.index((power, 0)) for power in range(4)]
    cubic, tangent = along @ correction.coefficients_px[terms]
    np.testing.assert_allclose(moved, tangent, atol=1e-9)
    assert np.abs(cubic).max() > 8 * np.abs(tangent).max()


def test_the_spline_is_that_of_scipy() -> None:
    correction, points = spline(), inside()
    knots = correction.grid.spacing_px * (np.arange(5 + 7) - 3.0)
    plain = np.zeros((len(points), 2))
    for axis in range(2):
        rows = BSpline(knots, correction.coefficients_px[:, :, axis], 3)(points[:, 1])
        plain[:, axis] = [BSpline(knots, line, 3)(col) for line, col in zip(rows, points[:, 0], strict=True)]
    np.testing.assert_allclose(displacement(correction, points), plain, atol=1e-12)


def test_the_design_of_a_spline_times_its_coefficients_is_the_spline() -> None:
    correction, points = spline(), scattered(3, 300, 800) - 100
    moved = correction.grid.design(points) @ correction.coefficients_px.reshape(-1, 2)
    np.testing.assert_allclose(moved, displacement(correction, points), atol=1e-12)


def test_a_plane_at_the_nodes_is_a_plane_everywhere() -> None:
    grid, points = spline().grid, scattered(4, 300, 1500) - 500
    plane = np.array([[0.3, -0.1], [0.2, 0.4]])
    made = SplineCorrection("tps", grid, (grid.nodes_px() @ plane).reshape(*grid.shape, 2))
    np.testing.assert_allclose(displacement(made, points), points @ plane, atol=1e-9)


def test_b_splines_and_their_derivatives() -> None:
    t, step = np.linspace(0.01, 0.99, 50), 1e-5
    values, slopes, bends = cubic_b_splines(t)
    np.testing.assert_allclose(values.sum(axis=1), 1)
    before, after = (cubic_b_splines(t + sign * step) for sign in (-1, 1))
    np.testing.assert_allclose((after[0] - before[0]) / (2 * step), slopes, atol=1e-8)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * step), bends, atol=1e-8)


def test_many_positions_are_mapped_in_parts() -> None:
    correction, points = spline(), scattered(5, 70000)
    np.testing.assert_array_equal(correction.forward(points)[-10:], correction.forward(points[-10:]))


def test_where_a_correction_folds_there_is_no_inverse() -> None:
    folding = spline(size_px=900.0)
    found = folding.inverse(inside())
    there = np.isfinite(found).all(axis=1)
    assert not there.all()
    np.testing.assert_allclose(folding.forward(found[there]), inside()[there], atol=1e-6)
