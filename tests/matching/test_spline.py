import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import spline_filter

from pcwlad_geo.matching import refinement as spline


def spline_coefficients(image: NDArray) -> NDArray:
    result = np.full(image.shape, np.nan, np.float32)
    spline.spline_coefficients(image, result)
    return result


@pytest.mark.parametrize("shape", [(200, 160), (57, 301), (40, 9), (5, 60), (2, 30)], ids=str)
def test_coefficients_are_those_of_the_recursive_filter(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(1).random(shape, np.float32)
    expected = spline_filter(image.astype(np.float64), 3, mode="mirror")
    np.testing.assert_allclose(spline_coefficients(image), expected, atol=1e-6 * np.ptp(expected))


@pytest.mark.parametrize("gain", [1e-6, 5e4])
def test_the_error_is_relative_to_the_range(gain: float) -> None:
    image = (gain * np.random.default_rng(2).random((90, 80))).astype(np.float32)
    expected = spline_filter(image.astype(np.float64), 3, mode="mirror")
    np.testing.assert_allclose(spline_coefficients(image), expected, atol=1e-6 * np.ptp(expected))


def test_a_constant_is_its_own_spline() -> None:
    np.testing.assert_allclose(spline_coefficients(np.full((30, 40), 0.3, np.float32)), 0.3, rtol=3e-7)
