"""When a pair counts as registered."""

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching import TiePoints
from pcwlad_geo.registration.decision import Decision
from pcwlad_geo.registration.judge import JudgeParameters, judge

LEAST_POINTS = JudgeParameters().least_points

WINDOW_PX, RADIUS_PX = 41, 12
COUNTS = {"candidates": 200}


def matches(n: int, side_px: float, *, right: float, seed: int = 0) -> tuple[TiePoints, NDArray[np.bool_]]:
    """Return n matches in a square, this share of them at (3, -2) px, the others anywhere in the radius."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, side_px, (n, 2))
    moved = rng.uniform(-RADIUS_PX, RADIUS_PX, (n, 2))
    kept = np.arange(n) < round(right * n)
    moved[kept] = rng.normal((3, -2), 0.1, (int(kept.sum()), 2))
    covariance = np.tile(0.01 * np.eye(2), (n, 1, 1))
    return TiePoints(xy, xy + moved, covariance, np.full(n, 0.5), np.zeros(n)), kept


def verdict(points: tuple[TiePoints, NDArray[np.bool_]], **counts: int) -> Decision:
    return judge(*points, {**COUNTS, **counts}, WINDOW_PX, RADIUS_PX)


def test_points_that_agree_all_over_the_scene_are_accepted() -> None:
    found = verdict(matches(200, 400, right=0.9))
    assert found.accepted
    assert found.refusal is None
    assert found.significance > 20
    assert found.evidence.agreeing_cells > 0.8 * found.evidence.cells


def test_random_matches_are_refused() -> None:
    for seed in range(20):
        points, _ = matches(200, 400, right=0.0, seed=seed)
        near = np.linalg.norm(points.displacement_px - np.median(points.displacement_px, axis=0), axis=1) < 3
        found = verdict((points, near))
        assert not found.accepted
        assert "no better than chance" in (found.refusal or "")
        assert f"{int(near.sum())} of 200 candidates" in (found.refusal or "")


def test_agreement_but_for_whole_blocks_of_jpeg_is_little_evidence() -> None:
    """Grids of 8 px lie on each other at nine displacements within the radius; one is the most frequent."""
    rng = np.random.default_rng(1)
    for side_px, right, accepted in ((70, 0.65, False), (400, 0.8, True)):
        points, kept = matches(200, side_px, right=right)
        assert verdict((points, kept)).accepted
        moved = np.where(kept[:, None], 0.0, rng.choice([(-8, 0), (0, 8), (-8, 8), (-16, 8)], 200))
        by_blocks = replace(points, target_xy_px=points.reference_xy_px + np.array([3.0, -2.0]) + moved)
        found = verdict((by_blocks, kept))
        assert found.evidence.agreeing_cells >= 8
        assert found.accepted is accepted
        assert accepted or "JPEG" in (found.refusal or "")


def test_many_points_in_one_place_are_one_witness() -> None:
    found = verdict(matches(200, 40, right=1.0))
    assert found.evidence.cells <= 4
    assert not found.accepted


@pytest.mark.parametrize("seed", range(12))
def test_a_plane_through_three_clusters_is_chance(seed: int) -> None:
    """Windows of a cluster show the same pixels; there is always a plane through three."""
    rng = np.random.default_rng(seed)
    middles = np.array([[30.0, 30.0], [110.0, 40.0], [60.0, 110.0]])
    xy = np.concatenate([middle + rng.uniform(-14, 14, (25, 2)) for middle in middles])
    moved = np.repeat(rng.uniform(-4, 4, (3, 2)), 25, axis=0) + rng.normal(0, 0.1, (75, 2))
    others = rng.uniform(0, 140, (25, 2)), rng.uniform(-RADIUS_PX, RADIUS_PX, (25, 2))
    xy, moved = np.concatenate([xy, others[0]]), np.concatenate([moved, others[1]])
    covariance = np.tile(0.01 * np.eye(2), (100, 1, 1))
    points = TiePoints(xy, xy + moved, covariance, np.full(100, 0.5), np.zeros(100))
    assert not verdict((points, np.arange(100) < 75)).accepted


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("windows", "evidence", "accepted"),
    [((1.8, 1.1), 2.93, False), ((1.8, 1.1), 4.0, True), ((3.3, 3.3), 2.93, True)],
)
def test_windows_that_overlap_have_found_a_pose_together(
    windows: tuple[float, float], evidence: float, accepted: bool, seed: int
) -> None:
    """As of one path in an image beside itself transposed, by which the search had found a pose."""
    xy = np.random.default_rng(seed).uniform(0, np.multiply(windows, WINDOW_PX), (300, 2))
    nothing = np.zeros(300)
    points = TiePoints(xy, xy, np.tile(0.01 * np.eye(2), (300, 1, 1)), nothing, nothing)
    found = judge(points, np.ones(300, bool), COUNTS, WINDOW_PX, RADIUS_PX, evidence=evidence)
    assert found.accepted == accepted


def test_too_few_points_are_refused_however_well_they_agree() -> None:
    assert verdict(matches(LEAST_POINTS, 300, right=1.0)).accepted
    assert not verdict(matches(LEAST_POINTS - 1, 300, right=1.0)).accepted


@pytest.mark.parametrize(("n", "side_px"), [(LEAST_POINTS - 1, 300), (200, 40)])
def test_points_that_agree_and_are_too_few_are_not_called_chance(n: int, side_px: float) -> None:
    """A radius raised would not help them: there is no more ground."""
    found = verdict(matches(n, side_px, right=1.0))
    assert not found.accepted
    assert f"{n} tie points agree" in (found.refusal or "")
    assert "share more ground" in (found.refusal or "")
    assert "chance" not in (found.refusal or "")
    assert found.evidence.past_search_border is None


def test_an_affine_field_counts_as_agreement() -> None:
    points, kept = matches(200, 400, right=1.0)
    tilted = points.reference_xy_px @ np.array([[1.02, 0.01], [-0.015, 0.98]]).T + [3, -2]
    stretched = replace(points, target_xy_px=tilted)
    assert verdict((stretched, kept)).accepted


def test_no_point_at_all() -> None:
    found = verdict((TiePoints.empty(), np.zeros(0, bool)))
    assert not found.accepted
    assert found.evidence.cells == found.evidence.agreeing_cells == 0


@pytest.mark.parametrize(
    ("counts", "advice"),
    [
        ({"candidates": 0}, "no structure to match"),
        ({"not_comparable": 195}, "enough valid pixels"),
    ],
)
def test_the_reason_says_what_to_do(counts: dict[str, int], advice: str) -> None:
    found = verdict(matches(100, 400, right=0.0), **counts)
    assert re.search(advice, found.refusal or "")
    assert found.evidence.past_search_border is None


@pytest.mark.parametrize(("at_search_border", "past_border"), [(80, True), (20, False)])
def test_many_matches_on_the_edge_of_the_search_tell_of_what_lies_beyond(
    at_search_border: int, past_border: bool
) -> None:
    found = verdict(matches(100, 400, right=0.0), at_search_border=at_search_border)
    assert "no better than chance" in (found.refusal or "")
    assert found.evidence.past_search_border is past_border
