from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pcwlad_geo.matching.noise import NOISE, Noise, measure_noise, smoothing_px

SHAPE = (300, 280)
EVERYWHERE = np.ones(SHAPE, bool)


def scene() -> np.ndarray:
    return 60 * gaussian_filter(np.random.default_rng(1).normal(size=SHAPE), 2.5) / 0.11


def test_white_noise_has_a_ratio_of_two_and_its_sigma() -> None:
    noise = measure_noise(np.random.default_rng(0).normal(100, 7.0, SHAPE), EVERYWHERE)
    assert noise.ratio == pytest.approx(2.0, abs=0.05)
    assert noise.sigma == pytest.approx(7.0, rel=0.05)
    assert smoothing_px(noise) == pytest.approx(NOISE.most_smoothing_px, abs=0.03)


def test_a_clean_scene_has_none() -> None:
    noise = measure_noise(scene(), EVERYWHERE)
    assert noise.ratio < 0.8
    assert noise.sigma == 0.0
    assert smoothing_px(noise) == NOISE.least_smoothing_px


def test_noise_on_a_scene_grows_with_it() -> None:
    added = np.random.default_rng(2).normal(size=SHAPE)
    found = [measure_noise(scene() + sigma * added, EVERYWHERE) for sigma in (0.0, 20.0, 60.0)]
    assert found[0].ratio < found[1].ratio < found[2].ratio
    assert found[2].sigma == pytest.approx(60.0, rel=0.25)


def test_units_and_inversion_do_not_matter() -> None:
    image = scene() + np.random.default_rng(3).normal(0, 10, SHAPE)
    noise, other = measure_noise(image, EVERYWHERE), measure_noise(1000 - 30 * image, EVERYWHERE)
    assert other.ratio == pytest.approx(noise.ratio, rel=1e-9)
    assert other.sigma == pytest.approx(30 * noise.sigma, rel=1e-9)


def test_invalid_pixels_do_not_count() -> None:
    valid = EVERYWHERE.copy()
    valid[100:160, 40:200] = False
    image = scene()
    spoilt = np.where(valid, image, np.random.default_rng(4).normal(0, 1e4, SHAPE))
    assert measure_noise(spoilt, valid).ratio == pytest.approx(measure_noise(image, valid).ratio, rel=1e-9)
    assert measure_noise(image, np.zeros(SHAPE, bool)) == Noise()


def test_the_noisier_image_decides() -> None:
    quiet, loud = Noise(0.5, 0.0), Noise(1.4, 3.0)
    assert smoothing_px(quiet, loud) == smoothing_px(loud) > smoothing_px(quiet) == NOISE.least_smoothing_px
