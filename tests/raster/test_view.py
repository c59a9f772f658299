"""Ramps over the ground: f(x, y) is known everywhere, so every view must show it at its own pixel centres."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import view as view_module
from pcwlad_geo.raster.grid import Grid, Window, map_px
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.view import View

Array = NDArray[np.float64]
UTM33, UTM34, WGS84 = CRS.from_epsg(32633), CRS.from_epsg(32634), CRS.from_epsg(4326)
X, Y = 500_000.0, 5_000_000.0


def north_up(px_m: float = 10.0, x: float = X, y: float = Y) -> Affine:
    return Affine(px_m, 0, x, 0, -px_m, y)


def centres(shape: tuple[int, int], window: Window | None = None) -> Array:
    window = window or Window.whole(shape)
    col, row = np.meshgrid(
        window.col + np.arange(window.cols) + 0.5, window.row + np.arange(window.rows) + 0.5
    )
    return np.column_stack([col.ravel(), row.ravel()])


def ramp_at(xy: Array) -> Array:
    return 100 + 0.05 * (xy[:, 0] - X) - 0.02 * (xy[:, 1] - Y)


def on_grid(grid: Grid, window: Window | None = None) -> Array:
    window = window or Window.whole(grid.shape)
    return ramp_at(grid.to_xy(centres(grid.shape, window))).reshape(window.shape)


def write(
    path: Path, values: NDArray[np.generic], transform: Affine, crs: CRS | None = UTM33, **profile: object
) -> Path:
    bands = values[None] if values.ndim == 2 else values
    count, height, width = bands.shape
    options = {
        "driver": "GTiff",
        "count": count,
        "height": height,
        "width": width,
        "dtype": bands.dtype,
    } | profile
    with rasterio.open(path, "w", transform=transform, crs=crs, **options) as dataset:
        dataset.write(bands)
    return path


def write_ramp(path: Path, shape: tuple[int, int], transform: Affine, crs: CRS | None = UTM33) -> Path:
    return write(path, on_grid(Grid(shape, transform, crs)), transform, crs)


def own(path: Path, **options: object) -> View:
    info = describe(path, **options)  # type: ignore[arg-type]
    return View(info, info.grid, "none")


# --- own pixels


def test_own_pixels_are_the_file(tmp_path: Path) -> None:
    values = np.arange(30 * 40, dtype="uint16").reshape(30, 40)
    view = own(write(tmp_path / "a.tif", values, north_up()))
    patch = view.read(Window(3, 5, 10, 12))
    np.testing.assert_array_equal(patch.values, values[3:13, 5:17])
    assert patch.values.dtype == np.float32
    assert patch.valid.all()
    points = np.array([[1.25, 7.5]])
    np.testing.assert_array_equal(view.to_file_px(points), points)
    assert pickle.loads(pickle.dumps(view)) == view


def test_outside_is_not_valid_and_zero(tmp_path: Path) -> None:
    view = own(write(tmp_path / "a.tif", np.full((6, 7), 9, "uint8"), north_up()))
    patch = view.read(Window(-2, 4, 5, 6))
    expected = np.zeros((5, 6))
    expected[2:, :3] = 9
    np.testing.assert_array_equal(patch.values, expected)
    np.testing.assert_array_equal(patch.valid, expected > 0)
    assert not view.read(Window(100, 100, 3, 3)).valid.any()


@pytest.mark.parametrize("dtype", ["uint32", "int32", "float64"])
def test_big_offsets_keep_their_last_digit(tmp_path: Path, dtype: str) -> None:
    values = (1_000_000_000 + np.arange(64).reshape(8, 8)).astype(dtype)
    patch = own(write(tmp_path / "a.tif", values, north_up())).read(Window(0, 0, 8, 8))
    np.testing.assert_array_equal(patch.values, values)


@pytest.mark.parametrize(
    ("dtype", "nodata"),
    [("uint8", 255), ("int16", -9999), ("float32", -3.4028235e38), ("float64", np.nan), ("float32", 0.1)],
)
def test_nodata(tmp_path: Path, dtype: str, nodata: float) -> None:
    values = np.full((5, 5), 3, dtype)
    values[1, 2] = nodata
    patch = own(write(tmp_path / "a.tif", values, north_up(), nodata=nodata)).read(Window(0, 0, 5, 5))
    assert np.argwhere(~patch.valid).tolist() == [[1, 2]]
    assert patch.values[1, 2] == 0


def test_nan_and_inf_without_nodata(tmp_path: Path) -> None:
    values = np.ones((4, 4), "float32")
    values[0, 1], values[2, 3], values[3, 0] = np.nan, np.inf, -np.inf
    patch = own(write(tmp_path / "a.tif", values, north_up())).read(Window(0, 0, 4, 4))
    assert np.argwhere(~patch.valid).tolist() == [[0, 1], [2, 3], [3, 0]]
    assert np.isfinite(patch.values).all()


@pytest.mark.parametrize("internal", [True, False])
def test_dataset_mask_and_nodata_add_up(tmp_path: Path, internal: bool) -> None:
    values = np.full((4, 4), 5, "uint8")
    values[0, 0] = 0
    path = tmp_path / "a.tif"
    mask = np.full((4, 4), 255, "uint8")
    mask[3, 3] = 0
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=internal),
        rasterio.open(
            path,
            "w",
            driver="GTiff",
            count=1,
            height=4,
            width=4,
            dtype="uint8",
            transform=north_up(),
            crs=UTM33,
            nodata=0,
        ) as dataset,
    ):
        dataset.write(values, 1)
        dataset.write_mask(mask)
    assert np.argwhere(~own(path).read(Window(0, 0, 4, 4)).valid).tolist() == [[0, 0], [3, 3]]


@pytest.mark.parametrize("nodata", [None, 0])
def test_alpha_band(tmp_path: Path, nodata: float | None) -> None:
    values = np.full((4, 4, 4), 200, "uint8")
    values[3, 1, 1] = 0
    path = tmp_path / "a.tif"
    write(path, values, north_up(), photometric="RGB", alpha="YES", nodata=nodata)
    assert np.argwhere(~own(path, band=2).read(Window(0, 0, 4, 4)).valid).tolist() == [[1, 1]]


def test_mask_file_pixel_for_pixel(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.full((6, 6), 7, "uint8"), north_up())
    mask = np.full((6, 6), 255, "uint8")
    mask[2, 4] = 0
    with pytest.warns(NotGeoreferencedWarning):
        mask_path = write(tmp_path / "mask.tif", mask, Affine.identity(), None)
    patch = own(path, mask=mask_path).read(Window(1, 1, 5, 6))
    assert np.argwhere(~patch.valid[:, :5]).tolist() == [[1, 3]]
    assert not patch.valid[:, 5].any()
    assert patch.values[1, 3] == 0


def test_mask_file_of_another_grid_is_nearest_and_excludes_beyond_it(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.full((12, 12), 7, "uint8"), north_up(10))
    mask = np.ones((3, 2), "uint8")  # 40 m: columns 0 to 7 of the raster only
    mask[1, 0] = 0
    patch = own(path, mask=write(tmp_path / "mask.tif", mask, north_up(40))).read(Window(0, 0, 12, 12))
    expected = np.ones((12, 12), bool)
    expected[4:8, :4] = False
    expected[:, 8:] = False
    np.testing.assert_array_equal(patch.valid, expected)


def test_mask_file_of_another_crs(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.full((40, 40), 7, "uint8"), north_up(30))
    grid = describe(path).grid
    mask_grid = Grid((400, 400), Affine(1e-4, 0, 14.99, 0, -1e-4, 45.17), WGS84)
    mask = np.ones((400, 400), "uint8")
    to_raster = map_px(centres((400, 400)), mask_grid, grid).reshape(400, 400, 2)
    mask[(to_raster[..., 0] > 20) & (to_raster[..., 1] > 10)] = 0
    patch = own(path, mask=write(tmp_path / "m.tif", mask, mask_grid.transform, WGS84)).read(
        Window(0, 0, 40, 40)
    )
    expected = np.ones((40, 40), bool)
    expected[10:, 20:] = False
    inner = expected.copy()
    # A mask pixel is a third of a raster pixel: only centres on the very edge could go either way.
    np.testing.assert_array_equal(patch.valid, inner)


def test_corrupt_mask_file_is_named(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.full((64, 64), 7, "uint8"), north_up())
    mask = write(tmp_path / "mask.tif", np.ones((64, 64), "uint8"), north_up())
    view = own(path, mask=mask)
    mask.write_bytes(mask.read_bytes()[:2000])
    with pytest.raises(InputError, match=r"mask\.tif"):
        view.read(Window(0, 0, 64, 64))


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_jpeg_2000_lossless(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(0, 60_000, (80, 90)).astype("uint16")
    path = write(
        tmp_path / "a.jp2", values, north_up(), driver="JP2OpenJPEG", QUALITY="100", REVERSIBLE="YES"
    )
    view = own(path)
    assert view.info.georeferenced
    np.testing.assert_array_equal(view.read(Window(10, 20, 50, 60)).values, values[10:60, 20:80])


def test_truncated_file_names_file_and_place(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(0, 255, (256, 256)).astype("uint8")
    path = write(tmp_path / "a.tif", values, north_up())
    path.write_bytes(path.read_bytes()[:30_000])
    view = own(path)
    assert view.read(Window(0, 0, 20, 256)).valid.all()
    with pytest.raises(InputError, match=r"a\.tif: band 1 cannot be read at rows 200 to 256") as caught:
        view.read(Window(200, 0, 100, 256))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("side_px", [512, 128])
def test_a_look_at_a_truncated_file_shows_what_can_be_read(side_px: int, tmp_path: Path) -> None:
    values = np.full((512, 512), 100, dtype="uint8")
    path = write(tmp_path / "a.tif", values, north_up())
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    patch, factor = own(path).read_decimated(side_px)
    assert factor == (512 / side_px, 512 / side_px)
    last = side_px // 2 - 32  # parts of 32 px are given up as a whole
    assert patch.valid[:last].all()
    assert not patch.valid[side_px // 2 + 1 :].any()
    np.testing.assert_array_equal(patch.values, np.where(patch.valid, 100, 0))
    path.write_bytes(content[:1000])
    with pytest.raises(InputError, match="truncated or corrupt"):
        own(path).read_decimated(side_px)


# --- nearest: flipped axes


def test_flipped_view_shows_own_pixels_in_the_other_order(tmp_path: Path) -> None:
    values = np.arange(20 * 30, dtype="uint16").reshape(20, 30)
    south_up = Affine(10, 0, X, 0, 10, Y - 200)
    info = describe(write(tmp_path / "a.tif", values, south_up))
    view = View(info, Grid((20, 30), north_up(), UTM33), "nearest")
    patch = view.read(Window(-1, 4, 8, 5))
    np.testing.assert_array_equal(patch.values[1:], values[::-1][:7, 4:9])
    assert not patch.valid[0].any()
    assert patch.valid[1:].all()
    np.testing.assert_allclose(view.to_file_px(np.array([[4.5, 0.5]])), [[4.5, 19.5]], atol=1e-9)
    np.testing.assert_allclose(view.from_file_px(np.array([[4.5, 19.5]])), [[4.5, 0.5]], atol=1e-9)


# --- average


@pytest.mark.parametrize("ratio", [2.0, 3.0, 2.5, 1.7])
@pytest.mark.parametrize("offset_m", [0.0, 3.0])
def test_average_of_a_ramp_is_the_ramp(tmp_path: Path, ratio: float, offset_m: float) -> None:
    info = describe(write_ramp(tmp_path / "a.tif", (100, 120), north_up()))
    # Pixels are steps: their average is the ramp where the cells' edges are the pixels', near it elsewhere.
    grid = Grid((30, 36), north_up(10 * ratio, X + 100 + offset_m, Y - 100), UTM33)
    view = View(info, grid, "average")
    patch = view.read(Window(0, 0, 30, 36))
    step = 0.05 * 10
    exact = offset_m == 0 and ratio.is_integer()
    tolerance = 1e-9 if exact else 0.25 * (step + 0.02 * 10) / ratio
    inside = (view.to_file_px(centres(grid.shape)) < [120 - ratio, 100 - ratio]).all(axis=1).reshape(30, 36)
    assert inside.sum() > 500
    np.testing.assert_allclose(patch.values[inside], on_grid(grid)[inside], atol=tolerance)
    assert patch.valid[inside].all()


def test_average_weighs_by_area(tmp_path: Path) -> None:
    values = np.array([[0.0, 10.0, 20.0, 30.0]] * 4)
    info = describe(write(tmp_path / "a.tif", values, north_up()))
    view = View(info, Grid((1, 1), north_up(25, X + 5, Y), UTM33), "average")
    # From 0.5 to 3.0 px: half of the first pixel, the second, the third.
    assert view.read(Window(0, 0, 1, 1)).values[0, 0] == pytest.approx((0.5 * 0 + 10 + 20) / 2.5)


def test_average_onto_a_south_up_grid(tmp_path: Path) -> None:
    info = describe(write_ramp(tmp_path / "a.tif", (40, 40), north_up()))
    grid = Grid((20, 20), Affine(20, 0, X, 0, 20, Y - 400), UTM33)
    np.testing.assert_allclose(View(info, grid, "average").read(Window(0, 0, 20, 20)).values, on_grid(grid))


def test_average_ignores_nodata_and_needs_half(tmp_path: Path) -> None:
    values = np.full((4, 6), 50, "uint8")
    values[0:2, 1] = 255  # half of the first cell
    values[0, 2] = 255  # a quarter of the second
    values[2:4, 0:2] = 255
    values[2, 1] = 50  # three quarters of the lower first
    info = describe(write(tmp_path / "a.tif", values, north_up(), nodata=255))
    patch = View(info, Grid((2, 3), north_up(20), UTM33), "average").read(Window(0, 0, 2, 3))
    np.testing.assert_array_equal(patch.valid, [[True, True, True], [False, True, True]])
    np.testing.assert_array_equal(patch.values, [[50, 50, 50], [0, 50, 50]])


def test_average_needs_half_of_its_area(tmp_path: Path) -> None:
    values = np.full((3, 6), np.nan, "float32")
    values[0, :3] = values[1, 0] = 8  # 4 of the first cell's 9 pixels
    values[0, 3:] = values[1, 3:5] = 8  # 5 of the second's
    info = describe(write(tmp_path / "a.tif", values, north_up()))
    patch = View(info, Grid((1, 2), north_up(30), UTM33), "average").read(Window(0, 0, 1, 2))
    np.testing.assert_array_equal(patch.valid, [[False, True]])
    np.testing.assert_array_equal(patch.values, [[0, 8]])


def test_average_does_not_round(tmp_path: Path) -> None:
    values = np.tile(np.array([[1, 2], [2, 2]], "uint8"), (2, 2))
    info = describe(write(tmp_path / "a.tif", values, north_up()))
    patch = View(info, Grid((2, 2), north_up(20), UTM33), "average").read(Window(0, 0, 2, 2))
    np.testing.assert_array_equal(patch.values, np.full((2, 2), 1.75))


# --- cubic


def rotated(px_m: float, angle_deg: float, x: float, y: float) -> Affine:
    c, s = px_m * np.cos(np.radians(angle_deg)), px_m * np.sin(np.radians(angle_deg))
    return Affine(c, s, x, s, -c, y)


@pytest.mark.parametrize("ratio", [1.0, 1.0005, 1.4, 2.3, 5.0])
def test_rotated_view_of_a_ramp(tmp_path: Path, ratio: float) -> None:
    shape = (260, 280)
    info = describe(write_ramp(tmp_path / "a.tif", shape, north_up()))
    grid = Grid((30, 30), rotated(10 * ratio, 30, X + 900, Y - 900), UTM33)
    patch = View(info, grid, "cubic").read(Window(0, 0, 30, 30))
    at = map_px(centres(grid.shape), grid, info.grid)
    inside = ((at > 20) & (at < [260, 240])).all(axis=1).reshape(30, 30)
    assert inside.sum() > 300
    assert patch.valid[inside].all()
    np.testing.assert_allclose(patch.values[inside], on_grid(grid)[inside], atol=1e-6)


def test_cubic_shows_a_wave_where_it_is(tmp_path: Path) -> None:
    # A wave of 8 px against a sub-pixel shift: half a pixel of error would show as 0.38 of the amplitude.
    col = np.arange(100) + 0.5
    values = np.broadcast_to(np.sin(2 * np.pi * col / 8), (100, 100)).astype("float64")
    info = describe(write(tmp_path / "a.tif", values, north_up()))
    grid = Grid((60, 60), north_up(10, X + 203, Y - 203), UTM33)
    patch = View(info, grid, "cubic").read(Window(0, 0, 60, 60))
    expected = np.sin(2 * np.pi * (np.arange(60) + 0.5 + 20.3) / 8)
    np.testing.assert_allclose(patch.values, np.broadcast_to(expected, (60, 60)), atol=4e-3)


@pytest.mark.parametrize(
    ("crs", "transform"),
    [(UTM34, Affine(10, 0, 29_000, 0, -10, 5_014_000)), (WGS84, Affine(1e-4, 0, 15.01, 0, -1e-4, 45.15))],
    ids=["UTM 34N", "geographic"],
)
def test_cross_crs_view_of_a_ramp(tmp_path: Path, crs: CRS, transform: Affine) -> None:
    info = describe(write_ramp(tmp_path / "a.tif", (400, 400), north_up()))
    view = View(info, Grid((150, 150), transform, crs), "cubic")
    at = view.to_file_px(centres(view.grid.shape))
    inside = ((at > 20) & (at < 380)).all(axis=1).reshape(150, 150)
    assert inside.sum() > 5000
    patch = view.read(Window(0, 0, 150, 150))
    expected = ramp_at(info.grid.to_xy(at)).reshape(150, 150)
    np.testing.assert_allclose(patch.values[inside], expected[inside], atol=1e-4)
    assert not patch.valid[~((at > 0) & (at < 400)).all(axis=1).reshape(150, 150)].any()
    np.testing.assert_allclose(view.from_file_px(at), centres(view.grid.shape), atol=1e-4)


def test_cubic_never_mixes_nodata_in(tmp_path: Path) -> None:
    values = np.full((80, 80), 100.0, "float32")
    values[30:50, 30:50] = -9999
    info = describe(write(tmp_path / "a.tif", values, north_up(), nodata=-9999))
    grid = Grid((80, 80), rotated(9.9, 10, X, Y), UTM33)
    patch = View(info, grid, "cubic").read(Window(0, 0, 80, 80))
    assert patch.valid.sum() > 3000
    np.testing.assert_allclose(patch.values[patch.valid], 100, atol=1e-4)
    at = map_px(centres(grid.shape), grid, info.grid).reshape(80, 80, 2)
    in_hole = ((at > 30) & (at < 50)).all(axis=2)
    assert not patch.valid[in_hole].any()
    assert patch.valid[((at > 2) & (at < 28)).all(axis=2)].all()


@pytest.mark.parametrize("resampling", ["average", "cubic"])
def test_a_window_shows_what_the_whole_shows(
    tmp_path: Path, resampling: view_module.ViewResampling, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = np.random.default_rng(3).normal(size=(200, 200)).astype("float32")
    values[50:70, 90:99] = np.nan
    info = describe(write(tmp_path / "a.tif", values, north_up()))
    turned = north_up(26, X + 13, Y - 7) if resampling == "average" else rotated(41, 20, X - 100, Y + 30)
    view = View(info, Grid((60, 60), turned, UTM33), resampling)
    whole = view.read(Window(-5, -5, 70, 70))
    part = view.read(Window(11, 17, 21, 13))
    here = Window(11, 17, 21, 13).slices_in(Window(-5, -5, 70, 70))
    np.testing.assert_array_equal(part.valid, whole.valid[here])
    np.testing.assert_allclose(part.values, whole.values[here], atol=1e-5)
    few = replace(view_module.VIEWS, max_px_at_once=8000)  # in parts, as a large scene
    monkeypatch.setattr(view_module, "VIEWS", few)
    in_parts = view.read(Window(-5, -5, 70, 70))
    np.testing.assert_array_equal(in_parts.valid, whole.valid)
    np.testing.assert_allclose(in_parts.values, whole.values, atol=1e-5)


# --- decimated


def test_small_views_are_not_decimated(tmp_path: Path) -> None:
    view = own(write_ramp(tmp_path / "a.tif", (40, 50), north_up()))
    patch, factor_xy = view.read_decimated(50)
    assert factor_xy == (1.0, 1.0)
    np.testing.assert_allclose(patch.values, on_grid(view.grid))


@pytest.mark.parametrize("georeferenced", [True, False])
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_decimated_look_is_the_ramp(tmp_path: Path, georeferenced: bool) -> None:
    path = write_ramp(tmp_path / "a.tif", (210, 300), north_up(), UTM33)
    if not georeferenced:
        with rasterio.open(path) as dataset:
            values = dataset.read(1)
        path = write(tmp_path / "b.tif", values, Affine.identity(), None)
    patch, (factor_x, factor_y) = own(path).read_decimated(100)
    assert patch.values.shape == (70, 100)
    assert (factor_x, factor_y) == (3.0, 3.0)
    np.testing.assert_allclose(patch.values, on_grid(Grid((70, 100), north_up(30), UTM33)))
    assert patch.valid.all()


def test_decimated_look_reads_overviews(tmp_path: Path) -> None:
    path = write_ramp(tmp_path / "a.tif", (256, 256), north_up())
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2, 4], Resampling.average)
    with rasterio.open(path, "r+") as dataset:  # the original now differs from its overviews
        dataset.write(np.zeros((256, 256)), 1)
    patch, factor_xy = own(path).read_decimated(32)
    assert factor_xy == (8.0, 8.0)
    np.testing.assert_allclose(patch.values, on_grid(Grid((32, 32), north_up(80), UTM33)))


@pytest.mark.parametrize("resampling", ["average", "cubic", "nearest"])
def test_decimated_look_at_a_resampled_view(tmp_path: Path, resampling: view_module.ViewResampling) -> None:
    info = describe(write_ramp(tmp_path / "a.tif", (400, 400), north_up()))
    transforms = {
        "average": north_up(20),
        "cubic": rotated(20, 5, X, Y - 300),
        "nearest": Affine(10, 0, X, 0, 10, Y - 4000),
    }
    shape = (400, 400) if resampling == "nearest" else (160, 160)
    view = View(info, Grid(shape, transforms[resampling], UTM33), resampling)
    patch, (factor_x, factor_y) = view.read_decimated(40)
    at = view.to_file_px(centres((40, 40)) * [factor_x, factor_y])
    inside = ((at > 80) & (at < 320)).all(axis=1).reshape(40, 40)
    assert inside.sum() > 300
    expected = ramp_at(info.grid.to_xy(at)).reshape(40, 40)
    np.testing.assert_allclose(patch.values[inside], expected[inside], atol=1e-4)


def test_decimated_look_ignores_nodata(tmp_path: Path) -> None:
    values = np.full((64, 64), 10, "uint8")
    values[:, :33] = 0
    patch, _ = own(write(tmp_path / "a.tif", values, north_up(), nodata=0)).read_decimated(16)
    assert not patch.valid[:, :8].any()
    assert patch.valid[:, 8:].all()
    np.testing.assert_array_equal(patch.values[patch.valid], 10)


def test_decimated_look_heeds_the_mask_file(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.full((128, 128), 10, "uint8"), north_up())
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2, 4], Resampling.average)
    mask = np.ones((128, 128), "uint8")
    mask[:64] = 0
    with pytest.warns(NotGeoreferencedWarning):
        mask_path = write(tmp_path / "m.tif", mask, Affine.identity(), None)
    patch, _ = own(path, mask=mask_path).read_decimated(16)
    np.testing.assert_array_equal(patch.valid, np.repeat([[False], [True]], 8, axis=0) & np.ones(16, bool))


def test_decimated_look_with_a_georeferenced_mask_reads_overviews(tmp_path: Path) -> None:
    """The original, which differs from its overviews here, is not read for it."""
    path = write_ramp(tmp_path / "a.tif", (256, 256), north_up())
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2, 4], Resampling.average)
    with rasterio.open(path, "r+") as dataset:
        dataset.write(np.zeros((256, 256)), 1)
    mask = np.ones((64, 64), "uint8")
    mask[:32] = 0
    mask_path = write(tmp_path / "m.tif", mask, north_up(40))
    patch, _ = own(path, mask=mask_path).read_decimated(32)
    np.testing.assert_array_equal(patch.valid, np.repeat([[False], [True]], 16, axis=0) & np.ones(32, bool))
    np.testing.assert_allclose(patch.values[16:], on_grid(Grid((32, 32), north_up(80), UTM33))[16:])
