"""Lengths against geodesics: in every CRS a metre is one of the ellipsoid."""

from __future__ import annotations

from functools import cache

import numpy as np
import pyproj
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.crs import CRS

from pcwlad_geo.raster.crs import displacement_m, moved_xy, transform_xy, with_arrays
from pcwlad_geo.raster.grid import Grid, pixel_size_m, pixel_sizes_m

ONE = np.array([[1.0, 1.0]])
WGS84 = CRS.from_epsg(4326)
GEOD = pyproj.Geod(ellps="WGS84")

# CRSs of many kinds with the longitudes and latitudes that they are for.
PROJECTED = {
    "Web Mercator": ("EPSG:3857", (-179, 179), (-80, 80)),
    "World Mercator": ("EPSG:3395", (-179, 179), (-80, 80)),
    "UTM, at its edge and beyond": ("EPSG:32633", (9, 21), (0, 83)),
    "polar stereographic": ("EPSG:3413", (-179, 179), (60, 89.9)),
    "polar stereographic, south": ("EPSG:3031", (-179, 179), (-89.9, -60)),
    "Lambert conformal conic": ("EPSG:3034", (-10, 40), (35, 70)),
    "oblique Mercator": ("EPSG:3375", (99, 105), (1, 7)),
    "US survey feet": ("EPSG:2263", (-74.5, -72), (40.4, 41.4)),
    "kilometres": ("+proj=utm +zone=33 +units=km +datum=WGS84", (9, 21), (0, 80)),
    "Lambert equal area": ("EPSG:3035", (-10, 35), (35, 70)),
    "cylindrical equal area": ("EPSG:6933", (-179, 179), (-80, 80)),
    "equidistant cylindrical": ("EPSG:4087", (-179, 179), (-85, 85)),
    "sinusoidal": ("+proj=sinu +datum=WGS84", (-60, 60), (-70, 70)),
    "Mollweide": ("ESRI:54009", (-60, 60), (-70, 70)),
    "westing and southing": ("EPSG:2053", (27, 31), (-34, -22)),
    "degrees": ("EPSG:4326", (-179, 179), (-85, 85)),
    "grads from Paris": ("EPSG:4807", (-5, 10), (42, 51)),
}


@cache
def described(crs_wkt: str) -> tuple[pyproj.CRS, pyproj.Transformer]:
    """Return a CRS, and what transforms its longitudes and latitudes to the map."""
    crs = pyproj.CRS.from_wkt(crs_wkt)
    geographic = crs.geodetic_crs
    assert geographic is not None
    return crs, pyproj.Transformer.from_crs(geographic, crs, always_xy=True)


@cache
def crs_of(name: str) -> CRS:
    return CRS.from_user_input(PROJECTED[name][0])


def ground(name: str, share: tuple[float, float]) -> tuple[CRS, np.ndarray]:
    """Return a CRS and a place (1, 2) in it, so far along the longitudes and latitudes that it is for."""
    _, lon, lat = PROJECTED[name]
    crs = crs_of(name)
    lon_lat = np.array([[lon[0] + share[0] * (lon[1] - lon[0]), lat[0] + share[1] * (lat[1] - lat[0])]])
    if name == "grads from Paris":
        return crs, (lon_lat - [2.33722917, 0.0]) / 0.9
    _, to_map = described(crs.to_wkt())
    return crs, np.array([to_map.transform(*lon_lat[0])])


def geodesic_m(xy_from: np.ndarray, xy_to: np.ndarray, crs: CRS) -> float:
    on_map, to_map = described(crs.to_wkt())
    geod, geographic = on_map.get_geod(), on_map.geodetic_crs
    assert geod is not None
    assert geographic is not None
    unit = np.degrees(geographic.axis_info[0].unit_conversion_factor)
    ends = [np.array(to_map.transform(*xy[0], direction="INVERSE")) * unit for xy in (xy_from, xy_to)]
    return float(geod.inv(*ends[0], *ends[1])[2])


