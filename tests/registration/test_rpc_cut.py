"""Parts cut from products with RPCs; ground far from the height offset below a DEM that ends near."""

from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Dem, Grid, RpcGrid, RpcModel, RpcPlacement, describe, map_px, read_rpc
from pcwlad_geo.raster.rpc.dem import Undulation
from pcwlad_geo.raster.rpc.ortho import ortho_grid
from pcwlad_geo.raster.rpc.placement import place_by_rpc
from pcwlad_geo.registration.rpc import place_target
from pcwlad_geo.registration.run import register_pair
from tests.rpc_scene import (
    SHAPE,
    UNDULATION_M,
    dem_grid,
    dem_values,
    make_rpc,
    oblique_rpc,
    of_a_product,
    write_dem,
    write_image,
)
from tests.scenes import make_grid, render, write

TRUTH_PX = np.array([-1.7, 2.2])
REFERENCE = make_grid((320, 340), offset_m=(-300, -300))
NEAR_DEM = dem_grid().part((50.0, 45.0), (90, 100))
"""6 km x 5.4 km of the 9.6 km x 9 km that the image shows."""

WIDE_DEM = dem_grid().part((-70.0, -70.0), (340, 350))
"""With the ground where lines of sight pass the height offset."""


def scene(folder: Path, rpc: RpcModel, dem: Path, grid: Grid) -> tuple[Path, Path]:
    """Write the reference, and the image of an RPC that errs by the truth."""
    reference = write(folder / "reference.tif", render(REFERENCE), REFERENCE)
    heights = Dem(str(dem), grid, 1.0, Undulation.constant(UNDULATION_M))
    seen = render(RpcGrid.of_file(SHAPE, rpc, heights), displacement_px=TRUTH_PX)
    values = np.clip(np.rint(seen * 200), 1, 65535).astype(np.uint16)
    return reference, write_image(folder / "image.tif", values, rpc)


@pytest.mark.slow
def test_a_part_cut_from_a_product_is_registered(tmp_path: Path) -> None:
    dem = write_dem(tmp_path / "dem.tif")
    pair = scene(tmp_path, of_a_product(make_rpc()), dem, dem_grid())
    found = register_pair(*pair, Settings(dem=dem, dem_vertical=UNDULATION_M, jobs=1))
    np.testing.assert_allclose(found.model.matrix[:, 2], TRUTH_PX, rtol=0, atol=0.02)
    assert found.rpc.bias_error_px < 1e-3
    assert found.warnings == ()


@pytest.fixture(scope="module")
def far_below(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Reference, image and near DEM of a scene 2000 m above the RPC's height offset."""
    folder = tmp_path_factory.mktemp("far")
    whole = write_dem(folder / "whole.tif", dem_values(WIDE_DEM), WIDE_DEM)
    pair = scene(folder, oblique_rpc(), whole, WIDE_DEM)
    return *pair, write_dem(folder / "dem.tif", dem_values(NEAR_DEM), NEAR_DEM)


def place(image: Path, dem: Path) -> RpcPlacement:
    source = read_rpc(str(image))
    assert source is not None
    return place_by_rpc(describe(image), source, str(dem), UNDULATION_M)


def test_all_ground_below_a_near_dem_is_seen(far_below: tuple[Path, Path, Path]) -> None:
    _, image, dem = far_below
    placed = place(image, dem)
    x, y = (np.linspace(0.5, side - 0.5, 40) for side in NEAR_DEM.shape[::-1])
    inside = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    seen = map_px(inside, NEAR_DEM, placed.info.grid)
    assert ((seen > 0) & (seen < SHAPE[::-1])).all()
    np.testing.assert_allclose(map_px(seen, placed.info.grid, NEAR_DEM), inside, rtol=0, atol=1e-3)
    low, high = dem_values(NEAR_DEM).min() + UNDULATION_M, dem_values(NEAR_DEM).max() + UNDULATION_M
    np.testing.assert_allclose(placed.heights_m, (low, high), rtol=0, atol=10.0)


def test_the_output_covers_all_that_dem_and_image_share(far_below: tuple[Path, Path, Path]) -> None:
    _, image, dem = far_below
    out = ortho_grid(REFERENCE, place(image, dem).info.grid)
    corners = map_px(np.array([[0.0, 0.0], [100.0, 90.0]]), NEAR_DEM, out)
    np.testing.assert_allclose(corners, [[0.0, 0.0], out.shape[::-1]], rtol=0, atol=1e-6)


def test_a_warning_says_what_is_lost_and_why(far_below: tuple[Path, Path, Path]) -> None:
    _, image, dem = far_below
    (warning,) = place(image, dem).warnings
    share = 100 * 90 * 3600 / (320 * 300 * 900)
    said = float(warning.split(" covers ")[1].split("%")[0]) / 100
    assert said == pytest.approx(share, abs=0.03)
    assert "neither matched nor warped, as its heights are not known" in warning
    assert "longitude" in warning


@pytest.mark.slow
def test_every_tie_point_has_metres(far_below: tuple[Path, Path, Path]) -> None:
    reference, image, dem = far_below
    found = register_pair(reference, image, Settings(dem=dem, dem_vertical=UNDULATION_M, jobs=1))
    assert np.isfinite(found.tie_points.displacement_m).all()
    assert np.isfinite(found.tie_points.target_px).all()
    np.testing.assert_allclose(found.model.matrix[:, 2], TRUTH_PX, rtol=0, atol=0.03)
    reached_px = np.ptp(found.tie_points.select("fit", "check").reference_px, axis=0)
    assert (reached_px > [120.0, 100.0]).all()  # of 200 x 180 px that the DEM covers


def test_a_stale_rpc_is_told_of_with_its_rival(tmp_path: Path) -> None:
    dem = write_dem(tmp_path / "dem.tif")
    reference = describe(write(tmp_path / "reference.tif", render(REFERENCE), REFERENCE))
    image = write_image(tmp_path / "image.tif", np.ones(SHAPE, np.uint8), make_rpc())
    write_image(tmp_path / "other.tif", np.ones(SHAPE, np.uint8), make_rpc(long_off=20.0), RPCTXT="YES")
    (tmp_path / "other_RPC.TXT").rename(tmp_path / "image_RPC.TXT")
    settings = Settings(dem=dem, dem_vertical=UNDULATION_M)
    with pytest.raises(InputError, match=r"do not overlap.*one of them is stale"):
        place_target(reference, describe(image), settings)


def test_trust_overrules_the_judgement(tmp_path: Path) -> None:
    reference = describe(write(tmp_path / "reference.tif", render(REFERENCE), REFERENCE))
    image = describe(write_image(tmp_path / "image.tif", np.ones((900, 320), np.uint8), make_rpc()))
    with pytest.raises(InputError, match="--trust-rpc"):
        place_target(reference, image, Settings())
    placed, _ = place_target(reference, image, Settings(trust_rpc=True))
    assert placed is not None


@pytest.mark.slow
def test_what_is_not_found_may_have_the_rpc_of_another_image(tmp_path: Path) -> None:
    dem = write_dem(tmp_path / "dem.tif")
    _, image = scene(tmp_path, make_rpc(), dem, dem_grid())
    other = write(tmp_path / "other.tif", render(REFERENCE, seed=7), REFERENCE)
    found = register_pair(
        other, image, Settings(dem=dem, dem_vertical=UNDULATION_M, prealign="georef", jobs=1)
    )
    assert found.status == "rejected"
    assert "the RPC in the tag of" in found.reason
    assert "cropped or decimated from" in found.reason
