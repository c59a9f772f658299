"""Maps wait for the second visit of their tile, within a limit, and are those that would be made again."""

from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.matching.prepare import Image, PreparedPair, prepare
from pcwlad_geo.registration.kept_pairs import KeptPairs


@pytest.fixture(scope="module")
def pair() -> PreparedPair:
    image = Image(np.random.default_rng(0).normal(size=(64, 64)), np.ones((64, 64), bool), 1e-4)
    return prepare(image, image, channels="orientations")


def test_a_pair_is_taken_once(pair: PreparedPair) -> None:
    kept = KeptPairs()
    kept.keep("scene", 3, pair)
    assert kept.take("scene", 2) is None
    assert kept.take("scene", 3) is pair
    assert kept.take("scene", 3) is None


def test_what_exceeds_the_limit_is_not_kept(pair: PreparedPair) -> None:
    kept = KeptPairs(most_bytes=2 * pair.nbytes)
    for tile in range(3):
        kept.keep("scene", tile, pair)
    assert [kept.take("scene", tile) is pair for tile in range(3)] == [True, True, False]


def test_another_scene_takes_the_place_of_the_last(pair: PreparedPair) -> None:
    kept = KeptPairs(most_bytes=pair.nbytes)
    kept.keep("first", 0, pair)
    kept.keep("second", 0, pair)
    assert kept.take("first", 0) is None
    assert kept.take("second", 0) is pair


def test_the_size_is_that_of_all_arrays(pair: PreparedPair) -> None:
    # of each image six maps, their coefficients, the map of maxima and its weight as float32, and the mask
    assert pair.nbytes == 64 * 64 * (2 * (4 * (6 + 6 + 1 + 1) + 1) + 4)
