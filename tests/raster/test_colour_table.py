"""Bands with a colour table (scanned maps, classifications) are matched by brightness, not by index."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio

from pcwlad_geo.job import match_files
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.view import View
from tests.scenes import make_grid, render, write

GRID = make_grid((160, 160))
QUICK: dict[str, Any] = {"template": 31, "window": 41, "features": 150, "jobs": 1}
LEVELS = 64


def with_colours(path: Path, values: np.ndarray) -> np.ndarray:
    """Write values as indices in random order into a table of greys; return the greys."""
    low, high = np.percentile(values, (1, 99))
    level = np.clip((values - low) / (high - low) * LEVELS, 0, LEVELS - 1).astype(np.uint8)
    index_of = np.random.default_rng(0).permutation(LEVELS).astype(np.uint8)
    write(path, index_of[level], GRID, dtype="uint8")
    with rasterio.open(path, "r+") as file:
        file.write_colormap(
            1, {int(index_of[each]): (4 * each, 4 * each, 4 * each, 255) for each in range(LEVELS)}
        )
    return 4 * level


def test_indices_become_brightness(tmp_path: Path) -> None:
    greys = with_colours(tmp_path / "map.tif", render(GRID))
    info = describe(tmp_path / "map.tif")
    np.testing.assert_array_equal(View(info, GRID, "none").read(Window.whole(GRID.shape)).values, greys)
    assert (
        describe(write(tmp_path / "plain.tif", greys.astype(np.uint8), GRID, dtype="uint8")).brightness
        is None
    )


def test_a_scanned_map_is_matched_to_a_fraction_of_a_pixel(tmp_path: Path) -> None:
    reference = write(tmp_path / "reference.tif", render(GRID), GRID)
    with_colours(tmp_path / "map.tif", render(GRID, displacement_px=(0.6, -0.4)))
    points = match_files(reference, tmp_path / "map.tif", out_dir=tmp_path / "out", **QUICK).tie_points
    assert len(points) > 50
    np.testing.assert_allclose(np.median(points.displacement_px, axis=0), [0.6, -0.4], atol=0.05)
