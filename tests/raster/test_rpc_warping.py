import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.raster import warping
from pcwlad_geo.raster.grid import Grid, Window, map_px
from pcwlad_geo.raster.output_grid import GridRequest
from pcwlad_geo.raster.rpc.dem import ConstantHeight, Dem, Undulation
from pcwlad_geo.raster.rpc.grid import RpcGrid, positions_on
from pcwlad_geo.raster.rpc.ortho import ortho_grid, orthorectify, requested_ortho_grids
from tests.rpc_scene import (
    SHAPE,
    UNDULATION_M,
    decimated,
    dem_grid,
    dem_values,
    make_rpc,
    rpc_grid,
    write_dem,
    write_image,
)
from tests.scenes import CRS_OF_SCENE, make_grid

UNDULATION = Undulation.constant(UNDULATION_M)
ROWS, COLS = (np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5).astype(np.float64)


def ramps() -> np.ndarray:
    """Each pixel holds its own column and row: a resampled one says where it comes from."""
    return np.stack([COLS, ROWS])


def read(path: Path, band: int | None = None) -> np.ndarray:
    with rasterio.open(path) as file:
        return file.read(band)


def test_every_pixel_comes_from_where_rpc_and_dem_say(tmp_path: Path) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"), make_rpc(samp_off=161.3))
    image = write_image(tmp_path / "image.tif", ramps(), make_rpc())  # not the RPC wanted
    out = make_grid((200, 210), offset_m=(1200, 900))
    orthorectify(image, tmp_path / "ortho.tif", grid, out, "bilinear")
    found = read(tmp_path / "ortho.tif")
    expected = positions_on(grid, out, Window.whole(out.shape), 1)[::-1]
    inside = (
        (expected[0] > 1) & (expected[0] < SHAPE[1] - 1) & (expected[1] > 1) & (expected[1] < SHAPE[0] - 1)
    )
    assert inside.mean() > 0.9
    np.testing.assert_allclose(found[:, inside], expected[:, inside], rtol=0, atol=1e-3)


def test_a_constant_height_counts_too(tmp_path: Path) -> None:
    grid = RpcGrid.of_file(SHAPE, make_rpc(), ConstantHeight(620.0))
    image = write_image(tmp_path / "image.tif", ramps(), make_rpc())
    out = make_grid((100, 110), offset_m=(2400, 2400))
    orthorectify(image, tmp_path / "ortho.tif", grid, out, "bilinear")
    expected = positions_on(grid, out, Window.whole(out.shape), 1)[::-1]
    np.testing.assert_allclose(read(tmp_path / "ortho.tif"), expected, rtol=0, atol=1e-3)


def test_blocks_leave_no_seams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"))
    values = np.random.default_rng(1).integers(1, 255, SHAPE).astype(np.uint8)
    image = write_image(tmp_path / "image.tif", values, make_rpc())
    out = make_grid((320, 340), offset_m=(-300, -300))
    orthorectify(image, tmp_path / "one.tif", grid, out)
    monkeypatch.setattr(warping, "WARPING", replace(warping.WARPING, block_px=96))
    done: list[tuple[int, int]] = []
    orthorectify(image, tmp_path / "many.tif", grid, out, progress=lambda *count: done.append(count))
    assert len(done) == done[-1][0] == done[-1][1] == 16
    np.testing.assert_array_equal(read(tmp_path / "one.tif"), read(tmp_path / "many.tif"))


