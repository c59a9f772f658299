"""Warped rasters against an analytic scene, displaced by a known amount."""

from __future__ import annotations

import logging
import subprocess
import sys
import textwrap
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, MaskFlags

from pcwlad_geo.correction.models import AffineCorrection, Correction, ProjectiveCorrection
from pcwlad_geo.correction.splines import SplineCorrection, SplineGrid
from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.gdal import raising_gdal_reports
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.output_grid import GridRequest, output_grid
from pcwlad_geo.raster.vrt import compose
from pcwlad_geo.raster.warping import WARPING, warp

UTM33, UTM32 = CRS.from_epsg(32633), CRS.from_epsg(32632)
ORIGIN = Affine(30.0, 0.0, 500_010.0, 0.0, -30.0, 4_900_020.0)
WAVELENGTH_PX = 16.0


def scene(px: np.ndarray) -> np.ndarray:
    """Two channels in quadrature per axis: the phase of a sample is its position."""
    angle = 2 * np.pi * px / WAVELENGTH_PX
    return np.concatenate([np.cos(angle), np.sin(angle)], axis=-1)


def pixel_centres(shape: tuple[int, int]) -> np.ndarray:
    rows, cols = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.stack([cols, rows], axis=-1).reshape(-1, 2)


def position_error_px(bands: np.ndarray, expected_px: np.ndarray) -> np.ndarray:
    """Difference of positions read from the phases of the four bands, modulo the wavelength."""
    values = bands.reshape(4, -1).T
    phase = np.arctan2(values[:, 2:], values[:, :2]) * WAVELENGTH_PX / (2 * np.pi)
    return (phase - expected_px + WAVELENGTH_PX / 2) % WAVELENGTH_PX - WAVELENGTH_PX / 2


def write(path: Path, bands: np.ndarray, grid: Grid | None = None, **profile: object) -> Path:
    bands = bands if bands.ndim == 3 else bands[None]
    place = {"transform": grid.transform, "crs": grid.crs} if grid else {}
    profile = {"count": len(bands), "dtype": bands.dtype.name, **place, **profile}
    with rasterio.open(
        path, "w", driver="GTiff", height=bands.shape[1], width=bands.shape[2], **profile
    ) as dataset:
        dataset.write(bands)
    return path


def observed_scene(grid: Grid, correction: Correction) -> np.ndarray:
    """What the sensor sees: the pixel observed at p shows the scene at the predicted position."""
    predicted_px = correction.inverse(pixel_centres(grid.shape))
    return scene(predicted_px).T.reshape(4, *grid.shape).astype(np.float32)


def shift(d_col: float, d_row: float) -> AffineCorrection:
    return AffineCorrection("shift", np.array([[1.0, 0.0, d_col], [0.0, 1.0, d_row]]))


AFFINE = AffineCorrection("affine", np.array([[1.0004, 0.0007, -1.63], [-0.0006, 0.9997, 2.41]]))
GRID = Grid((300, 320), ORIGIN, UTM33)


SPLINE = SplineCorrection(
    "tps",
    SplineGrid((-10.0, -5.0), 85.0, (4, 4)),
    np.random.default_rng(5).uniform([-1.0, -4.0], [5.0, 2.0], (7, 7, 2)),
)
PROJECTIVE = ProjectiveCorrection(
    "projective", np.array([[1.002, 0.001, 0.4], [-0.003, 0.999, -1.2], [8e-6, -6e-6, 1.0]])
)
CORRECTIONS = {"shift": shift(0.31, -0.44), "affine": AFFINE, "projective": PROJECTIVE, "tps": SPLINE}


@pytest.mark.parametrize("correction", CORRECTIONS.values(), ids=CORRECTIONS)
def test_a_displaced_scene_comes_back_to_its_place(tmp_path: Path, correction: Correction) -> None:
    source = write(tmp_path / "a.tif", observed_scene(GRID, correction), GRID)
    warp(source, tmp_path / "out.tif", correction, GRID, "cubic")
    with rasterio.open(tmp_path / "out.tif") as out:
        bands = out.read()
        assert (out.shape, out.transform, out.crs) == (GRID.shape, GRID.transform, GRID.crs)
    error = position_error_px(bands, pixel_centres(GRID.shape)).reshape(*GRID.shape, 2)
    inner = error[8:-8, 8:-8]
    assert np.abs(inner).max() < 0.02
    assert np.abs(inner.mean(axis=(0, 1))).max() < 0.003


