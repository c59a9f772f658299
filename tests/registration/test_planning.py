"""What is matched of a scene: every place once, or small windows that lie where there is structure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching import MatchSettings, TiePoints
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import ViewPair, Window, describe, plan_views
from pcwlad_geo.registration.planning import Plan, common_region, farthest_px, plan
from pcwlad_geo.registration.starts.overviews import read_overviews
from pcwlad_geo.registration.tiles import TileJob, TileResult
from tests.scenes import make_grid, write

SIDE = 3600
OFFSET = (-5, 3)
MATCHING = MatchSettings(template=61, window=MatchingWindow(41), search_radius=8)


def values(seed: int = 0) -> NDArray[np.uint8]:
    """Return blocks of random grey with a smooth lake in the upper left quarter."""
    blocks = np.random.default_rng(seed).integers(0, 255, (SIDE // 12, SIDE // 12), np.uint8)
    image = np.kron(blocks, np.ones((12, 12), np.uint8))
    image[: SIDE // 2, : SIDE // 2] = 40
    return image


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> ViewPair:
    folder, grid = tmp_path_factory.mktemp("planning"), make_grid((SIDE, SIDE))
    files = [write(folder / name, values(), grid) for name in ("ref.tif", "tgt.tif")]
    return plan_views(*(describe(file) for file in files))


def planned(pair: ViewPair, **options: object) -> Plan:
    return plan(pair, read_overviews(pair), OFFSET, MATCHING, Settings.from_options(options))


def result(job: TileJob, count: int) -> TileResult:
    """Return what a window gives in which so many points move alike."""
    xy = np.random.default_rng(job.id).uniform(0, 50, (count, 2))
    points = TiePoints(xy, xy + 1.0, np.tile(np.eye(2), (count, 1, 1)), np.ones(count), np.zeros(count))
    return TileResult(job.id, "matched" if count else "empty", points, {"candidates": count}, None)


def test_common_region(tmp_path: Path) -> None:
    first, second = make_grid((220, 240)), make_grid((220, 240), offset_m=(600, 300))
    image = np.random.default_rng(1).integers(0, 255, (220, 240), np.uint8)
    pair = plan_views(
        describe(write(tmp_path / "a.tif", image, first)), describe(write(tmp_path / "b.tif", image, second))
    )
    assert common_region(pair, (-20, -10)) == Window(10, 20, 210, 220)
    assert common_region(pair, (30, 5)) == Window(0, 0, 215, 210)
    assert common_region(pair, (500, 0)).empty
    assert farthest_px(pair, (-20, -10)) == 260  # the first column of the target on the last of the reference
    assert farthest_px(pair, (30, 5)) == 270


@pytest.mark.parametrize("tile_size", [512, 700, 1024])
def test_tiles_cover_the_common_region_once(pair: ViewPair, tile_size: int) -> None:
    jobs = planned(pair, points="all", tile_size=tile_size).first
    covered = np.zeros((SIDE, SIDE), np.int8)
    for job in jobs:
        core = job.core
        covered[core.row : core.row_stop, core.col : core.col_stop] += 1
        assert max(core.shape) <= 1.3 * tile_size
    assert (covered[: SIDE - 3, 5:] == 1).all()
    assert (covered[SIDE - 3 :] == 0).all()
    assert (covered[:, :5] == 0).all()
    assert [job.id for job in jobs] == list(range(len(jobs)))


def test_a_scene_gets_small_windows_where_there_is_structure(pair: ViewPair) -> None:
    jobs = planned(pair).first
    assert 40 <= len(jobs) <= 60  # three quarters of 64 places
    for job in jobs:
        middle = np.array([job.core.row + job.core.row_stop, job.core.col + job.core.col_stop]) / 2
        assert (middle > SIDE / 2 - 100).any(), "a window in the lake"
    places = {(job.core.row * 8 // SIDE, job.core.col * 8 // SIDE) for job in jobs}
    assert len(places) >= 40
    assert sum(job.read_window.area_px2 for job in jobs) < SIDE**2


def test_small_windows_hold_whole_cells_of_candidates(pair: ViewPair) -> None:
    for job in planned(pair, points=500).first:
        settings = job.settings
        cell = np.sqrt(settings.per_cell * settings.features_area_px2 / settings.features)
        assert cell == job.core.rows / 2 == job.core.cols / 2
        assert (job.core.row - job.region.row) % cell == (job.core.col - job.region.col) % cell == 0


def test_the_windows_of_a_place_do_not_share_pixels(pair: ViewPair) -> None:
    jobs = [job for site in planned(pair).sites for job in site]
    assert len({job.id for job in jobs}) == len(jobs)
    cores = np.array([(job.core.row, job.core.col) for job in jobs])
    distance = np.abs(cores[:, None] - cores[None]).max(axis=2) + np.eye(len(jobs)) * 1e6
    assert distance.min() >= jobs[0].core.rows


def test_a_window_that_gave_nothing_is_followed_by_the_next_of_its_place(pair: ViewPair) -> None:
    scene = planned(pair)
    poor = {scene.first[3].id, scene.first[7].id}
    results = [result(job, 0 if job.id in poor else 20) for job in scene.first]
    following = scene.following(results)
    sites = [site for site in scene.sites if site and site[0].id in poor]
    assert [site[1] for site in sites] == following


def test_enough_is_enough(pair: ViewPair) -> None:
    scene = planned(pair, points=500)
    assert scene.following([result(job, 20) for job in scene.first]) == []
    assert planned(pair, points="all").following([]) == []


def test_missing_points_come_from_second_windows_of_the_best_places(pair: ViewPair) -> None:
    scene = planned(pair)
    results = [result(job, 15 + job.id % 5) for job in scene.first]
    missing = 950 - sum(len(each.points) for each in results)
    assert missing > 0
    following = scene.following(results)
    assert len(following) == -(-missing // 17)
    assert not {job.id for job in following} & {job.id for job in scene.first}


def test_few_points_of_a_small_scene_are_spread_over_tiles_that_cover_it(tmp_path: Path) -> None:
    grid, image = make_grid((1500, 1400)), values()[1900:3400, 1900:3300]
    files = [write(tmp_path / name, image, grid) for name in ("ref.tif", "tgt.tif")]
    scene = planned(plan_views(*(describe(file) for file in files)), points=600)
    assert len(scene.first) == 4
    assert scene.following([result(job, 0) for job in scene.first]) == []
    settings = scene.first[0].settings
    density = settings.features / (settings.features_area_px2 or 1)
    assert density * 1500 * 1400 == pytest.approx(1.25 * 600, rel=0.1)


def test_what_the_target_does_not_show_gets_no_window(pair: ViewPair) -> None:
    look = read_overviews(pair)
    hidden = look.target.valid.copy()
    hidden[:, hidden.shape[1] * 3 // 4 :] = False
    half = replace(look, target=replace(look.target, valid=hidden))
    jobs = plan(pair, half, OFFSET, MATCHING, Settings()).first
    assert 20 <= len(jobs) <= 40
    assert max(job.core.col_stop for job in jobs) < SIDE * 3 / 4 + 20
