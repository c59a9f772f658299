from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.correction.splines import SplineCorrection, SplineGrid
from pcwlad_geo.correction.thin_plate import (
    THIN_PLATE,
    Successive,
    ThinPlateSystem,
    bending,
    grid_of,
    mean_precision,
)
from pcwlad_geo.estimation.shared_errors import probes_of

from .points import noise, scattered

Array = NDArray[np.float64]


@pytest.mark.parametrize("cells", [(5, 5), (7, 3), (1, 4)])
def test_the_bending_energy_is_the_integral_of_squared_second_derivatives(cells: tuple[int, int]) -> None:
    grid = SplineGrid((0.0, 0.0), 1.0, cells)
    values = np.random.default_rng(0).normal(size=grid.shape)
    made = SplineCorrection("tps", grid, np.stack([values, values], axis=2))
    fine, h = 40, 1 / 40
    line_x, line_y = ((np.arange(count * fine) + 0.5) * h for count in cells)
    x, y = np.meshgrid(line_x, line_y)

    def at(dx: float, dy: float) -> Array:
        places = np.stack([(x + dx).ravel(), (y + dy).ravel()], axis=1)
        return (made.forward(places) - places)[:, 0].reshape(x.shape)

    s = h / 4  # all differences stay inside a cell, where the second derivatives are smooth
    xx = (at(s, 0) - 2 * at(0, 0) + at(-s, 0)) / s**2
    yy = (at(0, s) - 2 * at(0, 0) + at(0, -s)) / s**2
    xy = (at(s, s) - at(s, -s) - at(-s, s) + at(-s, -s)) / (4 * s**2)
    integral = (xx**2 + 2 * xy**2 + yy**2).sum() * h**2
    assert values.ravel() @ (bending(grid) @ values.ravel()) == pytest.approx(integral, rel=2e-3)


def test_a_plane_does_not_bend() -> None:
    grid = SplineGrid((-3.0, 7.0), 12.0, (6, 4))
    plane = grid.nodes_px() @ np.array([0.3, -0.2]) + 5
    assert plane @ (bending(grid) @ plane) == pytest.approx(0, abs=1e-10)


@pytest.mark.parametrize(("n", "side", "window"), [(30, 512.0, 81), (5000, 5000.0, 81), (100000, 40000.0, 0)])
def test_the_grid_covers_the_points_and_stays_small(n: int, side: float, window: int) -> None:
    points = scattered(0, n, side) * [1.0, 0.6] + [1e5, -300.0]
    grid = grid_of(points, window)
    assert max(grid.cells) <= THIN_PLATE.max_cells
    low = np.array(grid.origin_px)
    high = low + grid.spacing_px * np.array(grid.cells)
    assert (low <= points.min(axis=0) + 1e-6).all()
    assert (high >= points.max(axis=0) - 1e-6).all()
    assert grid.cells[0] * grid.cells[1] < 1.5 * n


def test_points_on_a_line_have_a_grid_too() -> None:
    grid = grid_of(np.column_stack([np.linspace(0, 500, 40), np.full(40, 3.0)]), 81)
    assert grid.cells[1] == 1


def dense_fit(system: ThinPlateSystem, precision: Array, smoothing: float, values: Array) -> Array:
    """Return the (2 k,) coefficients by dense algebra: the plain twin of the sparse solution."""
    design = system.design.toarray()
    both = np.einsum("ik,ab->iakb", design, np.eye(2)).transpose(0, 1, 3, 2).reshape(len(design), 2, -1)
    normal = np.einsum("iap,iab,ibq->pq", both, precision, both)
    energy = np.kron(np.eye(2), system.energy.toarray())
    right = np.einsum("iap,iab,ib->p", both, precision, values)
    return np.linalg.solve(normal + smoothing * energy, right)


def test_the_sparse_solution_is_the_dense_one() -> None:
    points, values = scattered(1, 80), noise(1, 80, 1.0)
    system = ThinPlateSystem.of(points, 81)
    roots = np.random.default_rng(1).normal(size=(80, 2, 2))
    precision = roots @ roots.transpose(0, 2, 1)
    right = np.einsum("iab,ib->ia", precision, values)
    right = (system.design.T @ right).T.reshape(-1, 1)
    found = system.factor(system.normal(precision), 3.0).solve(right)[:, 0]
    np.testing.assert_allclose(found, dense_fit(system, precision, 3.0, values), rtol=1e-6, atol=1e-8)


def test_one_axis_is_half_of_two_equal_ones() -> None:
    points, values = scattered(2, 80), noise(2, 80, 1.0)
    system, weights = ThinPlateSystem.of(points, 81), np.random.default_rng(2).uniform(0.5, 2, 80)
    single = system.factor(system.normal(weights), 3.0).solve(system.design.T @ (weights[:, None] * values))
    both = dense_fit(system, weights[:, None, None] * np.eye(2), 3.0, values)
    np.testing.assert_allclose(single.T.ravel(), both, rtol=1e-6, atol=1e-8)


def test_stiffness_says_how_many_parameters_there_are() -> None:
    system = ThinPlateSystem.of(scattered(3, 400), 81)
    probes = probes_of(scattered(3, 400))
    stiff, soft = system.freedom(1e9, probes), system.freedom(1e-3, probes)
    assert stiff == pytest.approx(3, abs=0.01)  # a plane
    assert soft > 50
    design, energy = system.design.toarray(), system.energy.toarray()
    smoothing = system.smoothing(10.0, np.ones(400))
    normal = design.T @ design
    exact = np.trace(np.linalg.solve(normal + smoothing * energy, normal))
    assert system.freedom(10.0, probes) == pytest.approx(exact, rel=0.05)


def test_precision_of_a_point() -> None:
    whitener = np.array([[[2.0, 0.0], [0.0, 4.0]]])  # sigma 1/2 and 1/4
    np.testing.assert_allclose(mean_precision(whitener, np.array([0.5])), 0.5 * (4 + 16) / 2)


@pytest.mark.parametrize("apart", [0.02, 3.0])
def test_successive_fits_are_those_of_a_factor_each(apart: float) -> None:
    """Precisions that hardly change keep the factor, those that change much do not: both must be right."""
    rng = np.random.default_rng(5)
    xy = scattered(5, 300)
    values = rng.normal(0, 1, (300, 2))
    system = ThinPlateSystem.of(xy, 40.0)
    successive = Successive(system, values)
    for _ in range(4):
        precision = np.exp(rng.normal(0, apart, 300))[:, None, None] * np.array([[2.0, 0.5], [0.5, 1.0]])
        weighted = np.einsum("iab,ib->ia", precision, values)
        right = (system.design.T @ weighted).T.reshape(-1, 1)
        wanted = system.factor(system.normal(precision), 0.3).solve(right).reshape(2, -1).T
        found = successive.solve(precision, 0.3)
        np.testing.assert_allclose(system.design @ found, system.design @ wanted, atol=2e-6)
