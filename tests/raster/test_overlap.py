"""Where two rasters show the same ground, and where the output lies: around the earth, at poles and limb."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.raster.crs import turn_of
from pcwlad_geo.raster.grid import Grid, jacobian, map_px
from pcwlad_geo.raster.output_grid import GridRequest, output_grid
from pcwlad_geo.raster.overlap import common_ground, footprint, lon_lat_bounds, lon_lat_outline
from tests.earth import GEOSTATIONARY, LONLAT, SINUSOIDAL

NONE = AffineCorrection("shift", np.eye(2, 3))
SHOWN_OF_DISK = np.pi / 4


def grid(crs: str, left: float, top: float, right: float, bottom: float, shape: tuple[int, int]) -> Grid:
    rows, cols = shape
    step = Affine((right - left) / cols, 0, left, 0, (bottom - top) / rows, top)
    return Grid(shape, step, CRS.from_user_input(crs))


def lonlat(left: float, right: float, top: float = 10.0, bottom: float = 0.0) -> Grid:
    return grid(LONLAT, left, top, right, bottom, (round((top - bottom) * 10), round((right - left) * 10)))


WORLD = lonlat(-180.0, 180.0, 90.0, -90.0)
DISK = grid(GEOSTATIONARY.format(-137), -5.43e6, 5.43e6, 5.43e6, -5.43e6, (300, 300))
POLAR = grid("EPSG:3413", -2.75e6, 2.75e6, 2.75e6, -2.75e6, (220, 220))


@pytest.mark.parametrize(
    ("crs", "turn"),
    [
        (LONLAT, 360.0),
        ("EPSG:4807", 400.0),
        ("EPSG:3857", 2 * np.pi * 6378137.0),
        ("EPSG:3832", 2 * np.pi * 6378137.0),
        ("EPSG:6933", 34_735_060.89),
        *((crs, np.inf) for crs in ("EPSG:32660", "EPSG:8857", "EPSG:3413", SINUSOIDAL)),
        (GEOSTATIONARY.format(0), np.inf),
    ],
)
def test_a_turn_around_the_earth_in_map_units(crs: str, turn: float) -> None:
    assert turn_of(CRS.from_user_input(crs)) == pytest.approx(turn, rel=1e-9)


@pytest.mark.parametrize(
    ("reference", "target", "bounds"),
    [
        (lonlat(179.0, 181.0), lonlat(-181.0, -179.0), (0, 0, 20, 100)),
        (lonlat(350.0, 352.0), lonlat(-9.0, 5.0), (10, 0, 20, 100)),
        (lonlat(-170.0, -160.0), lonlat(0.0, 360.0, 90.0, -90.0), (0, 0, 100, 100)),
        (lonlat(-10.0, 10.0), lonlat(0.0, 360.0), (0, 0, 200, 100)),
        (lonlat(178.0, 179.0), lonlat(-180.0, -179.0), None),
        (WORLD, lonlat(170.0, 190.0), (0, 800, 3600, 900)),
        (WORLD, lonlat(0.0, 360.0, 90.0, -90.0), (0, 0, 3600, 1800)),
    ],
)
def test_longitudes_are_compared_by_their_place(
    reference: Grid, target: Grid, bounds: tuple[float, ...] | None
) -> None:
    common = common_ground(reference, target)
    assert common.is_empty if bounds is None else common.bounds == pytest.approx(bounds, abs=1e-6)
    assert common.area == pytest.approx(common_ground(target, reference).area)


def test_utm_and_mercator_across_180_degrees_overlap() -> None:
    around = lonlat(179.5, 180.5, 1.0, 0.5)
    for crs, left in (("EPSG:32660", 775_000.0), ("EPSG:32601", 105_000.0), ("EPSG:3832", 3_285_000.0)):
        other = grid(crs, left, 100_000.0, left + 110_000, 60_000.0, (40, 110))
        for one, two in ((around, other), (other, around)):
            assert common_ground(one, two).area > 0.5 * min(one.shape[0] * one.shape[1], 4400)


def test_space_around_a_full_disk_is_not_there() -> None:
    assert common_ground(DISK, WORLD).area / 300**2 == pytest.approx(SHOWN_OF_DISK, abs=0.01)
    parts = common_ground(WORLD, DISK)
    low, _, high, _ = parts.bounds
    assert (low, high) == (pytest.approx(0.0), pytest.approx(3600.0))  # both sides of 180 degrees
    assert parts.area < 0.45 * 1800 * 3600


def test_a_raster_around_the_pole_overlaps() -> None:
    assert common_ground(POLAR, WORLD).area == pytest.approx(220**2, rel=0.01)
    left, top, right, bottom = common_ground(WORLD, POLAR).bounds
    assert (left, right, top) == (pytest.approx(0.0), pytest.approx(3600.0), pytest.approx(0.0, abs=8))
    assert 340 < bottom < 380


def test_the_cut_of_a_projection_is_no_ground() -> None:
    across = grid("EPSG:8857", 1.71e7, 50_000.0, 1.75e7, -50_000.0, (50, 200))  # its edge is at 17,243,959 m
    shown = common_ground(across, lonlat(179.0, 181.0, 1.0, -1.0))
    assert shown.bounds[2] == pytest.approx((17_243_959 - 1.71e7) / 2000, abs=2.0)


def test_steps_over_the_edge_of_a_map_of_the_earth_are_short() -> None:
    slopes = jacobian(np.array([[0.0, 50.0]]), lonlat(180.0, 190.0), WORLD)[0]
    np.testing.assert_allclose(slopes, np.eye(2), atol=1e-6)
    np.testing.assert_allclose(map_px(np.array([[5.0, 5.0]]), lonlat(180.0, 190.0), WORLD), [[5.0, 805.0]])


@pytest.mark.parametrize(
    ("reference", "target", "left", "right"),
    [
        (lonlat(179.0, 181.0), lonlat(-181.0, -179.0), 179.0, 181.0),
        (lonlat(-10.0, 10.0), lonlat(345.0, 365.0), -15.0, 5.0),
        (WORLD, lonlat(0.0, 360.0, 90.0, -90.0), -180.0, 180.0),
        (lonlat(170.0, 190.0), WORLD, 0.0, 360.0),
        (lonlat(100.0, 120.0), WORLD, -180.0, 180.0),
        (lonlat(170.0, 190.0), grid("EPSG:32601", 1e5, 1e5, 2e5, 0.0, (10, 10)), 179.4, 180.5),
    ],
)
def test_the_output_lies_where_the_reference_lies(
    reference: Grid, target: Grid, left: float, right: float
) -> None:
    found = output_grid(reference, target, NONE)
    corners = found.to_xy(np.array([[0.0, 0.0], np.array(found.shape[::-1])]))[:, 0]
    assert corners == pytest.approx([left, right], abs=0.2)


def test_the_output_of_a_full_disk_is_its_part_of_the_earth() -> None:
    found = output_grid(lonlat(180.0, 280.0, 50.0, -50.0), DISK, NONE)
    (left, top), (right, bottom) = found.to_xy(np.array([[0.0, 0.0], np.array(found.shape[::-1])])).tolist()
    assert (left, right) == (pytest.approx(223 - 79, abs=3), pytest.approx(223 + 79, abs=3))
    assert (top, bottom) == (pytest.approx(79, abs=3), pytest.approx(-79, abs=3))
    back = output_grid(DISK, WORLD, NONE)
    assert back.to_xy(np.zeros((1, 2)))[0] == pytest.approx([-5.43e6, 5.43e6], rel=0.02)


def test_another_crs_of_the_output_is_in_one_turn_too() -> None:
    utm = grid("EPSG:32601", 1e5, 1e5, 2e5, 0.0, (100, 100))
    found = output_grid(utm, utm, NONE, GridRequest(crs=CRS.from_epsg(4326)))
    assert found.shape[1] < 200
    assert footprint(utm, found)[1]


@pytest.mark.parametrize(
    "made",
    [
        grid(LONLAT, 179.9, 1.0, 180.1, 0.8, (200, 200)),
        grid(LONLAT, -180.1, 1.0, -179.9, 0.8, (200, 200)),
        grid("EPSG:3832", 29.9 * 111319.49, 111325.14, 30.1 * 111319.49, 89000.0, (200, 200)),
    ],
)
def test_an_outline_is_cut_at_180_degrees(made: Grid) -> None:
    outline = lon_lat_outline(made)
    bounds = np.array(sorted(part.bounds for part in outline.geoms))
    np.testing.assert_allclose(bounds[:, [0, 2]], [[-180, -179.9], [179.9, 180]], atol=2e-5)
    assert outline.area == pytest.approx(0.04, rel=0.01)
    assert all(part.exterior.is_ccw for part in outline.geoms)
    assert lon_lat_bounds(bounds.tolist())[::2] == pytest.approx((179.9, -179.9), abs=2e-5)


def test_an_outline_around_a_pole_goes_along_it() -> None:
    south = grid("EPSG:3031", -2e6, 2e6, 2e6, -2e6, (400, 400))
    outline = lon_lat_outline(south)
    assert outline.bounds[:2] + outline.bounds[2:3] == pytest.approx((-180, -90, 180))
    assert shapely.contains_xy(outline, [-179, 0, 179], [-89.9, -75.0, -80.0]).all()
    assert not shapely.contains_xy(outline, 0, -60)


def test_an_outline_of_a_disk_leaves_space_out() -> None:
    disk = grid("+proj=geos +h=35786023 +lon_0=-137 +ellps=GRS80", -5.5e6, 5.5e6, 5.5e6, -5.5e6, (99, 99))
    outline = lon_lat_outline(disk)
    assert len(outline.geoms) == 2
    west, _, east, _ = lon_lat_bounds([part.bounds for part in outline.geoms])
    assert 140 < west < 150
    assert -65 < east < -55


def test_bounds_of_boxes_are_the_shortest_way_around() -> None:
    assert lon_lat_bounds([(10, 0, 20, 5), (-30, -5, -20, 1)]) == (-30, -5, 20, 5)
    assert lon_lat_bounds([(100, 0, 110, 1), (-170, 0, -160, 1)]) == (100, 0, -160, 1)
    assert lon_lat_bounds([(179, 0, -179, 1), (170, 0, 175, 1)]) == (170, 0, -179, 1)
    assert lon_lat_bounds([(-180, 0, 0, 1), (0, 0, 180, 1)])[::2] == (-180, 180)
