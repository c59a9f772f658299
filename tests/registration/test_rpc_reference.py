"""References with RPCs: seen on the ground, their tie points in their own pixels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.bands import output_grids_of
from pcwlad_geo.raster import WGS84, Grid, describe, transform_xy
from pcwlad_geo.raster.crs import utm_zone_of
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.registration import check_output, register_pair, resolve
from pcwlad_geo.registration.rpc import place_reference
from tests.rpc_scene import UNDULATION_M, make_rpc, oblique_rpc, rpc_grid, write_dem, write_image
from tests.scenes import CRS_OF_SCENE, make_grid, render, write

pytestmark = pytest.mark.slow  # one registration of two images with RPCs

TRUTH_PX = np.array([1.9, -2.3])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Hold two images seen from different sides, the target's RPC in error, and the DEM."""
    folder = tmp_path_factory.mktemp("both")
    dem = write_dem(folder / "dem.tif")
    for name, rpc, displacement_px in (
        ("reference", oblique_rpc(), (0.0, 0.0)),
        ("target", make_rpc(), TRUTH_PX),
    ):
        seen = render(rpc_grid(dem, rpc), displacement_px=displacement_px)
        write_image(folder / f"{name}.tif", np.clip(np.rint(seen * 200), 1, 65535).astype(np.uint16), rpc)
    return folder


def heights(folder: Path, **more: object) -> Settings:
    return Settings(dem=folder / "dem.tif", dem_vertical=UNDULATION_M, jobs=1, **more)