@pytest.mark.skipif(sys.platform != "linux", reason="a folder where root cannot write either: /proc")
def test_the_working_folder_need_not_be_writable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """GDAL puts temporary files there; a container's is often read-only."""
    source = write(tmp_path / "a.tif", observed_scene(GRID, SPLINE), GRID)
    for name in ("CPL_TMPDIR", "TMPDIR", "TEMP"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir("/proc/self")
    warp(source, tmp_path / "out.tif", SPLINE, GRID, "cubic")
    with rasterio.open(tmp_path / "out.tif") as out:
        error_px = position_error_px(out.read(), pixel_centres(GRID.shape)).reshape(*GRID.shape, 2)
    assert np.abs(error_px[8:-8, 8:-8]).max() < 0.02
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.tif", "out.tif"]


@pytest.mark.parametrize("correction", [shift(0.27, 0.61), SPLINE], ids=["shift", "tps"])
def test_across_crs_and_pixel_sizes_the_ground_stays_in_place(tmp_path: Path, correction: Correction) -> None:
    reference = Grid((200, 210), Affine(30.0, 0.0, 300_000.0, 0.0, -30.0, 4_905_000.0), UTM32)
    x, y = transform_xy(np.array([[302_000.0, 4_903_000.0]]), UTM32, UTM33)[0]
    target = Grid((240, 250), Affine(10.0, 0.0, round(x), 0.0, -10.0, round(y)), UTM33)
    source = write(tmp_path / "a.tif", observed_scene(target, correction), target)
    grid = output_grid(reference, target, correction)
    warp(source, tmp_path / "out.tif", correction, grid, "cubic")

    assert grid.crs == UTM32
    assert (grid.transform.a, grid.transform.e) == pytest.approx((10.0, -10.0), abs=1e-9)
    offset = reference.to_px(np.array([[grid.transform.c, grid.transform.f]]))[0] * 3
    assert offset == pytest.approx(np.round(offset), abs=1e-6)
    truth_px = target.to_px(transform_xy(grid.to_xy(pixel_centres(grid.shape)), UTM32, UTM33))
    observed_px = correction.forward(truth_px)
    inner = ((observed_px > 4) & (observed_px < np.array([246, 236]))).all(axis=1)
    with rasterio.open(tmp_path / "out.tif") as out:
        bands = out.read()
    assert inner.sum() > 50_000
    assert np.abs(position_error_px(bands, truth_px)[inner]).max() < 0.02
    outside = ((observed_px < -0.02) | (observed_px > np.array([250.02, 240.02]))).any(axis=1)
    assert outside.sum() > 100
    assert np.isnan(bands[0].ravel()[outside]).all()


def test_blocks_leave_no_seams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reference = Grid((400, 400), Affine(30.0, 2.0, 300_000.0, 2.0, -30.0, 4_905_000.0), UTM32)
    x, y = transform_xy(np.array([[302_000.0, 4_903_000.0]]), UTM32, UTM33)[0]
    target = Grid((300, 310), Affine(20.0, 0.0, x, 0.0, -20.0, y), UTM33)
    source = write(tmp_path / "a.tif", observed_scene(target, AFFINE), target)
    coarse = output_grid(reference, Grid((150, 155), Affine(40.0, 0, x, 0, -40.0, y), UTM33), AFFINE)
    a, b = warped_in_blocks(monkeypatch, source, AFFINE, coarse)
    assert np.array_equal(np.isnan(a), np.isnan(b))
    assert np.nanmax(np.abs(a - b)) < 2 * np.pi * 0.001 / WAVELENGTH_PX * 1.5


def test_blocks_of_a_lattice_leave_no_seams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write(tmp_path / "a.tif", observed_scene(GRID, SPLINE), GRID)
    a, b = warped_in_blocks(monkeypatch, source, SPLINE, output_grid(GRID, GRID, SPLINE))
    assert np.array_equal(np.isnan(a), np.isnan(b))
    assert np.nanmax(np.abs(a - b)) < 2 * np.pi * 0.001 / WAVELENGTH_PX * 1.5


def test_an_affine_through_a_lattice_is_the_affine(tmp_path: Path) -> None:
    """The same pixels, and the same ones missing, by GDAL's own formula and by our lattice."""
    matrix = np.vstack([AFFINE.matrix, [0.0, 0.0, 1.0]])
    values = np.random.default_rng(1).integers(1, 255, GRID.shape).astype(np.uint8)
    values[100:140, 50:90] = 0
    source = write(tmp_path / "a.tif", values, GRID, nodata=0)
    grid = output_grid(GRID, GRID, AFFINE)
    images = []
    for correction in (AFFINE, ProjectiveCorrection("projective", matrix)):
        warp(source, tmp_path / "out.tif", correction, grid)
        with rasterio.open(tmp_path / "out.tif") as out:
            images.append(out.read(1).astype(int))
    assert (images[0] == 0).sum() > 1600
    assert ((images[0] == 0) != (images[1] == 0)).mean() < 1e-4
    assert np.abs(images[0] - images[1])[(images[0] > 0) & (images[1] > 0)].max() <= 1


def test_pixels_that_the_correction_has_no_place_for_are_nodata(tmp_path: Path) -> None:
    horizon = ProjectiveCorrection("projective", np.array([[1.0, 0, 0], [0, 1.0, 0], [-1 / 200, 0, 1.0]]))
    source = write(tmp_path / "a.tif", np.full(GRID.shape, 7, np.uint8), GRID, nodata=0)
    warp(source, tmp_path / "out.tif", horizon, GRID)
    with rasterio.open(tmp_path / "out.tif") as out:
        values = out.read(1)
    inside = horizon.forward(pixel_centres(GRID.shape))
    seen = ((inside > 1) & (inside < np.array([319, 299]))).all(axis=1).reshape(GRID.shape)
    assert (values[seen] == 7).all()
    assert not values[:, 200:].any()


def test_an_image_of_few_rows_is_warped_too(tmp_path: Path) -> None:
    grid = Grid((3, 320), ORIGIN, UTM33)
    source = write(tmp_path / "a.tif", np.full(grid.shape, 7, np.uint8), grid, nodata=0)
    warp(source, tmp_path / "out.tif", ProjectiveCorrection("projective", np.eye(3)), grid)
    with rasterio.open(tmp_path / "out.tif") as out:
        assert (out.read(1) == 7).all()


@pytest.mark.parametrize("turned", [False, True], ids=["same axes", "rotated"])
@pytest.mark.parametrize("dtype", ["uint16", "float32"])
def test_within_one_crs_blocks_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dtype: str, turned: bool
) -> None:
    noise = np.random.default_rng(1).integers(1, 60000, GRID.shape).astype(dtype)
    source = write(tmp_path / "a.tif", noise, GRID, nodata=0)
    reference = Grid((200, 200), compose(ORIGIN, Affine.rotation(30)), UTM33) if turned else GRID
    a, b = warped_in_blocks(monkeypatch, source, AFFINE, output_grid(reference, GRID, AFFINE))
    assert (a != 0).sum() > 90_000
    # a block's pixels count from its own corner: that changes the last bit of a float at times
    np.testing.assert_allclose(a, b, rtol=0 if dtype == "uint16" else 2e-7, atol=0)


