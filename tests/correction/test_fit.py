from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.models import Correction, ProjectiveCorrection
from pcwlad_geo.errors import InputError

from .points import (
    affine,
    inside,
    isotropic,
    noise,
    polynomial,
    predicted_sigma,
    projective,
    scattered,
    waves,
    window_noise,
)

CORNERS_PX = np.array([[0.0, 0.0], [512.0, 0.0], [0.0, 512.0], [512.0, 512.0]])
SHIFT_PX = np.array([1.3, -0.6])
coordinate = st.floats(-1e3, 1e3, allow_nan=False)


@pytest.mark.parametrize("name", MODELS)
def test_a_noise_free_shift_is_recovered(name: str) -> None:
    predicted = scattered(0, 50) + 1e5
    fit = MODELS[name].fit(predicted, predicted + np.array([0.35, -2.75]), isotropic(50, 0.1))
    assert fit.correction.name == name
    np.testing.assert_allclose(
        fit.correction.forward(CORNERS_PX + 1e5), CORNERS_PX + 1e5 + [0.35, -2.75], atol=1e-8
    )


def test_a_noise_free_affine_is_recovered() -> None:
    predicted = scattered(0, 50)
    truth = affine(3.0)
    fit = MODELS["affine"].fit(predicted, truth.forward(predicted), isotropic(50, 0.1))
    np.testing.assert_allclose(fit.correction.forward(CORNERS_PX), truth.forward(CORNERS_PX), atol=1e-8)
    assert fit.inlier.all()


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", [0, *(pytest.param(each, marks=pytest.mark.slow) for each in range(1, 5))])
def test_ten_percent_gross_outliers_move_the_correction_by_less_than_0_02_px(name: str, seed: int) -> None:
    predicted, error = scattered(seed, 1000), noise(seed, 1000, 0.1)
    clean = MODELS[name].fit(predicted, predicted + SHIFT_PX + error, isotropic(1000, 0.1))
    # One-sided, the worst kind: they all pull the same way.
    error[::10] = np.random.default_rng(seed).uniform(1, 20, (100, 2))
    fit = MODELS[name].fit(predicted, predicted + SHIFT_PX + error, isotropic(1000, 0.1))
    centre = np.array([[256.0, 256.0]])
    np.testing.assert_allclose(fit.correction.forward(centre) - centre, [SHIFT_PX], atol=0.02)
    # The corners of a cubic or a spline are known to 0.03 px only: a tenth of the points less shows.
    np.testing.assert_allclose(
        fit.correction.forward(CORNERS_PX),
        clean.correction.forward(CORNERS_PX),
        atol=0.05 if name in ("polynomial3", "tps") else 0.02,
    )
    assert not fit.inlier[::10].any()
    assert fit.inlier.sum() >= 895


def test_forty_percent_outliers_do_not_take_over_an_affine() -> None:
    predicted, truth = scattered(1, 500), affine(8.0)
    observed = truth.forward(predicted) + noise(1, 500, 0.1)
    observed[:200] += np.random.default_rng(1).uniform(-60, 60, (200, 2))
    fit = MODELS["affine"].fit(predicted, observed, isotropic(500, 0.1))
    np.testing.assert_allclose(fit.correction.forward(CORNERS_PX), truth.forward(CORNERS_PX), atol=0.06)


def test_precise_points_count_more() -> None:
    predicted, sigma = scattered(2, 400), np.repeat([0.02, 0.5], 200)
    fitted = [
        MODELS["shift"].fit(
            predicted,
            predicted + noise(seed, 400, 1.0) * sigma[:, None],
            isotropic(400, 1.0) * sigma[:, None, None] ** 2,
        )
        for seed in range(20)
    ]
    shifts = np.array([fit.correction.forward(np.zeros((1, 2)))[0] for fit in fitted])
    # 0.02 / √200 = 0.0014 px by the precise half alone; equal weights would give 0.018 px.
    assert np.sqrt((shifts**2).mean()) < 0.003