@pytest.fixture(scope="module")
def registered(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[pcwlad_geo.Registration, Path]:
    out_dir = tmp_path_factory.mktemp("registered") / "out"
    found = pcwlad_geo.register(
        folder / "reference.tif",
        folder / "target.tif",
        out_dir=out_dir,
        dem=folder / "dem.tif",
        dem_vertical=UNDULATION_M,
        jobs=1,
    )
    return found, out_dir


def test_the_error_of_the_target_is_found(registered: tuple[pcwlad_geo.Registration, Path]) -> None:
    found, _ = registered
    np.testing.assert_allclose(found.model.matrix[:, 2], TRUTH_PX, rtol=0, atol=0.03)


def test_tie_points_are_in_the_pixels_of_both_images_and_on_the_ground(
    registered: tuple[pcwlad_geo.Registration, Path], folder: Path
) -> None:
    points = registered[0].tie_points.select("fit", "check")
    lon_lat = transform_xy(points.xy, CRS_OF_SCENE, WGS84)
    seen = {
        "reference": rpc_grid(folder / "dem.tif", oblique_rpc()).to_px(lon_lat),
        "target": rpc_grid(folder / "dem.tif").to_px(lon_lat),
    }
    np.testing.assert_allclose(points.reference_px, seen["reference"], rtol=0, atol=1e-3)
    np.testing.assert_allclose(points.predicted_px, seen["target"], rtol=0, atol=1e-3)
    np.testing.assert_allclose(points.target_px, seen["target"] + TRUTH_PX, rtol=0, atol=0.15)
    assert points.crs == CRS_OF_SCENE  # of the DEM, which is in metres
    # what is 1.9 px of about 30 m to the right is seen as if it lay to the east
    np.testing.assert_allclose(np.median(points.displacement_m, axis=0), [57.0, 69.0], rtol=0, atol=3.0)


def test_the_raster_lies_on_the_ground(registered: tuple[pcwlad_geo.Registration, Path]) -> None:
    found, out_dir = registered
    with rasterio.open(out_dir / "target_registered.tif") as file:
        grid, seen = Grid(file.shape, file.transform, file.crs), file.read(1) / 200.0
        valid = file.dataset_mask() != 0
    assert grid.crs == CRS_OF_SCENE
    assert grid.transform.a == pytest.approx(30.0, rel=0.05)
    valid[:4], valid[-4:], valid[:, :4], valid[:, -4:] = False, False, False, False
    right = np.abs(seen - render(grid))[valid].mean()
    assert right < 0.25 * np.abs(seen - render(grid, displacement_px=(1.0, -1.0)))[valid].mean()
    ground = ground_grid(found.reference.grid)
    corner = ground.to_px(grid.to_xy(np.zeros((1, 2)))) * ground.transform.a / grid.transform.a
    np.testing.assert_allclose(corner, np.rint(corner), rtol=0, atol=1e-6)


def test_an_output_grid_can_be_asked_for(
    registered: tuple[pcwlad_geo.Registration, Path], folder: Path, tmp_path: Path
) -> None:
    found, _ = registered
    like = make_grid((50, 60), offset_m=(900, -900))
    write(tmp_path / "like.tif", np.zeros(like.shape), like)
    (left, top), (right, bottom) = like.to_xy(np.array([[0.0, 0.0], [60.0, 50.0]])).tolist()
    for wishes, expected in (
        ({"like": tmp_path / "like.tif"}, like),
        ({"te": (left, bottom, right, top), "tr": (30.0, 30.0)}, like),
        ({"tr": (20.0, 25.0)}, None),
        ({"t_srs": "EPSG:3035"}, None),
    ):
        settings = heights(folder, **wishes)
        check_output(resolve(folder / "reference.tif", folder / "target.tif", settings))
        (grid,) = output_grids_of(replace(found, settings=settings), ())
        assert expected is None or grid == expected
        if "tr" in wishes:
            assert (grid.transform.a, -grid.transform.e) == wishes["tr"]
    for wishes, said in (
        ({"te": (0.0, 0.0, 99.0, 99.0)}, "shows nothing of the target"),
        ({"of": "VRT"}, "a VRT cannot hold the correction of an RPC"),
    ):
        with pytest.raises(pcwlad_geo.InputError, match=said):
            check_output(resolve(folder / "reference.tif", folder / "target.tif", heights(folder, **wishes)))
    with pytest.raises(pcwlad_geo.InputError, match=r"reference.tif has no georef.* or an RPC with --dem"):
        check_output(resolve(folder / "reference.tif", folder / "target.tif", Settings(tr=(30.0, 30.0))))


def test_its_siblings_lie_on_the_same_lattice(
    registered: tuple[pcwlad_geo.Registration, Path], folder: Path, tmp_path: Path
) -> None:
    pcwlad_geo.warp(registered[1], [folder / "target.tif"], out_dir=tmp_path)
    with (
        rasterio.open(tmp_path / "target_registered.tif") as ours,
        rasterio.open(registered[1] / "target_registered.tif") as first,
    ):
        assert ours.transform == first.transform
        np.testing.assert_array_equal(ours.read(), first.read())


def test_a_target_on_the_map_needs_no_rpc(folder: Path, tmp_path: Path) -> None:
    grid = make_grid((280, 290), offset_m=(150, 150))
    target = write(tmp_path / "target.tif", render(grid, displacement_px=TRUTH_PX), grid)
    found = register_pair(folder / "reference.tif", target, heights(folder))
    assert found.rpc is None
    np.testing.assert_allclose(found.model.forward(np.zeros((1, 2)))[0], TRUTH_PX, rtol=0, atol=0.05)
    assert found.tie_points.crs == CRS_OF_SCENE


def test_without_a_dem_its_rpc_does_not_count(folder: Path) -> None:
    reference, target = describe(folder / "reference.tif"), describe(folder / "target.tif")
    placed, (warning,) = place_reference(reference, target, Settings())
    assert placed is None
    assert "has an RPC, which counts for a reference with a DEM only" in warning


@pytest.mark.parametrize(
    ("lon_lat", "code"),
    [((15.5, 41.0), 32633), ((55.6, -21.2), 32740), ((-180.0, 10.0), 32601), ((10.0, 88.0), 5041)],
)
def test_utm_zones(lon_lat: tuple[float, float], code: int) -> None:
    assert utm_zone_of(np.array(lon_lat)).to_epsg() == code