def warped_in_blocks(
    monkeypatch: pytest.MonkeyPatch, source: Path, correction: Correction, grid: Grid
) -> tuple[np.ndarray, np.ndarray]:
    """The raster warped in one block, and in blocks of 100 px."""
    images = []
    for block in (1024, 100):
        monkeypatch.setattr("pcwlad_geo.raster.warping.WARPING", replace(WARPING, block_px=block))
        warp(source, source.with_name(f"{block}.tif"), correction, grid)
        with rasterio.open(source.with_name(f"{block}.tif")) as out:
            images.append(out.read())
    return images[0], images[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "correction",
    ['AffineCorrection("shift", np.eye(2, 3))', 'ProjectiveCorrection("projective", np.eye(3))'],
    ids=["formula", "lattice"],
)
def test_memory_does_not_grow_with_the_raster(tmp_path: Path, correction: str) -> None:
    side, bands = 2560, 12
    with rasterio.open(
        tmp_path / "a.tif",
        "w",
        driver="GTiff",
        height=side,
        width=side,
        count=bands,
        dtype="float64",
        transform=ORIGIN,
        crs=UTM33,
        tiled=True,
        interleave="band",
        SPARSE_OK=True,
        nodata=-1.0,
    ):
        pass
    script = textwrap.dedent(f"""
        import resource, numpy as np
        from pathlib import Path
        from pcwlad_geo.correction.models import AffineCorrection, ProjectiveCorrection
        from pcwlad_geo.raster.source import describe
        from pcwlad_geo.raster.warping import WARPING, warp
        def peak_mb():
            return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
        before = peak_mb()
        source = {str(tmp_path / "a.tif")!r}
        correction = {correction}
        warp(source, Path({str(tmp_path / "out.tif")!r}), correction, describe(source).grid, "nearest")
        print(peak_mb() - before)
    """)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 0.35 * side * side * bands * 8 / 1e6


