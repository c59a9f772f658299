import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching.field import (
    Prediction,
    Surface,
    choose_surface,
    global_affine,
    independent_residual,
    predict,
)

SIDE = 600.0
WINDOW = 81


def scattered(n: int, seed: int = 0) -> NDArray:
    return np.random.default_rng(seed).uniform(0, SIDE, (n, 2))


def noise(n: int, sigma: float, seed: int = 1) -> NDArray:
    return np.random.default_rng(seed).normal(0, sigma, (n, 2))


def test_a_plane_is_predicted_exactly_also_beyond_its_points() -> None:
    xy, at = scattered(200), np.array([[300.0, 300.0], [20.0, 580.0], [-10.0, 610.0]])
    linear = np.array([[0.01, -0.004], [0.003, -0.008]])
    found = predict(xy, xy @ linear.T + (3.0, -2.0), at, Surface(48, 1))
    np.testing.assert_allclose(found.displacement_px, at @ linear.T + (3.0, -2.0), atol=0.01)
    assert (found.scatter_px < 0.02).all()


def test_gross_errors_do_not_move_a_prediction() -> None:
    xy = scattered(200)
    displacement = np.tile([1.0, 2.0], (200, 1)) + noise(200, 0.05)
    displacement[::5] += (6.0, -4.0)
    found = predict(xy, displacement, xy[:50], Surface(48, 1))
    assert np.abs(found.displacement_px - (1.0, 2.0)).max() < 0.1


def test_the_scatter_is_that_of_the_neighbours() -> None:
    xy = scattered(2000)
    found = predict(xy, noise(2000, 0.2), xy[:100], Surface(192, 1))
    assert np.median(found.scatter_px) == pytest.approx(0.2, rel=0.15)


@pytest.mark.parametrize("count", [1, 3, 5])
def test_too_few_neighbours_predict_nothing(count: int) -> None:
    xy = scattered(count)
    found = predict(xy, np.zeros((count, 2)), xy, Surface(48, 1))
    assert np.isnan(found.displacement_px).all()
    assert np.isnan(found.scatter_px).all()


def test_points_on_a_line_and_points_in_one_place_are_no_error() -> None:
    line = np.c_[np.linspace(0, SIDE, 60), np.full(60, 9.0)]
    found = predict(line, np.tile([0.5, -0.5], (60, 1)), line, Surface(24, 1))
    np.testing.assert_allclose(found.displacement_px, np.tile([0.5, -0.5], (60, 1)), atol=1e-6)
    heap = np.zeros((30, 2))
    found = predict(heap, np.tile([0.5, -0.5], (30, 1)), heap[:2], Surface(24, 1))
    np.testing.assert_allclose(found.displacement_px, [[0.5, -0.5]] * 2, atol=1e-6)


def test_a_constant_field_takes_the_largest_neighbourhood() -> None:
    xy = scattered(900)
    choice = choose_surface(xy, np.full((900, 2), 2.0) + noise(900, 0.1), WINDOW)
    assert choice.surface.count == 768
    known = np.isfinite(choice.residual_px).all(axis=1)
    assert known.sum() >= 300
    assert choice.residual_px[known].std() == pytest.approx(0.1, rel=0.15)


def test_a_wavy_field_takes_a_small_neighbourhood() -> None:
    xy = scattered(900)
    wavy = 1.5 * np.sin(2 * np.pi * xy[:, ::-1] / 400)
    choice = choose_surface(xy, wavy + noise(900, 0.05), 21)
    assert choice.surface.count <= 192
    assert np.nanmedian(np.abs(choice.residual_px)) < 0.25


def test_witnesses_share_no_pixels_with_the_point() -> None:
    # clusters err together: each point's own cluster must not vouch for it
    centres = np.random.default_rng(3).uniform(0, 1500, (120, 2))
    xy = (centres[:, None] + np.random.default_rng(4).uniform(-8, 8, (120, 5, 2))).reshape(-1, 2)
    displacement = np.repeat(noise(120, 0.4), 5, axis=0)
    choice = choose_surface(xy, displacement, WINDOW)
    known = np.isfinite(choice.residual_px).all(axis=1)
    assert choice.residual_px[known].std() == pytest.approx(0.4, rel=0.25)


