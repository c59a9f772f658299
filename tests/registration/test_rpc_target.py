"""Targets with RPC from files to corrected RPC, and what cannot be used."""

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.fill import fillnodata
from rasterio.rpc import RPC

import pcwlad_geo
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Trust, View, Window, describe, read_rpc, trusting
from pcwlad_geo.raster.rpc.files import to_gdal
from pcwlad_geo.raster.rpc.planning import plan_rpc_views
from pcwlad_geo.registration.rpc import RpcParameters, check_start, place_target
from pcwlad_geo.registration.run import register_pair
from pcwlad_geo.registration.starts.alignment import Prealignment
from tests.cli.process import run_cli
from tests.rpc_scene import (
    PX_PER_M,
    SHAPE,
    UNDULATION_M,
    dem_grid,
    dem_values,
    make_rpc,
    rpc_grid,
    write_dem,
    write_image,
    write_pair,
)
from tests.scenes import make_grid, write

TRUTH_PX = np.array([2.6, -1.4])
slow = pytest.mark.slow
Pair = tuple[Path, Path, Path]
Registered = tuple[pcwlad_geo.Registration, Path]


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return write_pair(tmp_path_factory.mktemp("pair"), TRUTH_PX)


@pytest.fixture(scope="module")
def registered(pair: Pair, tmp_path_factory: pytest.TempPathFactory) -> Registered:
    reference, image, dem = pair
    out_dir = tmp_path_factory.mktemp("registered") / "out"
    options = {"dem": dem, "dem_vertical": UNDULATION_M, "jobs": 1, "features": 300}
    found = pcwlad_geo.register(reference, image, out_dir=out_dir, **options)
    return found, out_dir


def test_the_error_of_the_rpc_is_found(registered: Registered) -> None:
    found, _ = registered
    assert found.model.name == "shift"
    np.testing.assert_allclose(found.model.matrix[:, 2], TRUTH_PX, rtol=0, atol=0.01)
    points = found.tie_points.select("fit", "check")
    np.testing.assert_allclose(points.displacement_px.mean(axis=0), TRUTH_PX, rtol=0, atol=0.02)
    assert found.px_m == pytest.approx((30.0, 30.0), rel=0.02)
    assert found.warnings == ()


def test_points_are_seen_in_the_original_image(registered: Registered, pair: Pair) -> None:
    found, _ = registered
    points = found.tie_points.select("fit", "check")
    grid = rpc_grid(pair[2])
    predicted = grid.to_px(rpc_lon_lat(points.xy))
    np.testing.assert_allclose(points.predicted_px, predicted, rtol=0, atol=1e-6)
    np.testing.assert_allclose(points.target_px, predicted + TRUTH_PX, rtol=0, atol=0.1)


def rpc_lon_lat(xy: np.ndarray) -> np.ndarray:
    from pcwlad_geo.raster import WGS84, transform_xy
    from tests.scenes import CRS_OF_SCENE

    return transform_xy(xy, CRS_OF_SCENE, WGS84)


def test_what_is_written(registered: Registered) -> None:
    found, out_dir = registered
    names = {file.name for file in out_dir.iterdir()}
    assert {"image_rpc.vrt", "image_rpc_RPC.TXT", "image_registered.tif", "image_gcps.vrt"} <= names
    assert "image_corrected.vrt" not in names
    with rasterio.open(out_dir / "image_rpc.vrt") as file:
        assert file.rpcs.samp_off == pytest.approx(make_rpc().samp_off + found.model.matrix[0, 2])
        assert file.shape == SHAPE
    with trusting(Trust(vrt=True)):
        source = read_rpc(str(out_dir / "image_rpc.vrt"))
    assert source is not None
    assert source.rpc == found.rpc.corrected_grid.rpc
    assert source.warnings == ()
    report = json.loads((out_dir / "report.json").read_text())
    assert report["rpc"]["fold_error_px"] < 1e-3
    assert report["rpc"]["undulation_m"] == UNDULATION_M
    assert report["rpc"]["corrected"]["line_off"] == source.rpc.line_off
    assert report["target"]["georeferenced"] is False
    page = (out_dir / "report.html").read_text()
    assert "the tag of" in page
    assert "45.0 m up to the ellipsoid; error of the corrected coefficients" in page
    lines = (out_dir / "image.tif.points").read_text().splitlines()
    source_xy = np.array(lines[2].split(",")[2:4], float)
    assert (np.abs(source_xy) <= SHAPE[1]).all()  # pixels, not degrees


