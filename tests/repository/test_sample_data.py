"""The sample pair and the landscape it was made from."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import rasterio
from scipy import ndimage, optimize

SAMPLE_DATA = Path(__file__).resolve().parents[2] / "sample_data"
sys.path.insert(0, str(SAMPLE_DATA))
import landscape as scenery  # noqa: E402
import make_sample_data as sample  # noqa: E402

Image = npt.NDArray[Any]
WINDOW = np.s_[300:396, 280:392]


def measured_shift_px(first: Image, second: Image, border: int = 8) -> Image:
    """Return (col, row) by which the second image's content lies from the first's; the same band in both."""
    inner = np.s_[border:-border, border:-border]
    coefficients = ndimage.spline_filter(np.asarray(second, dtype=float), order=3)
    fixed = np.asarray(first, dtype=float)[inner]

    def residual(shift_xy: Image) -> Image:
        moved = ndimage.shift(coefficients, -np.asarray(shift_xy)[::-1], order=3, prefilter=False)[inner]
        return ((moved - moved.mean()) / moved.std() - (fixed - fixed.mean()) / fixed.std()).ravel()

    return optimize.least_squares(residual, [0.0, 0.0], diff_step=1e-3).x


@pytest.fixture(scope="module")
def undisplaced_b10() -> Image:
    return sample.render_b10(WINDOW, displaced=False, noise=False)


class TestFiles:
    @pytest.mark.parametrize("band", [sample.B4, sample.B10], ids=["b4", "b10"])
    def test_metadata(self, band: sample.Band) -> None:
        with rasterio.open(SAMPLE_DATA / band.file_name) as file:
            assert file.crs.to_epsg() == 32633
            assert file.dtypes == ("uint16",)
            assert file.nodata == 0
            assert file.shape == band.shape
            assert file.res == (30.0, 30.0)
            assert (file.transform.c, file.transform.f) == band.origin_xy_m
            assert "synthetic" in file.descriptions[0]

    def test_together_under_two_megabytes(self) -> None:
        assert sum((SAMPLE_DATA / band.file_name).stat().st_size for band in (sample.B4, sample.B10)) < 2e6

    def test_grids_differ_by_a_fraction_of_a_pixel(self) -> None:
        offset_px = (np.array(sample.B4.origin_xy_m) - sample.B10.origin_xy_m) / sample.PIXEL_M
        np.testing.assert_allclose(offset_px, [3.75, -2.75])

    def test_one_corner_without_data_different_in_the_two_bands(self) -> None:
        shares = []
        for band in (sample.B4, sample.B10):
            with rasterio.open(SAMPLE_DATA / band.file_name) as file:
                empty = file.read(1) == 0
            assert empty[0, -1]
            assert not empty[[0, -1, -1], [0, 0, -1]].any()
            shares.append(empty.mean())
        assert 0.01 < shares[0] < shares[1] < 0.05

    @pytest.mark.parametrize(
        ("band", "render"),
        [(sample.B4, sample.render_b4), (sample.B10, sample.render_b10)],
        ids=["b4", "b10"],
    )
    def test_the_script_makes_these_files(self, band: sample.Band, render: Callable[..., Image]) -> None:
        with rasterio.open(SAMPLE_DATA / band.file_name) as file:
            expected = file.read(1)[WINDOW]
        difference = np.abs(render(WINDOW).astype(int) - expected)
        # Another processor may round the last bit of a float differently: rarely, and by one number.
        assert difference.max() <= 1
        assert (difference > 0).mean() < 1e-3


class TestTruth:
    def test_values_by_hand(self) -> None:
        d = sample.true_displacement_px([[0.0, 0.0], [450.0, 0.0]])
        np.testing.assert_allclose(d[0], [1.3 + 0.3 * np.sin(0.5), -0.8 + 0.3 * np.sin(1.9)])
        np.testing.assert_allclose(d[1, 0], 1.3 - 0.3 * np.sin(0.5))

    def test_predicted_is_the_inverse(self) -> None:
        observed = np.array([[10.0, 20.0], [333.3, 500.1], [700.0, 3.0]])
        predicted = sample.predicted_xy_px(observed)
        np.testing.assert_allclose(predicted + sample.true_displacement_px(predicted), observed, atol=1e-9)

    def test_displaced_against_undisplaced_ground(self, undisplaced_b10: Image) -> None:
        displaced = sample.render_b10(WINDOW, noise=False)
        rows, cols = WINDOW
        centre = [[(cols.start + cols.stop) / 2, (rows.start + rows.stop) / 2]]
        truth = sample.true_displacement_px(centre)[0]
        assert truth[0] > 0.9
        assert truth[1] < -0.4
        np.testing.assert_allclose(measured_shift_px(undisplaced_b10, displaced), truth, atol=0.05)

    def test_the_thermal_sensor_does_not_shift_the_image(self, undisplaced_b10: Image) -> None:
        rows, cols = WINDOW
        origin = (
            sample.B10.origin_xy_m[0] - sample.GROUND_ORIGIN_XY_M[0] + cols.start * sample.PIXEL_M,
            sample.B10.origin_xy_m[1] - sample.GROUND_ORIGIN_XY_M[1] - rows.start * sample.PIXEL_M,
        )
        direct = scenery.landscape(undisplaced_b10.shape, sample.SEED, oversample=2, origin_xy_m=origin)
        blurred = ndimage.gaussian_filter(direct.thermal, 1.2)  # about the blur of the sensor, centred
        np.testing.assert_allclose(measured_shift_px(blurred, undisplaced_b10), 0, atol=0.02)

    def test_the_red_sensor_does_not_shift_the_image(self) -> None:
        rows, cols = WINDOW
        image = sample.render_b4(WINDOW, noise=False)
        origin = (cols.start * sample.PIXEL_M, -rows.start * sample.PIXEL_M)
        direct = scenery.landscape(image.shape, sample.SEED, oversample=2, origin_xy_m=origin)
        np.testing.assert_allclose(measured_shift_px(direct.red, image), 0, atol=0.02)


class TestLandscape:
    def test_same_seed_same_landscape_other_seed_another(self) -> None:
        first, again, other = (scenery.landscape((40, 50), seed) for seed in (3, 3, 4))
        np.testing.assert_array_equal(first.red, again.red)
        np.testing.assert_array_equal(first.thermal, again.thermal)
        assert abs(np.corrcoef(first.thermal.ravel(), other.thermal.ravel())[0, 1]) < 0.9

    def test_a_block_equals_the_same_part_of_the_whole(self) -> None:
        whole = scenery.landscape((420, 60), 3, origin_xy_m=(900.0, -300.0))
        part = scenery.landscape((100, 30), 3, origin_xy_m=(900.0 + 20 * 30, -300.0 - 310 * 30))
        np.testing.assert_allclose(part.red, whole.red[310:410, 20:50], atol=1e-5)
        np.testing.assert_allclose(part.thermal, whole.thermal[310:410, 20:50], atol=1e-3)
        np.testing.assert_array_equal(part.cover, whole.cover[310:410, 20:50])

    def test_grid_and_free_coordinates_agree(self) -> None:
        x_m, y_m = np.linspace(500, 4000, 60)[None, :], np.linspace(-2000, -5000, 50)[:, None]
        grid = scenery.ground(x_m, y_m, 3)
        free = scenery.ground(*np.broadcast_arrays(x_m, y_m), 3)
        np.testing.assert_allclose(free.red, grid.red, atol=1e-4)
        np.testing.assert_allclose(free.thermal, grid.thermal, atol=1e-2)

    def test_bands_share_structures_and_differ(self) -> None:
        scene = scenery.landscape((300, 300), sample.SEED)
        for cover in (scenery.Cover.CROP, scenery.Cover.FOREST):
            inside = scene.cover == cover
            assert abs(np.corrcoef(scene.red[inside], scene.thermal[inside])[0, 1]) < 0.8
        assert scene.thermal[scene.cover == scenery.Cover.WATER].mean() < scene.thermal.mean() - 5

    def test_pixels_are_means_of_their_samples(self) -> None:
        fine = scenery.landscape((60, 60), 3, pixel_m=10.0)
        coarse = scenery.landscape((20, 20), 3, oversample=3)
        np.testing.assert_allclose(coarse.red, fine.red.reshape(20, 3, 20, 3).mean(axis=(1, 3)), rtol=1e-4)

    @pytest.mark.parametrize("options", [{"pixel_m": 0.0}, {"oversample": 0}])
    def test_refuses_what_is_not_positive(self, options: dict[str, Any]) -> None:
        with pytest.raises(ValueError, match="positive"):
            scenery.landscape((4, 4), 1, **options)
