import numpy as np
import pytest

from pcwlad_geo.matching.gaps import fill_smoothly


def wavy(rows: int = 200, cols: int = 231) -> np.ndarray:
    y, x = np.mgrid[:rows, :cols]
    return 1000 + 200 * np.sin(x / 40) + 150 * np.cos(y / 35)


def masked(rows: int = 200, cols: int = 231) -> np.ndarray:
    y, x = np.mgrid[:rows, :cols]
    hole = (y > 60) & (y < 130) & (x > 80) & (x < 170)
    scattered = np.random.default_rng(4).random((rows, cols)) < 0.05
    return ~(hole | (x + y < 90) | scattered)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_valid_pixels_are_untouched_and_the_rest_is_finite(dtype: type) -> None:
    valid = masked()
    image = np.where(valid, wavy(), np.nan).astype(dtype)
    before = image.copy()
    filled = fill_smoothly(image, valid)
    assert filled.dtype == dtype
    np.testing.assert_array_equal(filled[valid], image[valid])
    np.testing.assert_array_equal(image, before)
    assert np.isfinite(filled).all()


def test_no_step_at_the_seam_and_none_inside() -> None:
    image, valid = wavy(), masked()
    filled = fill_smoothly(np.where(valid, image, 1e6), valid)
    steepest = max(np.abs(np.diff(image, axis=axis)).max() for axis in (0, 1))
    for axis in (0, 1):
        assert np.abs(np.diff(filled, axis=axis)).max() < 2.0 * steepest


def test_the_fill_stays_within_the_range_of_the_valid_pixels() -> None:
    image, valid = wavy(), masked()
    filled = fill_smoothly(image, valid)
    assert filled.min() >= image[valid].min() - 1e-6
    assert filled.max() <= image[valid].max() + 1e-6


def test_scattered_gaps_are_interpolated() -> None:
    image = wavy()
    valid = np.random.default_rng(5).random(image.shape) > 0.1
    # The waves turn through about 2 units over two pixels; at the border the fill must extrapolate.
    error = np.abs(fill_smoothly(image, valid) - image)
    assert np.sqrt((error[~valid] ** 2).mean()) < 1.0
    assert error.max() < 10.0


def test_a_constant_is_continued_exactly() -> None:
    valid = masked()
    np.testing.assert_array_equal(fill_smoothly(np.full(valid.shape, 7.25), valid), 7.25)


def test_far_pixels_do_not_change_a_small_gap() -> None:
    image, valid = wavy(256, 256), np.ones((256, 256), bool)
    valid[60:64, 60:64] = False
    valid[150:230, 140:230] = False
    changed, gap = image.copy(), np.s_[60:64, 60:64]
    changed[240:, :] += 500
    np.testing.assert_allclose(
        fill_smoothly(changed, valid)[gap], fill_smoothly(image, valid)[gap], atol=1e-6
    )


def test_nothing_valid_gives_zeros_and_all_valid_a_copy() -> None:
    image = np.full((9, 5), np.nan, np.float32)
    np.testing.assert_array_equal(fill_smoothly(image, np.zeros((9, 5), bool)), 0)
    whole = wavy(9, 5)
    filled = fill_smoothly(whole, np.ones((9, 5), bool))
    np.testing.assert_array_equal(filled, whole)
    assert filled is not whole


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (3, 2), (17, 1)])
def test_thin_images(shape: tuple[int, int]) -> None:
    valid = np.zeros(shape, bool)
    valid[0, 0] = True
    np.testing.assert_allclose(fill_smoothly(np.full(shape, 3.0), valid), 3.0)