SLOWLY_READ = ("image.tif.points", "image.pts", "image_gcps.vrt", "image.gcp")


@pytest.mark.parametrize(
    "name",
    [
        "tiepoints.csv",
        *(pytest.param(n, marks=slow) for n in SLOWLY_READ),
    ],
)
def test_its_own_tie_points_give_the_same_rpc(
    registered: Registered, pair: Pair, tmp_path: Path, name: str
) -> None:
    found, out_dir = registered
    options = {"dem": pair[2], "dem_vertical": UNDULATION_M, "write_sigma": True}
    again = pcwlad_geo.register(
        *pair[:2], out_dir=tmp_path / "again", tie_points=out_dir / name, model="shift", **options
    )
    corrected = again.rpc.corrected_grid.rpc
    expected = found.rpc.corrected_grid.rpc
    assert corrected.samp_off == pytest.approx(expected.samp_off, abs=0.02)
    assert corrected.line_off == pytest.approx(expected.line_off, abs=0.02)
    with (
        rasterio.open(tmp_path / "again" / "image_sigma.tif") as sigma,
        rasterio.open(tmp_path / "again" / "image_registered.tif") as warped,
    ):
        assert sigma.crs == warped.crs
        assert sigma.bounds == pytest.approx(warped.bounds)
        values = sigma.read([1, 2])
    assert (values[np.isfinite(values)] < 0.1).all()
    assert np.isfinite(values).mean() > 0.9


def test_dem_and_geoid_are_files_that_a_job_reads(pair: Pair) -> None:
    assert Settings(dem=pair[2], dem_vertical="/vsizip/egm.zip/egm.tif").files == (
        pair[2],
        "/vsizip/egm.zip/egm.tif",
    )
    assert Settings(dem=pair[2], dem_vertical=45.0).files == (pair[2],)


@pytest.mark.slow
def test_a_second_registration_finds_nothing(registered: Registered, pair: Pair) -> None:
    _, out_dir = registered
    settings = Settings(dem=pair[2], dem_vertical=UNDULATION_M, jobs=1, trust_vrt=True)
    with trusting(settings.trust):
        again = register_pair(pair[0], out_dir / "image_rpc.vrt", settings)
    assert np.hypot(*again.tie_points.select("fit", "check").displacement_px.mean(axis=0)) < 0.02


def test_the_orthorectified_raster_lies_on_the_reference(registered: Registered, pair: Pair) -> None:
    _, out_dir = registered
    again = register_pair(pair[0], out_dir / "image_registered.tif", Settings(jobs=1))
    assert np.hypot(*again.tie_points.select("fit", "check").displacement_px.mean(axis=0)) < 0.03


@pytest.mark.skipif(shutil.which("gdalwarp") is None, reason="no gdalwarp")
def test_gdalwarp_makes_the_same_of_the_corrected_rpc(
    registered: Registered, pair: Pair, tmp_path: Path
) -> None:
    _, out_dir = registered
    ellipsoidal = write_dem(tmp_path / "ellipsoidal.tif", dem_values(dem_grid()) + UNDULATION_M)
    with rasterio.open(out_dir / "image_registered.tif") as file:
        ours, valid, bounds, crs = file.read(1), file.dataset_mask() != 0, file.bounds, file.crs
    extent = ["-te", *map(repr, bounds), "-ts", str(ours.shape[1]), str(ours.shape[0])]
    options = [
        "-q",
        "-rpc",
        "-to",
        f"RPC_DEM={ellipsoidal}",
        "-et",
        "0",
        "-r",
        "lanczos",
        "-t_srs",
        crs.to_string(),
    ]
    theirs = tmp_path / "theirs.tif"
    subprocess.run(["gdalwarp", *options, *extent, out_dir / "image_rpc.vrt", theirs], check=True)
    with rasterio.open(theirs) as file:
        difference = np.abs(file.read(1)[valid].astype(float) - ours[valid])
    assert difference.mean() < 1e-3 * ours.std()


