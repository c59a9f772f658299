from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from phasepack import phasecong

from pcwlad_geo.matching.kernels.library import fast_even
from pcwlad_geo.matching.maps import maximum_moment, oriented_phase_congruency, scene_epsilon
from pcwlad_geo.matching.paper import PAPER
from tests.matching.landscape import Landscape
from tests.oracles.phase_congruency import (
    maximum_moment_plain,
    oriented_phase_congruency_plain,
)

SIDE = 160


def moment(image: NDArray, epsilon: float | None = None) -> NDArray:
    return maximum_moment(
        oriented_phase_congruency(image, scene_epsilon(image) if epsilon is None else epsilon)
    )


def correlation(first: NDArray, second: NDArray) -> float:
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


@pytest.fixture(scope="module")
def image() -> NDArray:
    return Landscape(3).image(SIDE) + np.random.default_rng(0).normal(0, 2, (SIDE, SIDE))


@pytest.mark.parametrize("crop", [np.s_[:, :], np.s_[:, :131], np.s_[:97, :]])
def test_the_map_is_that_of_phasepack(image: NDArray, crop: tuple[slice, slice]) -> None:
    expected = phasecong(image[crop], 4, 6, 3, 1.6, 0.75, k=1, cutOff=0.5, g=3, noiseMethod=0)[0]
    found = moment(image[crop], PAPER.byte_epsilon)
    assert correlation(found, expected) >= 0.99999
    np.testing.assert_allclose(found, expected, atol=2e-3)


@pytest.mark.parametrize(
    ("gain", "offset"), [(0.05, 0.0), (40.0, 1000.0), (-1.0, 255.0), (-1e-4, 0.3)], ids=str
)
def test_gain_offset_and_inversion_leave_the_maps_unchanged(
    image: NDArray, gain: float, offset: float
) -> None:
    other = gain * image + offset
    expected = oriented_phase_congruency(image, scene_epsilon(image))
    found = oriented_phase_congruency(other, scene_epsilon(other))
    assert np.abs(found - expected).max() < 1e-3


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "float32", "float64"])
def test_data_types_of_one_scene_give_the_same_map(image: NDArray, dtype: str) -> None:
    whole = np.clip(np.round(image), 0, 255)
    units = {"uint16": (257, 0), "int16": (120, -15000), "float32": (1 / 255, 0), "float64": (0.01, 273.15)}
    gain, offset = units.get(dtype, (1, 0))
    stored = (whole * gain + offset).astype(dtype)
    assert np.abs(moment(stored) - moment(whole)).max() < 2e-3


def test_epsilon_follows_the_range_of_the_valid_pixels(image: NDArray) -> None:
    valid = np.ones(image.shape, bool)
    valid[:20] = False
    spoilt = np.where(valid, image, 65535.0)
    assert scene_epsilon(spoilt, valid) == pytest.approx(scene_epsilon(image[20:]))
    assert scene_epsilon(10 * image) == pytest.approx(10 * scene_epsilon(image))
    assert scene_epsilon(np.full((9, 9), 4.0)) == 0.0
    assert scene_epsilon(image, np.zeros(image.shape, bool)) == 0.0


def test_epsilon_ignores_single_extreme_pixels(image: NDArray) -> None:
    spoilt = image.copy()
    spoilt[80, 80] = 1e6
    assert scene_epsilon(spoilt) == pytest.approx(scene_epsilon(image), rel=0.05)


@pytest.mark.parametrize("crop", [np.s_[:, :], np.s_[:, :131], np.s_[:97, :], np.s_[:97, :131]])
def test_the_maps_are_those_of_the_plain_equations(image: NDArray, crop: tuple[slice, slice]) -> None:
    part = image[crop]
    epsilon = scene_epsilon(part)
    expected = oriented_phase_congruency_plain(part, epsilon)
    np.testing.assert_allclose(oriented_phase_congruency(part, epsilon), expected, atol=2e-5)
    rows, cols = part.shape[0] - 7, part.shape[1] - 3
    found = oriented_phase_congruency(part, epsilon, (rows, cols))
    np.testing.assert_allclose(found, expected[:, :rows, :cols], atol=2e-5)


@pytest.mark.parametrize("shape", [(144, 150), (33, 20), (32, 48), (77, 130)], ids=str)
def test_the_maps_of_flat_and_faint_parts_are_those_of_the_plain_equations(shape: tuple[int, int]) -> None:
    part = np.random.default_rng(5).normal(size=shape)
    part[10:20] = 0.0
    part[20:30] *= 1e-3
    found = oriented_phase_congruency(part, 1e-3)
    np.testing.assert_allclose(found, oriented_phase_congruency_plain(part, 1e-3), atol=2e-5)


def test_the_compiled_moment_equals_its_plain_twin() -> None:
    maps = np.random.default_rng(6).random((6, 37, 41), np.float32)
    np.testing.assert_allclose(maximum_moment(maps), maximum_moment_plain(maps), atol=1e-6)
    np.testing.assert_array_equal(maximum_moment(maps[:, 5:30, 2:]), maximum_moment(maps)[5:30, 2:])


def test_a_step_edge_is_found_where_it_is_in_the_orientation_across_it() -> None:
    image = np.zeros((128, 128))
    image[:, 64:] = 100.0
    maps = oriented_phase_congruency(image, scene_epsilon(image))
    middle = maps[:, 40:90, 32:96].mean(axis=1)
    assert middle.argmax() // middle.shape[1] == 0
    assert middle[0].argmax() + 32 in (63, 64)
    assert maps.min() >= 0
    assert maps.max() <= 1


def test_a_constant_image_has_no_structure() -> None:
    assert moment(np.full((64, 64), 7.0), 1e-4).max() < 1e-3
    assert moment(np.full((64, 64), 7.0), 0.0).max() < 1e-3


def test_the_moment_of_one_orientation_is_its_square() -> None:
    maps = np.zeros((6, 8, 8), np.float32)
    maps[2] = 0.6
    # c + s = PC²/3 each way, and the root gives the same again
    np.testing.assert_allclose(maximum_moment(maps), 0.36 / 3, atol=1e-4)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_the_authors_map_comes_back(shared_data: Path) -> None:
    folder = shared_data / "paper" / "uav_1"
    with rasterio.open(folder / "DJI_20240707112018_0002_Z.JPG") as visible:
        red = visible.read(1)
    with rasterio.open(folder / "Sen_PC.tif") as published:
        expected = published.read(1)
    assert red.shape == expected.shape
    assert correlation(moment(red.astype(float)), expected) >= 0.99


@pytest.mark.parametrize(("least", "length"), [(1, 2), (2, 2), (7, 8), (255, 256), (257, 270), (2187, 2250)])
def test_lengths_are_even_and_of_factors_2_3_and_5(least: int, length: int) -> None:
    assert fast_even(least) == length