def test_a_coarser_output_averages_instead_of_aliasing(tmp_path: Path) -> None:
    checkers = (np.indices((120, 120)).sum(axis=0) % 2 * 1000.0).astype(np.float32)
    fine = Grid((120, 120), Affine(10.0, 0, 0, 0, -10.0, 0), UTM33)
    source = write(tmp_path / "a.tif", checkers, fine)
    warp(source, tmp_path / "out.tif", shift(0, 0), Grid((40, 40), Affine(30.0, 0, 0, 0, -30.0, 0), UTM33))
    with rasterio.open(tmp_path / "out.tif") as out:
        assert np.abs(out.read(1)[4:-4, 4:-4] - 500).max() < 60


@pytest.mark.parametrize(
    "turn",
    [
        Affine(1, 0, 0, 0, -1, 300),
        compose(Affine.translation(150, 10), Affine.rotation(37)),
        Affine(0, 1, 0, 1, 0, 0),
    ],
    ids=["south-up", "rotated", "transposed"],
)
def test_targets_that_are_not_north_up(tmp_path: Path, turn: Affine) -> None:
    target = Grid((300, 320), compose(ORIGIN, turn), UTM33)
    source = write(tmp_path / "a.tif", observed_scene(target, AFFINE), target)
    grid = output_grid(GRID, target, AFFINE)
    warp(source, tmp_path / "out.tif", AFFINE, grid)
    truth_px = target.to_px(grid.to_xy(pixel_centres(grid.shape)))
    observed_px = AFFINE.forward(truth_px)
    inner = ((observed_px > 4) & (observed_px < np.array([316, 296]))).all(axis=1)
    with rasterio.open(tmp_path / "out.tif") as out:
        assert (out.transform.a, out.transform.b, out.transform.e) == pytest.approx((30, 0, -30), abs=1e-6)
        error = position_error_px(out.read(), truth_px)[inner]
    assert inner.sum() > 80_000
    assert np.abs(error).max() < 0.02


@pytest.mark.parametrize("nodata", [None, 0])
@pytest.mark.parametrize(
    "dtype", ["int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"]
)
def test_every_data_type_is_kept(tmp_path: Path, dtype: str, nodata: int | None) -> None:
    limit = np.iinfo(dtype).max if np.dtype(dtype).kind in "iu" else 1e30
    image = np.full(GRID.shape, limit, dtype)
    image[:, :100] = 1
    source = write(tmp_path / "a.tif", image, GRID, nodata=nodata)
    warp(source, tmp_path / "out.tif", shift(0.5, 0.0), GRID)
    with rasterio.open(tmp_path / "out.tif") as out:
        assert out.dtypes == (dtype,)
        values, valid = out.read(1), out.read_masks(1) > 0
    assert valid[:, :-1].all()
    assert (values[:, :90] == 1).all()
    assert values[:, 110:-1] == pytest.approx(limit, rel=1e-6 if np.dtype(dtype).kind == "f" else 0)


