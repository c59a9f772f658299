"""What stands still in both frames is no ground: found, matched without, or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.options import Settings
from pcwlad_geo.raster import describe
from pcwlad_geo.registration.frame_evidence import FrameEvidence, frame_evidence
from pcwlad_geo.registration.run import register_pair
from tests.scenes import make_grid, render, write

Array = NDArray[np.float64]

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (320, 320)
POINTS = np.random.default_rng(0).uniform(20, 300, (200, 2))
PATTERN = np.random.default_rng(1).normal(0, 6, SHAPE)
STRIPES = np.random.default_rng(2).normal(0, 6, (1, SHAPE[1]))


def ground(
    seed: int = 0, moved_px: tuple[float, float] = (0, 0), band: str = "red", noise: float = 2
) -> Array:
    values = render(make_grid(SHAPE), band, seed=seed, displacement_px=moved_px, noise=0)
    return values + np.random.default_rng(seed + 7).normal(0, noise, SHAPE)


def frame(path: Path, values: Array) -> Path:
    return write(path, np.clip(np.rint(values), 0, 255).astype("uint8"), None, dtype="uint8")


def evidence(folder: Path, one: Array, other: Array) -> FrameEvidence | None:
    infos = [describe(frame(folder / name, values)) for name, values in (("a.tif", one), ("b.tif", other))]
    return frame_evidence(*infos, POINTS, POINTS + 0.01)


@pytest.mark.parametrize("pattern", [PATTERN, STRIPES])
def test_a_pattern_over_other_ground_is_no_evidence_of_the_ground(tmp_path: Path, pattern: Array) -> None:
    found = evidence(tmp_path, ground(0) + pattern, ground(1) + pattern)
    assert found is not None
    assert found.is_frame
    assert found.doubt is not None
    assert "stands still in both frames" in found.doubt


@pytest.mark.parametrize("band", ["red", "thermal"])
@pytest.mark.parametrize("pattern", [0 * PATTERN, PATTERN, STRIPES])
def test_ground_in_place_is_told_whatever_the_sensor_adds(tmp_path: Path, band: str, pattern: Array) -> None:
    other = ground(0, band=band, noise=0) + np.random.default_rng(8).normal(0, 4, SHAPE)
    found = evidence(tmp_path, ground(0) + pattern, other + pattern)
    assert found is None or found.doubt is None


def test_the_difference_of_both_shows_how_the_ground_has_moved(tmp_path: Path) -> None:
    found = evidence(tmp_path, ground(0) + PATTERN, ground(0, (23, -11)) + PATTERN)
    assert found is not None
    assert found.rival_px == (23, -11)


def test_moved_ground_that_draws_the_points_is_seen(tmp_path: Path) -> None:
    frames = ground(0) + PATTERN, ground(0, (23, -11)) + PATTERN
    infos = [describe(frame(tmp_path / f"{n}.tif", each)) for n, each in enumerate(frames)]
    found = frame_evidence(*infos, POINTS, POINTS + np.array([0.2, -0.2]))
    assert found is not None
    assert found.rival_px == (23, -11)


@pytest.mark.parametrize("drawn_px", [(0.0, 0.0), (0.3, -0.2), (0.9, -0.6)])
@pytest.mark.parametrize("moved_px", [(2.3, -1.6), (4.5, -3.7)])
def test_ground_that_has_moved_by_few_pixels_is_seen(
    tmp_path: Path, moved_px: tuple[float, float], drawn_px: tuple[float, float]
) -> None:
    """The pattern draws all points to it, or part of the way."""
    frames = faint(0), faint(0, moved_px, 1)
    infos = [describe(frame(tmp_path / f"{n}.tif", values)) for n, values in enumerate(frames)]
    seen = frame_evidence(*infos, POINTS, POINTS + drawn_px)
    assert seen is not None
    assert seen.is_frame
    np.testing.assert_allclose(seen.rival_px, moved_px, atol=0.8)


@pytest.mark.parametrize("moved_px", [(0.0, 0.0), (2.3, -1.6), (4.5, -3.7)])
def test_points_on_ground_that_has_moved_by_few_pixels_are_no_frame(
    tmp_path: Path, moved_px: tuple[float, float]
) -> None:
    frames = faint(0), faint(0, moved_px, 1)
    infos = [describe(frame(tmp_path / f"{n}.tif", values)) for n, values in enumerate(frames)]
    seen = frame_evidence(*infos, POINTS, POINTS + moved_px)
    assert seen is None or seen.doubt is None


def test_frames_of_ground_that_has_moved_by_few_pixels_are_refused(tmp_path: Path) -> None:
    frames = faint(0), faint(0, (2.3, -1.6), 1)
    paths = [frame(tmp_path / f"{n}.tif", values) for n, values in enumerate(frames)]
    result = register_pair(*paths, Settings(jobs=1))
    assert result.status == "rejected"
    assert "ground that has moved by about (+2, -" in str(result.reason)


@pytest.mark.parametrize("moved_px", [None, (2.3, -1.6)])
def test_ground_too_faint_to_be_seen_under_the_pattern_is_not_told(
    tmp_path: Path, moved_px: tuple[float, float] | None
) -> None:
    """Of a twentieth of its contrast, the ground is weaker than the pattern at all wavelengths."""
    other = faint(1, (0, 0), 1, 0.05) if moved_px is None else faint(0, moved_px, 1, 0.05)
    seen = evidence(tmp_path, faint(0, contrast=0.05), other)
    assert seen is not None
    assert seen.is_frame
    assert "from pixel to pixel" in str(seen.doubt)


def test_dead_pixels_over_other_ground_are_no_evidence_of_the_ground(tmp_path: Path) -> None:
    dead = np.random.default_rng(3).random(SHAPE) < 0.01
    frames = [np.where(dead, 0, faint(n, noise_seed=n) - PATTERN) for n in range(2)]
    seen = evidence(tmp_path, *frames)
    assert seen is not None
    assert seen.is_frame


@pytest.mark.parametrize("down_px", [-1.0, -21.0])
def test_dead_columns_place_no_ground_along_themselves(tmp_path: Path, down_px: float) -> None:
    """All points lie on the same columns, wherever along them; ground that has moved so is told."""
    dead = np.random.default_rng(3).choice(SHAPE[1], 12, replace=False)
    scatter_px = np.random.default_rng(4).normal(0, 1, len(POINTS))
    displacement_px = np.stack([0 * scatter_px, down_px + scatter_px], axis=1)

    def seen(seed: int, moved_px: tuple[float, float]) -> FrameEvidence | None:
        frames = [faint(0) - PATTERN, faint(seed, moved_px, 1) - PATTERN]
        for values in frames:
            values[:, dead] = 20
        infos = [describe(frame(tmp_path / f"{n}.tif", values)) for n, values in enumerate(frames)]
        return frame_evidence(*infos, POINTS, POINTS + displacement_px)

    other_ground = seen(1, (0, 0))
    assert other_ground is not None
    assert other_ground.is_frame
    assert "whole columns or rows" in str(other_ground.doubt)
    assert seen(0, (0, down_px)) is None


def test_ground_that_repeats_is_no_rival(tmp_path: Path) -> None:
    rows = 20 * np.sign(np.sin(np.arange(SHAPE[0]) * 2 * np.pi / 16))[:, None]
    found = evidence(tmp_path, 0.5 * ground(0) + 60 + rows, 0.5 * ground(0) + 60 - 0.7 * rows)
    assert found is None or found.rival_px is None


def test_images_without_a_common_pattern_are_not_asked(tmp_path: Path) -> None:
    one, other = (np.random.default_rng(seed).normal(100, 20, SHAPE) for seed in (3, 4))
    assert evidence(tmp_path, one, other) is None


def test_a_copy_of_an_image_shows_no_ground_that_has_moved(tmp_path: Path) -> None:
    found = evidence(tmp_path, ground(), ground())
    assert found is not None
    assert found.rival_px is None
    assert found.doubt is None


def test_only_points_on_the_same_pixels_are_asked_for(tmp_path: Path) -> None:
    infos = [describe(frame(tmp_path / f"{n}.tif", ground(n) + PATTERN)) for n in range(2)]
    assert frame_evidence(*infos, POINTS, POINTS + 0.2) is None
    assert frame_evidence(*infos, POINTS, POINTS + 0.7) is None
    other = describe(frame(tmp_path / "c.tif", ground(0)[:-1]))
    assert frame_evidence(infos[0], other, POINTS, POINTS) is None


def faint(
    seed: int, moved_px: tuple[float, float] = (0, 0), noise_seed: int = 0, contrast: float = 0.12
) -> Array:
    """Return a frame of ground without much contrast under the fixed pattern of the sensor."""
    noise = np.random.default_rng(noise_seed).normal(0, 1.5, SHAPE)
    return 127 + contrast * (ground(seed, moved_px, noise=0) - 127) + PATTERN + noise


def test_frames_that_share_only_their_pattern_are_not_registered(tmp_path: Path) -> None:
    paths = [frame(tmp_path / f"{n}.tif", faint(n, noise_seed=n)) for n in range(2)]
    found = register_pair(*paths, Settings(jobs=1))
    assert found.status == "rejected"
    assert "stands still in both frames" in str(found.reason)


def dusty(seed: int, side: int, dust: Array, noise_seed: int) -> Array:
    """Return a part of a frame of faint ground seen through dust: some grey spots that hide most of it."""
    noise = np.random.default_rng(noise_seed).normal(0, 1.5, SHAPE)
    seen = 127 + 0.12 * (ground(seed, noise=0) - 127) + noise
    return ((1 - dust) * seen + dust * 30)[:side, :side]


@pytest.fixture(scope="module")
def dust() -> Array:
    rng, canvas = np.random.default_rng(54), np.zeros(SHAPE, np.uint8)
    for place in rng.integers(320, size=(25, 2)).tolist():
        cv2.circle(canvas, place, int(rng.integers(3, 9)), int(rng.integers(60, 255)), -1)
    return np.asarray(0.7 * canvas / 255.0)


@pytest.mark.parametrize("side", [320, 240])
def test_dust_over_other_ground_is_no_evidence_of_the_ground(tmp_path: Path, dust: Array, side: int) -> None:
    found = evidence(tmp_path, dusty(0, side, dust, 1), dusty(1, side, dust, 2))
    assert found is not None
    assert found.is_frame
    assert found.doubt is not None
    assert "without small specks that both have" in found.doubt


@pytest.mark.parametrize("side", [320, 240])
def test_ground_in_place_under_dust_is_told(tmp_path: Path, dust: Array, side: int) -> None:
    found = evidence(tmp_path, dusty(0, side, dust, 1), dusty(0, side, dust, 2))
    assert found is not None
    assert found.doubt is None


def test_specks_over_nothing_but_noise_tell_nothing(tmp_path: Path, dust: Array) -> None:
    frames = [100 + 120 * dust + np.random.default_rng(seed).normal(0, 4, SHAPE) for seed in (1, 2)]
    found = evidence(tmp_path, *frames)
    assert found is None or found.doubt is None


@pytest.mark.slow
def test_dust_over_other_ground_is_refused(tmp_path: Path, dust: Array) -> None:
    paths = [frame(tmp_path / f"{n}.tif", dusty(n, 320, dust, n)) for n in range(2)]
    found = register_pair(*paths, Settings(jobs=1))
    assert found.status == "rejected"
    assert "stands still in both frames" in str(found.reason)


def test_ground_under_the_pattern_is_found(tmp_path: Path) -> None:
    moved_px = (17.3, -11.6)
    frames = faint(0, contrast=0.3), faint(0, moved_px, 1, contrast=0.3)
    paths = [frame(tmp_path / f"{n}.tif", each) for n, each in enumerate(frames)]
    found = register_pair(*paths, Settings(jobs=1, features=400))
    assert found.status == "registered"
    points = found.tie_points.select("fit", "check", "unused")
    np.testing.assert_allclose(np.median(points.displacement_px, axis=0), moved_px, atol=0.1)


NEAR_PX = (2.3, -1.6)
WRITING = np.zeros(SHAPE, np.uint8)
for _row in range(30, SHAPE[0], 60):
    for _col in range(-40 + _row % 50, SHAPE[1], 110):
        cv2.putText(WRITING, "(c) AIR", (_col, _row), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255, 2)
HOLE = np.hypot(*(np.indices(SHAPE) - 160)) < 80 + 20 * np.sin(5 * np.arctan2(*(np.indices(SHAPE) - 160)))


def plain(seed: int, moved_px: tuple[float, float], noise_seed: int) -> Array:
    """Return a frame of ground without much contrast, and without a pattern of the sensor."""
    return faint(seed, moved_px, noise_seed) - PATTERN


def striped(values: Array) -> Array:
    return values + np.random.default_rng(5).normal(0, 5, (SHAPE[0], 1))


def waved(values: Array) -> Array:
    return values + 5 * np.sin(np.indices(SHAPE).sum(axis=0) * 2 * np.pi / 11)


def with_dead_columns(values: Array) -> Array:
    dead = np.random.default_rng(6).choice(SHAPE[1], 12, replace=False)
    return np.where(np.isin(np.arange(SHAPE[1]), dead), 20.0, values)


def written_on(values: Array) -> Array:
    return values + 0.4 * WRITING / 255 * (255 - values)


def masked(values: Array) -> Array:
    return np.where(HOLE, 255.0, values)


DRAWN = [
    (striped, (2.6, 0.1)),
    (waved, (1.9, -2.1)),
    (with_dead_columns, (0.0, -1.9)),
    (written_on, (0.0, 0.0)),
]
"""What stands still, and where the tie points of ground moved by `NEAR_PX` come to lie because of it."""


def evidence_at(
    folder: Path, frames: tuple[Array, Array], displacement_px: tuple[float, float]
) -> FrameEvidence | None:
    infos = [describe(frame(folder / f"{n}.tif", values)) for n, values in enumerate(frames)]
    scatter_px = np.random.default_rng(9).normal(0, 0.03, POINTS.shape)
    return frame_evidence(*infos, POINTS, POINTS + displacement_px + scatter_px)


@pytest.mark.parametrize(("seen", "drawn_px"), DRAWN)
def test_stripes_waves_and_writing_do_not_hide_where_the_ground_has_moved(
    tmp_path: Path, seen: Callable[[Array], Array], drawn_px: tuple[float, float]
) -> None:
    frames = seen(plain(0, (0, 0), 0)), seen(plain(0, NEAR_PX, 1))
    told = evidence_at(tmp_path, frames, drawn_px)
    assert told is not None
    assert told.is_frame
    np.testing.assert_allclose(told.rival_px, NEAR_PX, atol=0.3)


@pytest.mark.parametrize("seen", [seen for seen, _ in DRAWN])
@pytest.mark.parametrize("moved_px", [(0.0, 0.0), NEAR_PX])
def test_points_on_the_ground_are_not_doubted_for_stripes_waves_and_writing(
    tmp_path: Path, seen: Callable[[Array], Array], moved_px: tuple[float, float]
) -> None:
    frames = seen(plain(0, (0, 0), 0)), seen(plain(0, moved_px, 1))
    told = evidence_at(tmp_path, frames, moved_px)
    assert told is None or told.doubt is None


@pytest.mark.parametrize("seen", [written_on, masked])
def test_writing_and_masks_over_other_ground_are_no_evidence_of_it(
    tmp_path: Path, seen: Callable[[Array], Array]
) -> None:
    told = evidence_at(tmp_path, (seen(plain(0, (0, 0), 0)), seen(plain(1, (0, 0), 1))), (0.0, 0.0))
    assert told is not None
    assert told.doubt is not None
    in_place = evidence_at(tmp_path, (seen(plain(0, (0, 0), 0)), seen(plain(0, (0, 0), 1))), (0.0, 0.0))
    assert in_place is None or in_place.doubt is None
