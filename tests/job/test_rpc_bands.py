"""The registration of a target with RPC, applied to bands and to siblings with RPCs of their own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.cli.app import run as run_app
from pcwlad_geo.errors import InputError, OutputError, SettingsError
from pcwlad_geo.raster import Grid, Trust, read_rpc, trusting
from tests.rpc_scene import (
    SHAPE,
    UNDULATION_M,
    decimated,
    make_rpc,
    oblique_rpc,
    write_image,
    write_pair,
)
from tests.scenes import make_grid, render, write

pytestmark = pytest.mark.slow

TRUTH_PX = np.array([2.6, -1.4])
FACTOR = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Hold a pair, its registration `done`, and a multispectral sibling `ms.tif`."""
    folder = tmp_path_factory.mktemp("siblings")
    reference, image, dem = write_pair(folder, TRUTH_PX)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)  # the DEM is named relatively
        pcwlad_geo.register(reference, image, out_dir="done", dem=dem.name, dem_vertical=UNDULATION_M, jobs=1)
    with rasterio.open(image) as file:
        values = np.rint(averaged(file.read(1).astype(np.float64))).astype(np.uint16)
    write_image(folder / "ms.tif", np.stack([values] * 2), decimated(make_rpc(), FACTOR), nodata=0)
    return folder


