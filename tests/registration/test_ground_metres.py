"""Metres of a job are metres of the ground, whatever the CRS of its rasters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.multi.qa.band_pairs import statistics_by_unit
from pcwlad_geo.multi.qa.bands import list_bands
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid, transform_xy
from pcwlad_geo.registration.run import register_pair
from pcwlad_geo.report.summary import summarise
from tests.scenes import CRS_OF_SCENE, ORIGIN_XY_M, render, write

MERCATOR = CRS.from_epsg(3857)
SHIFT_PX = (3.3, -2.6)
SHAPE = (200, 200)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a pair in Web Mercator at 41.5° north, 40 map units a pixel: 30 m of ground."""
    corner = transform_xy(ORIGIN_XY_M[None] + [300.0, -300.0], CRS_OF_SCENE, MERCATOR)[0]
    grid = Grid(SHAPE, Affine(40, 0, corner[0], 0, -40, corner[1]), MERCATOR)
    place = tmp_path_factory.mktemp("mercator")
    write(place / "ref.tif", render(grid), grid)
    write(place / "tgt.tif", 255 - render(grid, displacement_px=SHIFT_PX), grid)
    return place


def test_a_web_mercator_pair_is_measured_in_metres_of_the_ground(folder: Path) -> None:
    settings = Settings(template=61, window=41, features=60)
    found = register_pair(folder / "ref.tif", folder / "tgt.tif", settings)
    grid = found.target.grid
    ends_px = np.array([[99.5, 100], [100.5, 100], [100, 99.5], [100, 100.5]])
    ends = transform_xy(grid.to_xy(ends_px), MERCATOR, CRS.from_epsg(4326))
    geod = pyproj.Geod(ellps="WGS84")
    true_px_m = [geod.inv(*ends[0], *ends[1])[2], geod.inv(*ends[2], *ends[3])[2]]
    assert true_px_m == pytest.approx([30, 30], rel=0.02)
    assert found.px_m == pytest.approx(true_px_m, rel=2e-3)  # the middle of the overlap is about that

    points = found.tie_points.select("fit", "check")
    moved_m = points.displacement_px * [true_px_m[0], -true_px_m[1]]
    np.testing.assert_allclose(points.displacement_m, moved_m, rtol=2e-3, atol=0.02)
    for group in ("fit", "check"):
        px, m = found.accuracy[f"{group}_px"], found.accuracy[f"{group}_m"]
        assert m.ce90 == pytest.approx(px.ce90 * np.mean(true_px_m), rel=0.01)
    before = summarise(found, []).statistics.before["all"]
    assert before is not None
    assert before.m is not None
    assert before.m.radial.rmse == pytest.approx(np.hypot(*SHIFT_PX) * 30, rel=0.02)

    reference, target = list_bands([folder / "ref.tif", folder / "tgt.tif"])
    assert target.px_m == pytest.approx(true_px_m, rel=2e-3)
    metres = statistics_by_unit(points, reference, target)["m"]
    assert metres is not None
    assert metres.radial.rmse == pytest.approx(np.hypot(*SHIFT_PX) * 30, rel=0.02)
