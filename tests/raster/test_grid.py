from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import transform_xy, transformation_warnings
from pcwlad_geo.raster.grid import Grid, TiltedGrid, apply, jacobian, map_px

UTM33, UTM34 = CRS.from_epsg(32633), CRS.from_epsg(32634)
ENGINEERING = CRS.from_wkt('LOCAL_CS["mine",UNIT["metre",1]]')


def utm_grid(px_m: float = 30.0, x: float = 500_000.0, y: float = 5_000_000.0) -> Grid:
    return Grid((80, 100), Affine(px_m, 0, x, 0, -px_m, y), UTM33)


def test_pixel_coordinates_are_corner_based() -> None:
    grid = utm_grid()
    xy = grid.to_xy(np.array([[0.0, 0.0], [0.5, 0.5], [100.0, 80.0]]))
    np.testing.assert_array_equal(xy, [[500_000, 5_000_000], [500_015, 4_999_985], [503_000, 4_997_600]])


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(0, 360), st.floats(0.1, 1000))
def test_to_px_inverts_to_xy(col: float, row: float, angle_deg: float, px_m: float) -> None:
    c, s = px_m * np.cos(np.radians(angle_deg)), px_m * np.sin(np.radians(angle_deg))
    grid = Grid((10, 10), Affine(c, s, 712_345.67, s, -c, 5_432_109.87), UTM33)
    np.testing.assert_allclose(grid.to_px(grid.to_xy(np.array([[col, row]]))), [[col, row]], atol=1e-6)


def test_parts_and_scaled_grids_keep_the_ground() -> None:
    grid = utm_grid()
    part = grid.part((7.0, -3.0), (5, 6))
    np.testing.assert_allclose(part.to_xy(np.array([[1.5, 2.5]])), grid.to_xy(np.array([[8.5, -0.5]])))
    scaled = grid.scaled((20, 50))
    assert scaled.shape == (20, 50)
    np.testing.assert_allclose(scaled.to_xy(np.array([[10.0, 10.0]])), grid.to_xy(np.array([[20.0, 40.0]])))


def test_a_tilted_grid_is_in_perspective() -> None:
    transform = Affine(2.0, 0.5, 1000.0, -0.5, 2.0, 500.0)
    grid = TiltedGrid((80, 100), transform, None, (1100.0, 580.0), (4e-4, -3e-4))
    px = grid.lattice_px(5)
    xy = grid.to_xy(px)
    np.testing.assert_allclose(grid.to_px(xy), px, atol=1e-9)
    flat = apply(transform, px) - [1100.0, 580.0]
    nearer = 1 / (1 + 4e-4 * flat[:, 0] - 3e-4 * flat[:, 1])
    np.testing.assert_allclose(xy - [1100.0, 580.0], flat * nearer[:, None], atol=1e-9)
    beside = px + np.array([7.0, -3.0])
    np.testing.assert_allclose(grid.part((7.0, -3.0), (5, 6)).to_xy(px), grid.to_xy(beside))
    np.testing.assert_allclose(grid.scaled((20, 50)).to_xy(px), grid.to_xy(px * [2.0, 4.0]))


def test_nothing_is_seen_beyond_the_horizon() -> None:
    grid = TiltedGrid((80, 100), Affine.identity(), None, (0.0, 0.0), (-0.01, 0.0))
    assert np.isnan(grid.to_xy(np.array([[100.0, 0.0]]))).all()
    np.testing.assert_allclose(grid.to_xy(np.array([[50.0, 1.0]])), [[100.0, 2.0]])


def test_map_px_between_pixel_sizes() -> None:
    coarse, fine = utm_grid(30.0), utm_grid(10.0, x=500_005.0)
    np.testing.assert_allclose(map_px(np.array([[1.0, 1.0]]), coarse, fine), [[2.5, 3.0]], atol=1e-9)
    np.testing.assert_allclose(jacobian(np.array([[5.0, 5.0]]), coarse, fine)[0], 3 * np.eye(2), atol=1e-9)


def test_map_px_across_crs_goes_there_and_back() -> None:
    here = utm_grid(x=760_000.0)
    there = Grid((80, 100), Affine(30, 0, 290_000, 0, -30, 5_000_000), UTM34)
    points = np.array([[0.0, 0.0], [50.5, 20.25], [99.0, 79.0]])
    np.testing.assert_allclose(map_px(map_px(points, here, there), there, here), points, atol=1e-6)


def test_geographic_axes_are_longitude_latitude() -> None:
    xy = transform_xy(np.array([[500_000.0, 0.0]]), UTM33, CRS.from_epsg(4326))
    np.testing.assert_allclose(xy, [[15.0, 0.0]], atol=1e-9)


def test_engineering_crs_cannot_be_transformed() -> None:
    with pytest.raises(InputError, match="cannot transform coordinates from 'mine' to EPSG:32633"):
        transform_xy(np.zeros((1, 2)), ENGINEERING, UTM33)


def test_no_crs_cannot_be_transformed() -> None:
    with pytest.raises(InputError, match="without a CRS"):
        transform_xy(np.zeros((1, 2)), None, UTM33)


def test_impossible_places_are_nan() -> None:
    xy = transform_xy(np.array([[0.0, 1000.0]]), CRS.from_epsg(4326), UTM33)
    assert np.isnan(xy).all()


def test_ballpark_transformations_are_named() -> None:
    assert transformation_warnings(UTM33, UTM34) == ()
    (warning,) = transformation_warnings(CRS.from_epsg(4267), CRS.from_epsg(4269))  # grids not in the wheels
    assert "EPSG:4267" in warning
    assert "off" in warning