@pytest.mark.slow
def test_a_wrong_datum_moves_the_shift_by_what_its_height_means(registered: Registered, pair: Pair) -> None:
    found, _ = registered
    without = register_pair(pair[0], pair[1], Settings(dem=pair[2], dem_vertical=0.0, jobs=1, features=300))
    moved = found.model.matrix[:, 2] - without.model.matrix[:, 2]
    np.testing.assert_allclose(moved, -UNDULATION_M * PX_PER_M, rtol=0, atol=0.05)


def test_without_a_dem_a_warning_says_what_relief_costs(pair: Pair) -> None:
    reference, image = describe(pair[0]), describe(pair[1])
    placed, warnings = place_target(reference, image, Settings())
    assert placed is not None
    (warning,) = warnings
    assert "400 m above the ellipsoid" in warning
    assert "100 m of relief displaces the image by 2.15 px" in warning


@pytest.mark.slow
def test_an_affine_error_is_folded_too(pair: Pair, tmp_path: Path) -> None:
    from tests.scenes import render

    linear = np.array([[1.0, 6e-3], [-4e-3, 1.002]])
    seen = render(rpc_grid(pair[2]), displacement_px=(1.0, -0.5), linear=linear)
    values = np.clip(np.rint(seen * 200), 1, 65535).astype(np.uint16)
    image = write_image(tmp_path / "image.tif", values, make_rpc())
    found = register_pair(pair[0], image, Settings(dem=pair[2], dem_vertical=UNDULATION_M, jobs=1))
    assert found.model.name == "affine"
    assert found.rpc.bias_error_px < 1e-3
    corners = np.array([[0.0, 0.0], [320.0, 0.0], [320.0, 300.0], [0.0, 300.0]])
    expected = corners @ linear.T + (1.0, -0.5)
    np.testing.assert_allclose(found.model.forward(corners), expected, rtol=0, atol=0.05)


def test_a_target_with_both_needs_to_be_told(pair: Pair, tmp_path: Path) -> None:
    grid = make_grid(SHAPE)
    path = write(tmp_path / "both.tif", np.ones(SHAPE, np.uint8), grid, dtype="uint8", rpcs=rpcs())
    reference, target = describe(pair[0]), describe(path)
    placed, warnings = place_target(reference, target, Settings())
    assert placed is None
    assert "the RPC is not used; give --dem" in warnings[0]
    placed, _ = place_target(reference, target, Settings(model="rpc"))
    assert placed is not None


def test_a_broken_rpc_beside_a_geotransform_is_no_matter(pair: Pair, tmp_path: Path) -> None:
    path = write(tmp_path / "plain.tif", np.ones(SHAPE, np.uint8), make_grid(SHAPE), dtype="uint8")
    (tmp_path / "plain_RPC.TXT").write_text("LINE_OFF: none")
    assert place_target(describe(pair[0]), describe(path), Settings()) == (None, ())
    with pytest.raises(InputError, match="lacks"):
        place_target(describe(pair[0]), describe(path), Settings(model="rpc"))


def test_masks_are_in_the_sensors_geometry(pair: Pair, tmp_path: Path) -> None:
    mask = np.ones(SHAPE, np.uint8)
    mask[:100] = 0
    plain = write(tmp_path / "plain.tif", mask, None, dtype="uint8")
    placed, _ = place_target(describe(pair[0]), describe(pair[1], mask=plain), Settings())
    assert placed is not None
    view = View(placed.info, make_grid((320, 340), offset_m=(-300, -300)), "cubic")
    patch = view.read(Window.whole((320, 340)))
    rows = view.to_file_px(np.array([[170.5, 60.5], [170.5, 250.5]]))[:, 1]
    assert rows[0] < 100 < rows[1]
    assert patch.valid[60, 170] == (rows[0] > 100)
    assert patch.valid[250, 170]
    on_ground = write(tmp_path / "ground.tif", mask, make_grid(SHAPE), dtype="uint8")
    with pytest.raises(InputError, match="mask of the target's own pixels"):
        place_target(describe(pair[0]), describe(pair[1], mask=on_ground), Settings())


