from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.correction.selection import choose, spatial_blocks
from pcwlad_geo.errors import InputError

from .points import affine, isotropic, noise, scattered, window_noise


@pytest.mark.parametrize("n", [40, 250])
def test_a_noisy_shift_is_a_shift(n: int) -> None:
    wrong = 0
    for seed in range(40):
        predicted = scattered(seed, n)
        observed = predicted + np.array([2.0, -1.0]) + noise(seed, n, 0.1)
        wrong += choose(predicted, observed, isotropic(n, 0.1), 81).name != "shift"
    assert wrong <= 2


def test_errors_that_windows_share_are_not_taken_for_deformation() -> None:
    wrong = 0
    for seed in range(20):
        predicted = scattered(seed, 200)
        observed = predicted + 0.1 * window_noise(seed, predicted, 512, 81)
        wrong += choose(predicted, observed, isotropic(200, 0.1), 81).name != "shift"
    assert wrong <= 2


def test_0_3_px_across_the_image_is_an_affine() -> None:
    for seed in range(10):
        predicted = scattered(seed, 300)
        observed = affine(0.3).forward(predicted) + noise(seed, 300, 0.1)
        selection = choose(predicted, observed, isotropic(300, 0.1), 81)
        assert selection.name == "affine"
        np.testing.assert_allclose(
            selection.fit.correction.forward(predicted), affine(0.3).forward(predicted), atol=0.07
        )
        shift, chosen = selection.candidates
        # Radial RMSE: noise √2 · 0.1; the shift leaves 0.3/√12 more in col.
        assert chosen.rmse_px == pytest.approx(0.1414, rel=0.15)
        assert shift.rmse_px > chosen.rmse_px
        assert 0 < chosen.rmse_standard_error_px < 0.03


def test_outliers_neither_hide_nor_make_an_affine() -> None:
    predicted = scattered(3, 400)
    error = noise(3, 400, 0.1)
    error[::10] = np.random.default_rng(3).uniform(-30, 30, (40, 2))
    assert choose(predicted, predicted + error, isotropic(400, 0.1), 81).name == "shift"
    stretched = affine(0.6).forward(predicted) + error
    assert choose(predicted, stretched, isotropic(400, 0.1), 81).name == "affine"


def test_a_strong_affine_in_a_small_image() -> None:
    predicted = scattered(4, 100, 200)
    observed = affine(3.0, 200).forward(predicted) + noise(4, 100, 0.1)
    assert choose(predicted, observed, isotropic(100, 0.1), 81).name == "affine"


def test_few_points_get_the_simplest_model_and_the_reason() -> None:
    predicted = scattered(5, 8)
    selection = choose(predicted, affine(5.0).forward(predicted), isotropic(8, 0.1), 81)
    assert selection.name == "shift"
    assert all(np.isnan(c.rmse_px) and "too few" in c.note for c in selection.candidates)


def test_points_on_a_line_leave_the_shift() -> None:
    predicted = np.column_stack([np.linspace(0, 500, 60), np.full(60, 7.0)])
    selection = choose(predicted, predicted + noise(6, 60, 0.1), isotropic(60, 0.1), 41)
    assert selection.name == "shift"
    assert "on a line" in selection.candidates[1].note
    assert np.isfinite(selection.candidates[0].rmse_px)


def test_identical_images() -> None:
    predicted = scattered(7, 60)
    selection = choose(predicted, predicted, np.zeros((60, 2, 2)), 81)
    assert selection.name == "shift"
    assert selection.candidates[0].rmse_px == pytest.approx(0, abs=1e-9)


def test_one_candidate_is_taken() -> None:
    predicted = scattered(8, 60)
    assert choose(predicted, predicted, isotropic(60, 0.1), 81, ("affine",)).name == "affine"


def test_no_candidate_can_be_fitted() -> None:
    with pytest.raises(InputError, match="2 tie points for the shift model"):
        choose(scattered(0, 2), scattered(0, 2), isotropic(2, 0.1), 81)


def test_blocks_are_compact_and_equal() -> None:
    points = scattered(9, 320)
    blocks = spatial_blocks(points, 16)
    assert np.bincount(blocks).tolist() == [20] * 16
    for number in range(16):
        assert (np.ptp(points[blocks == number], axis=0) < 300).all()
