"""Constant borders that nothing marks: found where a frame ends, to the pixel, and nowhere else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS
from scipy.ndimage import gaussian_filter

from pcwlad_geo.events import Event, Warned
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.grid import Grid, Window
from pcwlad_geo.raster.source import RasterInfo, describe
from pcwlad_geo.raster.undeclared import without_collar
from pcwlad_geo.raster.view import View
from pcwlad_geo.registration import register_pair

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (300, 360)
RIM_PX = 3.0
"""Within this distance of the true end of the data either answer is right."""


def texture(shape: tuple[int, int] = SHAPE, seed: int = 0, smooth_px: float = 2.0) -> Array:
    """Return grey values from 30 to 230."""
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=shape), smooth_px)
    return np.asarray(30 + 200 * (noise - noise.min()) / np.ptp(noise))


def depth_in_frame(shape: tuple[int, int], degrees: float, size: float = 1.0) -> Array:
    """Return how deep each pixel's centre lies inside a frame turned about the raster's middle, px."""
    row, col = np.indices(shape) + 0.5
    x, y = col - shape[1] / 2, row - shape[0] / 2
    turn = np.deg2rad(degrees)
    u, v = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    return np.asarray(np.minimum(size * shape[1] / 2 - np.abs(u), size * shape[0] / 2 - np.abs(v)))


def framed(depth: Array, ground: Array, fill: float) -> Array:
    """Return the ground with a border of `fill`, blended over the last pixel as resampling does."""
    share = np.clip(depth + 0.5, 0, 1)
    return share * ground + (1 - share) * fill


def write(path: Path, values: NDArray[Any], **profile: object) -> Path:
    rows, cols = values.shape
    driver = {".jpg": "JPEG", ".tif": "GTiff"}[path.suffix]
    options: dict[str, object] = {"driver": driver, "count": 1, "height": rows, "width": cols}
    with rasterio.open(path, "w", **options, dtype=values.dtype, **profile) as dataset:
        dataset.write(values, 1)
    return path


def collared(path: Path) -> tuple[RasterInfo, tuple[str, ...]]:
    return without_collar(describe(path))


def valid(path: Path, window: Window | None = None) -> Mask:
    info, _ = collared(path)
    return View(info, info.grid, "none").read(window or Window.whole(info.grid.shape)).valid


def check_frame(found: Mask, depth: Array) -> None:
    """Check that the border is excluded and the frame is not, both up to its rim."""
    assert not found[depth < -RIM_PX].any()
    assert found[depth > RIM_PX].all()


@pytest.mark.parametrize("degrees", [2.0, 11.0, -37.0, 45.0])
@pytest.mark.parametrize("fill", [0, 255])
def test_rotated_frame(tmp_path: Path, degrees: float, fill: int) -> None:
    depth = depth_in_frame(SHAPE, degrees)
    values = framed(depth, texture(), fill).round().astype(np.uint8)
    check_frame(valid(write(tmp_path / "a.tif", values)), depth)


@pytest.mark.parametrize("quality", [50, 75, 95])
@pytest.mark.parametrize("fill", [0, 255])
def test_noise_of_jpeg(tmp_path: Path, quality: int, fill: int) -> None:
    depth = depth_in_frame(SHAPE, 17.0)
    values = framed(depth, texture(), fill).round().astype(np.uint8)
    path = write(tmp_path / "a.jpg", values, quality=quality)
    with rasterio.open(path) as dataset:
        assert len(np.unique(dataset.read(1)[depth < -RIM_PX])) > 1  # it is noisy
    check_frame(valid(path), depth)


@pytest.mark.parametrize(
    ("dtype", "fill", "scale"),
    [("uint16", 0.0, 10.0), ("uint16", 65535.0, 10.0), ("int16", -9999.0, 10.0), ("float32", -9999.0, 0.01)],
)
def test_fill_values_of_other_types(tmp_path: Path, dtype: str, fill: float, scale: float) -> None:
    depth = depth_in_frame(SHAPE, 17.0)
    values = np.where(depth > 0, texture() * scale, fill).astype(dtype)
    check_frame(valid(write(tmp_path / "a.tif", values)), depth)


@pytest.mark.parametrize("sides", [(12, 20, 9, 31), (14, 0, 0, 0), (0, 0, 0, 40)])
def test_margins_of_a_scan(tmp_path: Path, sides: tuple[int, int, int, int]) -> None:
    top, bottom, left, right = sides
    values = texture()
    paper = np.ones(SHAPE, bool)
    paper[top : SHAPE[0] - bottom, left : SHAPE[1] - right] = False
    values[paper] = 255
    found = valid(write(tmp_path / "a.jpg", values.round().astype(np.uint8), quality=85))
    assert not found[paper].any()
    outer = np.pad(~paper, 1, constant_values=True)  # the rim is at the margins alone
    inner = np.logical_and.reduce([outer[1 + dr : SHAPE[0] + 1 + dr, 1:-1] for dr in (-1, 0, 1)])
    inner &= np.logical_and.reduce([outer[1:-1, 1 + dc : SHAPE[1] + 1 + dc] for dc in (-1, 0, 1)])
    assert found[inner].mean() > 0.98


@pytest.mark.parametrize("overviews", [(), (2, 4)])
def test_large_raster_in_windows(tmp_path: Path, overviews: tuple[int, ...]) -> None:
    """Sides located from an overview are as exact, and all windows exclude the same pixels."""
    shape = (2300, 2900)
    depth = depth_in_frame(shape, 8.0)
    ground = np.kron(texture((230, 290)), np.ones((10, 10)))
    path = write(tmp_path / "a.tif", framed(depth, ground, 0).round().astype(np.uint8), tiled=True)
    with rasterio.open(path, "r+") as dataset:
        if overviews:
            dataset.build_overviews(overviews, rasterio.enums.Resampling.average)
    whole = valid(path)
    check_frame(whole, depth)
    for window in (Window(0, 0, 300, 500), Window(1111, 2400, 640, 500), Window(-20, -30, 100, 100)):
        inside = window.clipped(shape)
        parts = valid(path, window)[inside.slices_in(window)]
        assert (parts == whole[inside.row : inside.row_stop, inside.col : inside.col_stop]).all()


def test_decimated_read_excludes_it_too(tmp_path: Path) -> None:
    shape = (600, 720)
    depth = depth_in_frame(shape, 15.0)
    path = write(tmp_path / "a.tif", framed(depth, texture(shape), 0).round().astype(np.uint8))
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2, 4], rasterio.enums.Resampling.average)
    info, _ = collared(path)
    patch, factor = View(info, info.grid, "none").read_decimated(90)
    assert factor == (8.0, 8.0)
    coarse = depth.reshape(75, 8, 90, 8).mean(axis=(1, 3))
    assert not patch.valid[coarse < -8].any()
    assert patch.valid[coarse > 8].all()


def lake(shape: tuple[int, int]) -> Mask:
    """Return a lake that the left edge and a corner of the raster cut."""
    row, col = np.indices(shape)
    shore = 90 + 25 * np.sin(row / 23) + 9 * np.sin(row / 7 + 1)
    return np.asarray(col < shore)


def bay(shape: tuple[int, int]) -> Mask:
    row, col = np.indices(shape)
    return np.asarray(np.hypot(row, col) < 160)


def roads(shape: tuple[int, int]) -> Mask:
    """Return the white of a street map: streets along the edges and elsewhere."""
    row, col = np.indices(shape)
    return np.asarray((row % 90 < 30) | (col % 110 < 40))


@pytest.mark.parametrize("shape_of", [lake, bay, roads])
@pytest.mark.parametrize("value", [0, 255])
def test_water_shadow_and_streets_are_data(tmp_path: Path, shape_of: Any, value: int) -> None:
    values = np.where(shape_of(SHAPE), value, texture()).astype(np.uint8)
    info = describe(write(tmp_path / "a.tif", values))
    assert without_collar(info) == (info, ())


def test_noisy_darkness_with_a_straight_edge_is_data(tmp_path: Path) -> None:
    values = texture()
    values[:60] = np.random.default_rng(1).integers(0, 5, (60, SHAPE[1]))
    info = describe(write(tmp_path / "a.tif", values.astype(np.uint8)))
    assert without_collar(info) == (info, ())


@pytest.mark.parametrize("value", [0, 77, 255])
def test_constant_image(tmp_path: Path, value: int) -> None:
    info = describe(write(tmp_path / "a.tif", np.full(SHAPE, value, np.uint8)))
    assert without_collar(info) == (info, ())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, np.finfo(np.float64).max])
def test_odd_numbers(tmp_path: Path, value: float) -> None:
    values = np.where(depth_in_frame(SHAPE, 17.0) > 0, texture(), value)
    values[:5, 100:] = -np.finfo(np.float64).max
    without_collar(describe(write(tmp_path / "a.tif", values)))  # raises nothing, warns of nothing


@pytest.mark.parametrize("shape", [(1, 1), (2, 500), (3, 3)])
def test_tiny_rasters(tmp_path: Path, shape: tuple[int, int]) -> None:
    info = describe(write(tmp_path / "a.tif", np.zeros(shape, np.uint8)))
    assert without_collar(info) == (info, ())


def test_grey_border_is_data(tmp_path: Path) -> None:
    values = framed(depth_in_frame(SHAPE, 17.0), texture(), 120).round().astype(np.uint8)
    info = describe(write(tmp_path / "a.tif", values))
    assert without_collar(info) == (info, ())


def test_nothing_is_done_where_the_file_marks_its_data(tmp_path: Path) -> None:
    depth = depth_in_frame(SHAPE, 17.0)
    values = framed(depth, texture(), 0).round().astype(np.uint8)
    marked = describe(write(tmp_path / "nodata.tif", values, nodata=255))
    mask = write(tmp_path / "mask.tif", np.full(SHAPE, 1, np.uint8))
    masked = describe(write(tmp_path / "a.tif", values), mask=mask)
    with_mask = write(tmp_path / "b.tif", values)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(with_mask, "r+") as dataset:
        dataset.write_mask(np.full(SHAPE, 255, np.uint8))
    for info in (marked, masked, describe(with_mask)):
        assert without_collar(info) == (info, ())


def test_note_names_file_value_and_share(tmp_path: Path) -> None:
    depth = depth_in_frame(SHAPE, 17.0)
    path = write(tmp_path / "turned.tif", framed(depth, texture(), 0).round().astype(np.uint8))
    info, (note,) = collared(path)
    assert info.collar is not None
    assert info.collar.share == pytest.approx((depth < 0).mean(), abs=0.02)
    assert "turned.tif" in note
    assert "(value 0)" in note
    assert f"{100 * info.collar.share:.2g} %" in note


def test_a_narrow_border_is_masked_without_a_word(tmp_path: Path) -> None:
    values = texture((600, 720)).round().clip(1, 255).astype(np.uint8)
    values[:, :3] = 0
    info, notes = collared(write(tmp_path / "a.tif", values))
    assert info.collar is not None
    assert 0 < info.collar.share < 0.01
    assert notes == ()


def test_pair_is_matched_without_the_collar(tmp_path: Path) -> None:
    """Both rasters have the same black corners: their straight edges would agree on no displacement."""
    shape, moved = (260, 260), (3, -2)
    depth = depth_in_frame(shape, 20.0)
    ground = texture((280, 280), smooth_px=1.5)
    first = ground[10:270, 10:270]
    second = ground[10 - moved[1] : 270 - moved[1], 10 - moved[0] : 270 - moved[0]]
    grid = Grid(shape, Affine(10, 0, 500_000, 0, -10, 5_000_000), CRS.from_epsg(32633))
    paths = [
        write(
            tmp_path / name,
            framed(depth, part, 0).round().astype(np.uint8),
            crs=grid.crs,
            transform=grid.transform,
        )
        for name, part in (("ref.tif", first), ("tgt.tif", second))
    ]
    events: list[Event] = []
    settings = Settings(template=61, window=41, features=100)
    found = register_pair(paths[0], paths[1], settings, on_event=events.append, match_only=True)
    notes = [event.message for event in events if isinstance(event, Warned)]
    assert sum("constant border" in note for note in notes) == 2
    points = found.tie_points.select("matched")
    assert len(points) > 30
    off_px = points.displacement_px - moved
    assert np.hypot(*off_px.T).max() < 0.5
    assert np.hypot(*np.median(off_px, axis=0)) < 0.05
    row, col = (np.floor(points.reference_px[:, axis]).astype(int) for axis in (1, 0))
    assert (depth[row, col] > 0).all()


def scan(degrees: float, tone: float, seed: int) -> tuple[NDArray[np.uint8], Array]:
    """Return a frame on film of a tone, with marks and a strip of text, and how deep pixels lie inside it."""
    depth = np.minimum(depth_in_frame(SHAPE, degrees, 0.87), 40.0)
    values = np.where(depth > 0, texture(seed=seed), tone)
    values[4:10, 60:200:7] = 128  # text
    row, col = np.indices(SHAPE)
    for down, across in ((12, 12), (12, 348), (288, 12), (288, 348)):
        values[np.abs(np.hypot(row - down, col - across) - 5) < 1.5] = 128
    noisy = values + np.random.default_rng(seed).normal(0, 3, SHAPE)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), depth


@pytest.mark.parametrize("degrees", [0.0, 0.9, -1.3])
@pytest.mark.parametrize(("tone", "dtype"), [(6, np.uint8), (250, np.uint8), (6, np.uint16)])
def test_border_of_a_scanned_frame(tmp_path: Path, degrees: float, tone: float, dtype: type) -> None:
    """Noise of the film, fiducial marks and text do not hide it."""
    values, depth = scan(degrees, tone, 0)
    path = write(tmp_path / "a.tif", values.astype(dtype) * (1 if dtype is np.uint8 else 200))
    found = valid(path)
    assert not found[depth < -0.5].any()
    assert found[depth > 8].all()
    assert "border of a scanned frame (tone about" in collared(path)[1][0]
