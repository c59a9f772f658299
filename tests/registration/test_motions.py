"""Pairs in which parts of the scene have moved: clouds over ground, and a small thing that moves."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from pcwlad_geo.matching import TiePoints
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import of_one_product
from pcwlad_geo.registration.motions import (
    MotionParameters,
    motions_of,
    other_displacement,
    patches,
    share_displaced,
)
from pcwlad_geo.registration.run import register_pair
from tests.scenes import make_grid, render, write

Array = NDArray[np.float64]

GROUND_PX = (0.3, -0.2)
CLOUDS_PX = (4.0, -9.0)
SIDE = 400
FEW = Settings(features=300)
"""Enough points of every part of the scene."""
CLEAR = make_grid((300, 300))


def clouded(moved: tuple[float, float], share: float) -> Array:
    """Return how far clouds cover each pixel; they cover a share of the rows, and drift with an image."""
    rows, cols = np.mgrid[:SIDE, :SIDE].astype(float)
    edge = share * SIDE + 12 * np.sin((cols - moved[0]) / 25)
    return np.asarray(1 / (1 + np.exp((rows - moved[1] - edge) / 2)))


def band(name: str, ground_px: tuple[float, float], clouds_px: tuple[float, float], share: float) -> Array:
    grid, cover = make_grid((SIDE, SIDE)), clouded(clouds_px, share)
    clouds = render(grid, name, seed=9, displacement_px=clouds_px)
    return cover * clouds + (1 - cover) * render(grid, name, seed=2, displacement_px=ground_px)


def pair(folder: Path, names: tuple[str, str], share: float) -> tuple[Path, Path]:
    grid = make_grid((SIDE, SIDE))
    return (
        write(folder / names[0], band("red", (0.0, 0.0), (0.0, 0.0), share), grid),
        write(folder / names[1], band("thermal", GROUND_PX, CLOUDS_PX, share), grid),
    )


@pytest.mark.slow
def test_bands_of_one_product_follow_the_ground_below_most_clouds(tmp_path: Path) -> None:
    (tmp_path / "scene_MTL.txt").write_text("GROUP = L1_METADATA_FILE\n")
    found = register_pair(*pair(tmp_path, ("scene_B4.tif", "scene_B10.tif"), 0.65), FEW)
    assert found.status == "registered"
    at = np.array([[SIDE / 2, SIDE * 0.85]])
    assert found.model is not None
    assert np.abs(found.model.forward(at) - at - GROUND_PX).max() < 0.1
    assert len(found.motions) == 2
    assert np.hypot(*np.subtract(found.motions[1].displacement_px, CLOUDS_PX)) < 0.3
    assert found.quality is not None
    assert found.quality.grade != "good"
    assert sum("different displacements" in warning for warning in found.warnings) == 1


@pytest.mark.parametrize("moved_px", [(1.2, -0.7), (2.5, -1.6)])
def test_clear_bands_of_one_product_that_lie_apart_are_fair_and_told_of(
    tmp_path: Path, moved_px: tuple[float, float]
) -> None:
    (tmp_path / "scene_MTL.txt").write_text("GROUP = L1_METADATA_FILE\n")
    first = write(tmp_path / "scene_B4.tif", render(CLEAR, "red", seed=2), CLEAR)
    moved = render(CLEAR, "thermal", seed=2, displacement_px=moved_px)
    found = register_pair(first, write(tmp_path / "scene_B10.tif", moved, CLEAR), Settings(features=150))
    assert found.model is not None
    at = np.array([[150.0, 150.0]])
    assert np.abs(found.model.forward(at) - at - moved_px).max() < 0.1
    assert found.quality is not None
    assert found.quality.grade == "fair"
    assert "bands of one product lie more than" in found.quality.reasons[0].text


@pytest.mark.slow
def test_other_images_of_two_motions_are_refused_with_both_named(tmp_path: Path) -> None:
    found = register_pair(*pair(tmp_path, ("first.tif", "second.tif"), 0.65), FEW)
    assert found.status == "rejected"
    assert found.reason is not None
    assert "2 different displacements" in found.reason
    assert re.search(r"\(\+(3\.9|4\.0), -(8\.9|9\.0)\) px", found.reason)


@pytest.mark.slow
def test_a_few_clouds_leave_the_ground_its_place(tmp_path: Path) -> None:
    found = register_pair(*pair(tmp_path, ("first.tif", "second.tif"), 0.3), Settings())
    assert found.status == "registered"
    kept = found.tie_points.select("fit", "check", "unused").displacement_px
    assert np.linalg.norm(kept - GROUND_PX, axis=1).max() < 2.0
    assert len(found.motions) == 2


@pytest.mark.slow
def test_a_ship_that_moves_is_no_second_motion(tmp_path: Path) -> None:
    first, second = (
        render(CLEAR, name, seed=2, displacement_px=moved)
        for name, moved in (("red", (0.0, 0.0)), ("thermal", GROUND_PX))
    )
    first[200:230, 100:112] = 250.0
    second[205:235, 107:119] = 250.0
    found = register_pair(
        write(tmp_path / "a.tif", first, CLEAR), write(tmp_path / "b.tif", second, CLEAR), FEW
    )
    assert found.status == "registered"
    assert found.motions == ()
    assert found.quality is not None
    assert found.quality.grade == "good"


@pytest.mark.slow
def test_patches_smaller_than_a_window_are_told_from_what_fits_around_the_points(tmp_path: Path) -> None:
    """A sixth of the ground, in patches, lies 4 px off: large windows put most points with the rest."""
    grid = make_grid((SIDE, SIDE))
    rough = np.random.default_rng(7).normal(size=(SIDE, SIDE))
    height = ndimage.gaussian_filter(rough, 14, mode="wrap")
    patch = height > np.quantile(height, 0.84)
    moved = [render(grid, "thermal", seed=2, displacement_px=by) for by in (GROUND_PX, (4.3, -0.2))]
    first = write(tmp_path / "a.tif", render(grid, "red", seed=2), grid)
    found = register_pair(
        first, write(tmp_path / "b.tif", np.where(patch, moved[1], moved[0]), grid), Settings()
    )
    assert found.status == "registered"
    assert found.quality is not None
    assert found.quality.grade != "good"
    ground, other = found.motions
    assert np.hypot(*np.subtract(ground.displacement_px, GROUND_PX)) < 0.1
    assert np.hypot(*np.subtract(other.displacement_px, (4.3, -0.2))) < 0.5
    assert ground.points > other.points >= MotionParameters().least_rejected


def test_rejected_matches_that_agree_propose_where_else_the_ground_may_lie() -> None:
    rng = np.random.default_rng(4)
    xy = rng.uniform(0, 1000, (300, 2))
    kept = np.arange(300) >= 40
    moved = np.where(kept[:, None], 0.01 * xy, 0.01 * xy + rng.uniform(-9, 9, xy.shape))
    points = TiePoints(xy, xy + moved, np.tile(np.eye(2), (300, 1, 1)), np.ones(300), np.zeros(300))
    assert other_displacement(points, kept) is None
    moved[:12] = 0.01 * xy[:12] + (4.0, -1.0)
    points = replace(points, target_xy_px=xy + moved)
    found = other_displacement(points, kept)
    assert found is not None
    assert np.hypot(*(found[0] - (4.0, -1.0))) < 1.0
    assert found[1][:12].all()
    assert not found[1][kept].any()
    ground, other = patches(points, kept, found, np.zeros(2), 81)
    assert (ground.points, other.points) == (260, found[1].sum())
    assert 12 <= ground.places + other.places <= 2 * (1000 / 81 * 3 + 1) ** 2
    assert other_displacement(points, np.ones(300, bool)) is None


def test_what_fits_elsewhere_as_often_is_chance() -> None:
    other_px = np.array([4.0, -1.0])
    beside = np.zeros((200, 2))
    beside[:20], beside[20:24], beside[24:30] = other_px, -other_px, np.nan
    assert share_displaced(beside, other_px) == pytest.approx((20 - 2) / 194)
    beside[30:60] = other_px[::-1] * (1, -1)
    assert share_displaced(beside, other_px) < 0.02
    assert share_displaced(beside[24:30], other_px) == 0.0


@pytest.mark.parametrize("bend", ["rotation", "curve", "noise"])
def test_what_varies_smoothly_is_one_motion(bend: str) -> None:
    rng = np.random.default_rng(3)
    xy = rng.uniform(0, 1000, (900, 2))
    moved = {
        "rotation": (xy - 500) @ np.array([[0.0, 0.02], [-0.02, 0.0]]),
        "curve": 12 * ((xy - 500) / 500) ** 2,
        "noise": rng.uniform(-12, 12, xy.shape) * (rng.random((900, 1)) < 0.4),
    }[bend]
    points = TiePoints(xy, xy + moved, np.tile(np.eye(2), (900, 1, 1)), np.ones(900), np.zeros(900))
    kept = np.linalg.norm(moved, axis=1) < 1e-9 if bend == "noise" else np.ones(900, bool)
    assert len(motions_of(points, kept, np.zeros(2), 81, 12)) <= 1


@pytest.mark.parametrize(("apart_px", "motions"), [(3.5, 1), (4.5, 2)])
def test_two_levels_of_the_ground_are_told_apart_from_4_px_on(apart_px: float, motions: int) -> None:
    """The matches of each scatter, so that some of the one lie 4 px from the middle of the other."""
    rng = np.random.default_rng(3)
    xy = rng.uniform(0, 1000, (600, 2))
    higher = xy[:, :1] // 125 % 4 == 0
    moved = np.where(higher, (apart_px, 0.0), (0.0, 0.0)) + rng.normal(0, 0.5, xy.shape)
    points = TiePoints(xy, xy + moved, np.tile(np.eye(2), (600, 1, 1)), np.ones(600), np.zeros(600))
    assert len(motions_of(points, np.ones(600, bool), np.zeros(2), 81, 12)) == motions


def test_bands_are_of_one_product_by_their_names_and_metadata(tmp_path: Path) -> None:
    assert not of_one_product(str(tmp_path / "l8_B4.tif"), str(tmp_path / "l8_B10.tif"))
    (tmp_path / "l8_MTL.txt").touch()
    assert of_one_product(str(tmp_path / "l8_B4.tif"), f"vrt://{tmp_path}/l8_B10.tif?a_nodata=0")
    assert not of_one_product(str(tmp_path / "l8_B4.tif"), str(tmp_path / "l8_B4.tif"))
    assert not of_one_product(str(tmp_path / "l8_B4.tif"), str(tmp_path / "l9_B10.tif"))
    safe = "GRANULE/L2A/IMG_DATA"
    assert of_one_product(
        f"{safe}/R10m/T32TQM_20200101T101031_B04_10m.jp2", f"{safe}/R60m/T32TQM_20200101T101031_B01_60m.jp2"
    )
    assert not of_one_product("T32TQM_20200101T101031_B04.jp2", "T32TQM_20200106T101031_B04.jp2")
