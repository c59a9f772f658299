"""Tie points whose place is not known: no file gets coordinates that are no numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyogrio.raw
import pytest
import rasterio
import shapely
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.raster import Grid
from pcwlad_geo.tiepoints import geopackage
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.envi import write_envi
from pcwlad_geo.tiepoints.gcps import write_gcps_vrt
from pcwlad_geo.tiepoints.qgis_points import write_points
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import TiePointTable
from tests.scenes import write

UTM = CRS.from_epsg(32633)
GRID = Grid((100, 100), Affine(30.0, 0.0, 500_000.0, 0.0, -30.0, 4_900_000.0), UTM)
UNKNOWN = 1
"""The row that has no place on one side."""


def table(lacking: str) -> TiePointTable:
    px = np.array([[10.5, 20.5], [30.0, 40.0], [50.0, 60.0]])
    whole = TiePointTable(
        reference_px=px,
        target_px=px + 0.5,
        predicted_px=px,
        xy=GRID.to_xy(px),
        displacement_m=np.full((3, 2), 15.0),
        covariance_px2=np.tile(np.eye(2), (3, 1, 1)),
        score=np.ones(3),
        residual_px=np.zeros((3, 2)),
        status=np.array(["fit", "fit", "check"]),
        crs=UTM,
    )
    values = getattr(whole, lacking).copy()
    values[UNKNOWN] = np.nan
    return replace(whole, **{lacking: values})


@pytest.mark.parametrize(
    ("lacking", "unknown"),
    [("displacement_m", {"displacements"}), ("xy", {"tie_points", "displacements"}), ("target_px", set())],
)
def test_the_geopackage_has_no_geometry_for_them(tmp_path: Path, lacking: str, unknown: set[str]) -> None:
    geopackage.write_geopackage(table(lacking), tmp_path / "t.gpkg")
    for layer in ("tie_points", "displacements"):
        geometry = shapely.from_wkb(pyogrio.raw.read(tmp_path / "t.gpkg", layer=layer)[2])
        assert np.isfinite(shapely.get_coordinates(geometry)).all()
        missing = [index for index, shape in enumerate(geometry) if shape is None]
        assert missing == ([UNKNOWN] if layer in unknown else [])


@pytest.mark.parametrize("lacking", ["target_px", "xy"])
def test_control_point_files_leave_them_out(tmp_path: Path, lacking: str) -> None:
    points = table(lacking)
    image = write(tmp_path / "image.tif", np.ones(GRID.shape, np.uint8), GRID, dtype="uint8")
    write_points(points, tmp_path / "t.points", True, GRID)
    write_envi(points, tmp_path / "t.pts", "reference.tif", "image.tif")
    write_gcps_vrt(tmp_path / "t.vrt", image, points, UTM, final_path=tmp_path / "t.vrt")
    for name in ("t.points", "t.pts"):
        assert len(read_point_file(tmp_path / name).reference) == 2
        assert "nan" not in (tmp_path / name).read_text()
    with rasterio.open(tmp_path / "t.vrt") as file:
        assert [(gcp.col, gcp.row) for gcp in file.gcps[0]] == [(11.0, 21.0), (50.5, 60.5)]


def test_cells_of_the_table_are_empty(tmp_path: Path) -> None:
    write_csv(table("displacement_m"), tmp_path / "t.csv")
    lines = (tmp_path / "t.csv").read_text().splitlines()
    cells = dict(zip(lines[0].split(","), lines[1 + UNKNOWN].split(","), strict=True))
    assert (cells["d_x_m"], cells["d_y_m"], cells["d_col"]) == ("", "", "0.500000")