@settings(max_examples=150)
@given(
    name=st.sampled_from(sorted(PROJECTED)),
    share=st.tuples(st.floats(0.02, 0.98), st.floats(0.02, 0.98)),
    length_m=st.floats(0.1, 3000.0),
    angle=st.floats(0, 2 * np.pi),
)
def test_a_displacement_is_as_long_as_its_geodesic(
    name: str, share: tuple[float, float], length_m: float, angle: float
) -> None:
    crs, at = ground(name, share)
    unit = 1 / 111e3 if crs.is_geographic else 1 / crs.linear_units_factor[1]
    end = at + length_m * unit * np.array([[np.cos(angle), np.sin(angle)]])
    found = displacement_m(at, end, crs)
    assert np.hypot(*found[0]) == pytest.approx(geodesic_m(at, end, crs), rel=1e-3, abs=1e-6)
    assert moved_xy(at, found, crs) == pytest.approx(end, abs=1e-5 * length_m * unit)


@settings(max_examples=60)
@given(
    name=st.sampled_from(["Web Mercator", "polar stereographic", "oblique Mercator", "US survey feet"]),
    share=st.tuples(st.floats(0.1, 0.9), st.floats(0.1, 0.9)),
    angle=st.floats(0, 2 * np.pi),
)
def test_conformal_maps_keep_the_direction(name: str, share: tuple[float, float], angle: float) -> None:
    """Along the map's axes: a step to the map's north east is one to the north east, however long."""
    crs, at = ground(name, share)
    step = np.array([[np.cos(angle), np.sin(angle)]]) * 10
    found = displacement_m(at, at + step, crs)[0]
    # Web Mercator is conformal on the sphere only: 0.4 degrees of direction at the equator
    assert found / np.hypot(*found) == pytest.approx(step[0] / 10, abs=4e-3)


@pytest.mark.parametrize(("latitude", "scale"), [(0.0, 1.0), (33.0, 1.1917), (60.0, 1.9957), (75.0, 3.855)])
def test_web_mercator_is_not_taken_for_the_ground(latitude: float, scale: float) -> None:
    """Its metres are longer than those of the ground by 1/cos(latitude), on the ellipsoid a little less."""
    crs = CRS.from_epsg(3857)
    x, y = transform_xy(np.array([[15.0, latitude]]), WGS84, crs)[0]
    grid = Grid((9, 9), Affine(30, 0, x - 135, 0, -30, y + 135), crs)
    width_m, height_m = pixel_size_m(grid, (4.5, 4.5)) or (0.0, 0.0)
    assert width_m == pytest.approx(30 / scale, rel=3e-3)
    assert height_m == pytest.approx(30 / scale, rel=8e-3)
    lon_lat = transform_xy(grid.to_xy(np.array([[4.0, 4.5], [5.0, 4.5]])), crs, WGS84)
    assert width_m == pytest.approx(GEOD.inv(*lon_lat[0], *lon_lat[1])[2], rel=1e-6)


def test_pixel_sizes_change_from_place_to_place() -> None:
    crs = CRS.from_epsg(3857)
    top, bottom = transform_xy(np.array([[15.0, 60.0], [15.0, 50.0]]), WGS84, crs)[:, 1]
    grid = Grid((2, 2), Affine(1000, 0, 15e5, 0, (bottom - top) / 2, top), crs)
    sizes = pixel_sizes_m(grid, np.array([[1.0, 0.0], [1.0, 2.0]]))
    assert sizes is not None
    expected = np.cos(np.radians(60)) / np.cos(np.radians(50))
    assert sizes[0, 0] / sizes[1, 0] == pytest.approx(expected, rel=2e-3)


def test_projected_metres() -> None:
    crs = CRS.from_epsg(32633)  # on the central meridian: 0.9996 map metres a metre
    size = pixel_size_m(Grid((9, 9), Affine(30, 0, 5e5, 0, -20, 5e6), crs), (4, 4))
    assert size == pytest.approx((30 / 0.9996, 20 / 0.9996), rel=1e-6)
    here = np.array([[5e5, 5e6]])
    found = displacement_m(here, here + np.array([[3.0, -4.0]]), crs)
    np.testing.assert_allclose(found, np.array([[3, -4]]) / 0.9996, rtol=1e-6)


