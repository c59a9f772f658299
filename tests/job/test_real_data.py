"""Real image pairs; skipped where they are not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import Registration, register_pair
from tests.scenes import Array, write

FEW: Any = {"features": 80}


def shift_of(found: Registration) -> Array:
    """Return the displacement that the model gives in the middle of the target, px."""
    assert found.status == "registered", found.reason
    assert found.model is not None
    middle = np.array(found.target.grid.shape[::-1])[None] / 2
    return np.asarray((found.model.forward(middle) - middle)[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "fixed", "before", "after", "known_px", "within_px"),
    [
        ("landsat_sub1", "LC08b2_sub1.tif", "LC08B10_sub1.tif", "LC08B10offset_sub1.tif", (-1.4, -1.6), 0.03),
        ("rgbnir_sub1", "0000_rgb.tiff", "0000_nir.tiff", "0000_niroffset.tiff", (8.3, 3.6), 0.02),
    ],
)
def test_difference_of_two_registrations_is_the_known_shift(
    folder: str,
    fixed: str,
    before: str,
    after: str,
    known_px: tuple[float, float],
    within_px: float,
    shared_data: Path,
) -> None:
    """The bands may be apart before: the difference before and after a known shift has no such doubt.

    With few points; benchmarks/accuracy.py has the figures with many, and kept_accuracy.py holds the first.
    """
    images = shared_data / "paper" / folder
    first, second = (
        register_pair(images / fixed, images / name, Settings(model="shift", **FEW))
        for name in (before, after)
    )
    difference = shift_of(second) - shift_of(first)
    assert np.abs(difference - known_px).max() <= within_px
    assert any("no georeferencing" in warning for warning in first.warnings)


@pytest.mark.slow
def test_uav_pair_is_found_without_its_offset(shared_data: Path) -> None:
    images = shared_data / "paper" / "uav_1"
    visible, thermal = next(images.glob("*_Z.JPG")), next(images.glob("*_T.JPG"))
    found = register_pair(visible, thermal, Settings(features=80))
    assert found.prealignment.method == "search"
    # the offset that the authors' own points have, by and large
    peers = np.loadtxt(images / "peers" / "pcwlad.pts", comments=";")
    nominal = np.median(peers[:, 2:] - peers[:, :2], axis=0)
    assert np.hypot(*(shift_of(found) - nominal)) < 3


@pytest.mark.slow
def test_parallax_of_the_uav_pair_is_kept(shared_data: Path) -> None:
    images = shared_data / "paper" / "uav_1"
    visible, thermal = next(images.glob("*_Z.JPG")), next(images.glob("*_T.JPG"))
    found, planar = (
        register_pair(visible, thermal, Settings()),
        register_pair(visible, thermal, Settings(geometry="planar")),
    )
    assert found.geometry.name == "epipolar"
    assert found.geometry.across_px is not None
    assert found.geometry.across_px < 0.3
    counts = [np.count_nonzero(each.tie_points.status != "rejected") for each in (found, planar)]
    assert counts[0] > counts[1]  # the second try brings most of them back on a plane, too
    # not the RMSE: a tall object that is kept lies pixels off any plane
    assert found.accuracy["check_px"].ce90 < planar.accuracy["check_px"].ce90 + 0.1


@pytest.fixture(scope="module")
def sensors(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Aerial, Sentinel-2 and Landsat red bands."""
    images = shared_data / "cross_sensor"
    folder = tmp_path_factory.mktemp("sensors")
    sources = {"s2": ("sentinel2_b432_byte.tif", 1), "l8": ("landsat8_byte.tif", 4)}
    result = {"aerial": images / "ngi_rgb_byte_1.tif"}
    for name, (file_name, band) in sources.items():
        with rasterio.open(images / file_name) as file:
            kept = {
                "crs": file.crs,
                "transform": file.transform,
                "nodata": file.nodata,
                "dtype": file.dtypes[0],
            }
            result[name] = write(folder / f"{name}.tif", file.read(band), None, **kept)
    return result


@pytest.mark.gate
@pytest.mark.slow
def test_landsat_and_sentinel_forward_and_backward(sensors: dict[str, Path]) -> None:
    there = register_pair(sensors["l8"], sensors["s2"], Settings(model="shift", **FEW))
    back = register_pair(sensors["s2"], sensors["l8"], Settings(model="shift", **FEW))
    m = np.array(there.px_m), np.array(back.px_m)
    sum_m = shift_of(there) * m[0] + shift_of(back) * m[1]
    assert np.abs(sum_m).max() <= 0.02 * 30
    # known for these two: (-0.03, -0.28) px of 30 m
    np.testing.assert_allclose(shift_of(there) * m[0] / 30, [-0.03, -0.28], atol=0.05)