@pytest.mark.parametrize("n", [7, 24, 48, 49])
def test_few_points_are_enough_for_an_answer(n: int) -> None:
    xy = scattered(n)
    choice = choose_surface(xy, noise(n, 0.1), WINDOW)
    assert 0 < choice.surface.count <= n
    assert choice.residual_px.shape == (n, 2)


def test_the_global_deformation_is_found_with_its_uncertainty() -> None:
    linear = np.array([[0.004, -0.012], [0.011, -0.006]])
    xy = scattered(400)
    errors, sigmas = [], []
    for seed in range(40):
        found, sigma = global_affine(xy, xy @ linear.T + noise(400, 0.1, seed))
        errors.append(found - linear)
        sigmas.append(sigma)
    np.testing.assert_allclose(np.std(errors, axis=0), np.mean(sigmas, axis=0), rtol=0.6)
    assert np.abs(np.mean(errors, axis=0)).max() < 1e-4


def test_gross_errors_do_not_deform_the_whole() -> None:
    xy = scattered(300)
    displacement = xy * 0.01 + noise(300, 0.05)
    displacement[xy[:, 0] > 480] += 5.0
    found, _ = global_affine(xy, displacement)
    np.testing.assert_allclose(found, 0.01 * np.eye(2), atol=1e-3)


@pytest.mark.parametrize("at", [(300.0, 300.0), (5.0, 5.0)])
def test_the_leverage_is_the_variance_of_the_prediction(at: tuple[float, float]) -> None:
    xy = scattered(400)
    found = [predict(xy, noise(400, 0.1, seed), np.array([at]), Surface(48, 1)) for seed in range(300)]
    spread = np.std([prediction.displacement_px[0] for prediction in found])
    assert (spread / 0.1) ** 2 == pytest.approx(found[0].leverage[0], rel=0.3)


def test_a_residual_is_less_than_the_difference_where_neighbours_are_few() -> None:
    xy = scattered(300)
    displacement = noise(300, 0.1)
    sizes = [
        np.nanstd(independent_residual(xy, displacement, window, Surface(48, 1))[0]) for window in (21, 129)
    ]
    assert sizes[0] == pytest.approx(0.1, rel=0.15)
    assert sizes[1] < 0.085


def test_a_quadratic_surface_is_predicted_exactly() -> None:
    xy, at = scattered(300), np.array([[300.0, 300.0], [40.0, 560.0]])

    def bowl(where: NDArray) -> NDArray:
        x, y = (where / SIDE).T
        return np.c_[x * x - x * y + 0.3, y * y + 2 * x]

    found = predict(xy, bowl(xy), at, Surface(192, 2))
    np.testing.assert_allclose(found.displacement_px, bowl(at), atol=1e-4)


def test_the_field_is_smooth_where_its_neighbours_predict_to_the_noise() -> None:
    xy = scattered(900)
    flat = noise(900, 0.05)
    wavy = flat + 0.6 * np.sin(2 * np.pi * xy[:, ::-1] / 150)
    assert choose_surface(xy, flat, WINDOW).smooth
    assert not choose_surface(xy, wavy, WINDOW).smooth


def test_predictions_may_be_shared_out() -> None:
    rng = np.random.default_rng(8)
    xy, at = rng.uniform(0, 900, (1500, 2)), rng.uniform(0, 900, (70, 2))
    moved = np.sin(xy / 150) + rng.normal(0, 0.05, xy.shape)
    for surface in (Surface(192, 2), Surface(1400, 1)):
        whole = predict(xy, moved, at, surface)
        parts = Prediction.concatenate([predict(xy, moved, part, surface) for part in (at[:30], at[30:])])
        for name in ("displacement_px", "slope", "scatter_px", "leverage"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
