"""Rigid and similarity corrections against imposed rotations, scales and shifts, px."""

from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.correction.fit import CANDIDATES, MODELS, VRT_MODELS, of_option
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


def test_auto_does_not_try_them_and_a_vrt_holds_them() -> None:
    assert not {"rigid", "similarity"} & set(CANDIDATES)
    assert {"rigid", "similarity"} < set(VRT_MODELS)
    assert of_option("rigid") == ("rigid",)
    predicted = scattered(1, 200)
    target = observed(truth(0.5), predicted, 5)
    chosen = choose(predicted, target, isotropic(200, SIGMA_PX), 0.0, ("similarity",))
    assert chosen.name == "similarity"
    np.testing.assert_allclose(chosen.sigma(CORNERS) < 0.1, True)


@pytest.mark.parametrize("name", ["rigid", "similarity"])
def test_too_few_points_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"3 tie points for the {name} model, which needs at least 4"):
        MODELS[name].fit(scattered(1, 3), scattered(1, 3), isotropic(3, SIGMA_PX))
