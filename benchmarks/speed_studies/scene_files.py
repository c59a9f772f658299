"""The scenes of the benchmark: two bands of one landscape, the target displaced by a known smooth field.

The ground is evaluated where the displacement says: nothing is resampled. All sizes begin at the same corner
of the same landscape, so a small scene is a part of the larger ones.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.windows import Window

from benchmarks.speed_studies.coordinate_noise import add_pixel_noise
from benchmarks.speed_studies.land import RED, THERMAL, land_row

Float64 = NDArray[np.float64]

SEED: Final = 3
PIXEL_M: Final = 10.0
CRS: Final = "EPSG:32633"
ORIGIN_XY_M: Final = (412_180.0, 5_278_220.0)
OVERVIEWS_FROM_PX: Final = 4096
STRIP_ROWS: Final = 128
CACHE_BYTES: Final = 2**27
NOISE_DN: Final = (30.0, 20.0)

# One row an axis (col, row): mean displacement, px; then amplitude, px, waves a px along columns and rows,
# and phase of two waves, about 4,000 and 1,400 px long.
_DISPLACEMENT: Final = np.array(
    [
        [0.35, 0.80, 1 / 5200, 1 / 6500, 0.5, 0.35, 1 / 2100, -1 / 1900, 1.1],
        [-0.25, 0.85, 1 / 7000, -1 / 4700, 1.9, 0.40, 1 / 1800, 1 / 2300, 4.0],
    ]
)


@dataclass(frozen=True, slots=True)
class ScenePair:
    """Two files of one scene."""

    side_px: int
    reference: Path
    target: Path


def displacement_px(predicted_px: Float64) -> Float64:
    """Return observed minus predicted target position at predicted positions (..., 2), px."""
    col, row = np.moveaxis(np.asarray(predicted_px, dtype=np.float64), -1, 0)
    axes = []
    for mean, *waves in _DISPLACEMENT:
        total = np.full(np.broadcast(col, row).shape, mean)
        for amplitude, per_col, per_row, phase in np.reshape(waves, (-1, 4)):
            total = total + amplitude * np.sin(2 * np.pi * (per_col * col + per_row * row) + phase)
        axes.append(total)
    return np.stack(axes, axis=-1)


def predicted_px(observed_px: Float64) -> Float64:
    """Return where the ground seen at observed positions (..., 2) is predicted: the inverse of p + d(p)."""
    predicted = observed_px - displacement_px(observed_px)
    for _ in range(3):  # d changes by less than 0.003 px a px: each pass gains more than two digits
        predicted = observed_px - displacement_px(predicted)
    return predicted


def make_pair(folder: Path, side_px: int) -> ScenePair:
    """Write both bands of a scene, or return those that an earlier run left in the folder."""
    pair = ScenePair(side_px, folder / f"red_{side_px}.tif", folder / f"thermal_{side_px}.tif")
    folder.mkdir(parents=True, exist_ok=True)
    for path, band in ((pair.reference, RED), (pair.target, THERMAL)):
        if not path.exists():
            unfinished = path.with_suffix(".part.tif")
            _write(unfinished, side_px, band)
            unfinished.replace(path)
    return pair


def strip(band: int, first_row: int, rows: int, cols: int) -> NDArray[np.uint16]:
    """Render rows of a band, from column 0: digital numbers, the thermal band displaced."""
    image = np.empty((rows, cols), np.uint16)
    x_px = np.arange(cols) + 0.5
    for row in range(rows):
        y_px = np.full(cols, first_row + row + 0.5)
        if band == THERMAL:
            seen = predicted_px(np.stack([x_px, y_px], axis=-1))
            values = land_row(np.ascontiguousarray(seen[:, 0]), np.ascontiguousarray(seen[:, 1]), band, SEED)
            dn = 24000.0 + 220.0 * values
        else:
            dn = 6000.0 + 40000.0 * land_row(x_px, y_px, band, SEED)
        add_pixel_noise(dn, first_row + row, SEED * 10 + band, NOISE_DN[band])
        image[row] = np.clip(np.rint(dn), 1, 65535)
    return image


def _strips(band: int, side_px: int) -> Iterator[tuple[int, NDArray[np.uint16]]]:
    """Yield first row and pixels of each strip, a few at a time."""
    threads = os.cpu_count() or 1
    starts = list(range(0, side_px, STRIP_ROWS))

    def render(start: int) -> NDArray[np.uint16]:
        return strip(band, start, min(STRIP_ROWS, side_px - start), side_px)

    with ThreadPoolExecutor(threads) as pool:
        for first in range(0, len(starts), 4 * threads):
            some = starts[first : first + 4 * threads]
            yield from zip(some, pool.map(render, some), strict=True)


def _write(path: Path, side_px: int, band: int) -> None:
    """Write a band as agencies deliver it: tiled, compressed, large ones with overviews."""
    profile = {
        "driver": "GTiff",
        "width": side_px,
        "height": side_px,
        "count": 1,
        "dtype": "uint16",
        "nodata": 0,
        "crs": CRS,
        "transform": Affine(PIXEL_M, 0.0, ORIGIN_XY_M[0], 0.0, -PIXEL_M, ORIGIN_XY_M[1]),
        "tiled": True,
        "blockxsize": 512,
        "blockysize": 512,
        "compress": "deflate",
        "predictor": 2,
        "zlevel": 1,
        "num_threads": "all_cpus",
    }
    with rasterio.Env(GDAL_NUM_THREADS="ALL_CPUS", GDAL_CACHEMAX=CACHE_BYTES):
        with rasterio.open(path, "w", **profile) as file:
            for start, image in _strips(band, side_px):
                file.write(image, 1, window=Window(0, start, side_px, len(image)))
        if side_px >= OVERVIEWS_FROM_PX:
            with rasterio.open(path, "r+") as file:
                levels = [2**n for n in range(1, 10) if side_px >> n >= 256]
                file.build_overviews(levels, Resampling.average)
