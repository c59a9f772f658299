"""Robust scales of normal errors, which gross ones hardly change, and the weights of outliers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.estimation.robust import ROBUST, axis_sigma, biweight, huber, jackknife, sigma_of, unit_sigma


def test_scales_are_standard_deviations() -> None:
    errors = np.random.default_rng(5).normal(0, 0.4, (200_000, 2))
    errors[::20] = 50.0
    lengths = np.hypot(*errors.T)
    assert sigma_of(errors) == pytest.approx(0.4, rel=0.1)
    assert axis_sigma(lengths) == pytest.approx(0.4, rel=0.1)
    assert unit_sigma(lengths / 0.1) == pytest.approx(4.0, rel=0.1)
    assert unit_sigma(lengths) == 1.0  # errors smaller than their sigmas do not make these smaller


def test_weights_fall_beyond_a_limit_or_up_to_it() -> None:
    np.testing.assert_allclose(huber(np.array([0.5, 2.0, 4.0]), 2.0), [1.0, 1.0, 0.5])
    squared = np.array([0.0, 0.5, 1.0, 4.0]) * ROBUST.rejection_sigma**2
    np.testing.assert_allclose(biweight(squared), [1.0, 0.25, 0.0, 0.0])


def test_a_jackknife_of_blocks_that_err_alike_is_wider() -> None:
    estimates = np.random.default_rng(1).normal(size=(8, 2))
    independent = jackknife(estimates, replace(ROBUST, block_correlation=1.0))
    np.testing.assert_allclose(jackknife(estimates), ROBUST.block_correlation * independent)
