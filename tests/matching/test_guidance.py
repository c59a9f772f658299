from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching.calibration import calibrate
from pcwlad_geo.matching.guidance import guide_by_field
from pcwlad_geo.matching.lost_candidates import expect_lost
from pcwlad_geo.matching.second_pass import matched_again
from pcwlad_geo.matching.types import MatchSettings, TiePoints
from pcwlad_geo.matching.window import WINDOWS, MatchingWindow
from pcwlad_geo.matching.windows import Scales, choose_scales, window_errors

SIDE = 1000.0
SETTINGS = MatchSettings()


def points(displacement: NDArray, xy: NDArray) -> TiePoints:
    n = len(xy)
    return TiePoints(
        xy, xy + displacement, np.tile(1e-4 * np.eye(2), (n, 1, 1)), np.ones(n), np.full(n, np.nan)
    )


def scattered(n: int = 900, seed: int = 0) -> NDArray:
    return np.random.default_rng(seed).uniform(0, SIDE, (n, 2))


def noise(n: int, sigma_px: float) -> NDArray:
    return np.random.default_rng(1).normal(0, sigma_px, (n, 2))


def test_points_of_a_shifted_image_take_the_structure_where_their_neighbours_are() -> None:
    xy = scattered()
    guide = guide_by_field(points(np.array([2.0, -1.0]) + noise(len(xy), 0.05), xy), SETTINGS)
    assert not guide.deforms
    np.testing.assert_allclose(guide.structure_xy_px, np.tile([2.0, -1.0], (len(xy), 1)), atol=0.02)


def test_windows_of_a_bent_field_deform_by_its_slopes() -> None:
    xy = scattered()
    turn = 2 * np.pi / SIDE
    waves = 2.0 * np.sin(turn * xy[:, ::-1])
    slopes = 2.0 * turn * np.cos(turn * xy[:, ::-1])
    guide = guide_by_field(points(waves + noise(len(xy), 0.05), xy), SETTINGS)
    assert np.nanstd(guide.structure_xy_px - waves) < 0.1
    inner = ((xy > 100) & (xy < SIDE - 100)).all(axis=1)
    across = np.stack([guide.linear[:, 0, 1], guide.linear[:, 1, 0]], axis=1)
    along = np.stack([guide.linear[:, 0, 0], guide.linear[:, 1, 1]], axis=1)
    assert np.sqrt(((across - slopes)[inner] ** 2).mean()) < 0.2 * np.sqrt((slopes**2).mean())
    assert np.sqrt((along[inner] ** 2).mean()) < 0.2 * np.sqrt((slopes**2).mean())


def test_a_rotated_image_deforms_all_windows_alike() -> None:
    xy = scattered()
    linear = np.array([[0.0, -0.004], [0.004, 0.0]])
    guide = guide_by_field(points(xy @ linear.T + noise(len(xy), 0.05), xy), SETTINGS)
    np.testing.assert_array_equal(guide.linear, np.tile(guide.linear[0], (len(xy), 1, 1)))
    np.testing.assert_allclose(guide.linear[0], linear, atol=1e-4)
    assert np.isfinite(guide.structure_xy_px).all()


@pytest.mark.parametrize("count", [4, 20])
def test_few_points_guide_nothing(count: int) -> None:
    xy = scattered(count)
    guide = guide_by_field(points(np.tile([2.0, -1.0], (count, 1)), xy), SETTINGS)
    assert not guide.deforms
    assert np.isnan(guide.structure_xy_px).all()
    assert guide.surface is None


def test_only_what_the_guide_says_something_new_about_is_matched_again() -> None:
    xy = scattered()
    smooth = guide_by_field(points(np.array([2.0, -1.0]) + noise(len(xy), 0.05), xy), SETTINGS)
    assert matched_again(smooth, SETTINGS).all()
    rough = guide_by_field(
        points(noise(len(xy), 1.0) * np.sin(xy / 7), xy), replace(SETTINGS, consensus="off")
    )
    assert not rough.deforms
    assert not matched_again(rough, SETTINGS).any()
    assert matched_again(rough, replace(SETTINGS, backward="sample")).all()
    back = replace(rough, one_way=True)
    assert not matched_again(back, replace(SETTINGS, backward="sample")).any()
    assert not matched_again(smooth, replace(SETTINGS, method="pcwlad")).any()


WINDOWS_PX = (61, 81, 129)


def by_windows(
    noise_px: float, curvature: float, n: int = 160, seed: int = 2, sides: tuple[int, ...] = WINDOWS_PX
) -> NDArray:
    """Displacements by windows that share noise of a variance of 1/w, and average a field that bends."""
    rng = np.random.default_rng(seed)
    variance = noise_px**2 * 81 / np.array(sides)
    own = np.sqrt(-np.diff(variance, append=0.0))[:, None, None] * rng.normal(size=(len(sides), n, 2))
    shared = np.cumsum(own[::-1], axis=0)[::-1]  # what the largest window sees is part of what all see
    bend = curvature * rng.normal(size=(n, 2))
    return 3.0 + shared + np.array(sides)[:, None, None] ** 2 / 24 * bend


CONDITIONS = [(0.08, 0.0, 129), (0.05, 8e-5, 81), (0.02, 2e-4, 81), (0.001, 2e-4, 81)]


