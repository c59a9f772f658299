"""The scenes of the speed benchmark: the same ground at any size, displaced as the truth says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from benchmarks.speed_studies import scene_files
from benchmarks.speed_studies.coordinate_noise import add_noise, add_pixel_noise
from benchmarks.speed_studies.land import RED, THERMAL, land_row
from benchmarks.speed_studies.scene_files import displacement_px, make_pair, predicted_px, strip


def test_the_inverse_of_the_displacement_is_exact() -> None:
    observed = np.random.default_rng(1).uniform(0, 16384, (1000, 2))
    predicted = predicted_px(observed)
    np.testing.assert_allclose(predicted + displacement_px(predicted), observed, atol=1e-7)


def test_the_displacement_is_smooth_and_reaches_one_and_a_half_pixels() -> None:
    grid = np.stack(np.meshgrid(np.arange(0, 16384, 16.0), np.arange(0, 16384, 16.0)), axis=-1)
    field = displacement_px(grid)
    largest = np.abs(field).max(axis=(0, 1))
    assert (largest > 1.4).all()
    assert (largest < 1.7).all()
    assert max(np.abs(np.diff(field, axis=axis)).max() for axis in (0, 1)) / 16 < 0.004


@pytest.mark.slow
@pytest.mark.parametrize("band", [RED, THERMAL])
def test_a_small_scene_is_the_corner_of_a_large_one(band: int) -> None:
    large = strip(band, 0, 40, 300)
    np.testing.assert_array_equal(strip(band, 0, 40, 90), large[:, :90])
    np.testing.assert_array_equal(strip(band, 25, 15, 300), large[25:])


@pytest.mark.slow
def test_the_thermal_band_shows_the_ground_where_the_displacement_puts_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(scene_files, "NOISE_DN", (0.0, 0.0))
    image = strip(THERMAL, 700, 1, 400)[0].astype(float)
    observed = np.stack([np.arange(400) + 0.5, np.full(400, 700.5)], axis=-1)
    predicted = predicted_px(observed)
    here, there = (
        land_row(np.ascontiguousarray(px[:, 0]), np.ascontiguousarray(px[:, 1]), THERMAL, scene_files.SEED)
        for px in (observed, predicted)
    )
    kelvin = (image - 24000) / 220
    np.testing.assert_allclose(kelvin, there, atol=0.5 / 220 + 1e-9)
    assert np.abs(kelvin - here).max() > 1.0


def test_the_bands_are_not_functions_of_one_another() -> None:
    x = np.arange(512) + 0.5
    red, thermal = (
        np.stack([land_row(x, np.full(512, y + 0.5), band, scene_files.SEED) for y in range(0, 512, 8)])
        for band in (RED, THERMAL)
    )
    # the spread of one band among pixels that are alike in the other
    order = np.argsort(red.ravel())
    within = thermal.ravel()[order].reshape(64, -1).std(axis=1).mean()
    assert 0.2 * thermal.std() < within < 0.9 * thermal.std()
    assert 0.4 < np.corrcoef(red.ravel(), thermal.ravel())[0, 1] < 0.9


def test_noise_has_unit_spread_and_its_slopes_are_derivatives() -> None:
    x = np.random.default_rng(2).uniform(0, 1e5, 20000)
    out = np.zeros((6, len(x)), np.float32)
    add_noise(x, x[::-1].copy(), 64.0, 7, np.ones(4, np.float32), out)
    assert out[:4].mean(axis=1) == pytest.approx(0, abs=0.03)
    assert out[:4].std(axis=1) == pytest.approx(1, abs=0.03)
    assert np.abs(np.corrcoef(out[:4]) - np.eye(4)).max() < 0.03
    t = np.arange(200) * 0.5
    along = np.zeros((6, 200), np.float32)
    add_noise(t, np.full(200, 11.0), 64.0, 7, np.ones(4, np.float32), along)
    np.testing.assert_allclose(along[4, 1:-1], (along[0, 2:] - along[0, :-2]), atol=2e-3)


def test_pixel_noise_is_white_and_depends_on_the_pixel_alone() -> None:
    rows = np.zeros((64, 500))
    for row, values in enumerate(rows):
        add_pixel_noise(values, row, 3, 2.0)
    assert rows.std() == pytest.approx(2.0, rel=0.02)
    assert abs(np.mean(rows[:, 1:] * rows[:, :-1])) < 0.1
    again = np.zeros(20)
    add_pixel_noise(again, 5, 3, 2.0)
    np.testing.assert_array_equal(again, rows[5, :20])


def test_files_are_tiled_compressed_and_made_once(tmp_path: Path) -> None:
    pair = make_pair(tmp_path, 256)
    with rasterio.open(pair.target) as file:
        assert (file.shape, file.dtypes, file.nodata) == ((256, 256), ("uint16",), 0)
        assert file.profile["compress"] == "deflate"
        np.testing.assert_array_equal(file.read(1)[130:140], strip(THERMAL, 130, 10, 256))
    pair.reference.write_bytes(b"kept")
    assert make_pair(tmp_path, 256) == pair
    assert pair.reference.read_bytes() == b"kept"


def test_large_scenes_have_overviews(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_files, "OVERVIEWS_FROM_PX", 512)
    with rasterio.open(make_pair(tmp_path, 1024).reference) as file:
        assert file.overviews(1) == [2, 4]
