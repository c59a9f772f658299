"""What stands still in both frames is left out before the matching."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import View, Window
from pcwlad_geo.registration import match_pair, prepare_pair
from pcwlad_geo.registration.frame_cleaning import CleaningParameters, without_marks
from pcwlad_geo.registration.frame_smoothing import NOTE, without_pattern
from pcwlad_geo.registration.result import Matches, Pair
from tests.scenes import make_grid, render, write

Array = NDArray[np.float64]

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (240, 240)
MOVED_PX = (-0.6, -0.4)
WRITING = np.zeros(SHAPE, np.uint8)
for _row in range(30, SHAPE[0], 50):
    cv2.putText(WRITING, "(c) AIR 12:34", (_row % 40, _row), cv2.FONT_HERSHEY_SIMPLEX, 0.9, 255, 2)
for _at in range(20, SHAPE[0], 60):
    WRITING[_at], WRITING[:, _at] = 255, 255


def ground(moved_px: tuple[float, float], seed: int) -> Array:
    values = render(make_grid(SHAPE), "red", seed=0, displacement_px=moved_px, noise=0)
    return 127 + 0.5 * (values - 127) + np.random.default_rng(seed).normal(0, 2, SHAPE)


def written_on(values: Array) -> Array:
    return np.where(WRITING > 0, 255.0, np.minimum(values, 254))


def striped(axis: int) -> Callable[[Array], Array]:
    shape = (1, SHAPE[1]) if axis == 0 else (SHAPE[0], 1)
    return lambda values: values + np.random.default_rng(5).normal(0, 18, shape)


def patterned(values: Array) -> Array:
    return values + np.random.default_rng(6).normal(0, 6, SHAPE)


def pair_of(folder: Path, *frames: Array) -> Pair:
    paths = [
        write(folder / f"{n}.tif", np.clip(np.rint(values), 0, 255).astype("uint8"), None, dtype="uint8")
        for n, values in enumerate(frames)
    ]
    return prepare_pair(*paths, Settings(jobs=1))


def displacement_px(matches: Matches) -> Array:
    return np.asarray(np.median(matches.tie_points.select("matched").displacement_px, axis=0))


@pytest.mark.parametrize("seen", [written_on, striped(0), striped(1)], ids=["writing", "columns", "rows"])
def test_ground_is_matched_without_what_stands_still(tmp_path: Path, seen: Callable[[Array], Array]) -> None:
    pair = pair_of(tmp_path, seen(ground((0, 0), 1)), seen(ground(MOVED_PX, 2)))
    matches = match_pair(pair, InThisProcess())
    assert matches.accepted
    np.testing.assert_allclose(displacement_px(matches), MOVED_PX, atol=0.08)
    assert any("what both frames have at the same pixels" in text for text in matches.warnings)
    assert matches.pair is pair
    assert matches.views.target.info == pair.target


def test_frames_without_marks_are_matched_as_they_are(tmp_path: Path) -> None:
    assert without_marks(pair_of(tmp_path, ground((0, 0), 1), ground((0, 0), 2)), in_memory=True) is None


def test_stripes_of_one_image_alone_are_its_own(tmp_path: Path) -> None:
    pair = pair_of(tmp_path, striped(0)(ground((0, 0), 1)), ground(MOVED_PX, 2))
    assert without_marks(pair, in_memory=True) is None


@pytest.mark.parametrize("most_rows", [SHAPE[0], 60])
def test_stripes_are_taken_out_and_the_ground_remains(tmp_path: Path, most_rows: int) -> None:
    plain = ground((0, 0), 1)
    pair = pair_of(tmp_path, striped(0)(plain), striped(0)(ground(MOVED_PX, 2)))
    cleaned = without_marks(pair, in_memory=True, parameters=CleaningParameters(most_rows=most_rows))
    assert cleaned is not None
    info = cleaned.pair.reference
    values = View(info, info.grid, "none").read(Window.whole(SHAPE)).values
    difference = values - np.clip(plain, 0, 255)
    columns = np.median(difference, axis=0)
    fine = columns - np.convolve(columns, np.ones(15) / 15, "same")
    assert np.std(fine[8:-8]) < 18 / 4


@pytest.mark.parametrize("in_memory", [True, False])
def test_writing_is_invalid_or_where_it_is_dense_filled(tmp_path: Path, in_memory: bool) -> None:
    pair = pair_of(tmp_path, written_on(ground((0, 0), 1)), written_on(ground(MOVED_PX, 2)))
    cleaned = without_marks(pair, in_memory=in_memory)
    assert cleaned is not None
    info = cleaned.pair.target
    patch = View(info, info.grid, "none").read(Window.whole(SHAPE))
    assert not (patch.valid & (patch.values >= 255)).any()


def test_a_pattern_of_single_pixels_does_not_draw_the_points(tmp_path: Path) -> None:
    pair = pair_of(tmp_path, patterned(ground((0, 0), 1)), patterned(ground(MOVED_PX, 2)))
    matches = match_pair(pair, InThisProcess())
    assert matches.accepted
    np.testing.assert_allclose(displacement_px(matches), MOVED_PX, atol=0.08)
    assert NOTE in matches.warnings


@pytest.mark.parametrize("moved_px", [(0.0, 0.0), (2.3, -1.6)])
@pytest.mark.parametrize("seen", [patterned, lambda values: values], ids=["pattern", "none"])
def test_only_a_pattern_beside_ground_that_has_moved_is_smoothed(
    tmp_path: Path, seen: Callable[[Array], Array], moved_px: tuple[float, float]
) -> None:
    pair = pair_of(tmp_path, seen(ground((0, 0), 1)), seen(ground(moved_px, 2)))
    points_px = 0.5 * np.array(moved_px)
    is_smoothed = without_pattern(pair, points_px, in_memory=True) is not None
    assert is_smoothed == (seen is patterned and moved_px != (0.0, 0.0))


def test_smoothed_frames_keep_what_is_invalid(tmp_path: Path) -> None:
    hole = np.s_[50:90, 60:100]
    frames = [patterned(ground(moved_px, seed)) for seed, moved_px in enumerate([(0.0, 0.0), MOVED_PX])]
    frames = [np.clip(np.rint(values), 1, 255) for values in frames]
    for values in frames:
        values[hole] = 0
    paths = [
        write(tmp_path / f"{n}.tif", values.astype("uint8"), None, dtype="uint8", nodata=0)
        for n, values in enumerate(frames)
    ]
    pair, points_px = prepare_pair(*paths, Settings(jobs=1)), 0.5 * np.array(MOVED_PX)
    assert without_pattern(pair, 0 * points_px, in_memory=True) is None
    assert without_pattern(pair, np.array(MOVED_PX), in_memory=True) is None
    smooth = without_pattern(pair, points_px, in_memory=True)
    assert smooth is not None
    info = smooth.pair.reference
    patch = View(info, info.grid, "none").read(Window.whole(SHAPE))
    assert not patch.valid[hole].any()
    assert np.count_nonzero(~patch.valid) == 1600
    beside = np.abs(patch.values[46:50, 60:100] - patch.values[40:44, 60:100])
    assert beside.mean() < 25
