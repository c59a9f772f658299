"""The measured field: detail that windows have averaged, holes, its choice, its sigma."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.selection import choose
from pcwlad_geo.correction.splines import SplineGrid
from pcwlad_geo.correction.thin_plate import WINDOWED_SPLINE, grid_of, windowed_design

from .points import affine, inside, isotropic, predicted_sigma, scattered, window_noise

Array = NDArray[np.float64]
SIDE = 900
WINDOW = 81
NODES = np.linspace(-0.5, 0.5, 9) * WINDOW * 8 / 9


def ripples(xy: Array, wavelength_px: float = 400.0, size_px: float = 1.0) -> Array:
    x, y = xy.T
    k, c, s = 2 * np.pi / wavelength_px, np.cos(1.1), np.sin(1.1)
    return size_px * np.stack([np.sin(k * (c * x + s * y) + 0.9), np.sin(k * (s * x - c * y) + 1.7)], axis=1)


def seen_by_windows(xy: Array, wavelength_px: float = 400.0, size_px: float = 1.0) -> Array:
    """Return the means of the ripples over windows, as the matching finds them."""
    places = [(a, b) for a in NODES for b in NODES]
    return sum(ripples(xy + place, wavelength_px, size_px) for place in places) / len(places)


def observed_in(seed: int, xy: Array, moved: Array, sigma_px: float = 0.05) -> Array:
    return xy + moved + sigma_px * window_noise(seed, xy, SIDE, WINDOW)


def rms(errors: Array) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def error_of(name: str, seed: int) -> float:
    points, places = scattered(seed, 850, SIDE), inside(SIDE, 40)
    observed = observed_in(seed, points, seen_by_windows(points))
    fit = MODELS[name].fit(points, observed, isotropic(850, 0.05), footprint_px=WINDOW)
    return rms(fit.correction.forward(places) - places - ripples(places))


def test_detail_that_the_windows_have_averaged_is_restored() -> None:
    places = inside(SIDE, 40)
    lost = rms(seen_by_windows(places) - ripples(places))
    assert lost > 0.05
    assert error_of("field", 0) < 0.1
    assert error_of("field", 0) < 0.7 * error_of("tps", 0)


def test_the_means_of_a_plane_are_its_values() -> None:
    grid = SplineGrid((-3.0, 7.0), 40.0, (12, 9))
    at = np.random.default_rng(0).uniform((60, 60), (400, 300), (20, 2))
    coefficients = grid.nodes_px() @ np.array([0.3, -0.2]) + 5
    np.testing.assert_allclose(windowed_design(grid, at, WINDOW) @ coefficients, at @ [0.3, -0.2] + 5)
    np.testing.assert_allclose(windowed_design(grid, at, 0.0).toarray(), grid.design(at).toarray())


def test_its_cells_are_finer_where_the_points_are_dense() -> None:
    points = scattered(0, 2000, SIDE)
    assert grid_of(points, WINDOW, WINDOWED_SPLINE).spacing_px < 0.7 * grid_of(points, WINDOW).spacing_px
    assert max(grid_of(scattered(0, 50_000, 20_000), WINDOW, WINDOWED_SPLINE).cells) <= 80


def test_a_wide_hole_is_filled_by_the_affine() -> None:
    """Around it the ground moves by 1 px more than the affine; in its middle nothing says so."""
    truth = affine(3.0, 3000)
    points = scattered(1, 3000, 3000)
    from_middle = np.linalg.norm(points - 1500, axis=1)
    bump = np.exp(-(((from_middle - 900) / 150) ** 2))[:, None] * [1.0, 0.0]
    points, bump = points[from_middle > 800], bump[from_middle > 800]
    observed = truth.forward(points) + bump + 0.03 * np.random.default_rng(3).normal(size=points.shape)
    fit, plain = (
        MODELS[name].fit(points, observed, isotropic(len(points), 0.03), footprint_px=WINDOW)
        for name in ("field", "affine")
    )
    middle = 1500 + inside(100, 5) - 50
    beyond = fit.correction.forward(middle) - plain.correction.forward(middle)
    at_bump = points[bump[:, 0] > 0.95]
    at_edge = fit.correction.forward(at_bump) - plain.correction.forward(at_bump)
    assert np.abs(beyond).max() < 0.5 * np.median(at_edge[:, 0])
    assert rms(fit.correction.forward(at_bump) - truth.forward(at_bump) - [1.0, 0.0]) < 0.1


def test_auto_takes_it_where_left_out_points_prove_it() -> None:
    points = scattered(2, 850, SIDE)
    observed = observed_in(2, points, seen_by_windows(points))
    selection = choose(points, observed, isotropic(850, 0.05), WINDOW)
    assert selection.name == "field"
    assert [each.name for each in selection.candidates if each.chosen] == ["field"]


def test_auto_does_not_take_it_for_what_a_simpler_model_follows() -> None:
    points = scattered(3, 500, SIDE)
    shifted = observed_in(3, points, np.full_like(points, 1.5))
    selection = choose(points, shifted, isotropic(500, 0.05), WINDOW)
    assert selection.name == "shift"
    assert "not tried" in selection.candidates[-1].note
    long = observed_in(3, points, ripples(points, 1500.0, 2.0))
    assert choose(points, long, isotropic(500, 0.05), WINDOW).name != "field"


@pytest.mark.parametrize("seeds", [2, pytest.param(8, marks=pytest.mark.slow)])
def test_its_sigma_holds(seeds: int) -> None:
    ratios, places = [], inside(SIDE, 9)
    for seed in range(seeds):
        points = scattered(seed, 600, SIDE)
        observed = observed_in(seed, points, seen_by_windows(points, 500.0), 0.1)
        fit = MODELS["field"].fit(points, observed, isotropic(600, 0.1), footprint_px=WINDOW)
        missed = fit.correction.forward(places) - places - ripples(places, 500.0)
        ratios.append(missed / predicted_sigma(fit, places))
    size = np.abs(np.concatenate(ratios))
    assert 0.55 < (size < 1).mean() < 0.85
    assert (size < 1.96).mean() > 0.88
