from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.raster.geodesy import displacement_m, pixel_size_m
from pcwlad_geo.raster.grid import Grid

ONE = np.array([[1.0, 1.0]])


def test_projected_metres() -> None:
    crs = CRS.from_epsg(32633)
    assert pixel_size_m(Grid((9, 9), Affine(30, 0, 5e5, 0, -20, 5e6), crs), (4, 4)) == pytest.approx((30, 20))
    np.testing.assert_allclose(displacement_m(ONE, np.array([[4.0, -3.0]]), crs), [[3, -4]])


def test_feet() -> None:
    crs = CRS.from_epsg(2263)  # New York Long Island, US survey feet
    foot_m = 1200 / 3937
    size = pixel_size_m(Grid((9, 9), Affine(10, 0, 1e6, 0, -10, 2e5), crs), (4, 4))
    assert size == pytest.approx((10 * foot_m, 10 * foot_m))


def test_rotated_pixels_have_their_own_length() -> None:
    c, s = 10 * np.cos(0.5), 10 * np.sin(0.5)
    assert pixel_size_m(
        Grid((9, 9), Affine(c, s, 0, s, -c, 0), CRS.from_epsg(32633)), (0, 0)
    ) == pytest.approx((10, 10))


def test_geographic_on_the_ellipsoid() -> None:
    # WGS 84: one degree along the equator is 2 pi a / 360; along a meridian there, pi a (1 - e²) / 180.
    a, e2 = 6378137.0, 0.00669437999014
    grid = Grid((10, 10), Affine(1e-4, 0, 15, 0, -1e-4, 5e-4), CRS.from_epsg(4326))
    expected = (np.radians(1e-4) * a, np.radians(1e-4) * a * (1 - e2))
    assert pixel_size_m(grid, (5, 5)) == pytest.approx(expected, rel=1e-6)
    latitude = np.radians(60.0)
    north = Grid((10, 10), Affine(1e-4, 0, 15, 0, -1e-4, 60.0005), CRS.from_epsg(4326))
    width_m, height_m = pixel_size_m(north, (5, 5)) or (0, 0)
    curvature = np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    assert width_m == pytest.approx(np.radians(1e-4) * a * np.cos(latitude) / curvature, rel=1e-6)
    assert height_m == pytest.approx(np.radians(1e-4) * a * (1 - e2) / curvature**3, rel=1e-6)


def test_geographic_displacement_is_east_north() -> None:
    crs = CRS.from_epsg(4326)
    east = displacement_m(np.array([[15.0, 45.0]]), np.array([[15.0001, 45.0]]), crs)[0]
    south = displacement_m(np.array([[15.0, 45.0]]), np.array([[15.0, 44.9999]]), crs)[0]
    np.testing.assert_allclose(east, [7.8847, 0], atol=1e-3)
    np.testing.assert_allclose(south, [0, -11.1132], atol=1e-3)


def test_nothing_without_crs() -> None:
    assert pixel_size_m(Grid((9, 9), Affine.identity(), None), (4, 4)) is None
    assert np.isnan(displacement_m(ONE, ONE, None)).all()
