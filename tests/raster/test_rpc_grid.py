import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.raster.grid import Window, map_px
from pcwlad_geo.raster.rpc.dem import ConstantHeight
from pcwlad_geo.raster.rpc.grid import RpcGrid, at_mean_height, positions_on
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.view import View
from tests.rpc_scene import SHAPE, dem_grid, dem_values, make_rpc, relief, rpc_grid, write_dem, write_image
from tests.scenes import CRS_OF_SCENE, make_grid


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> RpcGrid:
    return rpc_grid(write_dem(tmp_path_factory.mktemp("dem") / "dem.tif"))


def pixels(n: int = 200) -> np.ndarray:
    return np.random.default_rng(3).uniform((0, 0), SHAPE[::-1], (n, 2))


def test_pixel_to_ground_and_back(grid: RpcGrid) -> None:
    np.testing.assert_allclose(grid.to_px(grid.to_xy(pixels())), pixels(), rtol=0, atol=1e-3)


def test_ground_is_where_the_line_of_sight_meets_the_relief(grid: RpcGrid) -> None:
    from pcwlad_geo.raster.crs import transform_xy

    lon_lat = grid.to_xy(pixels())
    heights = relief(transform_xy(lon_lat, grid.crs, CRS_OF_SCENE)) + 45.0
    seen = grid.rpc.to_px(np.column_stack([lon_lat, heights]))
    np.testing.assert_allclose(seen, pixels(), rtol=0, atol=0.05)  # the DEM's 60 m between its pixels


def test_no_height_no_ground(tmp_path: Path) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"))
    far = grid.to_xy(np.array([[160.0, 150.0], [-900.0, 150.0]]))
    assert np.isfinite(far[0]).all()
    assert np.isnan(grid.to_px(grid.to_xy(np.array([[-900.0, 150.0]])))).all()


def test_positions_are_those_of_each_pixel(grid: RpcGrid) -> None:
    view = make_grid((320, 340), offset_m=(-300, -300))
    window = Window(40, 70, 60, 50)
    found = positions_on(grid, view, window, 2)
    rows, cols = np.mgrid[40:100:0.5, 70:120:0.5] + 0.25
    expected = map_px(np.column_stack([cols.ravel(), rows.ravel()]), view, grid)
    np.testing.assert_allclose(found.reshape(2, -1)[::-1].T, expected, rtol=0, atol=1e-5)


def test_positions_do_not_depend_on_the_window(grid: RpcGrid) -> None:
    view = make_grid((320, 340), offset_m=(-300, -300))
    whole = positions_on(grid, view, Window(32, 32, 64, 64), 1)
    part = positions_on(grid, view, Window(50, 60, 20, 30), 1)
    np.testing.assert_allclose(whole[:, 18:38, 28:58], part, rtol=0, atol=1e-6)


def test_an_overviews_grid_is_the_same_ground(grid: RpcGrid) -> None:
    half = grid.scaled((SHAPE[0] // 2, SHAPE[1] // 2))
    np.testing.assert_allclose(half.to_px(grid.to_xy(pixels())), pixels() / 2, rtol=0, atol=1e-3)
    np.testing.assert_allclose(half.to_xy(pixels() / 2), grid.to_xy(pixels()), rtol=0, atol=1e-9)


def test_levelled_has_no_relief(grid: RpcGrid) -> None:
    assert at_mean_height(grid) == RpcGrid.of_file(SHAPE, make_rpc(), ConstantHeight(400.0))
    plain = make_grid()
    assert at_mean_height(plain) is plain


def test_it_travels_small(grid: RpcGrid) -> None:
    assert pickle.loads(pickle.dumps(grid)) == grid
    assert len(pickle.dumps(grid)) < 5000


def test_own_pixels_need_no_ground(tmp_path: Path) -> None:
    """The file's own pixels are read where the DEM has no heights, from which they could be placed."""
    nowhere = dem_values(dem_grid())
    nowhere[:, :90] = np.nan
    values = np.arange(SHAPE[0] * SHAPE[1], dtype=np.uint32).reshape(SHAPE)
    path = write_image(tmp_path / "raw.tif", values, make_rpc())
    grid = rpc_grid(write_dem(tmp_path / "dem.tif", nowhere))
    corner = np.array([[0.0, 0.0]])
    assert np.isnan(grid.to_xy(corner)).all()
    view = View(replace(describe(path), grid=grid), grid, "none")
    np.testing.assert_array_equal(view.read(Window(0, 0, 20, 30)).values, values[:20, :30])
    np.testing.assert_array_equal(view.to_file_px(corner), corner)
    np.testing.assert_array_equal(view.from_file_px(corner), corner)
