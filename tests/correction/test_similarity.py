"""Rigid and similarity corrections against imposed rotations, scales and shifts, px."""

from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.correction.fit import MODELS, VRT_MODELS, of_option
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.selection import choose
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.transforms import ShiftTransform, SimilarityTransform
from pcwlad_geo.types import Float64

from .points import isotropic, noise, scattered

SIGMA_PX = 0.1
CORNERS = np.array([[0.0, 0.0], [512, 0], [0, 512], [512, 512]])


def truth(angle_deg: float, scale: float = 1.0) -> SimilarityTransform:
    """Return a turn about the middle of the image, a scale there, and a shift."""
    middle = ShiftTransform.by(np.array([256.0, 256.0]))
    turned = SimilarityTransform.from_angle(np.radians(angle_deg), scale)
    moved = ShiftTransform.by(np.array([1.7, -0.6])) @ middle @ turned @ middle.inverse()
    assert isinstance(moved, SimilarityTransform)
    return moved


def observed(transform: SimilarityTransform, predicted: Float64, seed: int) -> Float64:
    return transform(predicted) + noise(seed, len(predicted), SIGMA_PX)


@pytest.mark.parametrize(
    ("name", "angle_deg", "scale"),
    [("rigid", 0.3, 1.0), ("rigid", 178.0, 1.0), ("similarity", -40.0, 1.02), ("similarity", 0.1, 0.7)],
)
def test_an_imposed_turn_is_recovered_among_outliers(name: str, angle_deg: float, scale: float) -> None:
    predicted, transform = scattered(1, 200), truth(angle_deg, scale)
    target = observed(transform, predicted, 2)
    target[::12] += np.random.default_rng(3).uniform(-20, 20, target[::12].shape)
    fit = MODELS[name].fit(predicted, target, isotropic(200, SIGMA_PX))
    assert np.abs(fit.correction.forward(CORNERS) - transform(CORNERS)).max() < 0.06
    assert fit.freedom == {"rigid": 3, "similarity": 4}[name]
    matrix = fit.correction.to_dict()["forward"]
    assert isinstance(matrix, dict)
    linear = np.array(matrix["matrix"])[:, :2]
    np.testing.assert_allclose(linear.T @ linear, np.linalg.det(linear) * np.eye(2), atol=1e-12)


def test_a_rigid_correction_takes_no_scale() -> None:
    predicted, transform = scattered(1, 200), truth(1.0, 1.01)
    fit = MODELS["rigid"].fit(predicted, observed(transform, predicted, 2), isotropic(200, SIGMA_PX))
    assert isinstance(fit.correction, AffineCorrection)
    assert np.linalg.det(fit.correction.matrix[:, :2]) == pytest.approx(1.0, abs=1e-12)
    off_px = np.linalg.norm(fit.correction.forward(CORNERS) - transform(CORNERS), axis=1)
    assert off_px == pytest.approx(0.01 * 256 * 2**0.5, rel=0.1)


@pytest.mark.parametrize("name", ["rigid", "similarity"])
def test_the_covariance_holds_for_the_error_at_the_corners(name: str) -> None:
    predicted, transform = scattered(4, 60), truth(0.5)
    squared = []
    for seed in range(60):
        fit = MODELS[name].fit(predicted, observed(transform, predicted, seed), isotropic(60, SIGMA_PX))
        error = fit.correction.forward(CORNERS) - transform(CORNERS)
        squared.append(np.einsum("na,nab,nb->n", error, np.linalg.inv(fit.covariance(CORNERS)), error))
    assert 1.6 < np.mean(squared) < 2.4  # two components of unit variance


def test_it_is_more_precise_than_an_affine() -> None:
    predicted = scattered(4, 60)
    target = observed(truth(0.5), predicted, 5)
    sigma = [
        np.trace(MODELS[name].fit(predicted, target, isotropic(60, SIGMA_PX)).covariance(CORNERS)[0])
        for name in ("rigid", "similarity", "affine")
    ]
    assert sigma == sorted(sigma)
    assert sigma[0] < 0.7 * sigma[2]


def test_a_vrt_holds_them() -> None:
    assert {"rigid", "similarity"} < set(VRT_MODELS)
    assert of_option("rigid") == ("rigid",)
    predicted = scattered(1, 200)
    target = observed(truth(0.5), predicted, 5)
    chosen = choose(predicted, target, isotropic(200, SIGMA_PX), 0.0, ("similarity",))
    assert chosen.name == "similarity"
    np.testing.assert_allclose(chosen.sigma(CORNERS) < 0.1, True)


LINEAR = ("shift", "rigid", "similarity", "affine")


@pytest.mark.parametrize(
    ("angle_deg", "scale", "expected"),
    [
        pytest.param(2.0, 1.0, {"rigid"}, marks=pytest.mark.slow),
        (0.05, 1.0, {"rigid"}),
        (0.5, 1.002, {"similarity"}),
        (0.0, 1.0, {"shift"}),
    ],
)
def test_auto_takes_them_where_the_affine_is_no_better(
    angle_deg: float, scale: float, expected: set[str]
) -> None:
    names, squared = [], []
    for seed in range(10):
        predicted, transform = scattered(seed, 120), truth(angle_deg, scale)
        target = observed(transform, predicted, seed)
        errors = []
        for candidates in (LINEAR, ("shift", "affine")):
            chosen = choose(predicted, target, isotropic(120, SIGMA_PX), 81, candidates)
            off_px = chosen.fit.correction.forward(CORNERS) - transform(CORNERS)
            errors.append((off_px**2).sum(axis=1).mean())
            if candidates == LINEAR:
                names.append(chosen.name)
                assert [score.name for score in chosen.candidates if score.chosen] == [chosen.name]
        squared.append(errors)
    assert sum(name in expected for name in names) >= 8
    ours, without = np.sqrt(np.mean(squared, axis=0))
    assert ours <= without * (1 if expected == {"shift"} else 0.9)


@pytest.mark.parametrize("shear_px", [0.1, 0.5])
def test_a_shear_stays_an_affine(shear_px: float) -> None:
    predicted, transform = scattered(1, 200), truth(2.0, 1.01)
    sheared = predicted + (predicted[:, ::-1] - 256) * (shear_px / 256)
    target = observed(transform, sheared, 2)
    chosen = choose(predicted, target, isotropic(200, SIGMA_PX), 81, LINEAR)
    assert chosen.name == "affine"
    assert {score.note.partition(" ")[0] for score in chosen.candidates[1:3]} <= {"affine", "differs"}
    kept = choose(predicted, target, isotropic(200, SIGMA_PX), 81, ("shift", "affine"))
    assert chosen.candidates[3].rmse_px == kept.candidates[1].rmse_px


def test_they_are_not_tried_beside_another_model() -> None:
    predicted = scattered(1, 200)
    target = predicted + np.array([1.5, -0.5]) + noise(2, 200, SIGMA_PX)
    chosen = choose(predicted, target, isotropic(200, SIGMA_PX), 81, LINEAR)
    assert chosen.name == "shift"
    assert [score.note for score in chosen.candidates[1:3]] == ["not tried: shift is chosen"] * 2
    few = choose(predicted[:5], target[:5], isotropic(5, SIGMA_PX), 81, LINEAR)
    assert few.name == "shift"


@pytest.mark.parametrize("name", ["rigid", "similarity"])
def test_too_few_points_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"3 tie points for the {name} model, which needs at least 4"):
        MODELS[name].fit(scattered(1, 3), scattered(1, 3), isotropic(3, SIGMA_PX))