def test_nodata_edges_neither_bleed_nor_grow(tmp_path: Path) -> None:
    image = np.full(GRID.shape, 1000, np.uint16)
    image[:90, :70] = 0
    source = write(tmp_path / "a.tif", image, GRID, nodata=0)
    correction = shift(0.31, -0.44)
    warp(source, tmp_path / "out.tif", correction, GRID)
    with rasterio.open(tmp_path / "out.tif") as out:
        result = out.read(1)
        assert out.nodata == 0
    observed = np.floor(correction.forward(pixel_centres(GRID.shape))).astype(int).reshape(*GRID.shape, 2)
    inside = (observed >= 0).all(axis=2) & (observed[..., 0] < 320) & (observed[..., 1] < 300)
    valid = inside & ~((observed[..., 1] < 90) & (observed[..., 0] < 70))
    assert np.array_equal(result, np.where(valid, 1000, 0))


@pytest.mark.parametrize(("options", "least_px", "most_px"), [((), 0.0, 0.01), (("cubic",), 0.04, 0.05)])
def test_fine_detail_stays_in_its_place(
    tmp_path: Path, options: tuple[str, ...], least_px: float, most_px: float
) -> None:
    """A wave of 4 px, moved by a quarter of a pixel, comes back by the default, not by cubic convolution."""
    correction, turn = shift(0.25, 0.0), 2 * np.pi / 4
    predicted_px = correction.inverse(pixel_centres(GRID.shape))
    wave = 100 + 50 * np.sin(turn * predicted_px[:, 0]).reshape(GRID.shape).astype(np.float32)
    warp(write(tmp_path / "a.tif", wave, GRID), tmp_path / "out.tif", correction, GRID, *options)
    with rasterio.open(tmp_path / "out.tif") as out:
        result = out.read(1)[:, 20:300]
    col = np.arange(20, 300) + 0.5
    phase = np.angle(1j * ((result - 100) * np.exp(-1j * turn * col)).mean())
    assert least_px <= abs(phase) / turn <= most_px


@pytest.mark.parametrize("resampling", ["nearest", "cubic", "lanczos"])
@pytest.mark.parametrize(
    ("dtype", "nodata"),
    [("uint16", 0), ("uint8", 255), ("int16", -32768), ("float32", -9999.0), ("float64", np.nan)],
)
def test_nodata_of_one_band_is_that_of_gdal_itself(
    tmp_path: Path, dtype: str, nodata: float, resampling: str
) -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(1, 250, GRID.shape).astype(dtype)
    image[100:140, 60:90] = nodata
    image[rng.random(GRID.shape) < 0.02] = nodata
    one = write(tmp_path / "one.tif", image, GRID, nodata=nodata)
    # with two bands GDAL fills in the nodata value, with one band we do
    two = write(tmp_path / "two.tif", np.stack([image, image]), GRID, nodata=nodata)
    results = []
    for source in (one, two):
        warp(source, tmp_path / f"out_{source.name}", AFFINE, GRID, resampling)
        with rasterio.open(tmp_path / f"out_{source.name}") as out:
            results.append(out.read(1))
    np.testing.assert_array_equal(*results)
    invalid = np.isnan(results[0]) if np.isnan(nodata) else results[0] == nodata
    assert 2000 < invalid.sum() < 12_000


@pytest.mark.parametrize(("nodata", "low"), [(0, 1), (65535, 65534)])
def test_overshoot_is_clipped_and_never_becomes_nodata(tmp_path: Path, nodata: int, low: int) -> None:
    image = np.full(GRID.shape, low, np.uint16)
    image[:, 160:] = 65534 if nodata == 0 else 1
    source = write(tmp_path / "a.tif", image, GRID, nodata=nodata)
    warp(source, tmp_path / "out.tif", shift(0.5, 0.0), GRID)
    with rasterio.open(tmp_path / "out.tif") as out:
        result = out.read(1)[:, :-1]
    assert (result != nodata).all()
    assert set(np.unique(result[:, :150])) == {low}


