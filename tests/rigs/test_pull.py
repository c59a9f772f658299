"""Distortion that is not yet known is seen as large as it is, near the corners too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.rig_scenes import Flown, TrueLens, ground_points, lens_rays, made_rig, made_thermal, seen_by
from pcwlad_geo.rigs.adjustment import Observations
from pcwlad_geo.rigs.captures import group
from pcwlad_geo.rigs.lens import Lens, lattice
from pcwlad_geo.rigs.lens_matching import LensTask, match_task
from pcwlad_geo.rigs.parameters import LEARNING
from pcwlad_geo.types import Float64
from tests.rigs.rigs import flown, ground, write

SHAPE = (480, 640)
NEAR_INFRARED = 3
CORNER_PX = 0.6
"""Of the distortion that is not known, at the corners."""
LEAST_WINDOW_PX = 31
"""Side of windows in frames of few px."""
NEAR_CORNERS_PX = 320.0
"""From the middle of the frame; the corners lie at 400 px."""


def plane_of(lens: TrueLens, capture: Flown, distance_m: float) -> Float64:
    """Return the (3,) inverse depth of the ground that the reference sees, and its slopes."""
    rays, place = lens_rays(lens, capture, lattice(SHAPE, 40))
    axes = (ground_points(ground(), capture, rays, place) - capture.place_m) * [1, 1, -1] @ capture.turn.T
    design = np.column_stack([np.ones(len(axes)), axes[:, :2] / axes[:, 2:]])
    return np.asarray(np.linalg.lstsq(design, distance_m / axes[:, 2], rcond=None)[0])


def seen_and_true(
    folder: Path, rig: Sequence[TrueLens], capture: Flown, expected: Lens, side_px: int
) -> tuple[Observations, Float64, Float64]:
    """Return tie points of the last lens of a rig with the first, and where it truly sees them and should."""
    reference, lens = rig[0], rig[-1]
    write(folder, "A_000", rig, capture)
    ((found,), _) = group(sorted(folder.glob("A_000_*.tif")))
    down_m = float(capture.place_m[2])
    pose = np.concatenate(
        [np.asarray(cv2.Rodrigues(lens.rotation)[0]).ravel(), -lens.rotation @ lens.place_m / down_m]
    )
    frames = found.frames[reference.name], found.frames[lens.name]
    plane = plane_of(reference, capture, down_m)
    task = LensTask(
        0, 1, 1, *frames, (reference.lens, expected), pose, plane, side_px, 4, LEARNING.window_share[1]
    )
    points = match_task(task)
    assert points is not None
    down, place = lens_rays(reference, capture, points.reference_px)
    true_px = seen_by(lens, capture, ground_points(ground(), capture, down, place))
    return points, true_px, task.lens_px(points.reference_px)


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Float64:
    """(n, 3) distance from the middle, true and observed displacement away from it, of tie points, px."""
    rig = made_rig(11, SHAPE)[: NEAR_INFRARED + 1]
    lens = rig[-1].lens
    bent = lens.vector.copy()
    bent[5] -= CORNER_PX / lens.focal_px / lens.corner**7
    parts = []
    for height_m, east_m in ((40.0, 34.0), (45.0, 42.0)):
        points, true_px, expected_px = seen_and_true(
            tmp_path_factory.mktemp("frames"), rig, flown(height_m, east_m), replace(lens, vector=bent), 640
        )
        away = points.lens_px - np.array(SHAPE[::-1]) / 2
        length = np.hypot(*away.T)
        along = [((px - expected_px) * away).sum(axis=1) / length for px in (true_px, points.lens_px)]
        parts.append(np.column_stack([length, *along]))
    return np.concatenate(parts)


def test_a_lens_of_few_px_is_matched_up_to_its_edges(tmp_path: Path) -> None:
    rig = made_thermal(11, told=True)
    lens = rig[-1].lens
    side_px = round(max(rig[0].lens.shape) * lens.focal_px / rig[0].lens.focal_px)
    points, true_px, _ = seen_and_true(tmp_path, rig, flown(45.0), lens, side_px)
    from_edge = np.minimum(points.lens_px, np.array(lens.shape[::-1]) - points.lens_px).min(axis=1)
    near = from_edge < LEARNING.margin_share * LEAST_WINDOW_PX
    assert near.sum() > 10
    assert np.median(np.hypot(*(points.lens_px - true_px)[near].T)) < 0.5


def test_a_lens_of_more_px_than_the_reference_is_matched_over_its_whole_frame(tmp_path: Path) -> None:
    reference, lens = made_rig(11, SHAPE)[:2]
    finer = replace(lens.lens, shape=(960, 1280), vector=lens.lens.vector * ([2.0] * 3 + [1.0] * 5))
    rig = reference, replace(lens, lens=finer, calibrated=None)
    points, *_ = seen_and_true(tmp_path, rig, flown(45.0), finer, 640)
    assert (points.lens_px > np.array(SHAPE[::-1])).all(axis=1).mean() > 0.1


def test_no_smooth_field_takes_away_what_bends_near_the_corners(seen: Float64) -> None:
    length, true, observed = seen[seen[:, 0] > NEAR_CORNERS_PX].T
    assert len(length) > 30
    assert np.median(true) > 0.1
    assert np.median(observed) == pytest.approx(np.median(true), abs=0.05)
    assert (true @ observed) / (true @ true) > 0.8