def test_the_rest_of_the_file_is_kept(tmp_path: Path) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"))
    image = write_image(tmp_path / "image.tif", np.full((2, *SHAPE), 7, np.uint16), make_rpc(), nodata=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(image, "r+") as file:
            file.update_tags(sensor="QB02")
            file.descriptions = ("pan", "other")
            file.scales = (0.1, 0.2)
    out = ortho_grid(make_grid((320, 340)), grid)
    orthorectify(image, tmp_path / "ortho.tif", grid, out)
    with rasterio.open(tmp_path / "ortho.tif") as file:
        assert file.tags()["sensor"] == "QB02"
        assert file.descriptions == ("pan", "other")
        assert file.scales == (0.1, 0.2)
        assert file.nodata == 0
        assert file.crs == CRS_OF_SCENE
        assert not file.tags(ns="RPC")
        assert set(np.unique(file.read())) == {0, 7}


def test_nodata_does_not_bleed_and_is_kept(tmp_path: Path) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"))
    values = np.full(SHAPE, 100, np.uint8)
    values[100:150, 120:200] = 0
    image = write_image(tmp_path / "image.tif", values, make_rpc(), nodata=0)
    orthorectify(image, tmp_path / "ortho.tif", grid, make_grid((320, 340), offset_m=(-300, -300)))
    result = read(tmp_path / "ortho.tif")
    assert set(np.unique(result)) == {0, 100}
    assert np.count_nonzero(result) == pytest.approx(np.count_nonzero(values), rel=0.02)


def test_a_hole_of_the_mask_stays_one(tmp_path: Path) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"))
    mask = np.full(SHAPE, 255, np.uint8)
    mask[100:150, 120:200] = 0
    image = write_image(tmp_path / "image.tif", np.full(SHAPE, 100, np.uint8), make_rpc())
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(image, "r+") as file:
        file.write_mask(mask)
    orthorectify(image, tmp_path / "ortho.tif", grid, make_grid((320, 340), offset_m=(-300, -300)))
    with rasterio.open(tmp_path / "ortho.tif") as file:
        valid = file.read_masks(1) != 0
        assert set(np.unique(file.read(1)[valid])) == {100}
    assert np.count_nonzero(valid) == pytest.approx(np.count_nonzero(mask), rel=0.02)


def test_what_the_image_does_not_cover_is_masked(tmp_path: Path) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"))
    image = write_image(tmp_path / "image.tif", np.full(SHAPE, 100, np.uint8), make_rpc())
    out = make_grid((340, 360), offset_m=(-600, -600))
    orthorectify(image, tmp_path / "ortho.tif", grid, out)
    with rasterio.open(tmp_path / "ortho.tif") as file:
        valid = file.dataset_mask() != 0
        assert (file.read(1)[valid] == 100).all()
    row, col = positions_on(grid, out, Window.whole(out.shape), 1)
    seen = (col > 0.5) & (col < SHAPE[1] - 0.5) & (row > 0.5) & (row < SHAPE[0] - 0.5)
    assert valid[seen].all()
    missed = (col < -2) | (col > SHAPE[1] + 2) | (row < -2) | (row > SHAPE[0] + 2)
    assert not valid[missed].any()


def test_no_height_no_pixel(tmp_path: Path) -> None:
    values = dem_values(dem_grid())
    values[:, 105:] = np.nan
    grid = rpc_grid(write_dem(tmp_path / "dem.tif", values))
    image = write_image(tmp_path / "image.tif", np.full(SHAPE, 100, np.uint8), make_rpc())
    out = make_grid((320, 340))
    orthorectify(image, tmp_path / "ortho.tif", grid, out)
    with rasterio.open(tmp_path / "ortho.tif") as file:
        valid = file.dataset_mask() != 0
    x = map_px(np.array([[0.0, 0.0]]), dem_grid(), out)[0, 0] + 2 * 105  # where the heights end
    assert valid[20:280, 20 : int(x) - 4].all()
    assert not valid[:, int(x) + 2 :].any()


def test_the_grid_that_is_asked_for(tmp_path: Path) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"))
    reference = make_grid((320, 340), offset_m=(-300, -300))

    def asked_for(request: GridRequest) -> Grid:
        return requested_ortho_grids(reference, grid, request, [grid])[0]

    own = ortho_grid(reference, grid)
    assert asked_for(GridRequest()) == own
    assert asked_for(GridRequest("reference-exact")) == reference
    like = Grid((20, 30), own.transform, own.crs)
    assert asked_for(GridRequest(like=like)) == like

    sized = asked_for(GridRequest(pixel_size=(20.0, 25.0)))
    assert (sized.transform.a, sized.transform.e) == (20.0, -25.0)
    edge = map_px(own.boundary_px(), own, sized)
    assert (edge >= -1e-3).all()
    assert (edge <= np.array(sized.shape[::-1]) + 1e-3).all()

    left, bottom, right, top = 500_300.0, 4_597_000.0, 501_200.0, 4_598_000.0
    request = GridRequest(extent=(left, bottom, right, top))
    cut = asked_for(request)
    assert cut.shape == (33, 30)
    assert cut.transform.a == 30.0
    assert cut.to_xy(np.array([[0.0, 0], [30, 33]])) == pytest.approx(
        np.array([[left, top], [right, bottom]])
    )

    elsewhere = asked_for(GridRequest(crs=CRS.from_epsg(3035)))
    assert elsewhere.crs == CRS.from_epsg(3035)
    edge = map_px(grid.boundary_px(), grid, elsewhere)
    assert (edge >= -1e-3).all()
    assert (edge <= np.array(elsewhere.shape[::-1]) + 1e-3).all()


def test_the_output_grid_lies_on_the_references_lattice(tmp_path: Path) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"))
    reference = make_grid((320, 340), offset_m=(-300, -300))
    out = ortho_grid(reference, grid)
    corner = map_px(np.array([[0.0, 0.0]]), out, reference)
    np.testing.assert_allclose(corner, np.rint(corner), rtol=0, atol=1e-6)
    assert out.transform.a == pytest.approx(30.0)  # within 2 %: taken as the reference's
    edge = map_px(grid.boundary_px(), grid, out)
    assert isinstance(out, Grid)
    assert (edge >= -1e-3).all()
    assert (edge <= np.array(out.shape[::-1]) + 1e-3).all()


def test_all_ground_up_to_the_edge_of_the_dem_is_written(tmp_path: Path) -> None:
    near = dem_grid().part((60.0, 60.0), (60, 70))
    heights = Dem(str(write_dem(tmp_path / "dem.tif", dem_values(near), near)), near, 1.0, UNDULATION)
    rpc, shape = decimated(make_rpc(), 0.25), (SHAPE[0] * 4, SHAPE[1] * 4)
    grid = RpcGrid.of_file(shape, rpc, heights)
    image = write_image(tmp_path / "image.tif", np.full(shape, 100, np.uint8), rpc)
    # it begins a little beside the DEM, and ends far off it
    out = make_grid((700, 800), pixel_m=7.0, offset_m=(2097.0, 2097.0))
    orthorectify(image, tmp_path / "ortho.tif", grid, out)
    with rasterio.open(tmp_path / "ortho.tif") as file:
        valid = file.dataset_mask() != 0
    known = np.isfinite(positions_on(grid, out, Window.whole(out.shape), 1)).all(axis=0)
    assert known.any()
    assert not (valid & ~known).any()
    assert np.count_nonzero(known & ~valid) <= sum(out.shape)  # a line of rounding
