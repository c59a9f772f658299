"""Tiles cover the scene once, and together give what one tile gives."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.matching import MatchSettings, Scales, guide_by_field
from pcwlad_geo.matching.grey_values import Tones
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.noise import Noise
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import ViewPair, describe, plan_views
from pcwlad_geo.registration.planning import plan as plan_scene
from pcwlad_geo.registration.starts.overviews import read_overviews
from pcwlad_geo.registration.tiles import Scene, TileJob, match_tile, rematch_tile
from tests.scenes import make_grid, render, write

SHIFT_PX = (2.4, -1.3)
SETTINGS = MatchSettings(
    template=61, window=MatchingWindow(41), features=80, features_area_px2=180.0**2, search_radius=8
)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> ViewPair:
    """Two rasters of 220 x 240 px, the second starts 20 columns and 10 rows later."""
    folder = tmp_path_factory.mktemp("tiles")
    first, second = make_grid((220, 240)), make_grid((220, 240), offset_m=(600, 300))
    return plan_views(
        describe(write(folder / "ref.tif", render(first), first)),
        describe(write(folder / "tgt.tif", render(second, displacement_px=SHIFT_PX), second)),
    )


def plan(pair: ViewPair, tile_size: int) -> list[TileJob]:
    scene = Scene(scene_epsilon(np.arange(255.0)), Noise())
    look = replace(read_overviews(pair), scenes=(scene, scene))
    settings = replace(Settings(points="all", features=80), tile_size=128)
    object.__setattr__(settings, "tile_size", tile_size)  # smaller than users may ask for
    return plan_scene(pair, look, (-20, -10), SETTINGS, settings).first


def test_a_job_is_small(pair: ViewPair) -> None:
    job = plan(pair, 128)[0]
    assert len(pickle.dumps(job)) < 8000
    assert pickle.loads(pickle.dumps(job)) == job


def test_maps_of_grey_values_are_not_those_of_structure(pair: ViewPair) -> None:
    """A tile whose maps were kept by one is another tile to the other; and the job is small with both."""
    values, everywhere = render(make_grid((80, 80))), np.ones((80, 80), bool)
    tones = Tones.of_pair((values, -values), everywhere, 16.0)
    assert tones is not None
    job = plan(pair, 128)[0]
    by_tones = replace(
        job,
        reference_scene=replace(job.reference_scene, tones=tones[0]),
        target_scene=replace(job.target_scene, tones=tones[1]),
    )
    assert by_tones.scene != job.scene
    pickled = pickle.dumps(by_tones)
    assert len(pickled) < 16_000
    assert pickle.loads(pickled) == by_tones
    assert pickle.loads(pickled).scene == by_tones.scene


def test_points_are_in_pixels_of_the_views(pair: ViewPair) -> None:
    job = plan(pair, 1000)[0]
    result = match_tile(job)
    assert result.status == "matched"
    assert len(result.points) >= 30
    # the grids lie (-20, -10) px apart, the content (2.4, -1.3) px from where they say
    apart = result.points.displacement_px - np.array([-20, -10]) - SHIFT_PX
    assert np.abs(np.median(apart, axis=0)).max() < 0.05
    again = rematch_tile(
        job, result.points, guide_by_field(result.points, job.settings), Scales.of(41)
    ).points
    np.testing.assert_array_equal(again.reference_xy_px, result.points.reference_xy_px)
    apart = again.displacement_px - np.array([-20, -10]) - SHIFT_PX
    assert np.abs(np.median(apart, axis=0)).max() < 0.03
    assert result.counts["candidates"] >= len(result.points)


def test_every_candidate_belongs_to_one_tile(pair: ViewPair) -> None:
    whole = match_tile(plan(pair, 1000)[0])
    parts = [match_tile(job) for job in plan(pair, 100)]
    assert len(parts) >= 4
    assert sum(part.counts.get("candidates", 0) for part in parts) == pytest.approx(
        whole.counts["candidates"], rel=0.02
    )
    places = np.concatenate([part.points.reference_xy_px for part in parts])
    assert len(np.unique(places, axis=0)) == len(places)


def test_a_tile_without_valid_pixels_is_empty(pair: ViewPair) -> None:
    job = replace(plan(pair, 128)[0], target_offset_px=(5000, 0))
    result = match_tile(job)
    assert result.status == "empty"
    assert len(result.points) == 0


def test_a_tile_that_cannot_be_read_says_why(pair: ViewPair, tmp_path: Path) -> None:
    job = plan(pair, 128)[0]
    gone = replace(job.target, info=replace(job.target.info, uri=str(tmp_path / "gone.tif")))
    result = match_tile(replace(job, target=gone))
    assert result.status == "failed"
    assert "gone.tif does not exist" in (result.reason or "")
