"""A Sentinel-1 GRD product of hills: refused as it is, registered with a DEM."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.job import match_files
from pcwlad_geo.multi.qa.run import qa
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import WGS84, Grid, describe, transform_xy
from pcwlad_geo.registration.rpc import place_target
from tests.product_files import packed
from tests.radar_scene import STEM, Array, Radar
from tests.scenes import CRS_OF_SCENE, make_grid, render, write

MIDDLE_XY_M = np.array([504200.0, 4595800.0])
REFERENCE = make_grid((260, 260), offset_m=(300, 300))
SMALL = {"features": 200, "jobs": 1}


def height_m(xy: Array) -> Array:
    """Return heights of mountains, 1,600 m from the lowest to the highest."""
    east, north = ((xy - MIDDLE_XY_M) / 1000.0).T
    return np.asarray(1400 + 800 * np.sin(east / 1.1) * np.cos(north / 1.2))


def ground(lon_lat: Array) -> Array:
    return height_m(transform_xy(lon_lat, WGS84, CRS_OF_SCENE))


RADAR = Radar.over(
    *transform_xy(MIDDLE_XY_M[None], CRS_OF_SCENE, WGS84)[0].tolist(),
    (260, 260),
    30.0,
    (200, 1800, 500, 2200, 100, 1500),
)


def write_dem(path: Path) -> Path:
    grid = Grid((480, 480), make_grid(pixel_m=30.0, offset_m=(-3000, -3000)).transform, CRS_OF_SCENE)
    centres = np.stack(np.meshgrid(np.arange(480) + 0.5, np.arange(480) + 0.5), -1).reshape(-1, 2)
    return write(path, height_m(grid.to_xy(centres)).reshape(480, 480), grid, dtype="float32")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Return reference, product and DEM."""
    folder = tmp_path_factory.mktemp("relief")
    safe = RADAR.write(folder, make_grid((760, 760), pixel_m=15.0, offset_m=(-1500, -1500)), ground)
    return (
        write(folder / "reference.tif", render(REFERENCE), REFERENCE),
        safe,
        write_dem(folder / "dem.tif"),
    )


def test_it_is_refused_without_dem(files: tuple[Path, Path, Path], tmp_path: Path) -> None:
    options = {"tgt_band": "VV", "out_dir": tmp_path / "out", **SMALL}
    with pytest.raises(RegistrationRejectedError, match=r"varies by 15\d\d m in height, .*: give --dem"):
        match_files(files[0], files[1], **options)  # type: ignore[arg-type]


def test_bands_of_one_product_are_not_told_of_relief(files: tuple[Path, Path, Path]) -> None:
    reference, image = describe(files[0]), describe(files[1] / "measurement" / f"{STEM}.tiff")
    assert place_target(image, image, Settings()) == (None, ())
    assert "give --dem" in place_target(reference, image, Settings())[1][0]


def test_it_is_registered_with_dem(files: tuple[Path, Path, Path], tmp_path: Path) -> None:
    reference, safe, dem = files
    out = tmp_path / "out"
    options = {"dem": dem, "dem_vertical": 0.0, **SMALL}
    found = pcwlad_geo.register(reference, packed(safe, ".zip"), tgt_band="VV", out_dir=out, **options)  # type: ignore[arg-type]
    assert found.status == "registered"
    assert found.warnings == ()
    points = found.tie_points.select("fit", "check")
    lon_lat = transform_xy(points.xy, CRS_OF_SCENE, WGS84)
    truth = RADAR.pixels(np.column_stack([lon_lat, ground(lon_lat)]))
    np.testing.assert_allclose(points.predicted_px, truth, rtol=0, atol=0.1)
    assert np.abs(np.median(points.target_px - truth, axis=0)).max() < 0.1
    assert len(points) > 50
    assert not list(out.glob("*_rpc*"))  # an RPC alone does not place it
    with rasterio.open(out / f"{STEM}_registered.tif") as file:
        grid, values = Grid(file.shape, file.transform, file.crs), file.read(1)
    shown = values > 0
    assert 0.6 < shown.mean() < 0.9
    seen = render(grid, noise=0.0) * 20
    assert np.corrcoef(values[shown], seen[shown])[0, 1] > 0.5


def test_a_stack_and_qa_place_it_alike(files: tuple[Path, Path, Path], tmp_path: Path) -> None:
    reference, safe, dem = files
    options = {"dem": dem, "dem_vertical": 0.0, **SMALL}
    (pair,) = qa([reference, safe], out_dir=tmp_path / "qa", **options).pairs  # type: ignore[arg-type]
    assert pair.status == "measured"
    assert pair.points is not None
    lon_lat = transform_xy(pair.points.xy, CRS_OF_SCENE, WGS84)
    truth = RADAR.pixels(np.column_stack([lon_lat, ground(lon_lat)]))
    np.testing.assert_allclose(pair.points.predicted_px, truth, rtol=0, atol=0.1)
    assert np.abs(np.median(pair.points.displacement_px, axis=0)).max() < 0.1
    options["model"] = "shift"
    out = pcwlad_geo.stack([safe, reference], out_dir=tmp_path / "stack", **options)  # type: ignore[arg-type]
    assert (out.reference, out.pairs[0].status) == ("reference", "used")
    (radar,) = (image for image in out.images if image.rpc is not None)
    assert radar.rpc is not None
    assert radar.rpc.vrt is None  # an RPC alone does not place it
    at_px = np.array([[60.0, 60.0], [130.0, 200.0], [200.0, 90.0]])
    assert np.abs(radar.correction.forward(at_px) - at_px).max() < 0.15
    with rasterio.open(radar.registered) as file:
        grid, values = Grid(file.shape, file.transform, file.crs), file.read(1)
    shown = values > 0
    assert np.corrcoef(values[shown], render(grid, noise=0.0)[shown])[0, 1] > 0.5
