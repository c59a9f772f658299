from functools import cache

import numpy as np

from pcwlad_geo.matching import keypoints
from pcwlad_geo.matching.local_correlation import significantly_correlated
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.mutual_structure import mutual_structure, passes_paper, shared_structure
from pcwlad_geo.matching.prepare import ChannelPair, Image, prepare
from pcwlad_geo.matching.refinement import InitialEstimate, Refined
from tests.matching.landscape import Landscape, constant

SIDE, WINDOW = 160, 41
CORNERS = np.array([[80, 70], [75, 90], [90, 84]])


@cache
def pair() -> ChannelPair:
    scene = Landscape(11)
    images = (scene.image(SIDE), scene.image(SIDE, 0, constant(2.0, -3.0)))
    return prepare(
        *(Image(i, np.ones(i.shape, bool), scene_epsilon(i)) for i in images), channels="moment"
    ).channels


def start_at(dx: float, dy: float) -> InitialEstimate:
    return InitialEstimate(np.tile([dx, dy], (3, 1)), np.zeros((3, 2, 2)))


def refined_at(dx: float, dy: float) -> Refined:
    return Refined(np.tile([dx, dy], (3, 1)), np.zeros((3, 2, 2)), np.zeros((3, 2, 2)), np.ones(3, bool))


def test_the_structure_is_that_of_the_displaced_windows() -> None:
    found = shared_structure(pair(), CORNERS, start_at(2.0, -3.0), WINDOW)
    assert found.shape == (3, WINDOW, WINDOW)
    half, scale = WINDOW // 2, keypoints.CORNERS.full_scale
    for weight, (row, col) in zip(found, CORNERS, strict=True):
        here = pair().reference.maps[0][row - half : row + half + 1, col - half : col + half + 1]
        there = pair().target.maps[0][
            row - 3 - half : row - 3 + half + 1, col + 2 - half : col + 2 + half + 1
        ]
        expected = mutual_structure(here / scale, there / scale)[2]
        np.testing.assert_allclose(weight, expected, atol=1e-3)


def test_the_structure_is_shared_only_where_the_windows_fit() -> None:
    right = shared_structure(pair(), CORNERS, start_at(2.0, -3.0), WINDOW).mean()
    wrong = shared_structure(pair(), CORNERS, start_at(8.0, 6.0), WINDOW).mean()
    assert right > 1.3 * wrong


def test_more_points_than_one_chunk_are_each_their_own() -> None:
    many = np.tile(CORNERS, (50, 1))
    start = InitialEstimate(np.tile([2.0, -3.0], (150, 1)), np.zeros((150, 2, 2)))
    found = shared_structure(pair(), many, start, WINDOW)
    np.testing.assert_array_equal(found[-3:], found[:3])


def test_nothing_is_shared_under_a_cloud_however_well_the_match_is_placed() -> None:
    scene = Landscape(11)
    side, moved = 400, constant(2.0, -3.0)
    ground, cloud = scene.image(side, 0, moved), Landscape(12).image(side, 0, moved)
    clouded = np.where(np.arange(side) < side // 2, ground, cloud)
    images = (
        Image(each, np.ones(each.shape, bool), scene_epsilon(each)) for each in (scene.image(side), clouded)
    )
    channels = prepare(*images, channels="orientations").channels
    rows, cols = np.meshgrid(np.arange(60, side - 60, 20), np.arange(60, side - 60, 20), indexing="ij")
    corners = np.column_stack([rows.ravel(), cols.ravel()])
    shared = significantly_correlated(channels, corners, np.tile([2.0, -3.0], (len(corners), 1)))
    assert shared[corners[:, 1] < 150].all()
    assert shared[corners[:, 1] > 250].mean() < 0.15
    assert significantly_correlated(channels, corners[:0], np.zeros((0, 2))).shape == (0,)


def test_a_match_passes_when_it_became_more_similar_and_is_similar_enough() -> None:
    away, there = start_at(1.0, -2.0), refined_at(2.0, -3.0)
    assert passes_paper(pair(), CORNERS, away, there, WINDOW, 0.4).all()
    assert not passes_paper(pair(), CORNERS, start_at(2.0, -3.0), refined_at(1.0, -2.0), WINDOW, 0.0).any()
    assert not passes_paper(pair(), CORNERS, away, there, WINDOW, 1.01).any()
