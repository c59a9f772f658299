"""Pairs of files with narrow gaps: right, or refused where they show different places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

import pcwlad_geo as pg
from tests.scenes import make_grid, render

SIDE = 260
SHIFT_XY = (1.71, -0.6)
MISSING = (np.arange(SIDE)[:, None] + 0.1 * np.arange(SIDE)) % 33 < 7


def raster(path: Path, seed: int = 0, shift_xy: tuple[float, float] = (0.0, 0.0), band: str = "red") -> Path:
    grid = make_grid((SIDE, SIDE))
    values: NDArray = render(grid, band, seed=seed, displacement_px=shift_xy).astype("float32")
    values[MISSING] = -9999
    place = {"height": SIDE, "width": SIDE, "crs": grid.crs, "transform": grid.transform, "nodata": -9999}
    with rasterio.open(path, "w", driver="GTiff", count=1, dtype="float32", **place) as file:
        file.write(values, 1)
    return path


def test_the_same_gaps_in_both_do_not_hold_the_ground(tmp_path: Path) -> None:
    pair = raster(tmp_path / "r.tif"), raster(tmp_path / "t.tif", shift_xy=SHIFT_XY)
    points = pg.match(*pair)
    assert np.abs(np.median(points.displacement_px, axis=0) - SHIFT_XY).max() < 0.05


def test_two_places_with_the_same_gaps_are_refused(tmp_path: Path) -> None:
    pair = raster(tmp_path / "r.tif"), raster(tmp_path / "t.tif", seed=9)
    with pytest.raises(pg.RegistrationRejectedError):
        pg.match(*pair, prealign="georef")


@pytest.mark.slow
def test_gaps_of_a_scanner_that_are_declared(shared_data: Path) -> None:
    folder = shared_data / "field" / "slc_off"
    points = pg.match(folder / "reference.tif", folder / "target_nodata0.tif")
    assert np.abs(np.median(points.displacement_px, axis=0) - SHIFT_XY).max() < 0.03


@pytest.mark.slow
def test_specks_without_data(shared_data: Path) -> None:
    folder = shared_data / "field" / "speckled_nodata"
    points = pg.match(folder / "day.tif", folder / "night.tif")
    # what the pair gives once its specks are filled
    assert np.abs(np.median(points.displacement_px, axis=0) - (1.72, 1.88)).max() < 0.1
