import numpy as np
import pytest

from pcwlad_geo.matching.calibration import CALIBRATION, calibrated, sigma_scale


def formal(n: int, seed: int = 0) -> np.ndarray:
    """Covariances of different size and shape."""
    root = np.random.default_rng(seed).normal(0, 0.03, (n, 2, 2)) + 0.03 * np.eye(2)
    return root @ np.swapaxes(root, 1, 2) + 1e-4 * np.eye(2)


def drawn(covariance: np.ndarray, seed: int = 1) -> np.ndarray:
    normal = np.random.default_rng(seed).normal(size=(len(covariance), 2))
    return np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), normal)


@pytest.mark.parametrize("scale", [2.0, 5.0, 9.0])
def test_the_factor_between_formal_and_real_errors_comes_back(scale: float) -> None:
    covariance = formal(2000)
    residual = scale * drawn(covariance)
    assert sigma_scale(residual, covariance) == pytest.approx(scale, rel=0.05)


def test_gross_errors_and_unknown_residuals_do_not_change_it() -> None:
    covariance = formal(2000)
    residual = 4.0 * drawn(covariance)
    residual[::20] = 30.0
    residual[1::20] = np.nan
    assert sigma_scale(residual, covariance) == pytest.approx(4.0, rel=0.1)


def test_too_few_residuals_say_nothing() -> None:
    covariance = formal(40)
    residual = drawn(covariance)
    residual[:20] = np.nan
    assert sigma_scale(residual, covariance) == CALIBRATION.default_scale


def test_the_factor_stays_within_reason() -> None:
    covariance = formal(200)
    assert sigma_scale(0.01 * drawn(covariance), covariance) == CALIBRATION.scale_range[0]
    assert sigma_scale(500 * drawn(covariance), covariance) == CALIBRATION.scale_range[1]


def test_calibrated_intervals_hold() -> None:
    covariance = formal(4000)
    residual = 4.0 * drawn(covariance)
    sigma = np.sqrt(np.diagonal(calibrated(covariance, sigma_scale(residual, covariance)), axis1=1, axis2=2))
    assert (np.abs(residual) < sigma).mean() == pytest.approx(0.68, abs=0.04)
    assert (np.abs(residual) < 1.96 * sigma).mean() == pytest.approx(0.95, abs=0.02)


def test_no_sigma_is_below_the_floor_and_correlations_stay() -> None:
    covariance = np.array([[[0.04, 0.02], [0.02, 0.09]], [[0.0, 0.0], [0.0, 0.0]]])
    found = calibrated(covariance, 2.0)
    np.testing.assert_allclose(found[0], 4 * covariance[0] + CALIBRATION.least_sigma_px**2 * np.eye(2))
    np.testing.assert_allclose(found[1], CALIBRATION.least_sigma_px**2 * np.eye(2))