def test_the_full_covariance_counts() -> None:
    # Errors along the diagonals of the pixel: precise along one, poor along the other, by turns.
    n = 200
    predicted, error = scattered(3, n), noise(3, n, 1.0) * [0.01, 1.0]
    turn = np.where(np.arange(n) % 2, 1.0, -1.0) * np.pi / 4
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]).transpose(2, 0, 1)
    covariance = rotation @ np.diag([1e-4, 1.0]) @ rotation.transpose(0, 2, 1)
    fit = MODELS["shift"].fit(predicted, predicted + np.einsum("iab,ib->ia", rotation, error), covariance)
    # The variances of each point per axis alone, all 0.5 px², would give 0.05 px.
    np.testing.assert_allclose(fit.correction.forward(np.zeros((1, 2))), 0, atol=0.005)


def test_points_of_tiny_formal_sigma_do_not_decide_alone() -> None:
    predicted, sigma = scattered(4, 300), np.full(300, 0.05)
    sigma[:5] = 1e-5
    error = noise(4, 300, 0.2)
    error[:5] = [0.3, 0.3]
    fit = MODELS["shift"].fit(predicted, predicted + error, isotropic(300, 1.0) * sigma[:, None, None] ** 2)
    np.testing.assert_allclose(fit.correction.forward(np.zeros((1, 2))), 0, atol=0.04)
    assert np.sqrt(fit.variance_floor_px2) == pytest.approx(np.sqrt(0.2**2 - 0.05**2), rel=0.1)


def test_there_is_no_variance_floor_where_the_covariances_say_it_all() -> None:
    predicted = scattered(5, 500)
    fit = MODELS["shift"].fit(predicted, predicted + noise(5, 500, 0.1), isotropic(500, 0.12))
    assert fit.variance_floor_px2 == 0