def averaged(values: np.ndarray) -> np.ndarray:
    rows, cols = (side // FACTOR for side in values.shape)
    return values.reshape(rows, FACTOR, cols, FACTOR).mean(axis=(1, 3))


def shift_of(found: Path, original: Path) -> np.ndarray:
    with trusting(Trust(vrt=True)):
        sources = [read_rpc(str(path)) for path in (found, original)]
    assert all(sources)
    after, before = (np.array([source.rpc.samp_off, source.rpc.line_off]) for source in sources)
    return after - before


def test_a_sibling_is_corrected_by_the_same_on_the_ground(folder: Path, tmp_path: Path) -> None:
    written = pcwlad_geo.warp(folder / "done", [folder / "ms.tif"], out_dir=tmp_path)
    assert [path.name for path in written] == ["ms_registered.tif", "ms_rpc.vrt", "ms_rpc_RPC.TXT"]
    found_px = shift_of(folder / "done/image_rpc.vrt", folder / "image.tif")
    np.testing.assert_allclose(found_px, TRUTH_PX, rtol=0, atol=0.01)
    carried_px = shift_of(tmp_path / "ms_rpc.vrt", folder / "ms.tif")
    np.testing.assert_allclose(carried_px, found_px / FACTOR, rtol=0, atol=1e-4)
    with rasterio.open(tmp_path / "ms_registered.tif") as file:
        grid, valid = Grid(file.shape, file.transform, file.crs), file.dataset_mask() != 0
        assert (file.count, file.nodata) == (2, 0)
        seen = file.read(1) / 200.0
    assert grid.transform.a == pytest.approx(30.0 * FACTOR, rel=0.02)
    corner_px = make_grid((320, 340), offset_m=(-300, -300)).to_px(grid.to_xy(np.zeros((1, 2))))
    np.testing.assert_allclose(corner_px / FACTOR, np.rint(corner_px / FACTOR), rtol=0, atol=1e-6)
    valid[:3], valid[-3:], valid[:, :3], valid[:, -3:] = False, False, False, False
    fine = grid.scaled((grid.shape[0] * FACTOR, grid.shape[1] * FACTOR))
    right = np.abs(seen - averaged(render(fine)))[valid].mean()
    wrong = np.abs(seen - averaged(render(fine, displacement_px=TRUTH_PX)))[valid].mean()
    assert right < 0.25 * wrong


def test_siblings_of_two_pixel_sizes_share_their_corners(folder: Path, tmp_path: Path) -> None:
    written = pcwlad_geo.warp(folder / "done", [folder / "image.tif", folder / "ms.tif"], out_dir=tmp_path)
    fine, coarse = (rasterio.open(path) for path in written if path.suffix == ".tif")
    with fine, coarse:
        assert fine.bounds == coarse.bounds
        assert fine.shape == (FACTOR * coarse.shape[0], FACTOR * coarse.shape[1])


def test_a_sibling_on_the_grid_of_another_raster(folder: Path, tmp_path: Path) -> None:
    grid = make_grid((50, 60), offset_m=(300, -300))
    like = write(tmp_path / "like.tif", np.zeros((50, 60)), grid)
    (path, *_) = pcwlad_geo.warp(
        folder / "done", [folder / "ms.tif"], out_dir=tmp_path, like=like, of="GTiff"
    )
    with rasterio.open(path) as file:
        assert (file.shape, file.transform, file.crs) == (grid.shape, grid.transform, grid.crs)
        assert file.dataset_mask().any()


def test_a_grid_that_shows_nothing_of_a_sibling_is_refused_before_the_work(
    folder: Path, tmp_path: Path
) -> None:
    rasters = [folder / "image.tif", folder / "ms.tif"]
    like = write(tmp_path / "like.tif", np.zeros((9, 9)), make_grid((9, 9), offset_m=(90_000, 0)))
    for wishes in ({"te": (100.0, 100.0, 200.0, 200.0)}, {"like": like}):
        with pytest.raises(InputError, match=r"the output grid shows nothing of the target.*change --te"):
            pcwlad_geo.warp(folder / "done", rasters, out_dir=tmp_path / "out", **wishes)
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("has_rpc", [True, False])
def test_a_band_of_the_same_pixels_becomes_what_the_target_became(
    folder: Path, tmp_path: Path, has_rpc: bool
) -> None:
    with rasterio.open(folder / "image.tif") as file:
        values = file.read()
    band = write_image(tmp_path / "band.tif", values, make_rpc() if has_rpc else None)
    pcwlad_geo.warp(folder / "done", [band], out_dir=tmp_path)
    with (
        rasterio.open(tmp_path / "band_registered.tif") as ours,
        rasterio.open(folder / "done/image_registered.tif") as target,
    ):
        assert ours.transform == target.transform
        np.testing.assert_array_equal(ours.read(), target.read())
    with trusting(Trust(vrt=True)):
        found = [read_rpc(str(path)) for path in (tmp_path / "band_rpc.vrt", folder / "done/image_rpc.vrt")]
    assert found[0].rpc == found[1].rpc


def test_one_raster_elsewhere_has_nothing_beside_it(folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "there/ms.tif"
    assert pcwlad_geo.warp(folder / "done", [folder / "ms.tif"], output_raster=place) == (place,)
    assert [path.name for path in place.parent.iterdir()] == ["ms.tif"]


def test_the_command_names_all_files(folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["warp", str(folder / "done"), str(folder / "ms.tif"), "-o", str(tmp_path)]
    assert run_app([*arguments, "--progress", "json"]) == 0
    ended = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert {Path(path).name for path in ended["paths"]} == {
        "ms_registered.tif",
        "ms_rpc.vrt",
        "ms_rpc_RPC.TXT",
    }


def test_what_is_no_sibling_is_an_error_before_anything_is_written(folder: Path, tmp_path: Path) -> None:
    ones = np.ones((100, 100), np.uint8)
    bad = {
        "no RPC .* but 100 x 100 px": write_image(tmp_path / "small.tif", ones, None),
        "no RPC .* but a geotransform": write(
            tmp_path / "map.tif", ones, make_grid((100, 100)), dtype="uint8"
        ),
        "not taken from where": write_image(tmp_path / "aside.tif", np.ones(SHAPE, np.uint8), oblique_rpc()),
    }
    for message, path in bad.items():
        with pytest.raises(InputError, match=message):
            pcwlad_geo.warp(folder / "done", [folder / "ms.tif", path], out_dir=tmp_path / "out")
        assert not (tmp_path / "out").exists()
    with pytest.raises(SettingsError, match="no grid on the ground"):
        pcwlad_geo.warp(folder / "done", [folder / "ms.tif"], out_dir=tmp_path / "out", grid="target")
    (tmp_path / "ms_rpc.vrt").write_text("mine")
    with pytest.raises(OutputError, match=r"ms_rpc\.vrt exists"):
        pcwlad_geo.warp(folder / "done", [folder / "ms.tif"], out_dir=tmp_path)


def test_a_dem_that_is_gone_is_told(folder: Path, tmp_path: Path) -> None:
    report = json.loads((folder / "done/report.json").read_text())
    assert Path(report["rpc"]["dem"]) == folder / "dem.tif"
    assert report["rpc"]["dem_vertical"] == UNDULATION_M
    report["rpc"]["dem"] = str(tmp_path / "gone.tif")
    (tmp_path / "report.json").write_text(json.dumps(report))
    with pytest.raises(InputError, match=r"gone\.tif does not exist"):
        pcwlad_geo.warp(tmp_path, [folder / "ms.tif"], out_dir=tmp_path / "out")