@pytest.mark.parametrize("reference_m", [12.0, 30.0, 75.0])
def test_the_target_is_matched_at_the_coarser_pixel_size(
    pair: Pair, tmp_path: Path, reference_m: float
) -> None:
    grid = make_grid((int(9000 / reference_m), int(9300 / reference_m)), pixel_m=reference_m)
    reference = describe(
        write(tmp_path / "reference.tif", np.ones(grid.shape, np.uint8), grid, dtype="uint8")
    )
    placed, _ = place_target(reference, describe(pair[1]), Settings(dem=pair[2], dem_vertical=UNDULATION_M))
    assert placed is not None
    views = plan_rpc_views(reference, placed.info)
    size_m = views.reference.grid.transform.a
    assert size_m == pytest.approx(max(reference_m, 30.0), rel=0.02)
    assert views.target.grid.transform.a == size_m
    at = np.array([[40.25, 55.75]])
    ground = views.reference.grid.to_xy(at)
    np.testing.assert_allclose(views.target.grid.to_xy(at + views.offset_px), ground, rtol=0, atol=1e-6)


def rpcs(**changes: float) -> RPC:
    return RPC.from_gdal(to_gdal(make_rpc(**changes)))


def holed() -> np.ndarray:
    values = dem_values(dem_grid())
    values[95:98, 100:104] = np.nan
    return values


def flat(value: float) -> np.ndarray:
    return np.full(dem_grid().shape, value)


def far_dem() -> object:
    return replace(dem_grid(), transform=make_grid(offset_m=(90_000, 0)).transform)


