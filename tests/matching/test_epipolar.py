"""Matches of two perspective views of ground with roofs, made from two cameras."""

from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.matching.epipolar import (
    EpipolarGeometry,
    epipolar_evidence,
    on_their_lines,
    parallax_evidence,
    plane_residual_px,
)
from pcwlad_geo.matching.outliers import consistent
from pcwlad_geo.matching.types import TiePoints
from pcwlad_geo.types import Bool, Float64

SIDE_PX, WINDOW_PX, RADIUS_PX, FOCAL_PX, HEIGHT_M = 700.0, 81, 14, 900.0, 100.0
CLEAR = 6.0
ROOF_M = 12.0


def roofs_m(xy_px: Float64, high_m: tuple[float, ...]) -> Float64:
    """Return the height of the ground: blocks of 90 px, every 180 px, of these heights in turn."""
    block = np.floor(xy_px / 90).astype(int)
    number = (block[:, 0] // 2 + 3 * (block[:, 1] // 2)) % len(high_m)
    return np.where((block % 2 == 1).all(axis=1), np.array(high_m)[number], 0.0)


def two_views(
    n: int = 900, seed: int = 0, high_m: tuple[float, ...] = (4.0, 8.0, ROOF_M), wrong: float = 0.1
) -> tuple[TiePoints, Bool, Bool]:
    """Return matches, and masks of the wrong ones and of those on roofs.

    The second camera stands 5 m to the east and 2 m to the south, is turned by 2 degrees about each axis,
    and the displacement is relative to the typical one, as after a search.
    """
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, SIDE_PX, (n, 2))
    height = roofs_m(xy, high_m)
    ray = np.column_stack([(xy - SIDE_PX / 2) / FOCAL_PX, np.ones(n)])
    ground = ray * (HEIGHT_M - height)[:, None] - [5.0, 2.0, 1.0]
    for first, second in ((0, 1), (0, 2), (1, 2)):
        turn = np.eye(3)
        cos, sin = np.cos(np.radians(2)), np.sin(np.radians(2))
        turn[[first, second], [first, second]] = cos
        turn[first, second], turn[second, first] = -sin, sin
        ground = ground @ turn.T
    seen = FOCAL_PX * ground[:, :2] / ground[:, 2:] + SIDE_PX / 2
    seen -= np.round(np.median(seen - xy, axis=0))
    seen += rng.normal(0, 0.1, (n, 2))
    bad = rng.random(n) < wrong
    seen[bad] = xy[bad] + rng.uniform(-RADIUS_PX, RADIUS_PX, (int(bad.sum()), 2))
    return points_of(xy, seen), bad, height > 0


def points_of(reference_xy: Float64, target_xy: Float64) -> TiePoints:
    n = len(reference_xy)
    nothing = np.full(n, np.nan)
    return TiePoints(reference_xy, target_xy, np.tile(0.01 * np.eye(2), (n, 1, 1)), nothing, nothing)


def smooth(points: TiePoints) -> Bool:
    return consistent(points.reference_xy_px, points.displacement_px, np.full(len(points), 0.14), WINDOW_PX)


def test_every_depth_stays_and_what_lies_off_its_line_goes() -> None:
    points, wrong, roof = two_views()
    kept, planar = on_their_lines(points), smooth(points)
    assert kept[~wrong].mean() > 0.95
    assert kept[~wrong & roof].mean() > 0.9
    assert planar[~wrong & roof].mean() < 0.75  # the other test calls many roofs wrong
    assert kept[wrong].mean() < 0.05


def test_a_wrong_match_on_its_line_goes_for_want_of_neighbours() -> None:
    points, _wrong, _ = two_views(wrong=0.0)
    lines = EpipolarGeometry.of(points.reference_xy_px, points.target_xy_px)
    assert lines is not None
    moved = np.arange(len(points)) % 10 == 0
    along = lines.along(points.reference_xy_px)
    far = np.random.default_rng(4).choice([-1, 1], len(points)) * 9.0
    target = points.target_xy_px + np.where(moved, far, 0.0)[:, None] * along
    kept = on_their_lines(points_of(points.reference_xy_px, target))
    assert kept[moved].mean() < 0.05
    assert kept[~moved].mean() > 0.95


