import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from pcwlad_geo.matching.maps import GRADIENTS, oriented_gradients, scene_epsilon
from tests.matching.landscape import Landscape

SIDE = 120
SMOOTH_PX = 0.6


def maps_of(image: NDArray) -> tuple[NDArray, NDArray]:
    return oriented_gradients(image, scene_epsilon(image), SMOOTH_PX)


@pytest.fixture(scope="module")
def image() -> NDArray:
    return Landscape(3).image(SIDE) + np.random.default_rng(0).normal(0, 2, (SIDE, SIDE))


def test_the_maps_are_those_of_the_formula(image: NDArray) -> None:
    low, high = np.percentile(image, (0.05, 99.95))
    dx, dy = (ndimage.sobel(image / (high - low), axis, mode="mirror") for axis in (1, 0))
    square = ndimage.gaussian_filter((dx**2 + dy**2) / 2, GRADIENTS.neighbourhood_px, mode="mirror")
    local = np.sqrt(square) + GRADIENTS.least_strength
    maps, strength = maps_of(image)
    for orientation, found in enumerate(maps):
        theta = orientation * np.pi / 6
        rectified = np.abs(dx * np.cos(theta) - dy * np.sin(theta)) / local
        expected = ndimage.gaussian_filter(rectified, SMOOTH_PX, mode="mirror")
        np.testing.assert_allclose(found, GRADIENTS.scale * expected, atol=1e-3)
    expected = ndimage.gaussian_filter(np.hypot(dx, dy) / local, SMOOTH_PX, mode="mirror") / np.sqrt(2)
    np.testing.assert_allclose(strength, GRADIENTS.strength_scale * expected, atol=1e-3)


@pytest.mark.parametrize(
    ("gain", "offset"), [(0.05, 0.0), (40.0, 1000.0), (-1.0, 255.0), (-1e-4, 0.3)], ids=str
)
def test_gain_offset_and_inversion_leave_the_maps_unchanged(
    image: NDArray, gain: float, offset: float
) -> None:
    expected, found = maps_of(image), maps_of(gain * image + offset)
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_allclose(other, one, atol=1e-5)


@pytest.mark.parametrize("dtype", ["uint16", "int16", "float32"])
def test_data_types_of_one_scene_give_the_same_maps(image: NDArray, dtype: str) -> None:
    whole = np.clip(np.round(image), 0, 255)
    for one, other in zip(maps_of(whole), maps_of((whole * 100).astype(dtype)), strict=True):
        np.testing.assert_allclose(other, one, atol=1e-5)


@pytest.mark.parametrize("turn", range(4))
def test_an_edge_shows_in_the_orientation_across_it(turn: int) -> None:
    image = np.zeros((SIDE, SIDE))
    image[:, SIDE // 2 :] = 100.0
    maps, strength = maps_of(np.rot90(image, turn))
    middle = maps[:, 40:80, 40:80].max(axis=(1, 2))
    assert middle.argmax() == (0 if turn % 2 == 0 else 3)
    assert middle.min() < 0.01 * middle.max()
    assert strength[10:30, 10:30].max() == 0


def test_weak_edges_gain_on_strong_ones_down_to_the_scene_s_least() -> None:
    image = np.zeros((SIDE, SIDE))
    image[:, 30:60] = 1.0
    image[:, 60:] = 9.0
    image[:, 90:] = 9.01
    _, strength = maps_of(image)
    across = [strength[60, col - 4 : col + 4].max() for col in (30, 60, 90)]
    assert across[0] > 2.5 / 8 * across[1]
    assert across[2] < 0.05 * across[1]


@pytest.mark.parametrize("epsilon", [0.0, 1e-4])
def test_a_constant_image_has_no_structure(epsilon: float) -> None:
    for found in oriented_gradients(np.full((64, 64), 7.0), epsilon, SMOOTH_PX):
        np.testing.assert_array_equal(found, 0)