BAD = {
    "DEM elsewhere": (lambda p: write_dem(p, grid=far_dem()), "do not overlap"),
    "DEM with holes": (lambda p: write_dem(p, holed()), "has holes below .*: 12 of its pixels"),
    "DEM in no unit": (lambda p: write_dem(p, flat(32767.0)), "check its unit"),
    "no DEM": (lambda p: p.with_name("absent.tif"), "does not exist"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_dem_that_does_not_fit_is_an_error(pair: Pair, tmp_path: Path, name: str) -> None:
    make, message = BAD[name]
    settings = Settings(dem=make(tmp_path / "dem.tif"), dem_vertical=0.0)
    with pytest.raises(InputError, match=message):
        place_target(describe(pair[0]), describe(pair[1]), settings)


def test_holes_of_nan_are_filled_as_the_message_says(pair: Pair, tmp_path: Path) -> None:
    values = holed().astype("float32")
    dem = write(tmp_path / "dem.tif", values, dem_grid(), dtype="float32")
    settings = Settings(dem=dem, dem_vertical=0.0)
    with rasterio.open(dem, "r+") as file:
        assert file.nodata is None
        assert np.isnan(fillnodata(file.read(1), file.read_masks(1))).any()  # nothing is done
        with pytest.raises(InputError, match=r"no nodata value, gdal_edit\.py -a_nodata nan DEM before it"):
            place_target(describe(pair[0]), describe(pair[1]), settings)
        file.nodata = np.nan
    with rasterio.open(dem, "r+") as file:
        file.write(fillnodata(file.read(1), file.read_masks(1)), 1)
    placed, _ = place_target(describe(pair[0]), describe(pair[1]), settings)
    assert placed is not None


def test_holes_beside_the_image_are_no_matter(pair: Pair, tmp_path: Path) -> None:
    values = dem_values(dem_grid())
    values[:10, :10] = np.nan
    settings = Settings(dem=write_dem(tmp_path / "dem.tif", values), dem_vertical=0.0)
    placed, warnings = place_target(describe(pair[0]), describe(pair[1]), settings)
    assert placed is not None
    assert warnings == ()


def test_a_dem_of_a_part_is_told(pair: Pair, tmp_path: Path) -> None:
    whole = dem_grid()
    part = whole.part((0.0, 0.0), (200, 120))
    settings = Settings(dem=write_dem(tmp_path / "dem.tif", dem_values(part), part), dem_vertical=0.0)
    placed, warnings = place_target(describe(pair[0]), describe(pair[1]), settings)
    assert placed is not None
    assert "% of" in warnings[0]
    assert "neither matched nor warped" in warnings[0]


def test_a_dem_for_a_target_without_rpc_is_an_error(pair: Pair) -> None:
    reference = describe(pair[0])
    with pytest.raises(InputError, match="has no RPC"):
        place_target(reference, reference, Settings(dem=pair[2], dem_vertical=0.0))


def test_a_reference_without_georeferencing_is_an_error_with_a_dem(pair: Pair) -> None:
    image = describe(pair[1])
    with pytest.raises(InputError, match="needs a reference that has"):
        place_target(image, image, Settings(dem=pair[2], dem_vertical=0.0))
    assert place_target(image, image, Settings()) == (None, ())


def test_options_that_make_no_sense_are_errors(pair: Pair) -> None:
    reference, image = describe(pair[0]), describe(pair[1])
    with pytest.raises(SettingsError, match="no grid on the ground"):
        place_target(reference, image, Settings(grid="target"))
    with pytest.raises(SettingsError, match="without a DEM"):
        Settings(dem_vertical=3.0)
    with pytest.raises(SettingsError, match="metres from -500 to 500"):
        Settings(dem=pair[2], dem_vertical=float("nan"))


def test_the_rpc_of_another_place_is_an_error(pair: Pair, tmp_path: Path) -> None:
    image = write_image(tmp_path / "image.tif", np.ones(SHAPE, np.uint8), make_rpc(long_off=20.0))
    with pytest.raises(InputError, match=r"do not overlap.*the RPC that belongs to the target"):
        register_pair(pair[0], image, Settings(jobs=1))


def test_the_rpc_of_an_image_that_was_cropped_is_an_error(pair: Pair) -> None:
    reference, image = describe(pair[0]), describe(pair[1])
    settings = Settings(dem=pair[2], dem_vertical=0.0)
    placed, _ = place_target(reference, image, settings)
    assert placed is not None
    px = RpcParameters().most_bias_m / 30.0
    for shift, good in (((0.9 * px, 0.0), True), ((0.8 * px, 0.8 * px), False)):
        start = Prealignment("search", shift, 8)
        if good:
            check_start(placed, start, reference.grid, settings)
            continue
        with pytest.raises(InputError, match="the one that this was cropped from"):
            check_start(placed, start, reference.grid, settings)
        check_start(placed, start, reference.grid, replace(settings, prealign="search"))


@pytest.mark.parametrize("case", ["missing datum", "holes", pytest.param("cropped", marks=pytest.mark.slow)])
def test_bad_input_ends_with_status_2_and_nothing_written(pair: Pair, tmp_path: Path, case: str) -> None:
    reference, image, dem = pair
    options = ["--dem-vertical", str(UNDULATION_M)]
    if case == "missing datum":
        options = []
    if case == "holes":
        dem = write_dem(tmp_path / "holed.tif", holed())
    if case == "cropped":
        with rasterio.open(image) as file:
            values = file.read()[:, 60:, 80:]
        image = write_image(tmp_path / "cropped.tif", values, make_rpc())
    out_dir = tmp_path / "out"
    arguments = ["register", reference, image, "--dem", dem, *options, "-o", out_dir, "--jobs", "1"]
    ended = run_cli(tmp_path, arguments)
    assert ended.returncode == 2, ended.stderr
    expected = {"missing datum": "--dem-vertical", "holes": "has holes", "cropped": "cropped from"}[case]
    assert expected in ended.stderr.splitlines()[-1]
    assert not out_dir.exists()
    assert not list(tmp_path.glob(".out*"))
