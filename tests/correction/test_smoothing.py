from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.correction.smoothing import SmoothingTrials
from pcwlad_geo.correction.spline_fit import fit_tps
from pcwlad_geo.correction.thin_plate import ThinPlateSystem
from pcwlad_geo.estimation.shared_errors import Overlaps, probes_of

from .points import inside, isotropic, noise, scattered, waves, window_noise

Array = NDArray[np.float64]
slow = pytest.mark.slow


def trials_of(points: Array, values: Array, side_px: float, outliers: int = 0) -> SmoothingTrials:
    whitener = np.broadcast_to(10 * np.eye(2), (len(points), 2, 2))
    weight = np.where(np.arange(len(points)) < outliers, 0.0, 0.7)
    overlaps, probes = Overlaps.of(points, side_px), probes_of(points)
    return SmoothingTrials.of(ThinPlateSystem.of(points, 81), overlaps, probes, values, whitener, weight)


@pytest.mark.parametrize("relative_smoothing", [0.3, 30.0, 3e3])
@pytest.mark.parametrize("outliers", [0, 20])
def test_the_information_used_up_is_that_of_dense_algebra(outliers: int, relative_smoothing: float) -> None:
    points, values_px = scattered(0, 200), noise(0, 200, 0.1)
    trials = trials_of(points, values_px, 81, outliers)
    smoothing = trials.smoothing(relative_smoothing)
    trial = trials.at(smoothing)
    design, energy = trials.system.design.toarray()[outliers:], trials.system.energy.toarray()
    precision = trials.precision[outliers:]
    np.testing.assert_allclose(precision, 100)  # inliers count in full
    hat = design @ np.linalg.solve((design.T * precision) @ design + smoothing * energy, design.T * precision)
    overlaps = trials.overlaps.times(np.eye(200))[outliers:, outliers:]
    # Random signs: to some hundredths of what there is to use.
    assert trial.parameters_per_point[0] == pytest.approx(np.trace(hat) / len(hat), abs=0.01, rel=0.05)
    assert trial.parameters_per_point[1] == pytest.approx(
        np.trace(hat @ overlaps) / len(hat), abs=0.01, rel=0.1
    )
    residual = values_px[outliers:] - hat @ values_px[outliers:]
    assert trial.squares == pytest.approx(100 * (residual**2).sum() / 2)


def test_the_score_is_ordinary_cross_validation_for_independent_errors() -> None:
    trials = trials_of(scattered(1, 200), noise(1, 200, 0.1), 0.0)
    trial = trials.at(trials.smoothing(30.0))
    assert trial.parameters_per_point[0] == pytest.approx(trial.parameters_per_point[1])
    assert trial.score(0.0) == pytest.approx(trial.squares / (1 - trial.parameters_per_point[0]) ** 2)
    assert trials.at(trials.smoothing(1e-9)).score(1.0) == np.inf


@pytest.mark.parametrize("shared", [pytest.param(0.0, marks=slow), 0.5, pytest.param(1.0, marks=slow)])
def test_noise_is_smoothed_away_whatever_windows_share(shared: float) -> None:
    freedom = []
    for seed in range(8):
        points = scattered(seed, 400)
        error = np.sqrt(shared) * window_noise(seed, points, 512, 81)
        error += np.sqrt(1 - shared) * noise(seed, 400, 1.0)
        fit = fit_tps(points, points + 0.1 * error, isotropic(400, 0.1), footprint_px=81)
        freedom.append(fit.freedom / 2)
    assert np.median(freedom) < 6  # a plane has 3


def test_without_knowing_the_windows_shared_errors_pass_for_detail() -> None:
    points = scattered(0, 400)
    observed = points + 0.1 * window_noise(0, points, 512, 81)
    deluded = fit_tps(points, observed, isotropic(400, 0.1))
    assert deluded.freedom > 100


def test_a_point_less_hardly_ever_bends_the_spline_elsewhere() -> None:
    """Once in 30 the smoothing, whose levels are apart by a factor of 2, goes to the next one."""
    moves_px = []
    for seed in (10, 11, 12):
        points = scattered(seed, 300)
        observed = points + waves(seed, points, 1.0, 700) + noise(seed, 300, 0.1)
        fits = [
            fit_tps(points[first:], observed[first:], isotropic(300 - first, 0.1), footprint_px=81)
            for first in range(11)
        ]
        at = [fit.correction.forward(points) for fit in fits]
        moves_px += [np.median(np.hypot(*(one - other).T)) for one, other in itertools.pairwise(at)]
    assert sum(move_px > 0.002 for move_px in moves_px) <= 1


def test_waves_are_followed_about_as_well_as_can_be() -> None:
    points, places = scattered(1, 500, 1024), inside(1024)
    error = np.sqrt(0.5) * (window_noise(1, points, 1024, 81) + noise(1, 500, 1.0))
    observed = points + waves(1, points, 1.0, 700) + 0.1 * error
    fit = fit_tps(points, observed, isotropic(500, 0.1), footprint_px=81)
    truth = places + waves(1, places, 1.0, 700)

    def rmse(moved: Array) -> float:
        return float(np.sqrt(((moved - truth) ** 2).sum(axis=1).mean()))

    system = ThinPlateSystem.of(points, 81)
    errors = []
    for step in range(12):
        relative_smoothing = 2e4 / 4.0**step
        precision = np.full(500, 100.0)
        factor = system.factor(system.normal(precision), system.smoothing(relative_smoothing, precision))
        found = factor.solve(system.design.T @ (100 * (observed - points)))
        errors.append(rmse(places + system.grid.design(places) @ found))
    assert rmse(fit.correction.forward(places)) < 1.25 * min(errors)
    assert min(errors) < 0.3 * max(errors)
