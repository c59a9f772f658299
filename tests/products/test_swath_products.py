"""Swaths of VIIRS and ECOSTRESS, on files that the tests write with the published names and arrays.

They have few of the arrays and of the attributes, small images, and scans that overlap as little as their
size allows. They cannot show the geolocation, relief, noise and chunks of delivered files.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pcwlad_geo
from pcwlad_geo.errors import InputError
from pcwlad_geo.job import match_files
from pcwlad_geo.multi.qa import run as qa_run
from pcwlad_geo.multi.stack.finished import earlier_pairs
from pcwlad_geo.multi.stack.frame import frame_of
from pcwlad_geo.multi.stack.inputs import listed, readable_images
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import find_product
from pcwlad_geo.products.unpacking import unpacked
from pcwlad_geo.raster import WGS84, Grid, describe, open_raster, transform_xy
from pcwlad_geo.registration import resolve
from tests.product_files import packed
from tests.scenes import make_grid, render, write
from tests.swaths import bent, lon_lat_of, pixels, seen_by

h5py = pytest.importorskip("h5py", reason="the tests write HDF5 with h5py")
SWATH = bent((160, 176), 32)
SHIFT_PX = np.array([1.6, -2.3])
CLOUD = (slice(60, 100), slice(50, 90))
QUICK: Any = {"template": 61, "window": 41, "features": 60}
TIME = "A2024017.1724"
VIIRS = f"VNP02IMG.{TIME}.002.2024018003923.nc"
VIIRS_GEO, VIIRS_MASK = VIIRS.replace("02", "03", 1), f"CLDMSK_L2_VIIRS_SNPP.{TIME}.001.2024018010203.nc"
SCENE = "24513_001_20221103T164413"
LST, RADIANCE, GEO, ECOSTRESS_MASK = (
    f"ECOv002_{kind}_{SCENE}_07{version}_01.h5"
    for kind, version in (("L2_LSTE", 13), ("L1B_RAD", 11), ("L1B_GEO", 11), ("L2_CLOUD", 13))
)


def write_arrays(path: Path, arrays: dict[str, tuple[np.ndarray, dict[str, Any]]]) -> Path:
    path.parent.mkdir(exist_ok=True)
    with h5py.File(path, "w") as file:
        for name, (values, attributes) in arrays.items():
            file[name] = values
            file[name].attrs.update(attributes)
    return path


def write_geolocation(path: Path, group: str, kind: str) -> None:
    arrays = zip(("longitude", "latitude"), lon_lat_of(SWATH), strict=True)
    write_arrays(path, {f"{group}/{name}": (values.astype(kind), {}) for name, values in arrays})


def deleted() -> np.ndarray:
    """Return the pixels that VIIRS does not send, at the ends of scans and the sides."""
    row, col = np.indices(SWATH.shape)
    return (np.minimum(row % 32, 31 - row % 32) < 2) & (np.abs(col - 88) > 60)


@pytest.fixture(scope="module")
def viirs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("viirs") / "a b"
    seen = np.clip(seen_by(SWATH, displacement_px=SHIFT_PX) * 200 + 2000, 0, 65527).astype("u2")
    seen[deleted()] = 65533
    scale = {
        "_FillValue": np.uint16([65535]),
        "scale_factor": np.float32([2e-5]),
        "add_offset": np.float32(0),
    }
    bands = {f"observation_data/{name}": (seen, scale) for name in ("I01", "I04")}
    flags = {"observation_data/I04_quality_flags": (np.zeros(SWATH.shape, "i2"), {})}
    write_arrays(folder / VIIRS, bands | flags)
    write_geolocation(folder / VIIRS_GEO, "geolocation_data", "f4")
    clouds = np.full(tuple(size // 2 for size in SWATH.shape), 3, "i1")
    clouds[tuple(slice(part.start // 2, part.stop // 2) for part in CLOUD)] = 1
    write_arrays(folder / VIIRS_MASK, {"geophysical_data/Integer_Cloud_Mask": (clouds, {})})
    return folder


@pytest.fixture(scope="module")
def ecostress(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ecostress")
    seen = seen_by(SWATH, displacement_px=SHIFT_PX)
    scale = {"_FillValue": np.uint16(0), "scale_factor": 0.02, "add_offset": 0.0}
    write_arrays(folder / LST, {"SDS/LST": ((seen * 10 + 13000).astype("u2"), scale), "SDS/QC": (seen, {})})
    radiance = (seen / 30 + 2).astype("f4")
    radiance[40:60, 100:110] = -9998
    write_arrays(folder / RADIANCE, {"Radiance/radiance_4": (radiance, {})})
    write_geolocation(folder / GEO, "Geolocation", "f8")
    clouds = np.zeros(SWATH.shape, "u1")
    clouds[CLOUD] = 1
    write_arrays(folder / ECOSTRESS_MASK, {"SDS/Cloud_final": (clouds, {})})
    return folder


def reference(folder: Path) -> Path:
    grid = make_grid((250, 250), offset_m=(0, -1400))
    return write(folder / "reference.tif", render(grid), grid)


def readable(paths: list[Path]) -> Any:
    """Return the images of a stack, and what is known of them."""
    return readable_images(paths, Settings(), lambda _: None)[:2]


def check_points(points: Any) -> None:
    """Check the displacement, and that no point lies in the cloud."""
    points = points[points.status != "rejected"]
    assert len(points) > 20
    moved = np.median(points.target_px - points.reference_px, axis=0)
    assert np.isfinite(moved).all()
    (rows, cols), (col, row) = CLOUD, points.target_px.T
    assert not ((col > cols.start) & (col < cols.stop) & (row > rows.start) & (row < rows.stop)).any()


def test_viirs_is_placed_and_masked(viirs: Path) -> None:
    for path, kind in ((viirs, "VIIRS L1B"), (viirs / VIIRS, "VIIRS L1B")):
        found = find_product(path)
        assert found is not None
        assert (found.kind, [band.name for band in found.bands]) == (kind, ["I01", "I04"])
    info = describe(found.band("I04").opened_as(), mask=found.mask)
    assert (info.nodata, info.mask_kind) == (65535, "Integer_Cloud_Mask")
    at = np.random.default_rng(0).uniform([10, 0], [160, 160], (200, 2))
    placed = transform_xy(info.grid.to_xy(at), info.grid.crs, SWATH.crs)
    np.testing.assert_allclose(SWATH.to_px(placed) - SWATH.to_px(SWATH.to_xy(at)), 0, atol=0.05)
    with open_raster(info.uri) as file:
        values = file.read(1)
        assert file.scales[0] == pytest.approx(2e-5)
    np.testing.assert_array_equal(values == 65535, deleted())
    with h5py.File(viirs / VIIRS) as file:
        stored = file["observation_data/I04"][()]
    np.testing.assert_array_equal(values[~deleted()], stored[~deleted()])


def test_viirs_is_registered(viirs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = pcwlad_geo.register(
        reference(tmp_path), viirs, out_dir="out", tgt_band="I01", model="shift", no_report=True, **QUICK
    )
    np.testing.assert_allclose(np.median(found.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.1)
    check_points(found.tie_points)
    report = json.loads(Path("out/report.json").read_text(encoding="utf-8"))
    names = {Path(file["path"]).name for file in report["inputs"]}
    assert {VIIRS, VIIRS_GEO, VIIRS_MASK} <= names
    for name in ("I01", "I04"):
        with open_raster(f"out/{name}_registered.tif") as file:
            assert file.nodata == 65535
            assert (file.read(1) != 65535).mean() > 0.2
    with open_raster("out/I01_lonlat.tif") as file:
        shown = transform_xy(file.read().reshape(2, -1).T, WGS84, SWATH.crs)
    assert np.median(np.abs(SWATH.to_px(shown) - SWATH.to_px(SWATH.to_xy(pixels(SWATH) - SHIFT_PX)))) < 0.1


def test_ecostress_is_matched_and_compared(ecostress: Path, tmp_path: Path) -> None:
    found = find_product(ecostress)
    assert found is not None
    assert {band.name for band in found.bands} == {"LST", "radiance_4"}
    with open_raster(found.band("radiance_4").uri) as file:
        assert (file.read(1)[40:60, 100:110] == -9999).all()
        assert (file.read(1) == -9999).sum() == 200
    out = match_files(reference(tmp_path), ecostress / LST, tgt_band="LST", out_dir=tmp_path / "out", **QUICK)
    np.testing.assert_allclose(np.median(out.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.1)
    check_points(out.tie_points)
    (pair,) = qa_run.qa([ecostress], out_dir=tmp_path / "qa", **QUICK).pairs
    assert (pair.status, pair.name) == ("measured", "radiance_4 – LST")


def test_a_stack_places_a_swath_on_a_map(ecostress: Path, tmp_path: Path) -> None:
    paths = [ecostress / LST, reference(tmp_path)]
    out = pcwlad_geo.stack(paths, out_dir=tmp_path / "stack", **QUICK | {"features": 120})
    assert (out.reference, out.pairs[0].target) == ("reference", f"{Path(LST).stem}_LST")
    with open_raster(str(tmp_path / "stack" / f"{Path(LST).stem}_LST_lonlat.tif")) as file:
        shown = transform_xy(file.read().reshape(2, -1).T, WGS84, SWATH.crs)
    inside = np.abs(pixels(SWATH)[:, 1] % 32 - 16) < 13  # what is beyond shows another scan
    away_px = SWATH.to_px(shown) - SWATH.to_px(SWATH.to_xy(pixels(SWATH) - SHIFT_PX))
    assert np.median(np.abs(away_px[inside]), axis=0).max() < 0.1
    assert not (tmp_path / "stack" / f"{Path(LST).stem}_LST_corrected.vrt").exists()
    with open_raster(str(out.images[0].registered)) as file:
        image, grid = file.read(1), describe(file.name).grid
    valid = image > 0
    assert np.corrcoef(image[valid], render(grid)[valid])[0, 1] > 0.99
    earlier = earlier_pairs(tmp_path / "stack", frame_of(*readable(paths), None, "auto"))
    assert earlier == [(0, 1)]


def test_swaths_alone_are_stacked_on_longitudes_and_latitudes(ecostress: Path) -> None:
    frame = frame_of(*readable([ecostress]), None, "auto")
    assert (type(frame.grid), frame.grid.crs) == (Grid, WGS84)
    assert frame.directed((0, 1)) == (0, 1)
    assert frame.pixel(0) == pytest.approx(1, abs=0.3)
    at = np.array([[40.0, 50.0], [120.0, 70.0]])
    np.testing.assert_allclose(frame.to_image(1, frame.from_image(0, at)), at, atol=0.01)


def test_a_folder_of_swaths_is_a_stack_with_names_and_dates(viirs: Path, tmp_path: Path) -> None:
    for path in viirs.iterdir():
        for day in ("A2024017", "A2024033"):
            (tmp_path / path.name.replace("A2024017", day)).symlink_to(path)
    images = list(listed([tmp_path], "I04"))
    later = VIIRS.replace("A2024017", "A2024033")
    assert [image.name for image in images] == [f"{Path(name).stem}_I04" for name in (VIIRS, later)]
    assert [image.date for image in images] == ["2024-01-17", "2024-02-02"]
    assert {image.describe().mask_kind for image in images} == {"Integer_Cloud_Mask"}


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        (VIIRS_GEO, rf"{VIIRS} is placed by VNP03IMG\*\.{TIME}\.\*\.nc, which is not in its folder"),
        (VIIRS, r"parts of a scene of VIIRS L1B without its images: add VNP02IMG"),
    ],
)
def test_what_is_missing_is_named(viirs: Path, missing: str, message: str, tmp_path: Path) -> None:
    for path in viirs.iterdir():
        if path.name != missing:
            (tmp_path / path.name).symlink_to(path)
    with pytest.raises(InputError, match=message):
        resolve(tmp_path, tmp_path, Settings(ref_band="I01", tgt_band="I04"))


def test_a_swath_without_its_mask_is_warned_of(ecostress: Path, tmp_path: Path) -> None:
    for name in (LST, GEO):
        (tmp_path / name).symlink_to(ecostress / name)
    notes = resolve(tmp_path, tmp_path, Settings(ref_band="LST", tgt_band="LST")).notes
    assert any(f"no quality raster (ECOv002_L2_CLOUD_{SCENE}_*.h5)" in note for note in notes)


@pytest.mark.parametrize("ending", [".zip", ".tar"])
def test_an_archive_is_unpacked_beside_the_results(ecostress: Path, tmp_path: Path, ending: str) -> None:
    for name in (LST, GEO):
        (tmp_path / "scene").mkdir(exist_ok=True)
        shutil.copy(ecostress / name, tmp_path / "scene")
    archive = packed(tmp_path / "scene", ending)
    with pytest.raises(InputError, match="unpack it"):
        find_product(archive)
    with unpacked(["other.tif", archive], tmp_path / "out", overwrite=False) as (other, folder):
        assert other == "other.tif"
        found = find_product(folder)
        assert found is not None
        assert [band.name for band in found.bands] == ["LST"]
        assert sorted(path.name for path in (tmp_path / "out_inputs" / "scene").iterdir()) == [GEO, LST]
    assert not (tmp_path / "out_inputs").exists()