def test_integers_without_nodata_get_a_mask(tmp_path: Path) -> None:
    source = write(tmp_path / "a.tif", np.full(GRID.shape, 7, np.uint8), GRID)
    warp(source, tmp_path / "out.tif", shift(3.0, 0.0), GRID)
    with rasterio.open(tmp_path / "out.tif") as out:
        assert out.nodata is None
        assert out.mask_flag_enums[0] == [MaskFlags.per_dataset]
        mask = out.read_masks(1)
    assert (mask[:, :317] == 255).all()
    assert (mask[:, 317:] == 0).all()


def test_a_source_mask_is_respected(tmp_path: Path) -> None:
    image = np.full(GRID.shape, 100, np.uint8)
    image[:50] = 7
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        write(tmp_path / "a.tif", image, GRID)
        with rasterio.open(tmp_path / "a.tif", "r+") as dataset:
            dataset.write_mask(image != 7)
    warp(tmp_path / "a.tif", tmp_path / "out.tif", shift(0.3, -0.3), GRID)
    with rasterio.open(tmp_path / "out.tif") as out:
        values, mask = out.read(1), out.read_masks(1)
    assert (mask[:50] == 0).all()
    assert (mask[51:] == 255).all()
    assert set(np.unique(values[mask > 0])) == {100}


def test_alpha_is_warped_with_its_colours(tmp_path: Path) -> None:
    bands = np.full((4, *GRID.shape), 200, np.uint8)
    bands[:3, :50], bands[3], bands[3, :50] = 9, 255, 0
    colours = [ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha]
    source = write(tmp_path / "a.tif", bands, GRID, photometric="RGB", alpha="YES")
    with rasterio.open(source) as dataset:
        assert list(dataset.colorinterp) == colours
    warp(source, tmp_path / "out.tif", shift(0.3, -0.3), GRID)
    with rasterio.open(tmp_path / "out.tif") as out:
        assert list(out.colorinterp) == colours
        result = out.read()
    assert set(np.unique(result[:3, result[3] > 0])) == {200}
    assert (result[3, :50] == 0).all()
    assert (result[3, 51:] == 255).all()


def test_everything_beside_the_pixels_is_kept_except_what_no_longer_holds(tmp_path: Path) -> None:
    bands = np.random.default_rng(1).integers(1, 9000, (2, *GRID.shape)).astype(np.int16)
    source = write(tmp_path / "a & b é.tif", bands, GRID, nodata=-32768)
    with rasterio.open(source, "r+") as dataset:
        dataset.scales, dataset.offsets, dataset.units = (0.01, 2.0), (273.15, -1.0), ("K", "m")
        dataset.descriptions = ("B10 <thermal>", "height")
        dataset.update_tags(ACQUIRED="2020-01-01T10:00Z", NOTE="a=b; é")
        dataset.update_tags(ns="SENSOR", gain="3.5")
        dataset.update_tags(ns="RPC", LINE_OFF="1")
        dataset.update_tags(1, STATISTICS_MEAN="17", WAVELENGTH="10.9")
        dataset.update_tags(1, ns="FILTER", width="0.6")
    warp(source, tmp_path / "out.tif", shift(0.3, -0.3), GRID)
    with rasterio.open(tmp_path / "out.tif") as out:
        assert (out.scales, out.offsets, out.units) == ((0.01, 2.0), (273.15, -1.0), ("K", "m"))
        assert out.descriptions == ("B10 <thermal>", "height")
        assert (out.tags()["ACQUIRED"], out.tags()["NOTE"]) == ("2020-01-01T10:00Z", "a=b; é")
        assert out.tags(ns="SENSOR") == {"gain": "3.5"}
        assert out.tags(1) == {"WAVELENGTH": "10.9"}
        assert out.tags(1, ns="FILTER") == {"width": "0.6"}
        assert out.tag_namespaces(1) == ["FILTER"]
        assert out.tags(ns="RPC") == {}
        assert out.rpcs is None
        assert (out.nodata, out.dtypes) == (-32768.0, ("int16", "int16"))
        assert out.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert out.profile["tiled"]


