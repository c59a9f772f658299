"""Targets that lie in another pose than their georeferencing says, or that have none."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rasterio

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import TiePoints
from pcwlad_geo.matching.pose.proposal import PoseProposal
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import ViewPair, describe, plan_views
from pcwlad_geo.raster.cameras import Camera
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.registration.run import register_pair
from pcwlad_geo.registration.scene import pose as pose_module
from pcwlad_geo.registration.scene.parameters import SceneContext
from pcwlad_geo.registration.scene.pose import match_again_in_pose, pose_from_points
from pcwlad_geo.registration.starts import searches
from pcwlad_geo.registration.starts.alignment import Prealignment, StartingAlignment
from pcwlad_geo.registration.starts.overviews import read_overviews
from pcwlad_geo.registration.starts.pose import Pose
from pcwlad_geo.registration.starts.posing import posed_start
from pcwlad_geo.registration.starts.searches import PoseStarts, scales_of_frames
from tests.scenes import Array, make_grid, render, tag_jpeg, write

GRID = make_grid((300, 320))
RMSE_AS_IT_LIES_PX = 0.193
"""Of the tie points of this scene where the target is not turned, as the first test measures."""


def pose_of(rotation_deg: float, scale: float, *, shear: float = 0.0) -> tuple[Array, Array]:
    """Return linear part and displacement of a pose about the middle of the grid: observed = L p + d."""
    turn = np.radians(rotation_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    linear = scale * rotation @ np.array([[1.0, shear], [0.0, 1.0]])
    middle = np.array([160.0, 150.0])
    return linear, middle - linear @ middle


def register(folder: Path, linear: Array, shift: Array, *, located: bool, **options: object) -> Registration:
    reference = write(folder / "reference.tif", render(GRID), GRID if located else None)
    values = render(GRID, "thermal", linear=linear, displacement_px=shift)
    target = write(folder / "target.tif", values, GRID if located else None)
    return register_pair(
        reference, target, Settings.from_options({"window": 81, "features": 1000, **options})
    )


def errors_px(found: Registration, linear: Array, shift: Array, least: int = 101) -> Array:
    points = found.tie_points.select("fit", "check", "matched")
    assert len(points) >= least
    return np.linalg.norm(points.target_px - points.reference_px @ linear.T - shift, axis=1)


def test_a_target_as_it_lies_is_not_searched_for_a_pose(tmp_path: Path) -> None:
    linear, shift = np.eye(2), np.zeros(2)
    found = register(tmp_path, linear, shift, located=True)
    assert found.prealignment.pose is None
    error_px = np.sqrt((errors_px(found, linear, shift) ** 2).mean())
    assert error_px == pytest.approx(RMSE_AS_IT_LIES_PX, abs=0.005)


@pytest.mark.parametrize(
    ("located", "rotation_deg", "scale", "candidates"),
    [
        (True, 35.0, 1.0, 250),
        pytest.param(True, 35.0, 1.0, 1000, marks=pytest.mark.slow),
        pytest.param(False, -170.0, 1.15, 1000, marks=pytest.mark.slow),
    ],
)
def test_a_turned_target_is_registered_as_precisely(
    located: bool, rotation_deg: float, scale: float, candidates: int, tmp_path: Path
) -> None:
    linear, shift = pose_of(rotation_deg, scale)
    found = register(tmp_path, linear, shift, located=located, features=candidates)
    assert found.status == "registered"
    assert np.sqrt((errors_px(found, linear, shift) ** 2).mean()) < 1.15 * RMSE_AS_IT_LIES_PX * scale
    corners = np.array([[0.0, 0.0], [320.0, 0.0], [0.0, 300.0], [320.0, 300.0]])
    assert found.model is not None
    np.testing.assert_allclose(found.model.forward(corners), corners @ linear.T + shift, atol=0.3)
    pose = found.prealignment.pose
    assert pose is not None
    assert pose.rotation_deg == pytest.approx(rotation_deg, abs=0.2)
    assert pose.scale == pytest.approx((scale, scale), rel=0.005)
    assert located == any(f"found the target at {pose}" in warning for warning in found.warnings)


@pytest.mark.slow
def test_a_sheared_target_is_matched_in_its_shape(tmp_path: Path) -> None:
    linear, shift = pose_of(60.0, 0.9, shear=0.05)
    found = register(tmp_path, linear, shift, located=False)
    assert found.status == "registered"
    assert np.sqrt((errors_px(found, linear, shift) ** 2).mean()) < 1.15 * RMSE_AS_IT_LIES_PX
    assert found.prealignment.pose is not None
    assert found.prealignment.pose.shear_deg == pytest.approx(np.degrees(np.arctan(0.05)), abs=0.2)


@pytest.mark.slow
def test_another_scene_is_refused_in_every_pose(tmp_path: Path) -> None:
    reference = write(tmp_path / "reference.tif", render(GRID), None)
    target = write(tmp_path / "target.tif", render(GRID, "thermal", seed=9), None)
    found = register_pair(reference, target, Settings())
    assert found.status == "rejected"
    assert found.prealignment.searched
    assert found.prealignment.pose is None


@pytest.mark.slow
def test_a_first_match_stands_where_a_second_finds_too_little_in_common(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> StartingAlignment:
        raise InputError("the common area is 12 x 12 px")

    monkeypatch.setattr("pcwlad_geo.registration.scene.pose.posed_start", refuse)
    linear, shift = pose_of(35.0, 1.0)
    found = register(tmp_path, linear, shift, located=True)
    assert found.status == "registered"
    assert np.median(errors_px(found, linear, shift)) < 0.5


@pytest.mark.slow
def test_a_georeferencing_that_must_be_believed_is(tmp_path: Path) -> None:
    linear, shift = pose_of(35.0, 1.0)
    found = register(tmp_path, linear, shift, located=True, prealign="georef")
    assert found.status == "rejected"
    assert found.prealignment.pose is None


@pytest.mark.slow
def test_a_mask_moves_with_its_target(tmp_path: Path) -> None:
    linear, shift = pose_of(35.0, 1.0)
    mask = np.ones((150, 160), np.uint8)
    mask[:, :80] = 0  # the left half of the target, in pixels of twice the size
    grid = GRID.scaled((150, 160))
    profile = {"driver": "GTiff", "height": 150, "width": 160, "count": 1, "dtype": "uint8"}
    with rasterio.open(tmp_path / "mask.tif", "w", crs=grid.crs, transform=grid.transform, **profile) as file:
        file.write(mask, 1)
    found = register(tmp_path, linear, shift, located=True, tgt_mask=tmp_path / "mask.tif")
    points = found.tie_points.select("fit", "check", "matched")
    assert len(points) > 50
    assert points.target_px[:, 0].min() > 150


@pytest.mark.parametrize(
    ("tilt_deg", "turn_deg", "on_map"),
    [
        (2.0, 0.0, False),
        pytest.param(3.0, 20.0, True, marks=pytest.mark.slow),
        pytest.param(3.0, 35.0, False, marks=pytest.mark.slow),
        pytest.param(10.0, 35.0, False, marks=pytest.mark.slow),  # 13 % across the frame
    ],
)
def test_flat_ground_seen_from_the_side_is_projective(
    tilt_deg: float, turn_deg: float, on_map: bool, tmp_path: Path
) -> None:
    homography = seen_from_the_side(tilt_deg, turn_deg)
    middle = np.array([[160.0, 150.0], [161.0, 150.0], [160.0, 151.0]])
    seen = through(homography, middle)
    linear = np.column_stack([seen[1] - seen[0], seen[2] - seen[0]])
    shift = seen[0] - linear @ middle[0]

    def beside(xy: Array) -> Array:
        return np.asarray(through(homography, xy) - xy @ linear.T - shift)

    reference = write(tmp_path / "reference.tif", render(GRID), GRID if on_map else None)
    values = render(GRID, "thermal", linear=linear, displacement_px=shift, local=beside)
    found = register_pair(reference, write(tmp_path / "target.tif", values, None), Settings(features=300))
    assert found.status == "registered"
    assert (found.prealignment.pose is not None) == (turn_deg != 0)
    assert found.model is not None
    assert found.model.name == "projective"
    places = np.array([[40.0, 40.0], [280.0, 40.0], [40.0, 260.0], [280.0, 260.0], [160.0, 150.0]])
    error_px = np.linalg.norm(found.model.forward(places) - through(homography, places), axis=1)
    assert error_px.max() < (0.25 if on_map else 0.5)


def seen_from_the_side(tilt_deg: float, turn_deg: float, focal_px: float = 400.0) -> Array:
    """Return the (3, 3) homography of flat ground, tilted about its columns and turned about the middle."""
    camera = np.array([[focal_px, 0, 160.0], [0, focal_px, 150.0], [0, 0, 1]])
    cos, sin = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    tilt = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    seen = camera @ turn @ tilt @ np.linalg.inv(camera)
    moved = through(seen, np.array([[160.0, 150.0]]))[0]
    back = np.array([[1, 0, 160.0 - moved[0]], [0, 1, 150.0 - moved[1]], [0, 0, 1]])
    return np.asarray(back @ seen)


def through(homography: Array, xy: Array) -> Array:
    moved = np.column_stack([xy, np.ones(len(xy))]) @ homography.T
    return np.asarray(moved[:, :2] / moved[:, 2:])


RELATIVE = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:d="http://www.dji.com/drone-dji/1.0/" d:RelativeAltitude="+300.00"/></rdf:RDF>'
    "</x:xmpmeta>"
)


@pytest.mark.slow
@pytest.mark.parametrize("told", [True, False])
def test_pixels_of_very_different_size_are_found_by_the_cameras(told: bool, tmp_path: Path) -> None:
    fine = make_grid((1600, 1760), pixel_m=30.0 / 8)
    linear, shift = pose_of(25.0, 1.0)
    jpeg = {"driver": "JPEG", "dtype": "uint8", "quality": 95}
    reference = write(tmp_path / "reference.jpg", render(fine), None, **jpeg)
    values = render(make_grid((300, 320)), "thermal", linear=linear, displacement_px=shift)
    target = write(tmp_path / "target.jpg", values, None, **jpeg)
    for path, focal_px in ((reference, 8000), (target, 1000)):
        tags = {
            "FocalLength": [10.0],
            "FocalPlaneXResolution": [focal_px / 10],
            "FocalPlaneResolutionUnit": 4,
        }
        tag_jpeg(path, RELATIVE if told else "", **tags)  # type: ignore[arg-type]
    found = register_pair(reference, target, Settings())
    assert any("8.0 times as large" in warning for warning in found.warnings) == told
    assert any("data are ignored" in warning for warning in found.warnings) != told
    assert found.status == "registered"
    assert found.prealignment.expected_scale == pytest.approx(1 / 8)  # by the lenses alone, if not told
    assert np.median(errors_px(found, linear / 8, shift, least=60)) < 0.3


@pytest.mark.slow
def test_frames_of_very_different_size_are_found_by_these(tmp_path: Path) -> None:
    """A thermal frame shows 1 / 1.4 of the width of the visible one, which has 7.7 times its columns."""
    scale = 1.4 / 7.7
    fine = make_grid((1232, 1355), pixel_m=30 * scale)
    turn, _ = pose_of(12.0, 1.0)
    shift = np.array([88.0, 80.0]) - turn @ np.array([1355, 1232]) / 2 * scale
    visible = write(tmp_path / "visible.tif", render(fine), None)
    values = render(make_grid((160, 176)), "thermal", linear=turn, displacement_px=shift)
    thermal = write(tmp_path / "thermal.tif", values, None)
    found = register_pair(visible, thermal, Settings())
    assert found.status == "registered"
    assert found.prealignment.expected_scale == pytest.approx(1 / 7.7, rel=1e-3)
    assert np.median(errors_px(found, turn * scale, shift)) < 0.3


def test_a_scale_is_guessed_of_frames_of_very_different_size_alone(tmp_path: Path) -> None:
    sizes = {"large": (900, 1200), "small": (112, 160), "similar": (600, 800)}
    infos = {
        name: describe(write(tmp_path / f"{name}.tif", np.ones(shape), None)) for name, shape in sizes.items()
    }
    large, small = infos["large"], infos["small"]
    guess = math.hypot(*sizes["small"]) / math.hypot(*sizes["large"])
    assert scales_of_frames(plan_views(large, small)) == (None, pytest.approx(guess))
    assert scales_of_frames(plan_views(small, large)) == (None, pytest.approx(1 / guess))
    assert scales_of_frames(plan_views(large, infos["similar"])) == (None, None)
    cameras = Camera(4000.0, None, None), Camera(400.0, None, None)
    by_lens = [replace(info, camera=camera) for info, camera in zip((large, small), cameras, strict=True)]
    assert scales_of_frames(plan_views(*by_lens)) == (None, pytest.approx(0.1))
    told = [replace(info, camera=replace(info.camera, height_m=50.0)) for info in by_lens]  # type: ignore[type-var]
    assert scales_of_frames(plan_views(*told)) == (pytest.approx(0.1), None)
    located = [replace(info, georeferenced=True) for info in (large, small)]
    assert scales_of_frames(plan_views(*located)) == (None, None)


@pytest.mark.slow
def test_a_refusal_speaks_of_the_scale_where_sizes_differ_much(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    paths = [write(tmp_path / f"{n}.tif", rng.uniform(1, 255, (n, n)), None) for n in (700, 100)]
    found = register_pair(*paths, Settings())
    assert found.status == "rejected"
    assert "The pixels of the reference may be 7.0 times as small" in str(found.reason)


def views(folder: Path, *, located: bool = True) -> ViewPair:
    files = [
        write(folder / f"{name}.tif", render(GRID), GRID if located else None)
        for name in ("reference", "target")
    ]
    return plan_views(*map(describe, files))


def test_the_pose_of_a_start_is_what_was_asked_for(tmp_path: Path) -> None:
    linear, shift = pose_of(20.0, 1.0)
    matrix = np.vstack([np.column_stack([linear, shift]), [0, 0, 1]])
    start = posed_start(views(tmp_path), matrix, 9)
    assert start.prealignment.search_radius_px == 9
    places = np.array([[100.0, 120.0], [200.0, 80.0]])
    reference = start.pair.reference.from_file_px(places)
    target = start.pair.target.to_file_px(reference + start.pair.offset_px)
    np.testing.assert_allclose(target, places @ linear.T + shift, atol=1e-6)


def test_a_start_may_be_seen_from_the_side(tmp_path: Path) -> None:
    homography = seen_from_the_side(4.0, 20.0)
    start = posed_start(views(tmp_path, located=False), homography, 9)
    places = np.array([[100.0, 120.0], [200.0, 80.0], [40.0, 250.0]])
    np.testing.assert_allclose(placed(start.pair, places), through(homography, places), atol=2e-3)
    assert start.prealignment.pose is not None
    assert start.prealignment.pose.rotation_deg == pytest.approx(20.0, abs=0.5)
    moved = np.eye(3)  # a pose beside that one
    moved[:2] = [[1.01, 0.02, start.pair.offset_px[0] + 3], [-0.03, 0.98, start.pair.offset_px[1] - 2]]
    again = posed_start(start.pair, moved, 9)
    reference = start.pair.reference.from_file_px(places)
    beside = start.pair.target.to_file_px(through(moved, reference))
    np.testing.assert_allclose(placed(again.pair, places), beside, atol=2e-3)


def placed(pair: ViewPair, places_px: Array) -> Array:
    """Return where a pair has (n, 2) px of the reference file in the target file."""
    return pair.target.to_file_px(pair.reference.from_file_px(places_px) + pair.offset_px)


@pytest.mark.parametrize("located", [False, True])
def test_a_search_gives_frames_alone_a_perspective(
    located: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from_corners = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
    homography = seen_from_the_side(4.0, 20.0)
    by_indices = from_corners @ homography @ np.linalg.inv(from_corners)
    affine = np.array([[1.0, 0.1, 4.0], [-0.1, 1.0, 7.0]])
    proposal = PoseProposal(affine, 1.0, 3.0, homography=by_indices)
    monkeypatch.setattr(searches, "search_pose", lambda *_, **__: SimpleNamespace(proposal=proposal))
    pair = views(tmp_path, located=located)
    start = PoseStarts(pair, read_overviews(pair), Settings()).by_structure()
    assert start is not None
    places = np.array([[100.0, 120.0], [200.0, 80.0], [40.0, 250.0]])
    from_affine = np.linalg.inv(from_corners) @ np.vstack([affine, [0, 0, 1]]) @ from_corners
    expected = through(from_affine if located else homography, places)
    np.testing.assert_allclose(placed(start.pair, places), expected, atol=2e-3)


@pytest.mark.parametrize(("tilt_deg", "tells"), [(0.0, False), (0.1, False), (4.0, True)])
def test_points_of_frames_tell_of_a_perspective(tilt_deg: float, tells: bool) -> None:
    rng, homography = np.random.default_rng(3), seen_from_the_side(tilt_deg, 0.0)
    here = rng.uniform(0, 300, (80, 2))
    there = through(homography, here) + rng.normal(0, 0.3, here.shape)
    points = TiePoints(here, there, np.tile(np.eye(2), (80, 1, 1)), np.zeros(80), np.zeros(80))
    found = pose_from_points(points, perspective=True)
    assert bool(found[2, :2].any()) == tells
    assert np.abs(through(found, here) - through(homography, here)).max() < 0.5
    assert not pose_from_points(points, perspective=False)[2, :2].any()
    faint = through(seen_from_the_side(0.5, 0.0), here) + 0.1 * (there - through(homography, here))
    of_faint = TiePoints(here, faint, points.covariance_px2, points.score, points.score)
    assert not pose_from_points(of_faint, perspective=True)[2, :2].any()
    assert pose_from_points(of_faint, perspective=True, refine=True)[2, :2].any()
    assert not pose_from_points(points[:20], perspective=True)[2, :2].any()


@pytest.mark.parametrize("rotation_deg", [-179.0, -90.0, 0.0, 12.5, 180.0])
def test_a_pose_is_told_in_words(rotation_deg: float) -> None:
    linear, shift = pose_of(rotation_deg, 1.5)
    pose = Pose.of(np.vstack([np.column_stack([linear, shift]), [0, 0, 1]]), (300, 320))
    assert abs((pose.rotation_deg - rotation_deg + 180) % 360 - 180) < 1e-9
    assert pose.scale == pytest.approx((1.5, 1.5))
    assert pose.shear_deg == pytest.approx(0.0, abs=1e-9)
    assert pose.shift_px == pytest.approx((0.0, 0.0), abs=1e-9)
    assert "scale 1.500 x 1.500" in str(pose)


@pytest.mark.parametrize(
    ("evidence", "must_stand", "verdicts", "accepted"),
    [
        (2.9, False, [False], False),
        (2.9, False, [True, False], True),
        (5.0, False, [False], True),
        (2.9, False, [True, True, True], True),
        (5.0, True, [True, False], False),
        (5.0, True, [True, True, True], True),
    ],
    ids=str,
)
def test_a_doubtful_pose_has_to_be_accepted_twice_and_one_of_grey_values_each_time(
    monkeypatch: pytest.MonkeyPatch, evidence: float, must_stand: bool, verdicts: list[bool], accepted: bool
) -> None:
    result, left = settle(monkeypatch, evidence, must_stand, verdicts, moved_px=50.0)
    assert result.decision.accepted == accepted
    assert left == 0, "all rounds were needed"


@pytest.mark.parametrize(("moved_px", "rounds"), [(0.05, 1), (0.2, 3)])
def test_a_pose_that_moves_no_more_is_settled(
    moved_px: float, rounds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    result, left = settle(monkeypatch, 5.0, False, [True] * 3, moved_px)
    assert result.decision.accepted
    assert left == 3 - rounds


def settle(
    monkeypatch: pytest.MonkeyPatch,
    evidence: float,
    must_stand: bool,
    verdicts: list[bool],
    moved_px: float,
) -> tuple[Any, int]:
    """Settle a pose that was accepted, with these verdicts next; return the result, and how many are left."""
    grid = SimpleNamespace(shape=(100, 100), crs=None)
    view = SimpleNamespace(grid=grid, info=SimpleNamespace(grid=grid))
    pair: Any = SimpleNamespace(reference=view, target=view, offset_px=(moved_px, 0.0))
    overviews: Any = SimpleNamespace(scenes=[SimpleNamespace(tones=None)] * 2)
    prealignment = Prealignment("pose", (0.0, 0.0), 12, searched=True, evidence=evidence)
    start = StartingAlignment(prealignment, pair, overviews, must_stand)

    def matched(verdict: bool) -> Any:
        accepted = SimpleNamespace(accepted=verdict)
        return SimpleNamespace(
            matches=np.zeros(3), consistent=slice(None), prealignment=prealignment, decision=accepted
        )

    upcoming = list(map(matched, verdicts))
    monkeypatch.setattr(pose_module, "pose_from_points", lambda points, **_: np.eye(3))
    monkeypatch.setattr(pose_module, "posed_start", lambda *_: start)
    monkeypatch.setattr(pose_module, "match_scene", lambda *_: upcoming.pop(0))
    nothing: Any = None
    result, _ = match_again_in_pose(
        matched(True), start, SceneContext(nothing, nothing, nothing), perspective=True
    )
    return result, len(upcoming)
