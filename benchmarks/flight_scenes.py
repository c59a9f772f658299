"""Scanned photographs of a simulated flight over the synthetic landscape, and a later orthophoto."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rasterio
import shapely
from affine import Affine
from numpy.typing import NDArray
from pyogrio.raw import write as write_vector
from rasterio.errors import NotGeoreferencedWarning

from benchmarks.unrelated import REPOSITORY
from pcwlad_geo.raster.gdal import ignoring

sys.path.insert(0, str(REPOSITORY / "sample_data"))
from landscape import ground, landscape

Array = NDArray[np.float64]
SEED = 7
PX_M = 10.0
"""Pixel of the orthophoto."""
EPSG = 32633
ORIGIN = (500000.0, 4600000.0)
SIDE_PX = 500
"""Longer side of a photograph, without its frame."""
FRAME_PX = 24
INDEX_M = 300.0
"""How far off the flight index may be."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph: where each of its pixels lies."""

    name: str
    matrix: Array
    """(3, 3) homography from px (col, row) of the scan to map coordinates."""
    shape: tuple[int, int]

    def to_xy(self, at_px: Array) -> Array:
        """Return the (n, 2) map coordinates of (n, 2) px."""
        mapped = np.column_stack([at_px, np.ones(len(at_px))]) @ self.matrix.T
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def write_orthophoto(path: Path, side_px: int) -> None:
    """Write the orthophoto, a square with its pyramid."""
    land = landscape((side_px, side_px), SEED, pixel_m=PX_M, oversample=1)
    grey = _grey(land.red, land.thermal, 0.0)
    with rasterio.open(
        path, "w", driver="GTiff", height=side_px, width=side_px, count=1, dtype="uint8", tiled=True,
        crs=f"EPSG:{EPSG}", transform=Affine.translation(*ORIGIN) @ Affine.scale(PX_M, -PX_M),
    ) as out:  # fmt: skip
        out.write(grey, 1)
        out.build_overviews([2, 4, 8])


def fly(folder: Path, count: int, side_px: int, seed: int = 1) -> list[Photograph]:
    """Write `count` photographs in strips that fly to and fro, and their index, flight.gpkg."""
    random = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    strips = max(1, round(np.sqrt(count / 2.4)))
    a_strip = -(-count // strips)
    size_m = side_px * PX_M
    photographs, places = [], []
    for number in range(count):
        strip, along = divmod(number, a_strip)
        middle = np.array([(along + 0.5) / a_strip, (strip + 0.5) / strips]) * 0.72 * size_m + 0.14 * size_m
        heading = np.pi * (strip % 2) + random.normal() * np.radians(4)
        px_m = 0.8 * PX_M * random.uniform(0.95, 1.05)
        photograph = _photograph(f"roll7_{number:04d}", middle, heading, px_m, random)
        _write(folder / f"{photograph.name}.tif", photograph, random)
        photographs.append(photograph)
        off = random.normal(size=2)
        off *= INDEX_M * np.sqrt(random.uniform()) / np.hypot(*off)
        xy = np.array(ORIGIN) + middle * [1, -1] + off
        places.append(shapely.Point(*xy))
    names = np.array([f"D:\\scans\\{photograph.name.upper()}.TIF" for photograph in photographs], object)
    write_vector(
        folder / "flight.gpkg", shapely.to_wkb(np.array(places)), [names], ["file"], crs=f"EPSG:{EPSG}",
        geometry_type="Point",
    )  # fmt: skip
    return photographs


def _photograph(
    name: str, middle_m: Array, heading: float, px_m: float, random: np.random.Generator
) -> Photograph:
    """Return a photograph that looks down nearly: its tilt of some degrees makes a homography."""
    rows, cols = round(SIDE_PX * 0.96) + 2 * FRAME_PX, SIDE_PX + 2 * FRAME_PX
    focal = 1.1 * SIDE_PX
    tilt = random.normal(size=2) * np.radians(1.2)
    turn = np.asarray(cv2.Rodrigues(np.array([tilt[0], tilt[1], 0.0]))[0])
    about = np.asarray(cv2.Rodrigues(np.array([0.0, 0.0, heading]))[0])
    camera = np.array([[1, 0, -cols / 2], [0, 1, -rows / 2], [0, 0, focal]])
    height = px_m * focal
    rays = about @ turn @ camera
    to_ground = np.array([[height, 0, middle_m[0]], [0, height, middle_m[1]], [0, 0, 1.0]])
    to_map = np.array([[1, 0, ORIGIN[0]], [0, -1, ORIGIN[1]], [0, 0, 1.0]])
    return Photograph(name, to_map @ to_ground @ rays, (rows, cols))


def _write(path: Path, photograph: Photograph, random: np.random.Generator) -> None:
    """Write a scan: film of another date, grain, vignetting, a black frame with fiducial marks."""
    rows, cols = photograph.shape
    col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    xy = photograph.to_xy(np.column_stack([col.ravel(), row.ravel()])) - np.array(ORIGIN)
    x_m, y_m = xy.T.reshape(2, rows, cols)
    land = ground(x_m, y_m, SEED)
    values = _grey(land.red, land.thermal, 0.35).astype(np.float64)
    radius = np.hypot(col - cols / 2, row - rows / 2) / (cols / 2)
    values = values * (1 - 0.25 * radius**2) + random.normal(size=values.shape) * 7
    values = cv2.GaussianBlur(values, (0, 0), 0.7) + random.normal(size=values.shape) * 2
    image = np.clip(values, 12, 255)
    inside = (np.abs(col - cols / 2) < cols / 2 - FRAME_PX) & (np.abs(row - rows / 2) < rows / 2 - FRAME_PX)
    image = np.where(inside, image, 4 + random.normal(size=values.shape))
    for x in (FRAME_PX // 2, cols - FRAME_PX // 2):
        for y in (FRAME_PX // 2, rows - FRAME_PX // 2):
            cv2.circle(image, (x, y), 5, 240.0, 1)
    with (
        ignoring(NotGeoreferencedWarning),
        rasterio.open(
            path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype="uint8", compress="deflate"
        ) as out,
    ):
        out.write(np.clip(np.rint(image), 0, 255).astype(np.uint8), 1)


def _grey(red: NDArray[np.float32], thermal: NDArray[np.float32], other: float) -> NDArray[np.uint8]:
    """Return grey values of a film; `other` is the share of what another date sees otherwise."""
    values = 40 + 500 * red - other * 4 * (thermal - 298.0)
    return np.clip(np.rint(values), 1, 255).astype(np.uint8)
