"""Small images: a few candidates first, and the others only where these do not agree."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching import AUTO_FEATURES
from pcwlad_geo.matching.matcher import match_arrays
from pcwlad_geo.matching.rounds import ROUNDS, are_hopeless, in_rounds, suffice
from pcwlad_geo.matching.types import MatchSettings, TiePoints
from pcwlad_geo.matching.window import MatchingWindow
from tests.matching.landscape import Landscape, constant

SIDE = 230
SHIFT_XY = (2.3, -3.6)
AUTO = MatchSettings(template=61, window=MatchingWindow(61), search_radius=6)
ALL = replace(AUTO, features=AUTO_FEATURES)


@cache
def image(band: int, shift_xy: tuple[float, float] = (0.0, 0.0), seed: int = 21, side: int = SIDE) -> NDArray:
    result = Landscape(seed).image(side, band, constant(*shift_xy))
    result.flags.writeable = False
    return result


def off_px(points: TiePoints) -> float:
    return float(np.linalg.norm(points.displacement_px.mean(axis=0) - SHIFT_XY))


def test_where_the_first_candidates_agree_no_others_are_matched() -> None:
    few, many = (match_arrays(image(0), image(0, SHIFT_XY), settings=each) for each in (AUTO, ALL))
    assert 60 <= len(few) <= 200
    assert len(many) > 4 * len(few)
    assert off_px(few) < 0.02
    assert off_px(few) < off_px(many) + 0.01


def test_where_they_disagree_all_are_matched_as_if_at_once() -> None:
    target = image(1, SHIFT_XY).copy()
    target[:, SIDE // 2 :] = image(1, SHIFT_XY, seed=5)[:, SIDE // 2 :]  # other ground in half of it
    rounds, at_once = (match_arrays(image(0), target, settings=each) for each in (AUTO, ALL))
    np.testing.assert_array_equal(rounds.reference_xy_px, at_once.reference_xy_px)
    np.testing.assert_array_equal(rounds.target_xy_px, at_once.target_xy_px)
    np.testing.assert_array_equal(rounds.covariance_px2, at_once.covariance_px2)


@pytest.mark.parametrize(("amplitude_px", "few"), [(0.1, True), (1.5, False)])
def test_displacements_with_detail_need_more_than_the_first(amplitude_px: float, few: bool) -> None:
    xy_px = np.stack(np.meshgrid(np.arange(60.0, 300, 16), np.arange(60.0, 300, 16)), axis=-1).reshape(-1, 2)
    wave_px = np.array(SHIFT_XY) + amplitude_px * np.sin(2 * np.pi * xy_px / 90.0) + 2e-5 * xy_px**2
    n = len(xy_px)
    points = TiePoints(xy_px, xy_px + wave_px, np.tile(1e-3 * np.eye(2), (n, 1, 1)), np.ones(n), np.zeros(n))
    agree = np.ones(n, bool)
    assert suffice(points, agree, n) == few
    assert not suffice(points[:50], agree[:50], 50)


@pytest.mark.parametrize(("together", "few"), [(4, False), (2, True), (0, True)])
def test_more_are_matched_where_the_rest_agrees_on_another_displacement(together: int, few: bool) -> None:
    xy_px = np.random.default_rng(3).uniform(0, 400, (160, 2))
    moved_px = np.tile(SHIFT_XY, (len(xy_px), 1))
    moved_px[:together] += (3.7, 0.2)
    moved_px[together:6] += np.array([[9, 1], [-8, 3], [1, -9], [-7, -7], [4, 9], [9, -6]])[together:]
    covariance_px2 = np.tile(1e-3 * np.eye(2), (len(xy_px), 1, 1))
    points = TiePoints(xy_px, xy_px + moved_px, covariance_px2, np.ones(160), np.zeros(160))
    assert suffice(points, np.arange(160) >= 6, len(points)) == few


def test_where_none_of_the_first_agree_no_others_are_matched() -> None:
    other = Landscape(5).image(360, 0, constant(0.0, 0.0))
    settings = replace(AUTO, search_radius=12, ssim_min=-1.0)
    at_once = match_arrays(image(0, side=360), other, settings=replace(settings, features=AUTO_FEATURES))
    assert len(at_once) > 0  # by chance
    assert len(match_arrays(image(0, side=360), other, settings=settings)) == 0


@pytest.mark.parametrize(("agreeing", "matches", "hopeless"), [(0, 12, True), (0, 11, False), (3, 50, False)])
def test_others_are_in_vain_where_enough_are_matched_and_none_agree(
    agreeing: int, matches: int, hopeless: bool
) -> None:
    assert are_hopeless(agreeing, matches) == hopeless


@pytest.mark.parametrize(
    ("settings", "area_px2", "first"),
    [
        (AUTO, 200.0**2, ROUNDS.least),
        (AUTO, 500.0**2, 250),
        (AUTO, 1000.0**2, None),
        (ALL, 200.0**2, None),
        (replace(AUTO, keypoints="strongest"), 200.0**2, None),
        (replace(AUTO, method="pcwlad"), 200.0**2, None),
        (replace(AUTO, method="gradient"), 200.0**2, ROUNDS.least),
    ],
)
def test_the_first_candidates_follow_from_the_area(
    settings: MatchSettings, area_px2: float, first: int | None
) -> None:
    chosen = in_rounds(settings, area_px2)
    assert chosen.first_features == first
    assert chosen.features == AUTO_FEATURES
