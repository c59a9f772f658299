"""The correction as a grid of offsets: PROJ and GDAL move by it what this program moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.warp import reproject

from pcwlad_geo import InputError
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.splines import SplineCorrection, SplineGrid
from pcwlad_geo.outputs.proj_grid import ProjGridParameters, proj_pipeline, write_proj_grid
from pcwlad_geo.raster import Grid

SPLINE = SplineCorrection(
    "tps", SplineGrid((0.0, 0.0), 200.0, (3, 2)), np.random.default_rng(1).uniform(-3, 3, (5, 6, 2))
)
SHIFT = AffineCorrection("shift", np.array([[1.0, 0.0, 2.25], [0.0, 1.0, -40.5]]))
UTM, LONLAT, LAEA, FEET = (CRS.from_epsg(code) for code in (32633, 4326, 3035, 2263))
GRIDS = {
    "utm": Grid((400, 600), Affine(30, 0, 500000, 0, -30, 4600000), UTM),
    "rotated": Grid((400, 600), Affine(20, 5, 500000, 5, -20, 4600000), UTM),
    "south up": Grid((400, 600), Affine(30, 0, 4500000, 0, 30, 2600000), LAEA),
    "degrees": Grid((400, 600), Affine(3e-4, 0, 15, 0, -3e-4, 41.5), LONLAT),
    "feet": Grid((400, 600), Affine(30, 0, 980000, 0, -30, 200000), FEET),
}


@pytest.mark.parametrize("correction", [SHIFT, SPLINE], ids=["shift", "tps"])
@pytest.mark.parametrize("name", GRIDS)
def test_proj_moves_points_as_the_correction_does(name: str, correction: Correction, tmp_path: Path) -> None:
    grid, path = GRIDS[name], tmp_path / "a folder"
    path.mkdir()
    for which in ("", "_inverse"):
        write_proj_grid(path / f"x{which}.tif", correction, grid, is_inverse=bool(which))
    drawn_px = np.random.default_rng(2).uniform((-30, -30), (630, 430), (2000, 2))
    assert grid.crs is not None
    xy = grid.to_xy(drawn_px)
    forth = pyproj.Transformer.from_pipeline(proj_pipeline(str(path / "x.tif"), grid.crs))
    moved_px = grid.to_px(np.column_stack(forth.transform(*xy.T)))
    assert np.abs(moved_px - correction.inverse(drawn_px)).max() < 0.02
    pipeline = proj_pipeline(str(path / "x_inverse.tif"), grid.crs, is_inverse=True)
    back = pyproj.Transformer.from_pipeline(pipeline)
    back_px = grid.to_px(np.column_stack(back.transform(*xy.T, direction="INVERSE")))
    assert np.abs(back_px - correction.forward(drawn_px)).max() < 0.02


@pytest.mark.parametrize("name", ["utm", "south up", "degrees"])
def test_gdal_warps_by_the_inverse_grid_without_holes(name: str, tmp_path: Path) -> None:
    """GDAL's own approximation, 0.125 px by default, is all that is between it and this program.

    It hands north over first where the CRS's first axis points north, as in two of these.
    """
    grid, path = GRIDS[name], tmp_path / "x_proj_inverse.tif"
    write_proj_grid(path, SPLINE, grid, is_inverse=True)
    assert grid.crs is not None
    pipeline = proj_pipeline(str(path), grid.crs, is_inverse=True, is_for_gdal=True)
    with rasterio.open(path) as file:
        assert file.tags()["gdal_pipeline"] == pipeline.replace(str(path), path.name)
    row, col = np.mgrid[:400, :600] + 0.5
    places_px = SPLINE.forward(np.column_stack([col.ravel(), row.ravel()]))
    for axis, values in enumerate((col, row)):
        warped, _ = reproject(
            values,
            np.full_like(values, np.nan),
            src_transform=grid.transform,
            dst_transform=grid.transform,
            src_crs=grid.crs,
            dst_crs=grid.crs,
            dst_nodata=np.nan,
            resampling=Resampling.bilinear,
            COORDINATE_OPERATION=pipeline,
        )
        error_px = (warped - places_px[:, axis].reshape(grid.shape))[10:-10, 10:-10]
        assert np.abs(error_px).max() < 0.13
        assert np.median(np.abs(error_px)) < 0.03


def test_its_tags_say_what_proj_asks_for(tmp_path: Path) -> None:
    for name, bands in (("utm", ["easting", "northing"]), ("degrees", ["latitude", "longitude"])):
        write_proj_grid(tmp_path / "x_proj.tif", SPLINE, GRIDS[name])
        with rasterio.open(tmp_path / "x_proj.tif") as file:
            assert [text.removesuffix("_offset") for text in file.descriptions] == bands
            tags = file.tags()
            assert tags["TYPE"] == "HORIZONTAL_OFFSET"
            assert tags["AREA_OR_POINT"] == "Point"
            assert {"area_of_use", "TIFFTAG_COPYRIGHT", "TIFFTAG_IMAGEDESCRIPTION"} <= tags.keys()
            code = str(file.crs.to_epsg())
            assert {tags[f"{which}_crs_epsg_code"] for which in ("source", "target", "interpolation")} == {
                code
            }
            assert "x_proj.tif" in tags["pipeline"]


def test_a_correction_that_bends_more_gets_nearer_nodes(tmp_path: Path) -> None:
    shapes = []
    for correction in (SHIFT, SPLINE):
        write_proj_grid(tmp_path / "x.tif", correction, GRIDS["utm"], ProjGridParameters())
        with rasterio.open(tmp_path / "x.tif") as file:
            shapes.append(file.shape)
    assert shapes[0][0] < shapes[1][0]


def test_a_target_without_a_crs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no CRS"):
        write_proj_grid(tmp_path / "x.tif", SHIFT, Grid((9, 9), Affine.identity(), None))
