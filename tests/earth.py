"""Rasters of one ground in any CRS: a function of the place on the earth, evaluated at the pixel centres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pyproj
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.raster.grid import apply

Array = NDArray[np.float64]

RADIUS_M = 6_371_000.0
SINUSOIDAL = "+proj=sinu +R=6371007.181 +units=m +no_defs"
GEOSTATIONARY = "+proj=geos +h=35786023 +lon_0={} +sweep=x +ellps=GRS80 +units=m +no_defs"
LONLAT = "EPSG:4326"


@dataclass(frozen=True)
class Raster:
    """A raster to be written: its place is that of its middle, unless map coordinates are given."""

    name: str
    crs: str
    lon_lat: tuple[float, float] = (0.0, 0.0)
    px_m: float = 100.0
    """Ground length of a pixel in its middle."""
    shape: tuple[int, int] = (220, 220)
    turns: int = 0
    """Turns around the earth by which the coordinates are counted further east than PROJ does."""
    bounds: tuple[float, float, float, float] | None = None
    """Left, bottom, right, top in map units, instead of a middle and the size of a pixel."""

    @property
    def transform(self) -> Affine:
        """The true geotransform."""
        rows, cols = self.shape
        if self.bounds is not None:
            left, bottom, right, top = self.bounds
            return Affine((right - left) / cols, 0, left, 0, (bottom - top) / rows, top)
        to_map = pyproj.Transformer.from_crs(LONLAT, self.crs, always_xy=True)
        lon, lat = self.lon_lat
        steps_m = (
            50.0 * self.px_m * np.array([1.0, 0.0, -1.0, 0.0]),
            50.0 * self.px_m * np.array([0, 1.0, 0, -1]),
        )
        inner = 1.0 - 1e-3 if abs(lon) == 180.0 else 1.0
        lons = lon * inner + np.degrees(steps_m[0] / RADIUS_M / np.cos(np.radians(lat)))
        lats = lat + np.degrees(steps_m[1] / RADIUS_M)
        x, y = to_map.transform(lons, lats)
        east, north = np.hypot(x[0] - x[2], y[0] - y[2]) / 100, np.hypot(x[1] - x[3], y[1] - y[3]) / 100
        if not pyproj.CRS(self.crs).is_geographic:
            east = north = float(
                np.sqrt(abs((x[0] - x[2]) * (y[1] - y[3]) - (x[1] - x[3]) * (y[0] - y[2]))) / 100
            )
        middle_x, middle_y = to_map.transform(lon, lat)
        middle_x += self.turns * (360.0 if pyproj.CRS(self.crs).is_geographic else 2 * np.pi * 6378137.0)
        return Affine(east, 0, middle_x - east * cols / 2, 0, -north, middle_y + north * rows / 2)

    def write(self, folder: Path, shift_px: tuple[float, float] = (0.0, 0.0)) -> Path:
        """Write it with a georeferencing that is off, so that its displacement is `shift_px` (col, row)."""
        rows, cols = self.shape
        col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
        x, y = apply(self.transform, np.stack([col.ravel(), row.ravel()], axis=1)).T
        to_ground = pyproj.Transformer.from_crs(self.crs, LONLAT, always_xy=True)
        lon, lat = (np.asarray(each) for each in to_ground.transform(x, y))
        back_x, back_y = to_ground.transform(lon, lat, direction="INVERSE")
        turn = 360.0 if pyproj.CRS(self.crs).is_geographic else 2 * np.pi * 6378137.0
        with np.errstate(invalid="ignore"):
            off = np.abs((back_x - x) / turn - np.rint((back_x - x) / turn) * (self.periodic))
            known = np.isfinite(lon) & np.isfinite(lat) & (off < 1e-6) & (np.abs(back_y - y) < 1e-6 * turn)
            known &= np.abs(lat) <= 90.0
        values = np.zeros(rows * cols, np.uint16)
        values[known] = np.rint(20_000 + 5_000 * ground(lon[known], lat[known], self.px_m)).astype(np.uint16)
        path = folder / f"{self.name.replace(' ', '_')}.tif"
        profile = {
            "driver": "GTiff",
            "count": 1,
            "height": rows,
            "width": cols,
            "dtype": "uint16",
            "nodata": 0,
        }
        moved = self.transform @ Affine.translation(*shift_px)
        with rasterio.open(path, "w", **profile, crs=CRS.from_user_input(self.crs), transform=moved) as file:
            file.write(values.reshape(self.shape), 1)
        return path

    @property
    def periodic(self) -> bool:
        """Whether x counts turns around the earth."""
        return self.crs in (LONLAT, "EPSG:3857", "EPSG:3832")


@cache
def _waves(px_m: float) -> tuple[Array, Array, Array]:
    random = np.random.default_rng(4)
    directions = random.normal(size=(80, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lengths_m = px_m * np.geomspace(6.0, 60.0, 80)
    return directions * (2 * np.pi / lengths_m)[:, None], random.uniform(0, 2 * np.pi, 80), lengths_m**0.3


def ground(lon: Array, lat: Array, px_m: float) -> Array:
    """Return the brightness at places on the earth: waves of 6 to 60 pixels of a size, one on average."""
    numbers, phases, weights = _waves(px_m)
    lam, phi = np.radians(lon), np.radians(lat)
    at_m = RADIUS_M * np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)])
    total = np.zeros(len(lon))
    for number, phase, weight in zip(numbers, phases, weights / np.linalg.norm(weights), strict=True):
        total += weight * np.cos(number @ at_m + phase)
    return np.clip(total, -3.5, 3.5)