@pytest.mark.parametrize("shared", [0.0, 0.5, pytest.param(1.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [pytest.param("shift", marks=pytest.mark.slow), "affine"])
def test_predicted_sigma_holds_with_independent_and_with_shared_errors(name: str, shared: float) -> None:
    at_px, ratios = np.array([[128.0, 380.0]]), []
    for seed in range(60):
        predicted = scattered(seed, 250)
        error = np.sqrt(shared) * window_noise(seed, predicted, 512, 81) + np.sqrt(1 - shared) * noise(
            seed, 250, 1
        )
        # Formal sigma 0.03 px, true 0.1 px: the floor has to make up for it.
        fit = MODELS[name].fit(predicted, predicted + 0.1 * error, isotropic(250, 0.03), footprint_px=81)
        ratios.append((fit.correction.forward(at_px) - at_px) / predicted_sigma(fit, at_px))
    # 120 ratios of unit variance: ± 6.5 % standard error; conservative at most by a factor of two.
    assert 0.55 < np.sqrt(np.mean(np.square(ratios))) < 1.25


def test_overlapping_windows_are_worth_fewer_points() -> None:
    predicted = scattered(6, 400)
    observed = predicted + 0.1 * window_noise(6, predicted, 512, 81)
    fit = MODELS["shift"].fit(predicted, observed, isotropic(400, 0.1), footprint_px=81)
    alone = MODELS["shift"].fit(predicted, observed, isotropic(400, 0.1))
    ratio = fit.covariance(predicted[:1])[0, 0, 0] / alone.covariance(predicted[:1])[0, 0, 0]
    assert 400 / 80 < ratio < 400 / 20  # (512 / 81)² = 40 windows side by side


def test_shift_covariance_of_independent_points() -> None:
    predicted = scattered(7, 400)
    fit = MODELS["shift"].fit(predicted, predicted + noise(7, 400, 0.1), isotropic(400, 0.1))
    np.testing.assert_allclose(predicted_sigma(fit, CORNERS_PX), 0.1 / np.sqrt(400), rtol=0.1)


def test_affine_sigma_grows_outwards() -> None:
    predicted = scattered(8, 400)
    fit = MODELS["affine"].fit(predicted, predicted + noise(8, 400, 0.1), isotropic(400, 0.1))
    # At a corner: centre, col and row terms of 256 px over a spread of 512/√12 each.
    np.testing.assert_allclose(predicted_sigma(fit, CORNERS_PX), 0.005 * np.sqrt(1 + 3 + 3), rtol=0.2)


@cache
def corners_by(name: str, seed: int) -> np.ndarray:
    """Return where the correction of forty points has the corners."""
    predicted = scattered(seed, 40)
    fit = MODELS[name].fit(predicted, predicted + noise(seed, 40, 0.2), isotropic(40, 0.1))
    return fit.correction.forward(CORNERS_PX)


@given(coordinate, coordinate, st.integers(0, 5))
@settings(max_examples=10)
def test_moving_the_observations_moves_the_correction(d_col: float, d_row: float, seed: int) -> None:
    predicted = scattered(seed, 40)
    observed = predicted + noise(seed, 40, 0.2)
    move = np.array([d_col, d_row])
    for name, model in MODELS.items():
        before = corners_by(name, seed)
        after = model.fit(predicted, observed + move, isotropic(40, 0.1)).correction.forward(CORNERS_PX)
        np.testing.assert_allclose(after, before + move, atol=1e-4)


@pytest.mark.parametrize("name", MODELS)
@given(col=coordinate, row=coordinate, seed=st.integers(0, 5))
@settings(max_examples=10)
def test_the_origin_of_the_image_does_not_matter(name: str, col: float, row: float, seed: int) -> None:
    predicted = scattered(seed, 40)
    observed, origin = predicted + noise(seed, 40, 0.2), 50 * np.array([col, row])
    before = corners_by(name, seed)
    moved = MODELS[name].fit(predicted + origin, observed + origin, isotropic(40, 0.1)).correction
    np.testing.assert_allclose(moved.forward(CORNERS_PX + origin) - origin, before, atol=1e-3)


@pytest.mark.parametrize("name", MODELS)
def test_the_order_of_the_points_does_not_matter(name: str) -> None:
    points = scattered(10, 300)
    observed, order = points + noise(10, 300, 0.1), np.random.default_rng(10).permutation(300)
    observed[::10] += 4.0
    plain, mixed = (
        MODELS[name].fit(points[index], observed[index], isotropic(300, 0.1), footprint_px=81)
        for index in (np.arange(300), order)
    )
    np.testing.assert_allclose(
        mixed.correction.forward(CORNERS_PX), plain.correction.forward(CORNERS_PX), atol=1e-5
    )
    np.testing.assert_allclose(
        predicted_sigma(mixed, CORNERS_PX), predicted_sigma(plain, CORNERS_PX), rtol=1e-3
    )
    np.testing.assert_array_equal(mixed.inlier, plain.inlier[order])


@pytest.mark.parametrize(
    ("name", "n"),
    [
        ("shift", 2),
        ("drift", 3),
        ("affine", 4),
        ("shift", 0),
        ("projective", 5),
        ("polynomial2", 7),
        ("tps", 11),
    ],
)
def test_too_few_points(name: str, n: int) -> None:
    with pytest.raises(InputError, match=f"{n} tie points for the {name} model"):
        MODELS[name].fit(scattered(0, n), scattered(0, n), isotropic(n, 0.1))


@pytest.mark.parametrize("name", sorted(set(MODELS) - {"shift", "drift"}))
def test_points_on_a_line_determine_nothing_but_a_shift(name: str) -> None:
    predicted = np.column_stack([np.arange(20.0), 3 * np.arange(20.0) + 1])
    with pytest.raises(InputError, match="on a line"):
        MODELS[name].fit(predicted, predicted + 1, isotropic(20, 0.1))


def test_a_drift_is_found_and_nothing_along_the_lines() -> None:
    predicted = scattered(3, 300)
    truth = np.array([[1.0, 0.0004, 1.2], [0.0, 0.9991, -0.7]])
    observed = predicted @ truth[:, :2].T + truth[:, 2] + noise(3, 300, 0.1)
    fit = MODELS["drift"].fit(predicted, observed, isotropic(300, 0.1))
    assert fit.freedom == 4
    np.testing.assert_array_equal(fit.correction.matrix[:, 0], [1.0, 0.0])
    sigma = predicted_sigma(fit, CORNERS_PX)
    missed = fit.correction.forward(CORNERS_PX) - (CORNERS_PX @ truth[:, :2].T + truth[:, 2])
    assert (np.abs(missed) < 4 * sigma).all()
    assert sigma.max() < 0.02


def test_points_on_one_row_determine_no_drift() -> None:
    predicted = np.column_stack([np.arange(20.0), np.full(20, 7.0)])
    with pytest.raises(InputError):
        MODELS["drift"].fit(predicted, predicted + 1, isotropic(20, 0.1))


def test_points_on_two_lines_do_not_determine_a_polynomial() -> None:
    col = np.tile(np.linspace(0, 500, 30), 2)
    predicted = np.column_stack([col, np.repeat([100.0, 400.0], 30)])
    with pytest.raises(InputError, match="not determine the model"):
        MODELS["polynomial2"].fit(predicted, predicted + 1, isotropic(60, 0.1))


def test_not_finite_points() -> None:
    predicted = scattered(0, 20)
    observed = predicted.copy()
    observed[3, 1] = np.nan
    with pytest.raises(InputError, match="not finite"):
        MODELS["shift"].fit(predicted, observed, isotropic(20, 0.1))


def test_wrong_shape() -> None:
    with pytest.raises(InputError, match="shapes"):
        MODELS["shift"].fit(scattered(0, 20), scattered(0, 20), np.ones((20, 2)))


@pytest.mark.parametrize("name", MODELS)
def test_identical_images_without_any_variance(name: str) -> None:
    predicted = scattered(9, 30)
    fit = MODELS[name].fit(predicted, predicted, np.zeros((30, 2, 2)), footprint_px=81)
    np.testing.assert_allclose(fit.correction.forward(CORNERS_PX), CORNERS_PX, atol=1e-9)
    assert np.isfinite(predicted_sigma(fit, CORNERS_PX)).all()


@pytest.mark.parametrize(
    ("name", "truth"),
    [
        ("projective", projective()),
        ("polynomial2", polynomial(2)),
        ("polynomial3", polynomial(3)),
        ("tps", affine(3.0)),
    ],
)
def test_exact_points_give_back_the_model(name: str, truth: Correction) -> None:
    predicted = scattered(11, 80)
    fit = MODELS[name].fit(predicted, truth.forward(predicted), isotropic(80, 0.1))
    places = inside()
    np.testing.assert_allclose(fit.correction.forward(places), truth.forward(places), atol=1e-6)
    assert fit.inlier.all()


def test_a_strong_perspective_is_recovered() -> None:
    matrix = np.array([[1.1, 0.2, 30.0], [-0.1, 0.9, -20.0], [4e-4, -3e-4, 1.0]])
    truth, predicted = ProjectiveCorrection("projective", matrix), scattered(12, 200)
    fit = MODELS["projective"].fit(predicted, truth.forward(predicted), isotropic(200, 0.1))
    np.testing.assert_allclose(fit.correction.forward(CORNERS_PX), truth.forward(CORNERS_PX), atol=1e-5)


def test_a_spline_never_goes_through_every_point() -> None:
    for seed in range(5):
        predicted, error = scattered(seed, 30), noise(seed, 30, 0.5)
        fit = MODELS["tps"].fit(predicted, predicted + error, isotropic(30, 0.5))
        residual = predicted + error - fit.correction.forward(predicted)
        assert np.sqrt((residual**2).mean()) > 0.3


@pytest.mark.parametrize("name", ["projective", "polynomial2", "polynomial3", "tps"])
def test_forty_percent_outliers_do_not_take_over(name: str) -> None:
    truth = {"projective": projective(), "polynomial2": polynomial(2), "polynomial3": polynomial(3)}
    correction = truth.get(name, polynomial(2, size_px=4.0))
    predicted = scattered(13, 500)
    observed = correction.forward(predicted) + noise(13, 500, 0.1)
    observed[:200] += np.random.default_rng(13).uniform(-60, 60, (200, 2))
    fit = MODELS[name].fit(predicted, observed, isotropic(500, 0.1))
    error = fit.correction.forward(inside()) - correction.forward(inside())
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.08
    assert np.mean(fit.inlier[:200]) < 0.03


def test_a_spline_follows_waves_past_outliers() -> None:
    predicted = scattered(14, 600, 1024)
    error = noise(14, 600, 0.1)
    error[::10] += np.random.default_rng(14).uniform(-20, 20, (60, 2))
    observed = predicted + waves(14, predicted, 2.0, 1000) + error
    fit = MODELS["tps"].fit(predicted, observed, isotropic(600, 0.1), footprint_px=81)
    places = inside(1024)
    missed = fit.correction.forward(places) - places - waves(14, places, 2.0, 1000)
    assert np.sqrt((missed**2).sum(axis=1).mean()) < 0.08
    assert np.mean(fit.inlier[::10]) < 0.1
