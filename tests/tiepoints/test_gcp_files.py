"""QGIS .points and ENVI .pts, read by their documented rules."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.raster import Grid
from pcwlad_geo.tiepoints.envi import write_envi
from pcwlad_geo.tiepoints.qgis_points import write_points
from pcwlad_geo.tiepoints.table import TiePointTable

UTM = CRS.from_epsg(32633)
TARGET = Grid((100, 100), Affine(30.0, 0.0, 500_000.0, 0.0, -30.0, 4_900_000.0), UTM)


def table(crs: CRS | None) -> TiePointTable:
    reference_px = np.array([[10.5, 20.5], [30.0, 40.0], [50.0, 60.0]])
    target_px = np.array([[11.25, 19.5], [31.0, 40.5], [99.0, 1.0]])
    return TiePointTable(
        reference_px=reference_px,
        target_px=target_px,
        predicted_px=reference_px,
        xy=reference_px * np.array([1.0, -1.0]) if crs is None else reference_px * 1000.0,
        displacement_m=np.full((3, 2), np.nan),
        covariance_px2=np.tile(np.eye(2), (3, 1, 1)),
        score=np.ones(3),
        residual_px=np.array([[0.3, -0.4], [np.nan, np.nan], [5.0, 12.0]]),
        status=np.array(["fit", "unused", "rejected"]),
        crs=crs,
    )


def rows(path: Path, header_lines: int) -> list[list[float]]:
    return [
        [float(cell) for cell in line.split(",")] for line in path.read_text().splitlines()[header_lines:]
    ]


def test_points_of_a_georeferenced_target_are_in_layer_coordinates(tmp_path: Path) -> None:
    """Residuals are predicted minus observed pixels (col, row), as the Georeferencer's table has them."""
    write_points(table(UTM), tmp_path / "t.points", True, TARGET)
    first, second = (tmp_path / "t.points").read_text().splitlines()[:2]
    assert first.startswith("#CRS: ")
    assert CRS.from_wkt(first.removeprefix("#CRS: ")) == UTM
    assert second == "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"
    assert rows(tmp_path / "t.points", 2) == [
        [10500, 20500, 500_337.5, 4_899_415, 1, -0.3, 0.4, pytest.approx(0.5)],
        [30000, 40000, 500_930, 4_898_785, 1, 0, 0, 0],
        [50000, 60000, 502_970, 4_899_970, 0, -5, -12, 13],  # switched off, and what is known of it kept
    ]


def test_points_of_a_plain_target_are_pixels_with_y_up(tmp_path: Path) -> None:
    write_points(table(None), tmp_path / "t.points", False, Grid((100, 100), Affine.identity(), None))
    assert (tmp_path / "t.points").read_text().startswith("mapX,")
    assert rows(tmp_path / "t.points", 1)[0] == [10.5, -20.5, 11.25, -19.5, 1, -0.3, 0.4, pytest.approx(0.5)]


def test_envi_counts_from_one_and_leaves_rejected_points_out(tmp_path: Path) -> None:
    write_envi(table(UTM), tmp_path / "t.pts", "a & b.tif", "é.tif")
    lines = (tmp_path / "t.pts").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "; ENVI Image to Image GCP File"
    assert lines[1:3] == ["; base file: a & b.tif", "; warp file: é.tif"]
    assert lines[3:5] == ["; Base Image (x,y), Warp Image (x,y)", ";"]
    # The centre of GDAL's first pixel, (0.5, 0.5), is ENVI's (1.5, 1.5).
    assert np.loadtxt(lines[5:]) == pytest.approx(np.array([[11.5, 21.5, 12.25, 20.5], [31, 41, 32, 41.5]]))