@pytest.mark.slow
def test_closure_of_three_sensors(sensors: dict[str, Path]) -> None:
    """Over their common ground: a sign wrong, or half a pixel of any, would show."""
    low, high = [-56650.0, -3730450.0], [-53600.0, -3724520.0]

    def median_m(reference: str, target: str) -> Array:
        found = register_pair(sensors[reference], sensors[target], Settings(features=120))
        assert found.status == "registered", found.reason
        points = found.tie_points.select("fit", "check", "unused")
        common = ((points.xy > low) & (points.xy < high)).all(axis=1)
        assert common.sum() >= 20
        return np.asarray(np.median(points.displacement_m[common], axis=0))

    closure = median_m("aerial", "s2") + median_m("s2", "l8") - median_m("aerial", "l8")
    assert np.abs(closure).max() <= 2.5


@pytest.mark.slow
def test_raw_frames_of_three_lenses_close(shared_data: Path, tmp_path: Path) -> None:
    """Up to 25 px apart, rotated and bent: added displacements of the same place would miss by 0.3 px."""
    frames = [shared_data / "rig" / "rededge" / f"IMG_0001_{lens}.tif" for lens in (1, 4, 5)]
    result = pcwlad_geo.qa(frames, out_dir=tmp_path / "qa", features=200, method="gradient", jobs=1)
    (triangle,) = result.triangles
    assert triangle.cells >= 12
    assert triangle.mean_px == pytest.approx((0.0, 0.0), abs=0.05)


@pytest.fixture
def clouded_landsat(shared_data: Path) -> Path:
    """Bands of a Landsat 8 crop, more than half of it clouded; parallax moves the clouds of B10 by 12 px."""
    folder = shared_data / "real" / "landsat_clouds"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    return folder


@pytest.mark.slow
def test_a_thermal_band_follows_the_ground_below_the_clouds(clouded_landsat: Path) -> None:
    found = register_pair(clouded_landsat / "l8_B4.tif", clouded_landsat / "l8_B10.tif", Settings())
    assert np.abs(shift_of(found) - (0.06, -0.04)).max() < 0.3
    assert found.quality is not None
    assert found.quality.grade != "good"


@pytest.mark.slow
def test_the_same_bands_without_their_product_are_refused(clouded_landsat: Path, tmp_path: Path) -> None:
    for band, name in (("B4", "red"), ("B10", "thermal")):
        (tmp_path / f"{name}.tif").write_bytes((clouded_landsat / f"l8_{band}.tif").read_bytes())
    found = register_pair(tmp_path / "red.tif", tmp_path / "thermal.tif", Settings())
    assert found.status == "rejected"
    assert "2 different displacements" in str(found.reason)


def sift_places(path: Path, sift: Any) -> tuple[Array, Any]:
    """Return the map coordinates (x, y) of SIFT's features in an orthoimage, and their descriptors."""
    with rasterio.open(path) as file:
        values, seen = file.read(1).astype(float), file.dataset_mask()
        transform = file.transform
    low, high = np.percentile(values[seen > 0], (1, 99))
    grey = np.clip((values - low) / (high - low) * 255, 0, 255).astype(np.uint8)
    features, described = sift.detectAndCompute(grey, cv2.erode(seen, np.ones((15, 15), np.uint8)))
    px = np.array([each.pt for each in features]) + 0.5
    return np.column_stack(transform @ px.T), described


@pytest.mark.gate
@pytest.mark.slow
def test_orthoimages_of_a_block_over_a_coarse_dem_lie_on_each_other(
    shared_data: Path, tmp_path: Path
) -> None:
    """SIFT is the judge: before they lie (-4.0, -4.9) px apart. The DEM has pixels of 90 m, they of 0.5 m."""
    images = shared_data / "real/ventoux"
    if not images.is_dir():
        pytest.skip(f"no real images with RPCs in {images}")
    found = pcwlad_geo.stack(
        [images / "left.tif", images / "right.tif"],
        out_dir=tmp_path / "out",
        dem=images / "N44E005.hgt",
        dem_vertical=images / "egm96_15.gtx",
        jobs=1,
        no_report=True,
    )
    sift = cv2.SIFT_create(contrastThreshold=0.01)
    (left, of_left), (right, of_right) = (
        sift_places(tmp_path / f"out/{name}_registered.tif", sift) for name in ("left", "right")
    )
    pairs = cv2.BFMatcher().knnMatch(of_left, of_right, k=2)
    best = [one for one, second in pairs if one.distance < 0.8 * second.distance]
    apart_m = right[[each.trainIdx for each in best]] - left[[each.queryIdx for each in best]]
    near = apart_m[np.hypot(*apart_m.T) < 30]
    assert len(near) > 200
    assert np.hypot(*np.median(near, axis=0)) <= 0.5 * 0.5
    # what the DEM does to them is told everywhere, and no image is called good
    assert found.block is not None
    assert found.block.dem is not None
    assert set(found.block.dem.faults) <= set(found.warnings)
    assert any("scatter" in each for each in found.block.dem.faults)
    assert {each.quality.grade for each in found.images if each.quality} == {"poor"}
