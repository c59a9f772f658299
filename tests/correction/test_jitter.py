"""Jitter: waves along rows or columns are found with their amplitude, and chance makes none."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.correction.fit import CANDIDATES, MODELS
from pcwlad_geo.correction.jitter import Peak, peaks, profile, without_trend
from pcwlad_geo.correction.reading import from_dict
from pcwlad_geo.correction.waves import JitterCorrection
from pcwlad_geo.errors import InputError

from .points import isotropic, noise, scattered, window_noise

Array = NDArray[np.float64]
SIDE, WINDOW, PERIOD, AMPLITUDE = 2048, 81, 200.0, 0.05
NODES = (np.arange(WINDOW) - WINDOW // 2).astype(float)


def jitter(rows: Array, amplitude: float = AMPLITUDE, seen: bool = True) -> Array:
    """Return (n, 2) displacements in column that depend on the row: as windows see them, or as they are."""
    nodes = NODES if seen else np.zeros(1)
    wave = np.mean([np.sin(2 * np.pi * (rows + node) / PERIOD + 0.7) for node in nodes], axis=0)
    return np.stack([amplitude * wave, np.zeros_like(wave)], axis=1)


@cache
def erring(seed: int, n: int) -> tuple[Array, Array]:
    """Return positions and their errors, which several tests take."""
    at = scattered(seed, n, SIDE)
    return at, 0.05 * (0.8 * window_noise(seed, at, SIDE, WINDOW) + 0.6 * noise(seed, n, 1.0))


def points(seed: int, amplitude: float, n: int = 1000) -> tuple[Array, Array]:
    """Return positions, and displacements with errors of 0.05 px that windows share in part."""
    at, errors = erring(seed, n)
    return at, jitter(at[:, 1], amplitude) + errors + [1.3, -0.4]


def oblique_waves(seed: int, at_px: Array, size_px: float, wavelength_px: float) -> Array:
    """Return (n, 2) displacements that wave in a direction which is that of neither rows nor columns."""
    random = np.random.default_rng([7, seed])
    turn = np.pi / 4 + random.uniform(-0.35, 0.35) + np.pi / 2 * random.integers(2)
    along = at_px @ np.array([np.cos(turn), np.sin(turn)]) / wavelength_px
    return np.asarray(size_px * np.sin(2 * np.pi * along[:, None] + random.uniform(0, 2 * np.pi, 2)))


def found_in(seed: int, amplitude: float, beside: float = 0.0) -> list[Peak]:
    at, moved = points(seed, amplitude)
    moved = moved + oblique_waves(seed, at, beside, 700)
    return [each for each in peaks(at, without_trend(at, moved), WINDOW) if each.significant]


@pytest.mark.parametrize("seeds", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_jitter_of_0_05_px_is_found_to_0_01_px(seeds: int) -> None:
    for seed in range(seeds):
        (wave,) = found_in(seed, AMPLITUDE)
        assert (wave.along, wave.of) == ("row", "column")
        assert wave.amplitude_px == pytest.approx(AMPLITUDE, abs=0.01)
        assert wave.period_px == pytest.approx(PERIOD, rel=0.02)
        assert abs(wave.amplitude_px - AMPLITUDE) < 4 * wave.sigma_px < 0.03


@pytest.mark.parametrize("beside", [0.0, 0.1])
@pytest.mark.parametrize("seeds", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_no_jitter_is_found_where_there_is_none(seeds: int, beside: float) -> None:
    assert [found_in(seed, 0.0, beside) for seed in range(seeds)] == [[]] * seeds


def test_the_model_takes_it_out() -> None:
    at, moved = points(3, AMPLITUDE)
    fit = MODELS["jitter"].fit(at, at + moved, isotropic(len(at), 0.05), footprint_px=WINDOW)
    plain = MODELS["affine"].fit(at, at + moved, isotropic(len(at), 0.05), footprint_px=WINDOW)
    rows = np.linspace(100, 1900, 300)
    places = np.stack([np.full_like(rows, 1000.0), rows], axis=1)
    truth = places + jitter(rows, seen=False) + np.array([1.3, -0.4])
    missed, left = (each.correction.forward(places) - truth for each in (fit, plain))
    assert np.sqrt((missed**2).mean(axis=0)).max() < 0.015
    assert np.sqrt((left[:, 0] ** 2).mean()) > 0.03
    there = fit.correction.forward(places)
    np.testing.assert_allclose(fit.correction.inverse(there), places, atol=1e-7)
    again = from_dict(json.loads(json.dumps(fit.correction.to_dict())))
    np.testing.assert_array_equal(again.forward(places), there)


def test_without_jitter_the_model_is_the_affine() -> None:
    at, moved = points(4, 0.0)
    fit, plain = (
        MODELS[name].fit(at, at + moved, isotropic(len(at), 0.05), footprint_px=WINDOW)
        for name in ("jitter", "affine")
    )
    assert isinstance(fit.correction, JitterCorrection)
    assert fit.correction.waves == ()
    np.testing.assert_allclose(fit.correction.forward(at), plain.correction.forward(at), atol=1e-6)
    assert "jitter" not in CANDIDATES


def test_a_damaged_wave_is_refused() -> None:
    wave = {"along": "up", "period": 200.0, "origin": 0.0, "coefficients": [[0, 0], [0, 0]]}
    forward = {"type": "jitter", "matrix": [[1, 0, 0], [0, 1, 0]], "waves": [wave]}
    for change in ({}, {"along": "row", "period": 0.0}, {"along": "row", "origin": float("nan")}):
        with pytest.raises(InputError, match="no correction model"):
            from_dict({"name": "jitter", "forward": {**forward, "waves": [wave | change]}})


def test_a_profile_shows_the_wave_within_its_band() -> None:
    at, moved = points(5, 0.2, 3000)
    found = profile(at[:, 1], at[:, 0], moved - moved.mean(axis=0), WINDOW / 2)
    mean, band = np.array(found.mean_px), np.array(found.band_px)
    truth = jitter(np.array(found.place), 0.2)
    inside = np.abs(mean - truth) < band + 0.02  # a mean over an interval of 43 rows loses a little
    assert inside.mean() > 0.9
    assert (np.abs(mean[:, 0]) > band[:, 0]).mean() > 0.6
    assert profile(at[:9, 1], at[:9, 0], moved[:9], 40.0).place == ()
