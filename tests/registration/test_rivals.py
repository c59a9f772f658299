"""Pairs whose displacement has rivals: ground that repeats, and ground that lies beyond the search."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from pcwlad_geo.options import Settings
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.registration.run import register_pair
from tests.repeating_ground import repeating_pair
from tests.scenes import make_grid, render, write

FEW = Settings(features=300)


def _write(path: Path, values: NDArray[np.uint8]) -> Path:
    rows, cols = values.shape
    profile = {"driver": "GTiff", "height": rows, "width": cols, "count": 1, "dtype": "uint8"}
    place = Affine(0.2, 0, 500000.0, 0, -0.2, 4600000.0)
    with rasterio.open(path, "w", **profile, crs="EPSG:32633", transform=place) as file:
        file.write(values, 1)
    return path


def _registered(folder: Path, images: tuple[NDArray[np.uint8], ...], settings: Settings) -> Registration:
    paths = [_write(folder / f"{name}.tif", image) for name, image in zip("rt", images, strict=True)]
    return register_pair(*paths, settings)


def _median_px(result: Registration) -> NDArray[np.float64]:
    points = result.tie_points
    return np.asarray(np.median(points.displacement_px[points.status != "rejected"], axis=0))


def test_a_pair_that_is_one_period_off_is_registered_where_the_whole_scene_fits(tmp_path: Path) -> None:
    result = _registered(tmp_path, repeating_pair("field trial", (0.0, 29.0)), FEW)
    assert result.quality is not None
    assert result.quality.grade == "good"
    assert_allclose(_median_px(result), (0.0, 29.0), atol=0.2)


def test_within_the_radius_that_is_given_a_better_rival_is_named(tmp_path: Path) -> None:
    images = repeating_pair("field trial", (0.0, 29.0))
    result = _registered(tmp_path, images, replace(FEW, search_radius=12))
    assert result.quality is not None
    assert result.quality.grade == "poor"
    assert "(+0, +29)" in result.quality.reasons[0].text
    assert result.quality.expected_ce90_px > 20


def _seam(folder: Path, left_px: float, right_px: float, settings: Settings) -> Registration:
    """Register a mosaic of which the right half is displaced by another amount along the columns."""
    grid = make_grid((360, 360))
    halves = [render(grid, displacement_px=(px, 0.0)) for px in (left_px, right_px)]
    mosaic = np.where(np.arange(360) < 200, *halves)
    reference = write(folder / "reference.tif", render(grid), grid)
    target = write(folder / "target.tif", mosaic, grid)
    return register_pair(reference, target, settings)


@pytest.mark.parametrize("settings", [FEW, pytest.param(Settings(), marks=pytest.mark.slow)])
def test_a_part_beyond_the_search_border_is_searched_for(tmp_path: Path, settings: Settings) -> None:
    result = _seam(tmp_path, 11.2, 13.4, settings)
    points = result.tie_points[result.tie_points.status != "rejected"]
    col = points.predicted_px[:, 0]
    assert_allclose(np.median(points.displacement_px[col < 150, 0]), 11.2, atol=0.1)
    assert_allclose(np.median(points.displacement_px[col > 260, 0]), 13.4, atol=0.1)
    assert np.count_nonzero(col > 260) > 30


@pytest.mark.parametrize("right_px", [13.6, 26.0])
def test_a_part_beyond_a_given_search_radius_is_said_to_be_unknown(tmp_path: Path, right_px: float) -> None:
    result = _seam(tmp_path, 11.2, right_px, replace(FEW, search_radius=12))
    assert result.quality is not None
    assert result.quality.grade == "poor"
    assert "has no tie points" in result.quality.reasons[0].text
    assert_allclose(result.quality.expected_ce90_px, right_px - 11.2, atol=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("prealign", ["auto", "search"])
def test_a_field_trial_that_is_one_plot_off(shared_data: Path, prealign: str) -> None:
    case = shared_data / "field" / "plot_trial_period"
    if not case.is_dir():
        pytest.skip(f"no {case}")
    settings = Settings(prealign=prealign)  # type: ignore[arg-type]
    result = register_pair(case / "reference.tif", case / "one_plot_north.tif", settings)
    assert result.quality is not None
    assert result.quality.grade == "good"
    assert_allclose(_median_px(result), (0.0, -30.006), atol=0.05)


@pytest.mark.slow
def test_two_blocks_of_a_mosaic_of_which_one_lies_beyond_the_search(shared_data: Path) -> None:
    case = shared_data / "field" / "two_blocks_search_border"
    if not case.is_dir():
        pytest.skip(f"no {case}")
    result = register_pair(case / "reference.tif", case / "target.tif", Settings())
    points = result.tie_points[result.tie_points.status != "rejected"]
    col, off_px = points.predicted_px[:, 0], points.displacement_px[:, 0]
    assert_allclose(np.median(off_px[col < 0.5 * 512]), 11.2, atol=0.05)
    assert_allclose(np.median(off_px[col > 0.65 * 512]), 13.4, atol=0.05)
    assert result.quality is not None
    assert result.quality.grade != "good"
