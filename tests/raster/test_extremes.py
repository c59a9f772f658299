"""Values that nothing measures, in files: nodata wherever a band is read, and said once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

import pcwlad_geo as pg
from pcwlad_geo.raster.bands import BandPart, Bands
from pcwlad_geo.raster.combined_bands import with_bands
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.undeclared import without_extremes
from pcwlad_geo.raster.view import View
from pcwlad_geo.report.views import read_backdrop
from tests.scenes import make_grid, render


def write(path: Path, values: NDArray, nodata: float | None = None) -> Path:
    grid = make_grid(values.shape[-2:])
    layers = values.reshape(-1, *values.shape[-2:])
    profile = {"driver": "GTiff", "count": len(layers), "dtype": values.dtype, "nodata": nodata}
    place = {"height": grid.shape[0], "width": grid.shape[1], "crs": grid.crs, "transform": grid.transform}
    with rasterio.open(path, "w", **profile, **place) as file:
        file.write(layers)
    return path


def valid_of(path: Path) -> tuple[NDArray, tuple[str, ...]]:
    info, notes = without_extremes(describe(path))
    patch = View(info, info.grid, "none").read(Window.whole(info.grid.shape))
    assert np.isfinite(patch.values).all()
    assert np.abs(patch.values).max() < 1e4
    overview, _ = View(info, info.grid, "none").read_decimated(20)
    assert np.abs(overview.values).max() < 1e4
    return patch.valid, notes


@pytest.mark.parametrize(
    ("dtype", "value"),
    [
        ("float32", -3.4028235e38),
        ("float32", 1e20),
        ("float32", 1e15),
        ("float64", 1.7e308),
        ("int32", -(2**31)),
    ],
)
def test_they_are_nodata_with_a_note(tmp_path: Path, dtype: str, value: float) -> None:
    values = render(make_grid((60, 70))).astype(dtype)
    values[20, 30] = value
    valid, notes = valid_of(write(tmp_path / "a.tif", values))
    assert np.argwhere(~valid).tolist() == [[20, 30]]
    assert len(notes) == 1
    assert f"{np.dtype(dtype).type(value):g}" in notes[0]


def test_an_image_without_them_has_no_note(tmp_path: Path) -> None:
    for dtype in ("uint8", "float32", "float64"):
        valid, notes = valid_of(write(tmp_path / f"{dtype}.tif", render(make_grid((60, 70))).astype(dtype)))
        assert valid.all()
        assert notes == ()


@pytest.mark.parametrize(
    ("dtype", "value", "declared"),
    [("float32", -3.4028235e38, -3.4e38), ("float64", float(np.float32(-9999.9)), -9999.9),
     ("float64", -9999.9, float(np.float32(-9999.9)))],
)  # fmt: skip
def test_a_declared_value_may_be_rounded(tmp_path: Path, dtype: str, value: float, declared: float) -> None:
    values = render(make_grid((60, 70))).astype(dtype)
    values[20:30, 30:40] = value
    valid, notes = valid_of(write(tmp_path / "a.tif", values, declared))
    assert (~valid).sum() == 100
    assert notes == ()


def test_bands_that_are_matched_as_one_have_limits_each(tmp_path: Path) -> None:
    values = np.stack([render(make_grid((60, 70)), band) for band in ("red", "thermal")]).astype("float32")
    values[1, 5, 6] = 1e12
    path = write(tmp_path / "a.tif", values)
    info = with_bands(describe(path), Bands((BandPart(str(path), 1), BandPart(str(path), 2))))
    patch = View(info, info.grid, "none").read(Window.whole(info.grid.shape))
    assert np.argwhere(~patch.valid).tolist() == [[5, 6]]


def test_the_picture_of_the_report_shows_the_rest(tmp_path: Path) -> None:
    values = render(make_grid((60, 70))).astype("float64")
    whole = read_backdrop(describe(write(tmp_path / "a.tif", values)))
    values[:10], values[10:20] = 1.7e308, -1.7e308
    shown = read_backdrop(describe(write(tmp_path / "b.tif", values)))
    assert whole is not None
    assert shown is not None
    assert (shown[:20] == 0).all()
    assert np.abs(shown[20:].astype(int) - whole[20:]).max() < 60


@pytest.mark.parametrize("declared", [None, pytest.param(-3.4e38, marks=pytest.mark.slow)])
def test_a_pair_registers_as_without_them(tmp_path: Path, declared: float | None) -> None:
    shift = (1.3, -0.7)
    reference = render(make_grid()).astype("float32")
    target = render(make_grid(), "thermal", displacement_px=shift).astype("float32")
    target[100:104, 60:64] = -3.4028235e38
    paths = write(tmp_path / "r.tif", reference), write(tmp_path / "t.tif", target, declared)
    points = pg.match(*paths, points=200, features=400, prealign="georef")
    assert points.matches is not None
    assert len(points.matches.warnings) == (declared is None)
    found = np.median(points.displacement_px, axis=0)
    assert np.abs(found - shift).max() < 0.12  # as of this scene without them
