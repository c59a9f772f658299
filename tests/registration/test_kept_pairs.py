"""Maps wait for the second visit of their tile, within a limit, and are those that would be made again."""

from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.matching import Image
from pcwlad_geo.matching.prepare import ChannelPair, prepare
from pcwlad_geo.registration.tiles import TileCache

NBYTES = 64 * 64 * 2 * (6 * 4 + 1)
"""Of each image six maps as float32, and the mask."""


@pytest.fixture(scope="module")
def pair() -> ChannelPair:
    images = [
        Image(np.random.default_rng(seed).normal(size=(64, 64)), np.ones((64, 64), bool), 1e-4)
        for seed in (0, 1)
    ]
    return prepare(*images, channels="orientations").channels


def assert_same(found: ChannelPair | None, wanted: ChannelPair) -> None:
    assert found is not None
    for mine, its in ((found.reference, wanted.reference), (found.target, wanted.target)):
        np.testing.assert_array_equal(mine.maps, its.maps)
        np.testing.assert_array_equal(mine.coefficients, its.coefficients)
        np.testing.assert_array_equal(mine.valid, its.valid)


def test_a_pair_is_taken_once_and_is_what_it_was(pair: ChannelPair) -> None:
    kept = TileCache()
    kept.keep("scene", 3, pair, 9 * NBYTES)
    assert kept.take("scene", 2) is None
    assert_same(kept.take("scene", 3), pair)
    assert kept.take("scene", 3) is None


def test_what_exceeds_the_limit_is_not_kept(pair: ChannelPair) -> None:
    kept = TileCache()
    for tile in range(3):
        kept.keep("scene", tile, pair, 2 * NBYTES)
    assert [kept.take("scene", tile) is None for tile in range(3)] == [False, False, True]


def test_of_many_pairs_the_maps_are_kept_and_of_a_lone_one_all(pair: ChannelPair) -> None:
    kept = TileCache()
    kept.keep("scene", 0, pair, 5 * NBYTES)
    assert kept.take("scene", 0) is pair, "there is room for what interpolates it"
    for tile in range(3):
        kept.keep("scene", tile, pair, 5 * NBYTES)
    for tile in range(3):
        found = kept.take("scene", tile)
        assert_same(found, pair)
        assert found is not pair, "three have no room for that"
    kept = TileCache()
    kept.keep("scene", 0, pair, NBYTES, alone=True)
    assert kept.take("scene", 0) is pair


def test_another_scene_takes_the_place_of_the_last(pair: ChannelPair) -> None:
    kept = TileCache()
    kept.keep("first", 0, pair, NBYTES)
    kept.keep("second", 0, pair, NBYTES)
    assert kept.take("first", 0) is None
    assert_same(kept.take("second", 0), pair)
