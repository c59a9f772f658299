from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.correction.agreement import AGREEMENT, agreement

RNG = np.random.default_rng(11)


def wavy(xy: np.ndarray) -> np.ndarray:
    return 2.0 * np.column_stack([np.sin(xy[:, 1] / 160), np.cos(xy[:, 0] / 200)])


@pytest.mark.parametrize("n", [40, 400])
@pytest.mark.parametrize("linear", [np.eye(2), 3.7 * np.array([[0.6, 0.8], [-0.8, 0.6]])])
def test_finds_gross_errors_whatever_the_trend(n: int, linear: np.ndarray) -> None:
    predicted = RNG.uniform(0, 1000, (n, 2))
    observed = predicted @ linear.T + [5000, -70] + RNG.normal(0, 0.1, (n, 2))
    wrong = np.arange(n) % 10 == 3
    observed[wrong] += RNG.choice([-1, 1], (wrong.sum(), 2)) * RNG.uniform(4, 80, (wrong.sum(), 2))
    found = agreement(predicted, observed)
    assert not found.consistent[wrong].any()
    assert found.consistent[~wrong].mean() > 0.97
    assert found.linear == pytest.approx(linear, abs=2e-3)
    assert found.sigma_px == pytest.approx(0.1, rel=0.35)
    assert found.unexplained < 0.01


def test_keeps_a_smooth_deformation() -> None:
    predicted = RNG.uniform(0, 2000, (800, 2))
    observed = predicted + wavy(predicted) + RNG.normal(0, 0.1, (800, 2))
    observed[::10] += [20, -15]
    found = agreement(predicted, observed)
    assert not found.consistent[::10].any()
    assert found.consistent.sum() >= 700


def test_exact_points_are_kept() -> None:
    predicted = RNG.uniform(0, 100, (30, 2))
    found = agreement(predicted, predicted + np.array([1.5, -2.0]))
    assert found.consistent.all()
    assert found.sigma_px == 1e-3


def test_a_point_within_its_own_sigma_is_kept() -> None:
    predicted = RNG.uniform(0, 100, (60, 2))
    observed = predicted + RNG.normal(0, 0.01, (60, 2))
    observed[7] += [0.5, 0.5]
    sigma = np.full(60, 0.01)
    assert not agreement(predicted, observed, sigma).consistent[7]
    sigma[7] = 0.3
    assert agreement(predicted, observed, sigma).consistent[7]
    sigma[7] = np.nan
    assert not agreement(predicted, observed, sigma).consistent[7]


def test_points_at_one_place_do_not_stand_for_themselves() -> None:
    predicted = np.repeat(RNG.uniform(0, 100, (20, 2)), 2, axis=0)
    observed = predicted + RNG.normal(0, 0.05, (40, 2))
    observed[5] += 9
    found = agreement(predicted, observed)
    assert np.flatnonzero(~found.consistent).tolist() == [5]


def test_unrelated_points_are_not_explained() -> None:
    found = agreement(RNG.uniform(0, 500, (200, 2)), RNG.uniform(0, 500, (200, 2)))
    assert found.unexplained > 0.3


def test_few_points_are_believed() -> None:
    found = agreement(RNG.uniform(0, 500, (5, 2)), RNG.uniform(0, 500, (5, 2)))
    assert found.consistent.all()
    assert np.isnan(found.sigma_px)


def test_the_limit_follows_its_parameters() -> None:
    predicted = RNG.uniform(0, 1000, (200, 2))
    observed = predicted + RNG.normal(0, 0.1, (200, 2))
    strict = agreement(predicted, observed, parameters=replace(AGREEMENT, scatters=1.5))
    assert strict.consistent.sum() < agreement(predicted, observed).consistent.sum()
