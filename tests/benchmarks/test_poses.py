"""Known poses: truths, the family of rotations, drawn warps, warped images."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from benchmarks.poses import (
    MAX_SHEAR,
    MAX_SHIFT,
    SCALES,
    Warp,
    draw_warp,
    grid_px,
    inside,
    mapped,
    mean_distance_px,
    mutual_information,
    nearest_rotation,
    read_similarity,
    share_of,
    spread_sample,
    warp_image,
)


def test_similarity_of_pixel_centres_becomes_corner_based(tmp_path: Path) -> None:
    # doubles 0-based centres and adds (10, 20): the first centre, (0.5, 0.5) here, goes to (10.5, 20.5)
    (tmp_path / "gt.txt").write_text("  2.0  0.0  10.0\n  0.0  2.0  20.0\n")
    at_px = np.array([[0.5, 0.5], [3.5, 1.5]])
    np.testing.assert_allclose(
        mapped(read_similarity(tmp_path / "gt.txt"), at_px), [[10.5, 20.5], [16.5, 22.5]]
    )


def test_nearest_rotation_of_a_rotation_is_itself() -> None:
    at_px = grid_px((256, 256))
    angle = math.radians(137.0)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    found = (at_px - 128.5) @ turn.T + 128.5
    np.testing.assert_allclose(nearest_rotation(at_px, found, (128.5, 128.5)), found, atol=1e-9)


def test_distance_from_the_rotations_is_what_no_rotation_explains() -> None:
    at_px = grid_px((256, 256)) + 0.5  # its middle is the place about which is rotated
    moved = at_px + np.array([2.0, 0.0])
    assert mean_distance_px(moved, nearest_rotation(at_px, moved, (128.5, 128.5))) == pytest.approx(2.0)
    radius = np.linalg.norm(at_px - 128.5, axis=1)
    scaled = (at_px - 128.5) * 1.1 + 128.5
    expected = 0.1 * radius.mean()
    assert mean_distance_px(scaled, nearest_rotation(at_px, scaled, (128.5, 128.5))) == pytest.approx(
        expected
    )


def test_distance_to_nothing_is_not_known() -> None:
    assert math.isnan(mean_distance_px(np.empty((0, 2)), np.empty((0, 2))))


def test_grid_reaches_the_corners_of_the_image() -> None:
    at_px = grid_px((100, 200))
    assert at_px.shape == (225, 2)
    np.testing.assert_array_equal([at_px[0], at_px[-1]], [[0.0, 0.0], [200.0, 100.0]])


def test_inside_is_col_and_row() -> None:
    at_px = np.array([[0.0, 0.0], [199.0, 99.0], [99.0, 199.0], [-0.1, 5.0], [200.0, 5.0]])
    assert inside(at_px, (100, 200)).tolist() == [True, True, False, False, False]


def test_warp_turns_clockwise_about_the_middle_and_shifts_by_sides() -> None:
    matrix = Warp(90.0, 1.0, 0.0, (0.25, -0.1)).matrix((100, 200))
    middle, right = mapped(matrix, np.array([[100.0, 50.0], [110.0, 50.0]]))
    np.testing.assert_allclose(middle, [150.0, 40.0])
    np.testing.assert_allclose(right - middle, [0.0, 10.0], atol=1e-9)  # rows grow downwards


def test_warp_scales_its_canvas_and_shears_along_rows() -> None:
    warp = Warp(0.0, 0.5, 0.04, (0.0, 0.0))
    assert warp.canvas((100, 200)) == (50, 100)
    lower = mapped(warp.matrix((100, 200)), np.array([[100.0, 50.0], [100.0, 60.0]]))
    np.testing.assert_allclose(lower, [[50.0, 25.0], [50.2, 30.0]])


def test_drawn_warps_fill_their_ranges_and_keep_to_them() -> None:
    rng = np.random.default_rng(1)
    drawn = [draw_warp(rng) for _ in range(500)]
    turns = np.array([warp.rotation_deg for warp in drawn])
    assert 2 <= np.abs(turns).min() < 5
    assert 175 < np.abs(turns).max() <= 180
    assert 0.4 < (turns > 0).mean() < 0.6
    scales = np.array([warp.scale for warp in drawn])
    assert SCALES[0] <= scales.min() < 0.61
    assert 1.68 < scales.max() <= SCALES[1]
    assert MAX_SHEAR * 0.95 < max(abs(warp.shear) for warp in drawn) <= MAX_SHEAR
    assert MAX_SHIFT * 0.95 < max(abs(part) for warp in drawn for part in warp.shift) <= MAX_SHIFT


def test_drawn_warps_leave_a_quarter_of_the_image() -> None:
    rng = np.random.default_rng(2)
    for shape in ((512, 512), (680, 1024), (454, 267)):
        axes = np.meshgrid((np.arange(30) + 0.5) / 30 * shape[1], (np.arange(30) + 0.5) / 30 * shape[0])
        at_px = np.stack(axes, axis=-1).reshape(-1, 2)
        for _ in range(200):
            warp = draw_warp(rng)
            assert inside(mapped(warp.matrix(shape), at_px), warp.canvas(shape)).mean() > 0.25


def scene(at_px: np.ndarray) -> np.ndarray:
    x, y = np.moveaxis(at_px, -1, 0)
    return np.asarray(100 + 30 * np.sin(0.21 * x + 0.1 * y) + 20 * np.cos(0.13 * y - 0.2 * x))


def centres(shape: tuple[int, int]) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5), axis=-1)


@pytest.mark.parametrize("scale", [0.7, 1.6])
def test_warped_image_shows_the_scene_where_the_matrix_says(scale: float) -> None:
    shape = 120, 160
    warp = Warp(33.0, scale, 0.03, (0.1, -0.2))
    warped, seen = warp_image(scene(centres(shape)), np.ones(shape, bool), warp)
    assert warped.shape == warp.canvas(shape)
    at_px = centres(warp.canvas(shape)).reshape(-1, 2)
    original = mapped(warp.inverse(shape), at_px)
    away = seen.ravel() & inside(original - 4, (shape[0] - 8, shape[1] - 8))
    assert away.mean() > 0.3
    # a coarser pixel is a mean over ground: less contrast, not another place
    assert np.abs(warped.ravel()[away] - scene(original[away])).max() < (2.0 if scale < 1 else 0.05)
    assert abs((warped.ravel()[away] - scene(original[away])).mean()) < 0.05


def test_warped_image_marks_what_it_does_not_show() -> None:
    shape = 80, 80
    valid = np.ones(shape, bool)
    valid[:, :20] = False
    values = np.where(valid, 100.0, -1e6)  # whatever is there must not be seen through the splines
    warp = Warp(0.0, 1.0, 0.0, (0.25, 0.0))
    warped, seen = warp_image(values, valid, warp)
    # columns 20 to 39 came from without data, those before from outside
    assert not seen[:, :41].any()
    assert seen[5:-5, 44:].all()
    np.testing.assert_allclose(warped[:, 60:], 100.0, atol=1e-3)


def test_spread_sample_of_all_is_all() -> None:
    assert spread_sample(30, 1.0, 5) == list(range(30))


def test_spread_sample_takes_one_of_each_part_and_repeats_itself() -> None:
    chosen = spread_sample(2000, 0.005, 5)
    assert [index // 200 for index in chosen] == list(range(10))
    assert chosen == spread_sample(2000, 0.005, 5)
    assert chosen != spread_sample(2000, 0.005, 6)
    assert len({index % 4 for index in chosen}) > 1  # no stride that meets one of four kinds alone


def test_spread_sample_takes_at_least_one() -> None:
    assert len(spread_sample(30, 0.001, 5)) == 1


def test_share_of_none_is_not_known() -> None:
    assert share_of([True, False, True, True]) == 75.0
    assert math.isnan(share_of([]))


def test_the_right_pose_makes_images_tell_most_of_each_other() -> None:
    image = ndimage.gaussian_filter(np.random.default_rng(3).normal(size=(120, 140)), 3.0)
    inverted = np.exp(-image / image.std())  # another modality: dark where the first is bright
    moved = np.roll(inverted, (-2, 4), axis=(0, 1))
    at = {
        off: mutual_information(image, moved, np.array([[1.0, 0.0, 4.0 + off], [0.0, 1.0, -2.0]]))
        for off in (0, 1, 3)
    }
    assert at[0] > at[1] > at[3] > 0