def test_feet() -> None:
    crs = CRS.from_epsg(2263)  # New York Long Island, US survey feet
    foot_m = 1200 / 3937
    size = pixel_size_m(Grid((9, 9), Affine(10, 0, 1e6, 0, -10, 2e5), crs), (4, 4))
    assert size == pytest.approx((10 * foot_m, 10 * foot_m), rel=1e-4)


def test_rotated_pixels_have_their_own_length() -> None:
    c, s = 10 * np.cos(0.5), 10 * np.sin(0.5)
    size = pixel_size_m(Grid((9, 9), Affine(c, s, 5e5, s, -c, 5e6), CRS.from_epsg(32633)), (0, 0))
    assert size == pytest.approx((10 / 0.9996, 10 / 0.9996), rel=1e-6)


def test_geographic_on_the_ellipsoid() -> None:
    # WGS 84: one degree along the equator is 2 pi a / 360; along a meridian there, pi a (1 - e²) / 180.
    a, e2 = 6378137.0, 0.00669437999014
    grid = Grid((10, 10), Affine(1e-4, 0, 15, 0, -1e-4, 5e-4), WGS84)
    expected = (np.radians(1e-4) * a, np.radians(1e-4) * a * (1 - e2))
    assert pixel_size_m(grid, (5, 5)) == pytest.approx(expected, rel=1e-6)
    latitude = np.radians(60.0)
    north = Grid((10, 10), Affine(1e-4, 0, 15, 0, -1e-4, 60.0005), WGS84)
    width_m, height_m = pixel_size_m(north, (5, 5)) or (0, 0)
    curvature = np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    assert width_m == pytest.approx(np.radians(1e-4) * a * np.cos(latitude) / curvature, rel=1e-6)
    assert height_m == pytest.approx(np.radians(1e-4) * a * (1 - e2) / curvature**3, rel=1e-6)


def test_geographic_displacement_is_east_north() -> None:
    east = displacement_m(np.array([[15.0, 45.0]]), np.array([[15.0001, 45.0]]), WGS84)[0]
    south = displacement_m(np.array([[15.0, 45.0]]), np.array([[15.0, 44.9999]]), WGS84)[0]
    np.testing.assert_allclose(east, [7.8847, 0], atol=1e-3)
    np.testing.assert_allclose(south, [0, -11.1132], atol=1e-3)


def test_a_step_over_the_antimeridian_is_short() -> None:
    found = displacement_m(np.array([[179.9999, 45.0]]), np.array([[-179.9999, 45.0]]), WGS84)
    np.testing.assert_allclose(found, [[2 * 7.8847, 0]], atol=1e-3)


def test_a_plane_without_an_ellipsoid_is_its_own_ground() -> None:
    site = CRS.from_wkt('LOCAL_CS["site",UNIT["foot",0.3048]]')
    np.testing.assert_allclose(displacement_m(ONE, ONE + 10, site), [[3.048, 3.048]])
    np.testing.assert_allclose(moved_xy(ONE, np.array([[3.048, 3.048]]), site), ONE + 10)


def test_nothing_without_crs() -> None:
    assert pixel_size_m(Grid((9, 9), Affine.identity(), None), (4, 4)) is None
    assert np.isnan(displacement_m(ONE, ONE, None)).all()


@pytest.mark.parametrize("n", [1, 2])
def test_one_point_is_given_to_pyproj_as_a_number_and_comes_back_as_an_array(n: int) -> None:
    given = []

    def double(*coordinates: object) -> tuple[object, ...]:
        given.append([type(each) for each in coordinates])
        return tuple(2 * each for each in coordinates)

    x, y = with_arrays(double, np.arange(1.0, n + 1), np.zeros(n))
    assert given == [[float, float] if n == 1 else [np.ndarray, np.ndarray]]
    np.testing.assert_array_equal(x, 2 * np.arange(1.0, n + 1))
    np.testing.assert_array_equal(y, np.zeros(n))