def test_distance_is_that_across_the_line() -> None:
    points, _wrong, _ = two_views(wrong=0.0)
    lines = EpipolarGeometry.of(points.reference_xy_px, points.target_xy_px)
    assert lines is not None
    along = lines.along(points.reference_xy_px)
    across = np.column_stack([along[:, 1], -along[:, 0]])
    before = lines.distance_px(points.reference_xy_px, points.target_xy_px)
    after = lines.distance_px(points.reference_xy_px, points.target_xy_px + 3 * across + 5 * along)
    np.testing.assert_allclose(after - before, 3.0, atol=1e-9)
    assert np.sqrt((before**2).mean()) == pytest.approx(0.1, abs=0.02)


def test_the_same_matches_always_give_the_same_geometry() -> None:
    points, _, _ = two_views()
    first, second = (EpipolarGeometry.of(points.reference_xy_px, points.target_xy_px) for _ in range(2))
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.matrix, second.matrix)


def test_a_plane_is_taken_out_and_roofs_are_left() -> None:
    points, _wrong, roof = two_views(wrong=0.0)
    left = plane_residual_px(points.reference_xy_px, points.target_xy_px, ~roof)
    assert left is not None
    assert np.hypot(*left[~roof].T).max() < 0.6
    # parallax = focal length * base * height / (distance * (distance - height)), 5.4 m of base
    largest = FOCAL_PX * np.hypot(5.0, 2.0) * ROOF_M / (HEIGHT_M * (HEIGHT_M - ROOF_M))
    assert np.hypot(*left.T).max() == pytest.approx(largest, abs=1.0)


@pytest.mark.parametrize("seed", range(3))
def test_several_depths_are_parallax(seed: int) -> None:
    points, _, _ = two_views(seed=seed)
    assert parallax_evidence(points, smooth(points), WINDOW_PX) > CLEAR


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("wrong", [0.1, 0.4])
def test_errors_beside_a_plane_are_no_parallax(seed: int, wrong: float) -> None:
    points, _, _ = two_views(seed=seed, high_m=(0.0,), wrong=wrong)
    assert parallax_evidence(points, smooth(points), WINDOW_PX) == 0.0


def test_a_layer_of_clouds_that_moved_is_no_parallax() -> None:
    points, _, _ = two_views(high_m=(10.0,))
    planar = smooth(points)
    assert parallax_evidence(points, planar, WINDOW_PX) == 0.0


@pytest.mark.parametrize("seed", range(10))
def test_unrelated_images_fit_no_epipolar_geometry(seed: int) -> None:
    points, _, _ = two_views(seed=seed, wrong=1.0)
    assert epipolar_evidence(points, WINDOW_PX, RADIUS_PX) < 3.0


def test_related_images_do() -> None:
    points, _, _ = two_views(wrong=0.3)
    assert epipolar_evidence(points, WINDOW_PX, RADIUS_PX) > CLEAR


@pytest.mark.parametrize("n", [0, 1, 7, 23])
def test_few_matches_tell_no_geometry(n: int) -> None:
    points, _, _ = two_views(n=max(n, 1))
    few = points[:n]
    assert not on_their_lines(few).any()
    assert parallax_evidence(few, np.ones(n, bool), WINDOW_PX) == 0.0
    assert epipolar_evidence(few, WINDOW_PX, RADIUS_PX) == 0.0


def test_matches_on_a_line_or_at_one_place_are_survived() -> None:
    for xy in (np.full((60, 2), 5.0), np.column_stack([np.arange(60.0), np.arange(60.0)])):
        points = points_of(xy, xy + 1.0)
        assert len(on_their_lines(points)) == 60
        assert parallax_evidence(points, np.ones(60, bool), WINDOW_PX) == 0.0
