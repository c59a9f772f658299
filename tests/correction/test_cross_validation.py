from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.correction.cross_validation import SharedNoise, cross_validation_blocks, left_out_errors
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.errors import InputError

from .points import affine, isotropic, noise, scattered, window_noise


def test_blocks_are_predicted_by_a_fit_to_the_others() -> None:
    points = scattered(0, 200)
    observed = affine(1.0).forward(points) + noise(0, 200, 0.1)
    has_foldover = cross_validation_blocks(points, 0.0)
    for name in ("shift", "affine"):
        fit = MODELS[name].fit(points, observed, isotropic(200, 0.1))
        found = left_out_errors(fit, has_foldover, SharedNoise.of(fit, points, 0.0, has_foldover))
        for test in has_foldover.tests:
            again = MODELS[name].fit(points[~test], observed[~test], isotropic(int((~test).sum()), 0.1))
            plain = ((observed[test] - again.correction.forward(points[test])) ** 2).sum(axis=1)
            # Robust weights stay those of all points: hence not equal to the last digit.
            np.testing.assert_allclose(np.sqrt(found[test]), np.sqrt(plain), atol=0.01)


@pytest.mark.parametrize("name", ["affine", "polynomial3", "tps"])
def test_folds_solved_together_are_those_solved_one_by_one(name: str) -> None:
    points = scattered(2, 240)
    observed = affine(1.0).forward(points) + noise(2, 240, 0.1)
    folds = cross_validation_blocks(points, 0.0).tests
    fit = MODELS[name].fit(points, observed, isotropic(240, 0.1))
    values = [noise(number, 240, 1.0)[:, :, None] for number in range(len(folds))]
    together = fit.left_out(folds, values)
    odd = np.any(folds[1::2], axis=0)
    for fold, of_fold, found in zip(folds, values, together, strict=True):
        alone = fit.left_out((fold, ~fold & odd, ~fold & ~odd), [of_fold] * 3)[0]
        np.testing.assert_allclose(found, alone, atol=1e-9)


def test_points_outside_a_fold_must_determine_the_model() -> None:
    points = scattered(3, 60)
    fit = MODELS["affine"].fit(points, points + noise(3, 60, 0.1), isotropic(60, 0.1))
    nearly_all = np.arange(60) < 58
    with pytest.raises(InputError, match="affine model needs tie points"):
        fit.left_out((nearly_all, ~nearly_all), [points[:, :, None]] * 2)


def test_a_projective_is_predicted_by_one_step() -> None:
    points = scattered(1, 300)
    observed = affine(1.0).forward(points) + noise(1, 300, 0.1)
    has_foldover = cross_validation_blocks(points, 0.0)
    test = has_foldover.tests[3]
    fit = MODELS["projective"].fit(points, observed, isotropic(300, 0.1))
    found = left_out_errors(fit, has_foldover, SharedNoise.of(fit, points, 0.0, has_foldover))[test]
    again = MODELS["projective"].fit(points[~test], observed[~test], isotropic(int((~test).sum()), 0.1))
    plain = ((observed[test] - again.correction.forward(points[test])) ** 2).sum(axis=1)
    np.testing.assert_allclose(np.sqrt(found), np.sqrt(plain), atol=0.01)


@pytest.mark.parametrize("name", ["affine", "polynomial2", "polynomial3"])
def test_errors_shared_with_the_others_do_not_flatter(name: str) -> None:
    """Against the truth: the points' own errors, and what their predictions are off the true displacement."""
    flattered, corrected, true = [], [], []
    for seed in range(20):
        points = scattered(seed, 400)
        observed = points + 0.1 * window_noise(seed, points, 512, 81)
        has_foldover = cross_validation_blocks(points, 81)
        fit = MODELS[name].fit(points, observed, isotropic(400, 0.1), footprint_px=81)
        noise = SharedNoise.of(fit, points, 81, has_foldover)
        corrected.append(left_out_errors(fit, has_foldover, noise).mean())
        silent = SharedNoise(noise.probes, tuple(np.zeros_like(part) for part in noise.shared))
        flattered.append(left_out_errors(fit, has_foldover, silent).mean())
        missed = observed - points - fit.remainder_px
        folds = has_foldover.tests
        values = [fit.remainder_px[:, :, None]] * len(folds)
        for test, predicted in zip(folds, fit.left_out(folds, values), strict=True):
            missed[test] += predicted[..., 0]
        true.append(((observed - points) ** 2 + missed**2).sum(axis=1).mean())
    optimism = np.mean(true) - np.mean(flattered)
    assert optimism > 5e-4
    assert np.mean(corrected) - np.mean(flattered) == pytest.approx(optimism, rel=0.45)


def test_exact_points_leave_nothing() -> None:
    points = scattered(2, 60)
    fit = MODELS["shift"].fit(points, points, isotropic(60, 0.1), footprint_px=81)
    has_foldover = cross_validation_blocks(points, 81)
    found = left_out_errors(fit, has_foldover, SharedNoise.of(fit, points, 81, has_foldover))
    np.testing.assert_allclose(found, 0, atol=1e-3)
