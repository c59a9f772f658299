"""Rasters and vectors moved together by hand: pixels stay, all places move by the same amount."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyogrio.raw
import pytest
import rasterio
import shapely
from rasterio.crs import CRS
from rasterio.warp import transform

import pcwlad_geo
from pcwlad_geo.cli.app import run
from pcwlad_geo.raster import Grid
from tests.scenes import make_grid, render, write

FINE = make_grid((60, 80), pixel_m=10.0, rotation_deg=5.0)
COARSE = make_grid((30, 40), pixel_m=20.0, offset_m=(100, 50))
PLACES_PX = np.array([[0.0, 0.0], [80.0, 0.0], [13.5, 44.25]])
BY = (12.5, -7.25)


def grid_of(path: Path) -> Grid:
    with rasterio.open(path) as file:
        return Grid(file.shape, file.transform, file.crs)


def write_points(path: str, xy: np.ndarray, crs: str) -> str:
    points = shapely.to_wkb(shapely.points(xy))
    pyogrio.raw.write(path, points, [np.arange(len(xy))], ["number"], geometry_type="Point", crs=crs)
    return path


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.chdir(tmp_path)
    xy = FINE.to_xy(PLACES_PX)
    lon, lat = transform(FINE.crs, CRS.from_epsg(4326), *xy.T)
    return [
        str(write(tmp_path / "fine.tif", render(FINE), FINE)),
        str(write(tmp_path / "coarse.tif", render(COARSE), COARSE)),
        write_points("plots.gpkg", xy, "EPSG:32633"),
        write_points("world.geojson", np.column_stack([lon, lat]), "EPSG:4326"),
    ]


@pytest.mark.parametrize("copy", [False, True])
def test_all_files_move_by_the_same_amount(files: list[str], copy: bool) -> None:
    about = (500_300.0, 4_599_800.0)
    written = pcwlad_geo.shift_files(files, BY, angle_deg=30.0, about=about, copy=copy, out_dir="out")
    suffix = "tif" if copy else "vrt"
    names = [
        f"fine_shifted.{suffix}",
        f"coarse_shifted.{suffix}",
        "plots_shifted.gpkg",
        "world_shifted.geojson",
    ]
    assert [path.name for path in written] == names
    turn = np.array([[np.sqrt(0.75), -0.5], [0.5, np.sqrt(0.75)]])
    for grid, path, source in zip((FINE, COARSE), written[:2], files[:2], strict=True):
        truth = (grid.to_xy(PLACES_PX) - about) @ turn.T + about + BY
        np.testing.assert_allclose(grid_of(path).to_xy(PLACES_PX), truth, atol=1e-6)
        with rasterio.open(path) as moved, rasterio.open(source) as original:
            np.testing.assert_array_equal(moved.read(), original.read())
            assert moved.crs == original.crs
    truth = (FINE.to_xy(PLACES_PX) - about) @ turn.T + about + BY
    for path, crs in zip(written[2:], (32633, 4326), strict=True):
        xy = shapely.get_coordinates(shapely.from_wkb(pyogrio.raw.read(path)[2]))
        x, y = transform(CRS.from_epsg(crs), FINE.crs, *xy.T)
        np.testing.assert_allclose(np.column_stack([x, y]), truth, atol=0.01)


def test_it_turns_about_the_middle_of_the_first_file(files: list[str]) -> None:
    assert run(["shift", *files[:3], "--by", "0,0,90", "-o", "out"]) == 0
    middle = FINE.to_xy(FINE.middle_px)
    np.testing.assert_allclose(grid_of(Path("out/fine_shifted.vrt")).to_xy(FINE.middle_px), middle, atol=1e-6)
    off = COARSE.to_xy(COARSE.middle_px) - middle
    np.testing.assert_allclose(
        grid_of(Path("out/coarse_shifted.vrt")).to_xy(COARSE.middle_px),
        middle + off[:, ::-1] * [-1, 1],
        atol=1e-6,
    )


def test_vectors_alone_and_negative_numbers(files: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["shift", files[2], "--by", "-3.5,2"]) == 0
    xy = shapely.get_coordinates(shapely.from_wkb(pyogrio.raw.read("plots_shifted.gpkg")[2]))
    np.testing.assert_allclose(xy, FINE.to_xy(PLACES_PX) + np.array([-3.5, 2.0]), atol=1e-6)
    assert "warning" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["fine.tif", "--by", "1"], "give 2 or 3 numbers"),
        (["fine.tif", "--by", "1,x"], "give 2 or 3 numbers"),
        (["fine.tif", "--by", "nan,1"], "finite"),
        (["plain.tif", "--by", "1,2"], "plain.tif has no geotransform"),
        (["fine.tif", "degrees.tif", "--by", "1,2"], "in EPSG:4326 and the first file in EPSG:32633"),
        (["fine.tif", "missing.tif", "--by", "1,2"], "does not exist"),
        (["fine.tif", "--by", "1,2", "-o", "full"], "exists"),
    ],
)
def test_what_cannot_be_shifted_is_told(
    arguments: list[str], said: str, files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "plain.tif", render(FINE), None)
    degrees = Grid((30, 40), rasterio.Affine(0.1, 0, 10, 0, -0.1, 50), CRS.from_epsg(4326))
    write(tmp_path / "degrees.tif", np.ones((30, 40)), degrees)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "fine_shifted.vrt").write_text("mine", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    assert run(["shift", *arguments]) == 2
    assert said in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before
