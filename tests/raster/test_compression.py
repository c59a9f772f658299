"""Rounding and lossy compression: their steps are found, and count as nothing to match."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pcwlad_geo.options import Settings
from pcwlad_geo.raster.compression import find_blocks, with_compression_blocks
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.source import describe
from pcwlad_geo.registration import register_pair
from pcwlad_geo.types import Bool

Bytes = NDArray[np.uint8]

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def scene(
    shape: tuple[int, int], seed: int, smooth_px: float = 2.0, contrast: float = 25.0
) -> NDArray[np.float64]:
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=shape), smooth_px)
    return np.asarray(128 + contrast * noise / noise.std())


def in_bytes(values: NDArray[np.float64]) -> Bytes:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def compressed(values: NDArray[np.float64], quality: int) -> Bytes:
    """Return the bytes that a JPEG of a quality leaves, in memory."""
    done, coded = cv2.imencode(".jpg", in_bytes(values), [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), np.uint8)


def blocks_of(values: Bytes, valid: Bool | None = None) -> tuple[int, int] | None:
    good = np.ones(values.shape, bool) if valid is None else valid

    def read(window: Window) -> tuple[Bytes, Bool]:
        part = window.slices_in(Window.whole(values.shape))
        return values[part], good[part]

    return find_blocks(read, values.shape)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("quality", [20, 50, 75])
def test_blocks_are_found_where_they_begin(quality: int, seed: int) -> None:
    row, col = np.random.default_rng(seed).integers(0, 8, 2).tolist()
    cropped = compressed(scene((400, 500), seed), quality)[row:, col:]
    assert blocks_of(cropped) == (-row % 8, -col % 8)


@pytest.mark.parametrize("smooth_px", [0.0, 0.7, 2.0, 6.0])
@pytest.mark.parametrize("seed", range(4))
def test_what_was_not_compressed_shows_no_blocks(seed: int, smooth_px: float) -> None:
    assert blocks_of(in_bytes(scene((400, 500), seed, smooth_px))) is None


def test_edges_along_one_axis_are_no_blocks() -> None:
    rows_every_eight = np.repeat(np.random.default_rng(0).uniform(60, 200, (50, 1)), 8, axis=0)
    assert blocks_of(in_bytes(np.broadcast_to(rows_every_eight, (400, 500)))) is None


def test_pixels_without_data_are_left_out() -> None:
    row, col = np.indices((400, 500))
    values = in_bytes(scene((400, 500), 1, 4.0) + 20 * ((row // 8 + col // 8) % 2))
    valid = (row % 8 > 0) & (col % 8 > 0)
    assert blocks_of(values) is not None
    assert blocks_of(values, valid) is None


def test_a_small_or_constant_band_shows_nothing() -> None:
    assert blocks_of(np.zeros((20, 300), np.uint8)) is None
    assert blocks_of(np.full((300, 300), 7, np.uint8)) is None


def test_only_bands_of_eight_bits_are_looked_at(tmp_path: Path) -> None:
    values = compressed(scene((300, 300), 2), 40)
    for dtype, shown in (("uint8", True), ("uint16", False)):
        path = write(tmp_path / f"{dtype}.tif", values.astype(dtype))
        assert with_compression_blocks(describe(path)).shows_blocks is shown


def wall(seed: int) -> NDArray[np.float64]:
    """Return a bare wall: a slope of grey with broad clouds of a third of a grey value."""
    row, col = np.indices((300, 620))
    return 140 + 0.12 * col - 0.1 * row + scene((300, 620), seed, 20.0, 0.3) - 128


def write(path: Path, values: NDArray[np.generic]) -> Path:
    rows, cols = values.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=1, dtype=values.dtype
    ) as dataset:
        dataset.write(values, 1)
    return path


@pytest.mark.parametrize("quality", [35, 60, 100])
def test_two_parts_of_a_bare_wall_have_nothing_to_match(tmp_path: Path, quality: int) -> None:
    """As floats, whose steps may be real, such parts of low quality are registered to each other."""
    values = compressed(wall(2), quality)
    a = write(tmp_path / "a.tif", values[5:265, 3:283])
    b = write(tmp_path / "b.tif", values[11:271, 320:600])
    found = register_pair(a, b, Settings(jobs=1, prealign="none"))
    assert found.status == "rejected"
    assert found.counts["candidates"] == 0


def test_weak_structure_of_whole_numbers_is_matched(tmp_path: Path) -> None:
    """Detail of 2 grey values is little, and well above that of rounding."""
    ground = scene((420, 420), 3, 2.5, 2.5)
    a, b = (
        write(tmp_path / "a.tif", in_bytes(ground[:400, :400])),
        write(tmp_path / "b.tif", in_bytes(255 - ground[6:406, 4:404])),
    )
    found = register_pair(a, b, Settings(jobs=1))
    assert found.status == "registered"
    points = found.tie_points.select("matched", "check", "fit")
    assert np.median(np.hypot(*(points.displacement_px - [-4, -6]).T)) < 0.1
