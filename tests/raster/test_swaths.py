"""Swaths with geolocation arrays, on files that the tests write as GDAL reads NASA's level 2.

They cannot show the relief, the noise and the gaps of delivered arrays.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS

import pcwlad_geo
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.errors import InputError, SettingsError, TrustError
from pcwlad_geo.outputs.geolayers import write_lon_lat
from pcwlad_geo.raster import WGS84, Grid, describe, transform_xy, warp
from pcwlad_geo.raster.geolocation import SwathGrid, swath_of
from tests.scenes import CRS_OF_SCENE, Array, make_grid, render, write
from tests.swaths import bent, lon_lat_of, pixels, seen_by, write_swath

pytest.importorskip("h5py", reason="the tests write netCDF-4 with h5py")
SWATH = bent()
SHIFT_PX = np.array([1.6, -2.3])
QUICK: Any = {"template": 61, "window": 41, "features": 80, "model": "shift", "no_report": True}
AROUND_180 = CRS.from_user_input("+proj=tmerc +lon_0=180 +k=0.9996 +x_0=500000 +datum=WGS84 +type=crs")
"""The CRS of the scene, 165 degrees farther east."""


def as_read(px: Array, rows: int = SWATH.shape[0]) -> Array:
    """Return pixels as GDAL reads such a file: the last line first."""
    return np.column_stack([px[:, 0], rows - px[:, 1]])


def scene_px(lon_lat: Array) -> Array:
    """Return longitudes and latitudes in pixels of the scene."""
    return make_grid().to_px(transform_xy(lon_lat, WGS84, CRS_OF_SCENE))


def reference(folder: Path, crs: CRS = CRS_OF_SCENE) -> Path:
    grid = make_grid((330, 330), offset_m=(-300, -2000))
    return write(folder / "reference.tif", render(grid), Grid(grid.shape, grid.transform, crs))


@pytest.fixture(scope="module")
def swath(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("swath") / "swath.nc"
    return write_swath(path, seen_by(SWATH, displacement_px=SHIFT_PX), lon_lat_of(SWATH))


def test_arrays_place_pixels_and_back(swath: str) -> None:
    grid = describe(swath).grid
    assert isinstance(grid, SwathGrid)
    at = np.random.default_rng(0).uniform(0, 200, (300, 2))
    lon_lat = transform_xy(grid.to_xy(at), grid.crs, WGS84)
    truth = transform_xy(SWATH.to_xy(as_read(at)), SWATH.crs, WGS84)
    np.testing.assert_allclose(scene_px(lon_lat), scene_px(truth), atol=0.02)
    np.testing.assert_allclose(grid.to_px(grid.to_xy(at)), at, atol=1e-3)
    part = grid.part((30.0, 50.0), (90, 80)).scaled((45, 40))
    np.testing.assert_allclose(part.to_xy(at / 4), grid.to_xy(at / 2 + [30, 50]), atol=1e-6)


def test_swath_is_registered(swath: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = pcwlad_geo.register(reference(tmp_path), swath, out_dir="out", **QUICK)
    median_px = np.median(found.tie_points.displacement_px, axis=0)
    np.testing.assert_allclose(as_read(median_px[None], 0)[0], SHIFT_PX, atol=0.05)
    assert not Path("out/sst_corrected.vrt").exists()
    with rasterio.open("out/sst_lonlat.tif") as file:
        assert file.descriptions == ("longitude", "latitude")
        shown = scene_px(file.read()[:, ::-1].reshape(2, -1).T)
    truth = transform_xy(SWATH.to_xy(pixels(SWATH) - SHIFT_PX), SWATH.crs, WGS84)
    np.testing.assert_allclose(shown, scene_px(truth), atol=0.1)
    with rasterio.open("out/sst_registered.tif") as file:
        image, grid = file.read(1), Grid(file.shape, file.transform, file.crs)
        assert file.res == (30.0, 30.0)
    inside = np.isfinite(image)
    assert np.corrcoef(image[inside], render(grid)[inside])[0, 1] > 0.998
    (again,) = pcwlad_geo.warp("out", [swath], output_raster="again.tif")
    with rasterio.open(again) as file:
        np.testing.assert_array_equal(file.read(1), image)
    (in_degrees,) = pcwlad_geo.warp("out", [swath], output_raster="degrees.tif", grid="target")
    with rasterio.open(in_degrees) as file:
        assert file.crs == WGS84


def test_swath_across_180_degrees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    grid = bent(offset_m=(-2500, -500))
    lon, lat = lon_lat_of(grid)
    lon = (lon + 165 + 180) % 360 - 180
    assert lon.min() < -179 < 179 < lon.max()
    uri = write_swath(tmp_path / "swath.nc", seen_by(grid, displacement_px=SHIFT_PX), np.array([lon, lat]))
    place = make_grid((330, 400), offset_m=(-4500, -2000))
    ref = write(tmp_path / "ref.tif", render(place), Grid(place.shape, place.transform, AROUND_180))
    found = pcwlad_geo.match(ref, uri, template=61, window=41, features=80)
    median_px = np.median(found.displacement_px, axis=0)
    np.testing.assert_allclose(as_read(median_px[None], 0)[0], SHIFT_PX, atol=0.1)


def test_overlapping_scans_stay_apart(tmp_path: Path) -> None:
    grid = bent((208, 240), 16)
    uri = write_swath(tmp_path / "scans.nc", seen_by(grid, displacement_px=(0, 2)), lon_lat_of(grid))
    placed = describe(uri).grid
    assert isinstance(placed, SwathGrid)
    np.testing.assert_array_equal(swath_of(placed.arrays).scans, np.arange(0, 209, 16))
    at = make_grid((200, 200), offset_m=(2500, 500))
    xy = transform_xy(at.to_xy(pixels(at)), at.crs, placed.crs)
    px = placed.to_px(xy)
    inside = ((px > 0) & (px < [240, 208])).all(axis=1)
    assert inside.mean() > 0.7
    np.testing.assert_allclose(at.to_px(grid.to_xy(as_read(px[inside]))), pixels(at)[inside], atol=0.02)
    # two rows of a scan are beyond its end once they are moved, and show what that scan shows there
    down = AffineCorrection("shift", np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -2.0]]))
    write_lon_lat(tmp_path / "lonlat.tif", down, placed)
    with rasterio.open(tmp_path / "lonlat.tif") as file:
        shown = scene_px(file.read()[:, ::-1].reshape(2, -1).T)
    cols, rows = pixels(grid).T
    middle = (np.floor(rows / 16) + 0.5) * 16
    rows = middle + (rows - 2 - middle) * (1 + (cols / 120 - 1) ** 2 / 2)
    along = bent((208, 240)).to_xy(np.column_stack([cols, rows]))
    np.testing.assert_allclose(shown, make_grid().to_px(along), atol=0.06)
    warp(uri, tmp_path / "out.tif", down, at)
    with rasterio.open(tmp_path / "out.tif") as file:
        image = file.read(1)
    valid = np.isfinite(image)
    assert np.corrcoef(image[valid], render(at)[valid])[0, 1] > 0.98


def test_arrays_of_a_neighbour_file(tmp_path: Path) -> None:
    image, arrays = write_pixels(tmp_path / "image.tif", 1), write_pixels(tmp_path / "lonlat.tif", 2)
    tags: Any = {"X_DATASET": str(arrays), "Y_DATASET": str(arrays), "Y_BAND": 2}
    tags |= {"GEOREFERENCING_CONVENTION": "PIXEL_CENTER"}
    with rasterio.open(arrays, "r+") as file:
        file.write(lon_lat_of(SWATH))
    with rasterio.open(image, "r+") as file:
        file.update_tags(ns="GEOLOCATION", **tags)
    grid = describe(image).grid
    at = np.array([[20.0, 30.0], [180.0, 100.0]])
    np.testing.assert_allclose(transform_xy(grid.to_xy(at), grid.crs, SWATH.crs), SWATH.to_xy(at), atol=0.3)
    (tmp_path / "elsewhere").mkdir()
    with pytest.raises(TrustError, match=r"lonlat.tif, which is not in its own folder"):
        describe(image.rename(tmp_path / "elsewhere" / "image.tif"))


def write_pixels(path: Path, bands: int) -> Path:
    """Write a raster without georeferencing, but for a geotransform, without which rasterio warns."""
    profile = {"driver": "GTiff", "count": bands, "dtype": "float64", "transform": Affine.scale(2.0)}
    with rasterio.open(path, "w", height=SWATH.shape[0], width=SWATH.shape[1], **profile):
        return path


def test_what_a_swath_cannot_be_is_refused(swath: str, tmp_path: Path) -> None:
    ref = reference(tmp_path)
    with pytest.raises(InputError, match=r"is a swath.*a reference must be on a map grid"):
        pcwlad_geo.match(swath, ref)
    with pytest.raises(InputError, match=r"give a mask on the pixels of the raster"):
        pcwlad_geo.match(ref, swath, tgt_mask=ref)
    with pytest.raises(SettingsError, match=r"a VRT cannot hold .*geolocation arrays"):
        pcwlad_geo.register(ref, swath, of="VRT", out_dir=tmp_path / "out")
    with pytest.raises(InputError, match=r"leave out --write-proj-grid"):
        pcwlad_geo.register(ref, swath, write_proj_grid=True, out_dir=tmp_path / "out")
    short = write_swath(tmp_path / "short.nc", np.zeros((60, 50)), np.zeros((2, 60, 50)))
    with pytest.raises(InputError, match=r"have values for 0% of their pixels"):
        describe(short)
