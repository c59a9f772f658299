"""Simulated speckle: gamma distributed power of mean 1, as fully developed speckle has it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter

from pcwlad_geo.matching.matcher import match_arrays
from pcwlad_geo.matching.noise import NOISE, measure_noise, smoothing_px
from pcwlad_geo.matching.speckle import find_speckle, has_empty_border
from pcwlad_geo.matching.types import MatchSettings

SIDE = 320
EVERYWHERE = np.ones((SIDE, SIDE), bool)


def fields(seed: int, moved_px: tuple[int, int] = (0, 0)) -> NDArray:
    """Backscatter of fields, of power -20 to -5 dB; `moved_px` are rows and columns."""
    level = gaussian_filter(np.random.default_rng(seed).normal(size=(SIDE + 40, SIDE + 40)), 20)
    steps = np.digitize(level, np.quantile(level, np.linspace(0, 1, 9)[1:-1]))
    power = uniform_filter(10 ** (np.random.default_rng(seed + 1).uniform(-2, -0.5, 9)[steps]), 2)
    row, col = 20 - moved_px[0], 20 - moved_px[1]
    return power[row : row + SIDE, col : col + SIDE]


def speckled(power: NDArray, looks: int, seed: int = 0) -> NDArray:
    return power * np.random.default_rng(seed).gamma(looks, 1 / looks, power.shape)


def in_db(power: NDArray) -> NDArray:
    return 10 * np.log10(power)


FORMS: dict[str, Callable[[NDArray], NDArray]] = {
    "decibels": in_db,
    "amplitude": np.sqrt,
    "power": np.asarray,
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("looks", [1, 2, 4])
def test_speckle_tells_its_looks_and_what_the_values_are(form: str, looks: int) -> None:
    found = find_speckle([(FORMS[form](speckled(fields(1), looks)), EVERYWHERE)])
    assert found is not None
    assert found.form == form
    assert found.looks == pytest.approx(looks, rel=0.3)


def test_units_do_not_matter_and_samples_are_taken_together() -> None:
    amplitude = np.sqrt(speckled(fields(1), 1))
    counts = np.rint(3000 * amplitude)  # as GRD products have them
    found = find_speckle([(part, np.ones(part.shape, bool)) for part in np.split(counts, 4)])
    assert found is not None
    assert found.form == "amplitude"


OTHER_NOISE: dict[str, Callable[[NDArray, np.random.Generator], NDArray]] = {
    "none": lambda scene, rng: scene,
    "added": lambda scene, rng: scene + rng.normal(0, 0.02, scene.shape),
    "much added, of both signs": lambda scene, rng: scene - 0.1 + rng.normal(0, 0.3, scene.shape),
    "as strong in decibels": lambda scene, rng: in_db(scene) + rng.normal(0, 2.0, scene.shape),
    "photons": lambda scene, rng: rng.poisson(60 * scene).astype(float),
    "a picture of speckle": lambda scene, rng: np.minimum(np.rint(300 * np.sqrt(speckled(scene, 1))), 255),
    "many looks": lambda scene, rng: speckled(scene, 40),
}


@pytest.mark.parametrize("name", OTHER_NOISE)
def test_other_noise_is_no_speckle(name: str) -> None:
    image = OTHER_NOISE[name](fields(1), np.random.default_rng(2))
    assert measure_noise(image, EVERYWHERE).speckle is None


def test_too_little_is_no_speckle() -> None:
    image, valid = speckled(fields(1), 1), np.zeros_like(EVERYWHERE)
    valid[:50, :50] = True
    assert find_speckle([(image, valid)]) is None
    assert find_speckle([]) is None


def test_speckle_is_averaged_and_maps_are_smoothed_where_pixels_are_independent() -> None:
    noise = measure_noise(speckled(fields(1), 1), EVERYWHERE)
    together = measure_noise(uniform_filter(speckled(fields(1), 1), (1, 2)), EVERYWHERE)
    assert noise.speckle is not None
    assert noise.speckle.scale == "averaged"
    assert smoothing_px(noise) == pytest.approx(NOISE.most_smoothing_px, abs=0.1)
    assert together.speckle is not None
    assert together.speckle.scale == "root"


@pytest.mark.parametrize("form", FORMS)
def test_of_some_looks_all_forms_become_decibels(form: str) -> None:
    power = speckled(fields(1), 4)
    noise = measure_noise(FORMS[form](power), EVERYWHERE)
    assert noise.speckle is not None
    np.testing.assert_allclose(
        noise.speckle.stabilised(FORMS[form](power), EVERYWHERE), in_db(power), rtol=1e-6
    )


def test_what_is_stabilised_has_the_same_noise_everywhere_and_keeps_the_ground() -> None:
    noise = measure_noise(in_db(speckled(fields(1), 1)), EVERYWHERE)
    assert noise.speckle is not None
    stabilised = noise.speckle.stabilised(in_db(speckled(fields(1), 1)), EVERYWHERE)
    assert np.corrcoef(stabilised.ravel(), np.cbrt(fields(1)).ravel())[0, 1] > 0.9
    assert noise.speckle.epsilon > 0


def test_invalid_pixels_do_not_reach_their_neighbours() -> None:
    power, valid = speckled(fields(1), 1), EVERYWHERE.copy()
    valid[100:200, 100:200] = False
    speckle = measure_noise(power, valid).speckle
    assert speckle is not None
    spoilt = np.where(valid, power, 1e6)
    np.testing.assert_allclose(speckle.stabilised(spoilt, valid), speckle.stabilised(power, valid))


def test_zeros_along_the_border_are_no_data_and_single_ones_are() -> None:
    amplitude = np.sqrt(speckled(fields(1), 2))
    amplitude[250, 160] = 0.0
    assert not has_empty_border(amplitude, EVERYWHERE)
    ragged = (30 + 10 * np.sin(np.arange(SIDE) / 9)).astype(int)  # as terrain correction leaves it
    empty = np.arange(SIDE)[:, None] < ragged
    amplitude[empty] = 0.0
    speckle = measure_noise(amplitude, EVERYWHERE).speckle
    assert speckle is not None
    assert speckle.empty_border
    known = speckle.known(amplitude, EVERYWHERE)
    assert (known & empty).mean() < 1e-3
    assert known[250, 160]
    assert known[~empty].all()


def test_all_forms_of_one_look_match_alike_and_right() -> None:
    moved = (2, -3)
    settings = MatchSettings(features=60, template=81, search_radius=8)
    optical = 3000 - 900 * np.log10(fields(1)) + np.random.default_rng(5).normal(0, 20, (SIDE, SIDE))
    power = speckled(fields(1, moved), 1)
    found = [match_arrays(optical, form(power), settings=settings) for form in FORMS.values()]
    for points in found:
        assert len(points) >= 15
        np.testing.assert_allclose(np.median(points.displacement_px, axis=0), moved[::-1], atol=0.4)
        assert len(points) == len(found[0])
        np.testing.assert_allclose(points.target_xy_px, found[0].target_xy_px, atol=1e-3)
