"""Narrow gaps are filled for the maps and have no weight; the answer is that of the image without them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching.gaps import GAPS, least_share, narrow_gaps, open_share, usable
from pcwlad_geo.matching.matcher import match_arrays
from pcwlad_geo.matching.prepare import MAPS
from pcwlad_geo.matching.shift_search import search_shift
from pcwlad_geo.matching.types import MatchSettings, TiePoints
from pcwlad_geo.matching.window import MatchingWindow
from tests.matching.landscape import Landscape, constant

SIDE = 240
SHIFT_XY = (3.4, -2.3)
SETTINGS = MatchSettings(features=60, template=81, window=MatchingWindow(81), search_radius=6)
NOTHING = np.zeros((SIDE, SIDE), bool)
PERIOD_PX = 33


def stripes(width_px: int, slope: float = 0.15, phase_px: float = 0.0) -> NDArray:
    y, x = np.mgrid[:SIDE, :SIDE]
    return np.asarray((y + slope * x + phase_px) % PERIOD_PX < width_px)


def specks(share: float, largest_px: int, seed: int) -> NDArray:
    rng = np.random.default_rng(seed)
    missing = NOTHING.copy()
    while missing.mean() < share:
        row, col, rows, cols = *rng.integers(0, SIDE, 2), *rng.integers(1, largest_px + 1, 2)
        missing[row : row + rows, col : col + cols] = True
    return missing


@cache
def image(band: int, shift_xy: tuple[float, float] = (0.0, 0.0), seed: int = 5) -> NDArray:
    noise = np.random.default_rng(band + 10).normal(0, 1, (SIDE, SIDE))
    return Landscape(seed).image(SIDE, band, constant(*shift_xy)) + noise


def matched(in_reference: NDArray, in_target: NDArray, seed: int = 5) -> TiePoints:
    target = image(0, SHIFT_XY, seed)
    return match_arrays(
        np.where(in_reference, -9999, image(0)),
        np.where(in_target, 0, target),
        reference_valid=~in_reference,
        target_valid=~in_target,
        settings=SETTINGS,
    )


def assert_true(points: TiePoints, least: int, most_px: float = 0.05) -> None:
    assert len(points) > least
    error = points.displacement_px - SHIFT_XY
    assert np.abs(np.median(error, axis=0)).max() < most_px
    assert np.linalg.norm(error, axis=1).max() < 0.5


@pytest.mark.parametrize("width_px", [4, 7, 11])  # 12, 21 and 33 %
def test_stripes_in_one_image(width_px: int) -> None:
    assert_true(matched(NOTHING, stripes(width_px)), 20)


@pytest.mark.parametrize("width_px", [7, 11])
def test_stripes_that_stand_still_in_both_images_are_no_structure(width_px: int) -> None:
    missing = stripes(width_px)
    assert_true(matched(missing, missing), 20)


def test_other_stripes_in_each_image() -> None:
    assert_true(matched(stripes(7, phase_px=16), stripes(7, slope=0.1)), 20)


@pytest.mark.parametrize("share", [0.035, 0.07, 0.15, 0.25])
def test_specks(share: float) -> None:
    missing = specks(share, 3, seed=1)
    assert_true(matched(NOTHING, missing), 15)
    assert_true(matched(missing, missing), 15)


def test_specks_of_many_sizes() -> None:
    assert_true(matched(specks(0.1, 11, seed=2), specks(0.1, 11, seed=3)), 15)


def test_unrelated_images_with_the_same_gaps_do_not_agree() -> None:
    for missing in (stripes(7), specks(0.15, 4, seed=1)):
        points = matched(missing, missing, seed=77)
        still = np.hypot(*points.displacement_px.T) < 0.5
        assert still.sum() < 4


def test_the_search_sees_across_gaps() -> None:
    side, scene = 320, Landscape(5)
    still, moved = scene.image(side), scene.image(side, 0, constant(14.0, -9.0))
    valid = ~np.pad(stripes(7) | specks(0.1, 4, seed=1), (0, side - SIDE), mode="wrap")
    found = search_shift(still, moved, valid, valid)
    assert found.accepted
    assert np.hypot(*np.subtract(found.shift_xy, (14.0, -9.0))) < 2


def test_a_gap_is_narrow_wherever_it_lies() -> None:
    valid = np.ones((120, 130), bool)
    valid[10:14], valid[60:63, 50:56], valid[:, 100:114] = False, False, False
    np.testing.assert_array_equal(narrow_gaps(valid), ~valid)
    np.testing.assert_array_equal(usable(valid, narrow_gaps(valid), MAPS.edge_px), valid)


def test_a_wide_hole_is_none_nor_is_its_ragged_edge() -> None:
    y, x = np.mgrid[:150, :160]
    ragged = np.hypot(y - 70, x - 80) > 30 + 3 * np.sin(9 * np.arctan2(y - 70, x - 80))
    collar = np.ones((150, 160), bool)
    collar[:, :5] = False
    for valid in (ragged, collar):
        assert not narrow_gaps(valid).any()
        inside = usable(valid, narrow_gaps(valid), MAPS.edge_px)
        assert inside.sum() < valid.sum()
        assert open_share(inside, narrow_gaps(valid), 64) == 1


def test_small_holes_beside_a_cloud_are_no_gaps() -> None:
    valid = np.ones((300, 300), bool)
    valid[40:80, 50:90], valid[100:104, 70:74], valid[250:254, 250:254] = False, False, False
    expected = np.zeros_like(valid)
    expected[250:254, 250:254] = True
    np.testing.assert_array_equal(narrow_gaps(valid), expected)


def test_a_gap_of_an_overview_is_as_wide_on_the_ground() -> None:
    valid = np.ones((90, 90), bool)
    valid[40:50] = False
    assert narrow_gaps(valid).any()
    assert not narrow_gaps(valid, 2.0).any()
    valid[43:50] = True
    assert narrow_gaps(valid, 2.0).any()
    assert not narrow_gaps(valid, 100.0).any()


def test_the_least_share_follows_the_gaps() -> None:
    assert least_share(0.6) == least_share(0.6, 1.0, 1.0) == 0.6
    assert least_share(0.6, 0.8, 1.0) == pytest.approx(0.48)
    assert least_share(0.6, 0.5, 0.5) == GAPS.least_share
    assert least_share(0.0, 0.5) == 0.0
    missing = stripes(11)
    assert open_share(~missing, missing, 64) == pytest.approx(1 - missing.mean(), abs=0.01)
    half = missing & (np.arange(SIDE) < SIDE // 4)
    assert open_share(~half, half, 20) < 0.85 < (~half).mean()


def test_an_image_without_gaps_is_matched_as_before() -> None:
    hole = NOTHING.copy()
    hole[80:130, 90:150] = True
    points = matched(NOTHING, hole)
    assert_true(points, 5)
    row, col = (np.floor(points.target_xy_px).astype(int)).T[::-1]
    edge_px = MAPS.edge_px
    near = (row >= 80 - edge_px) & (row < 130 + edge_px) & (col >= 90 - edge_px) & (col < 150 + edge_px)
    assert not near.any()
