"""Blocks come complete, from threads that end."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.windows import Window

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.warped_views import READING, UnreadableParts, warped_blocks

SHAPE = (130, 170)
WINDOWS = [
    Window(col, row, min(40, 170 - col), min(30, 130 - row))
    for row in range(0, 130, 30)
    for col in range(0, 170, 40)
]


@pytest.fixture
def image() -> np.ndarray:
    return np.random.default_rng(3).integers(0, 60000, (2, *SHAPE)).astype(np.uint16)


@pytest.fixture
def raster(tmp_path: Path, image: np.ndarray) -> str:
    path = tmp_path / "a.tif"
    profile = {"height": SHAPE[0], "width": SHAPE[1], "count": 2, "dtype": "uint16", "crs": "EPSG:32633"}
    with rasterio.open(
        path, "w", driver="GTiff", transform=Affine(10, 0, 5e5, 0, -10, 5e6), **profile
    ) as file:
        file.write(image)
    return str(path)


def unreadable(name: str) -> UnreadableParts:
    return UnreadableParts(name, SHAPE[0] * SHAPE[1])


def threads() -> set[threading.Thread]:
    return set(threading.enumerate())


def test_every_window_comes_once_with_its_pixels(raster: str, image: np.ndarray) -> None:
    before = threads()
    seen = np.zeros_like(image)
    for window, block in warped_blocks(unreadable(raster), [partial(open_raster, raster)], WINDOWS):
        rows, cols = window.toslices()
        assert not seen[:, rows, cols].any()
        seen[:, rows, cols] = block
    np.testing.assert_array_equal(seen, image)
    assert threads() == before


def test_no_more_blocks_are_read_ahead_than_there_are_threads(
    raster: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pcwlad_geo.raster.warped_views.READING", replace(READING, max_threads=2))
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    before = threads()
    blocks = warped_blocks(unreadable(raster), [partial(open_raster, raster)], WINDOWS)
    next(blocks)
    assert len(threads() - before) == 2
    blocks.close()  # both threads wait to hand over: they must end all the same
    assert threads() == before


def test_what_cannot_be_read_is_an_input_error(raster: str) -> None:
    before = threads()
    with pytest.raises(InputError, match=r"absent\.tif"):
        list(warped_blocks(unreadable("absent.tif"), [partial(open_raster, "absent.tif")], WINDOWS))
    with Path(raster).open("r+b") as file:
        file.truncate(20_000)
    with pytest.raises(InputError, match=r"a\.tif cannot be read"):
        list(warped_blocks(unreadable(raster), [partial(open_raster, raster)], WINDOWS))
    assert threads() == before
