"""Does the predicted sigma hold? On simulated fields, with errors that windows share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.selection import choose
from pcwlad_geo.correction.selection_parameters import SELECTION
from pcwlad_geo.correction.spline_fit import fit_tps

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

Array = NDArray[np.float64]
SIDE = 1024.0
slow = pytest.mark.slow


def errors_px(seed: int, points: Array, shared: float) -> Array:
    """Return errors of 0.1 px, in part shared by windows of 81 px."""
    own = noise(seed, len(points), 1.0)
    return 0.1 * (np.sqrt(shared) * window_noise(seed, points, 1024, 81) + np.sqrt(1 - shared) * own)


def coverage(ratios: list[Array]) -> tuple[float, float]:
    size = np.abs(np.concatenate(ratios))
    return float(np.mean(size < 1)), float(np.mean(size < 1.96))


@pytest.mark.parametrize("shared", [pytest.param(0.0, marks=slow), 0.6])
@pytest.mark.parametrize(
    ("name", "field", "seeds"),
    [
        pytest.param("shift", lambda seed, xy: np.full_like(xy, 1.5), 80, marks=slow),
        pytest.param("affine", lambda seed, xy: affine(1.0, SIDE).forward(xy) - xy, 50, marks=slow),
        pytest.param("projective", lambda seed, xy: projective(SIDE).forward(xy) - xy, 30, marks=slow),
        pytest.param(
            "polynomial2", lambda seed, xy: polynomial(2, seed, SIDE).forward(xy) - xy, 25, marks=slow
        ),
        ("polynomial3", lambda seed, xy: polynomial(3, seed, SIDE).forward(xy) - xy, 20),
        pytest.param("tps", lambda seed, xy: waves(seed, xy, 2.0, 1000), 8, marks=slow),
        pytest.param("tps", lambda seed, xy: waves(seed, xy, 0.3, 600), 8, marks=slow),
    ],
)
def test_sigma_of_a_true_model_holds(
    name: str, field: Callable[[int, Array], Array], seeds: int, shared: float
) -> None:
    ratios, places = [], inside(SIDE, 9)
    for seed in range(seeds):
        points = scattered(seed, 350, SIDE)
        observed = points + field(seed, points) + errors_px(seed, points, shared)
        fit = MODELS[name].fit(points, observed, isotropic(350, 0.1), footprint_px=81)
        missed = fit.correction.forward(places) - places - field(seed, places)
        ratios.append(missed / predicted_sigma(fit, places))
    one_sigma, two_sigma = coverage(ratios)
    assert 0.58 < one_sigma < 0.78
    assert 0.90 < two_sigma < 0.99


@pytest.mark.parametrize("formal_px", [0.03, 0.2])
@pytest.mark.parametrize("name", ["polynomial2", pytest.param("tps", marks=slow)])
def test_sigma_holds_where_that_of_the_points_does_not(name: str, formal_px: float) -> None:
    ratios, places = [], inside(SIDE, 9)
    for seed in range(16):
        points, truth = scattered(seed, 350, SIDE), polynomial(2, seed, SIDE)
        observed = truth.forward(points) + errors_px(seed, points, 0.5)
        fit = MODELS[name].fit(points, observed, isotropic(350, formal_px), footprint_px=81)
        missed = fit.correction.forward(places) - truth.forward(places)
        ratios.append(missed / predicted_sigma(fit, places))
    one_sigma, two_sigma = coverage(ratios)
    assert 0.55 < one_sigma < 0.85
    assert 0.88 < two_sigma <= 1.0


@pytest.mark.slow
def test_sigma_of_the_model_chosen_holds_whatever_the_field() -> None:
    ratios, places = [], inside(SIDE, 9)
    for seed in range(12):
        points = scattered(seed, 350, SIDE)
        size = (0.0, 0.3, 2.0)[seed % 3]
        common = SELECTION.common_sigma * noise(1000 + seed, 1, 0.1)  # what all points err alike
        observed = points + waves(seed, points, size, 900) + errors_px(seed, points, 0.5) + common
        selection = choose(points, observed, isotropic(350, 0.1), 81)
        moved = selection.fit.correction.forward(places) - places
        ratios.append((moved - waves(seed, places, size, 900)) / selection.sigma(places))
    one_sigma, two_sigma = coverage(ratios)
    assert 0.58 < one_sigma < 0.78
    assert 0.90 < two_sigma < 0.99


@pytest.mark.parametrize("name", ["affine", "polynomial2", "polynomial3", "tps"])
def test_sigma_grows_beyond_the_points(name: str) -> None:
    points = scattered(0, 300)
    found = MODELS[name].fit(points, points + noise(0, 300, 0.1), isotropic(300, 0.1), footprint_px=41)
    centre, corner, beyond, far = predicted_sigma(
        found, np.array([[256.0, 256.0], [510.0, 510.0], [700.0, 700.0], [1500.0, 1500.0]])
    ).mean(axis=1)
    assert centre < corner < beyond < far
    assert found.support.extrapolated(np.array([[700.0, 700.0]]))[0]


def test_precision_at_many_places_is_that_at_few() -> None:
    points = scattered(1, 300)
    observed = points + waves(1, points, 1.0, 400) + noise(1, 300, 0.1)
    fit = fit_tps(points, observed, isotropic(300, 0.1), footprint_px=41)
    places = inside(512, 30)
    many = fit.covariance(places)  # 900 places: between nodes
    few = np.concatenate([fit.covariance(places[start : start + 300]) for start in (0, 300, 600)])
    assert many.shape == (900, 2, 2)
    assert np.percentile(np.abs(many[:, 0, 0] / few[:, 0, 0] - 1), 95) < 0.25
    assert np.mean(many) == pytest.approx(np.mean(few), rel=0.05)
    np.testing.assert_allclose(many, many.transpose(0, 2, 1), atol=1e-12)