@pytest.mark.parametrize(("noise_px", "curvature", "most"), CONDITIONS)
def test_the_window_is_small_where_the_field_bends_and_large_where_noise_rules(
    noise_px: float, curvature: float, most: int
) -> None:
    found = [window_errors(by_windows(noise_px, curvature, seed=seed), WINDOWS_PX) for seed in range(20)]
    errors = [each for each in found if each is not None]
    chosen = [each.best(WINDOWS_PX, 81) for each in errors]
    # where hardly any noise is left, 61 px corrected by 129 are as good
    also = 61 if noise_px < 0.03 else most
    assert sum(each.window_px in (most, also) for each in chosen) >= 17
    if also != most:
        assert all(each.weights[-1] < 0 for each in chosen if len(each.weights) == 2)
    sigma_px = np.sqrt(np.median([each.variance_px2(Scales.of(81)) for each in errors]))
    assert sigma_px == pytest.approx(np.hypot(noise_px, curvature * 81**2 / 24), rel=0.2)
    bend_px = [each.bend_px(Scales.of(81)) for each in errors]
    assert np.median(bend_px) == pytest.approx(np.sqrt(2) * curvature * 81**2 / 24, rel=0.2)
    if curvature == 0.0:  # noise seems to bend the field by chance, but seldom by more than that explains
        assert bend_px.count(0.0) >= 17


@pytest.mark.parametrize(("noise_px", "curvature", "most"), CONDITIONS)
def test_two_windows_err_less_than_each_alone_and_as_much_as_they_say(
    noise_px: float, curvature: float, most: int
) -> None:
    better, expected = [], []
    for seed in range(20):
        moved = by_windows(noise_px, curvature, seed=seed)
        errors = window_errors(moved, WINDOWS_PX)
        assert errors is not None
        scales = errors.best(WINDOWS_PX, 81)
        assert sum(scales.weights) == pytest.approx(1)
        used = [WINDOWS_PX.index(each) for each in scales.windows_px]
        left = np.tensordot(scales.weights, moved[used], 1) - 3.0
        alone = np.sqrt(((moved - 3.0) ** 2).mean(axis=(1, 2)))
        better.append(np.sqrt((left**2).mean()) / alone.min())
        expected.append(np.sqrt(errors.variance_px2(scales) / (left**2).mean()))
    assert np.median(better) < 1.02
    if curvature > 0 and noise_px < 0.03:  # the larger window tells what the smaller averages away
        assert np.median(better) < 0.9
    if noise_px >= 0.02:
        assert 0.6 < np.median(expected) < 1.6


def test_larger_windows_are_tried_while_they_seem_good() -> None:
    window = MatchingWindow.of(None)

    def tried(noise_px: float, curvature: float) -> tuple[list[tuple[int, ...]], Scales]:
        asked = []
        moved = by_windows(noise_px, curvature, sides=window.all_px)

        def seen(windows_px: Sequence[int]) -> NDArray:
            asked.append(tuple(windows_px))
            return moved[[window.all_px.index(each) for each in windows_px]]

        return asked, choose_scales(seen, window)[0]

    asked, scales = tried(0.08, 0.0)
    # 257 px are for finding what was lost, not for measuring
    assert asked == [(61, 81, 129), (181,)]
    assert scales.window_px == 181
    asked, scales = tried(0.02, 2e-4)
    assert asked == [(61, 81, 129)]
    assert scales.windows_px == (81, 129)
    assert scales.weights[1] < 0
    window = replace(window, is_open=False)
    assert tried(0.08, 0.0)[1] == Scales.of(81)


def test_candidates_are_expected_where_their_neighbours_are() -> None:
    xy = scattered()
    linear = np.array([[0.002, 0.0], [0.001, -0.003]])
    consistent = points(xy @ linear.T + noise(len(xy), 0.03), xy)
    guide = guide_by_field(consistent, SETTINGS)
    places = scattered(30, seed=9)
    lost = expect_lost(places, consistent, guide, SETTINGS)
    off_px = np.linalg.norm(lost.guide.structure_xy_px - places @ linear.T, axis=1)
    assert np.median(off_px) < 0.02
    assert (lost.limit_px >= 0.25).all()
    assert (lost.limit_px <= 0.6).all()
    few = expect_lost(places, consistent[:10], guide, SETTINGS)
    assert len(few.limit_px) == 0


def test_windows_tell_nothing_where_too_few_points_do() -> None:
    moved = by_windows(0.08, 0.0)
    known = window_errors(moved, WINDOWS_PX)
    assert known is not None
    assert known.points == 160
    few = window_errors(moved[:, : WINDOWS.least_to_choose - 1], WINDOWS_PX)
    assert few is not None
    assert few.best(WINDOWS_PX, 81) == Scales.of(81)
    assert window_errors(moved[:2], WINDOWS_PX[:2]) is None
    moved[2, WINDOWS.least_sample - 1 :] = np.nan  # failed
    assert window_errors(moved, WINDOWS_PX) is None


def test_sigma_of_a_rough_field_is_that_which_the_windows_tell() -> None:
    xy = scattered(200)
    errors = window_errors(by_windows(0.3, 0.0), WINDOWS_PX)
    assert errors is not None
    told_px2 = errors.variance_px2(Scales.of(81))
    rough = points(noise(len(xy), 5.0), xy)
    sigma_px = calibrate(rough, None, 0.0, replace(SETTINGS, window=MatchingWindow(81)), told_px2).sigma_px
    assert np.median(sigma_px) == pytest.approx(0.12, abs=0.01)  # twelve times the formal one, at most
    tight = replace(rough, covariance_px2=9 * rough.covariance_px2)
    sigma_px = calibrate(tight, None, 0.0, replace(SETTINGS, window=MatchingWindow(81)), told_px2).sigma_px
    assert np.median(sigma_px) == pytest.approx(0.3, rel=0.2)