def test_a_colour_table_is_kept_and_its_indices_are_not_interpolated(tmp_path: Path) -> None:
    classes = (np.indices(GRID.shape)[1] // 10 % 2 * 40).astype(np.uint8)
    source = write(tmp_path / "a.tif", classes, GRID)
    with rasterio.open(source, "r+") as dataset:
        dataset.write_colormap(1, {0: (1, 2, 3, 255), 40: (250, 0, 9, 255)})
    warp(source, tmp_path / "out.tif", shift(0.3, 0.2), GRID, "cubic")
    with rasterio.open(tmp_path / "out.tif") as out:
        assert out.colormap(1)[40] == (250, 0, 9, 255)
        assert set(np.unique(out.read(1))) == {0, 40}


def test_without_georeferencing_the_result_lies_on_the_reference_pixels(tmp_path: Path) -> None:
    correction = shift(12.31, -4.44)
    target = Grid((300, 320), Affine.identity(), None)
    reference = Grid((280, 290), Affine.identity(), None)
    bands = observed_scene(target, correction)
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        source = write(tmp_path / "a.tif", bands)
    grid = output_grid(reference, target, correction)
    assert grid == reference
    warp(source, tmp_path / "out.tif", correction, grid)
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        out = rasterio.open(tmp_path / "out.tif")
    with out:
        result = out.read()
        assert (out.shape, out.crs) == (reference.shape, None)
    error = position_error_px(result, pixel_centres(grid.shape)).reshape(*grid.shape, 2)
    assert np.abs(error[8:, :-8]).max() < 0.02


def test_another_band_of_the_target_with_other_pixels_moves_by_the_same_ground(tmp_path: Path) -> None:
    coarse = Grid((150, 160), compose(ORIGIN, Affine.scale(2.0)), UTM33)
    fine_correction, coarse_correction = shift(0.6, -0.8), shift(0.3, -0.4)
    source = write(tmp_path / "a.tif", observed_scene(coarse, coarse_correction), coarse)
    warp(source, tmp_path / "out.tif", fine_correction, coarse, target_grid=GRID)
    with rasterio.open(tmp_path / "out.tif") as out:
        error = position_error_px(out.read(), pixel_centres(coarse.shape)).reshape(*coarse.shape, 2)
    assert np.abs(error[6:-6, 6:-6]).max() < 0.02


def test_output_grid_is_the_references_lattice_over_the_whole_footprint() -> None:
    target = Grid((100, 120), compose(ORIGIN, Affine.translation(10, 20)), UTM33)
    assert output_grid(GRID, target, shift(0, 0)) == target
    grown = output_grid(GRID, target, shift(0.3, -0.4))
    assert grown.shape == (101, 121)
    assert GRID.to_px(np.array([[grown.transform.c, grown.transform.f]]))[0] == pytest.approx([9, 20])
    assert output_grid(GRID, target, shift(0.3, -0.4), GridRequest("target")) == target
    assert output_grid(GRID, target, shift(-0.3, 0.4)).transform == compose(
        ORIGIN, Affine.translation(10, 19)
    )


def test_output_grid_keeps_the_targets_pixel_size_and_the_references_corner() -> None:
    target = Grid((300, 330), Affine(10.0, 0.0, 500_004.0, 0.0, -10.0, 4_900_004.0), UTM33)
    grid = output_grid(GRID, target, shift(0, 0))
    assert grid.transform == Affine(10.0, 0.0, 500_000.0, 0.0, -10.0, 4_900_010.0)
    assert grid.shape == (301, 331)


def test_output_grid_keeps_the_references_rotation() -> None:
    turned = Grid((200, 200), compose(ORIGIN, Affine.rotation(30)), UTM33)
    grid = output_grid(turned, GRID, shift(0, 0))
    steps = turned.to_px(grid.to_xy(np.array([[0.0, 0], [1, 0], [0, 1]])))
    assert steps[1] - steps[0] == pytest.approx([1, 0], abs=1e-9)
    assert steps[2] - steps[0] == pytest.approx([0, 1], abs=1e-9)
    assert steps[0] == pytest.approx(np.round(steps[0]), abs=1e-6)


def test_progress_is_told_and_may_end_the_work(tmp_path: Path) -> None:
    source = write(tmp_path / "a.tif", np.ones(GRID.shape, np.uint8), GRID)
    seen: list[tuple[int, int]] = []
    warp(
        source,
        tmp_path / "out.tif",
        shift(0, 0),
        GRID,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert seen == [(1, 1)]

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        warp(source, tmp_path / "other.tif", shift(0, 0), GRID, progress=stop)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.tif", "out.tif"]


def test_an_unreadable_source_and_another_crs_are_input_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.tif"):
        warp(tmp_path / "absent.tif", tmp_path / "out.tif", shift(0, 0), GRID)
    source = write(tmp_path / "a.tif", np.ones(GRID.shape, np.uint8), GRID)
    with pytest.raises(InputError, match="EPSG:32632"):
        warp(source, tmp_path / "out.tif", shift(0, 0), GRID, target_grid=Grid(GRID.shape, ORIGIN, UTM32))
    with pytest.raises(OutputError, match="nowhere"):
        warp(source, tmp_path / "nowhere" / "out.tif", shift(0, 0), GRID)


@pytest.mark.parametrize("limit", [200_000, 900_000])
def test_a_full_disk_is_an_output_error(tmp_path: Path, limit: int) -> None:
    noise = np.random.default_rng(1).integers(1, 60000, (800, 900)).astype(np.uint16)
    source = write(tmp_path / "a.tif", noise, Grid((800, 900), ORIGIN, UTM33), nodata=0)
    script = textwrap.dedent(f"""
        import resource, signal, numpy as np
        from pathlib import Path
        from affine import Affine
        from rasterio.crs import CRS
        from pcwlad_geo.correction.models import AffineCorrection
        from pcwlad_geo.errors import OutputError
        from pcwlad_geo.raster.grid import Grid
        from pcwlad_geo.raster.warping import WARPING, warp
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
        grid = Grid((800, 900), Affine{tuple(ORIGIN)[:6]}, CRS.from_epsg(32633))
        try:
            warp({str(source)!r}, Path({str(tmp_path / "out.tif")!r}),
                 AffineCorrection("shift", np.eye(2, 3)), grid)
        except OutputError as error:
            print("refused:", error)
    """)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "refused:" in done.stdout, done.stdout + done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


def test_a_file_without_band_tags_is_not_searched_for_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the search would go through all pixels of a large file, and count as memory
    def fail(path: Path) -> None:
        raise AssertionError(f"{path} is searched")

    monkeypatch.setattr("pcwlad_geo.raster.output_format._rename_band_tags", fail)
    source = write(tmp_path / "a.tif", np.ones(GRID.shape, np.uint8), GRID)
    warp(source, tmp_path / "out.tif", shift(0.3, -0.3), GRID)
    assert (tmp_path / "out.tif").exists()


@pytest.mark.parametrize("level", [logging.INFO, logging.ERROR])
def test_what_gdal_reports_while_it_closes_a_file_is_an_error(level: int) -> None:
    """As when the disk is full: rasterio logs it, and the file lacks its pixels."""
    logger, words = logging.getLogger("rasterio._env"), "TIFFLinkDirectory:Error writing directory link"
    signalled = words if level == logging.ERROR else f"GDAL signalled an error: err_no=1, msg='{words}'"
    with pytest.raises(OSError, match=f"^{words}$"), raising_gdal_reports():
        logger.log(level, signalled)
    with raising_gdal_reports():
        logger.info("all is well")
    elsewhere = threading.Thread(target=logger.error, args=("of another thread",))
    with raising_gdal_reports():
        elsewhere.start()
        elsewhere.join()
