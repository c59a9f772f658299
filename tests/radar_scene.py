"""A radar on an orbit, the annotation of its Sentinel-1 GRD image, and the image of a scene with relief.

All is simulated forwards: places on the ground to the time and range at which the radar sees them, these to
pixels. The orbit is a circle about a turning earth. The ground range of a line is measured on a sphere at the
height that its part of the orbit is given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pyproj
import rasterio
from numpy.typing import ArrayLike, NDArray
from rasterio.control import GroundControlPoint
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import brentq

from pcwlad_geo.raster import WGS84, Grid, transform_xy
from tests.scenes import render

Array = NDArray[np.float64]

STEM = "s1a-iw-grd-vv-20230809t170000-20230809t170025-049800-05fd00-001"
START = datetime(2023, 8, 9, 17, 0, 0, 123456, tzinfo=timezone.utc)
ORBIT_M, INCLINATION, TURN = 7_071_000.0, np.radians(98.18), 7.2921151467e-5
RATE = float(np.sqrt(3.986004418e14 / ORBIT_M**3))
EARTH_M = 6_371_000.0
LIGHT_M_S = 299_792_458.0
TO_XYZ = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
TO_LON_LAT = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)


@dataclass(frozen=True)
class Radar:
    """A satellite going north, the ground on its right, and the image that it makes."""

    shape: tuple[int, int]
    spacing_m: float
    """Of columns on the ground, and of lines."""
    heights_m: tuple[float, ...]
    """Of the spheres of ground range, at times spread over the image and beyond its ends."""
    node: float
    """Longitude of the satellite at the time 0, radians, and its angle from the equator along the orbit."""
    along: float
    first_s: float
    near_m: float
    """Time of the first line, and slant range of the first column."""

    @staticmethod
    def over(lon: float, lat: float, shape: tuple[int, int], spacing_m: float, heights_m: ArrayLike) -> Radar:
        """Return the radar in the middle of whose image a place at sea level lies."""
        along = float(np.arcsin(np.sin(np.radians(lat)) / np.sin(INCLINATION)))
        behind = float(np.arctan2(np.sin(along) * np.cos(INCLINATION), np.cos(along)))
        heights = tuple(np.asarray(heights_m, float).tolist())
        radar = Radar(shape, spacing_m, heights, np.radians(lon - 6.2) - behind, along, 0.0, 0.0)
        time_s, range_m = radar.seen(np.array([[lon, lat, 0.0]]))
        first_s = float(time_s[0]) - shape[0] / 2 * radar.line_s
        half = shape[1] / 2 * spacing_m
        near_m = brentq(lambda near: radar.slant_m(half, 0.0, near) - range_m[0], 7.5e5, range_m[0])
        return Radar(shape, spacing_m, heights, radar.node, along, first_s, float(near_m))

    @property
    def line_s(self) -> float:
        return self.spacing_m / 6800.0

    @property
    def records_s(self) -> Array:
        """Times of the polynomials after the first line."""
        span_s = self.shape[0] * self.line_s
        return np.linspace(-0.1 * span_s, 1.1 * span_s, len(self.heights_m))

    def orbit(self, time_s: Array) -> tuple[Array, Array]:
        """Return (n, 3) positions and velocities in the earth-fixed frame."""
        angle, turned = self.along + RATE * time_s, self.node - TURN * time_s
        cos, sin = np.cos(angle), np.sin(angle)
        up, ahead = (
            np.stack([a, b * np.cos(INCLINATION), b * np.sin(INCLINATION)], axis=-1)
            for a, b in ((cos, sin), (-sin, cos))
        )

        def fixed(vectors: Array) -> Array:
            x, y, z = vectors.T
            return np.stack(
                [np.cos(turned) * x - np.sin(turned) * y, np.sin(turned) * x + np.cos(turned) * y, z], axis=-1
            )

        position = ORBIT_M * fixed(up)
        return position, ORBIT_M * RATE * fixed(ahead) - np.cross([0.0, 0.0, TURN], position)

    def seen(self, places: Array) -> tuple[Array, Array]:
        """Return the times and slant ranges at which places (longitude, latitude, height) are seen."""
        xyz = np.column_stack(TO_XYZ.transform(*places.T))
        time_s = np.zeros(len(xyz))
        for _ in range(12):
            position, velocity = self.orbit(time_s)
            time_s = time_s + np.einsum("ni,ni->n", velocity, xyz - position) / (velocity**2).sum(axis=1)
        return time_s, np.linalg.norm(xyz - self.orbit(time_s)[0], axis=1)

    def slant_m(self, ground_m: ArrayLike, height_m: ArrayLike, near_m: float = 0.0) -> Array:
        """Return the slant range of a ground range on the sphere of a height."""
        radius, near = EARTH_M + np.asarray(height_m), near_m or self.near_m
        first = np.arccos((ORBIT_M**2 + radius**2 - near**2) / (2 * ORBIT_M * radius))
        angle = first + np.asarray(ground_m) / radius
        return np.sqrt(ORBIT_M**2 + radius**2 - 2 * ORBIT_M * radius * np.cos(angle))

    def _slant_of(self, ground_m: Array, time_s: Array) -> Array:
        """Return the slant range of ground ranges in lines of a time, linear between those of the records."""
        at = np.interp(time_s, self.records_s, np.arange(len(self.heights_m), dtype=float))
        first = np.minimum(at.astype(int), len(self.heights_m) - 2)
        low, high = (self.slant_m(ground_m, np.array(self.heights_m)[first + n]) for n in (0, 1))
        return low + (at - first) * (high - low)

    def pixels(self, places: Array) -> Array:
        """Return the pixels (col, row), corner-based, of places (longitude, latitude, height)."""
        time_s, range_m = self.seen(places)
        middle_m = self.slant_m(self.shape[1] / 2 * self.spacing_m, 0.0)
        line_s = time_s - self.first_s - (range_m - middle_m) / LIGHT_M_S
        low, high = -5e4 * np.ones(len(places)), 5e4 + np.full(len(places), self.shape[1] * self.spacing_m)
        for _ in range(40):
            ground_m = (low + high) / 2
            nearer = self._slant_of(ground_m, line_s) < range_m
            low, high = np.where(nearer, ground_m, low), np.where(nearer, high, ground_m)
        return np.column_stack([low / self.spacing_m, line_s / self.line_s]) + 0.5

    def place(self, pixel: tuple[float, float], height_m: float) -> Array:
        """Return the place (longitude, latitude, height) at a height that a sample (col, row) shows."""
        line_s = np.array([pixel[1] * self.line_s])
        range_m = self._slant_of(np.array([pixel[0] * self.spacing_m]), line_s)
        middle_m = self.slant_m(self.shape[1] / 2 * self.spacing_m, 0.0)
        position, velocity = self.orbit(self.first_s + line_s + (range_m - middle_m) / LIGHT_M_S)
        ahead = velocity[0] / np.linalg.norm(velocity)
        right = np.cross(ahead, position[0])
        right /= np.linalg.norm(right)
        down = np.cross(ahead, right)

        def point(angle: float) -> Array:
            xyz = position[0] + range_m[0] * (np.cos(angle) * down + np.sin(angle) * right)
            return np.array(TO_LON_LAT.transform(*xyz))

        return point(brentq(lambda angle: point(angle)[2] - height_m, 0.2, 1.1))

    def annotation(self, ground: Callable[[Array], Array]) -> tuple[str, list[tuple[tuple[int, int], Array]]]:
        """Return the annotation's text, and samples (col, row) with their places of the geolocation grid.

        The heights of that are those of the ground at (n, 2) longitudes and latitudes.
        """
        rows, cols = self.shape
        nodes = [(int(c), int(r)) for r in np.linspace(0, rows - 1, 5) for c in np.linspace(0, cols - 1, 6)]
        grid = []
        for node in nodes:
            place = self.place(node, 0.0)
            for _ in range(4):
                place = self.place(node, float(ground(place[None, :2])[0]))
            grid.append((node, place))
        return self._text(grid), grid

    def _text(self, grid: list[tuple[tuple[int, int], Array]]) -> str:
        def when(time_s: float) -> str:
            return (START + timedelta(seconds=time_s)).replace(tzinfo=None).isoformat(timespec="microseconds")

        orbit = ""
        for time_s in np.arange(-40.0, 50.0, 10.0):
            vectors = self.orbit(np.array([self.first_s + time_s]))
            parts = [
                f"<{tag}><x>{x!r}</x><y>{y!r}</y><z>{z!r}</z></{tag}>"
                for tag, (x, y, z) in zip(
                    ("position", "velocity"), [at[0].tolist() for at in vectors], strict=True
                )
            ]
            orbit += f"<orbit><time>{when(time_s)}</time><frame>Earth Fixed</frame>{''.join(parts)}</orbit>"
        ground_m = np.linspace(-0.1, 1.1, 99) * self.shape[1] * self.spacing_m
        records = ""
        for time_s, height in zip(self.records_s.tolist(), self.heights_m, strict=True):
            fit = np.polynomial.Polynomial.fit(ground_m, self.slant_m(ground_m, height), 8).convert().coef
            records += (
                f"<coordinateConversion><azimuthTime>{when(time_s)}</azimuthTime><gr0>0.0</gr0>"
                f"<grsrCoefficients>{' '.join(map(repr, fit.tolist()))}</grsrCoefficients>"
                "</coordinateConversion>"
            )
        points = ""
        middle_m = self.slant_m(self.shape[1] / 2 * self.spacing_m, 0.0)
        for (col, row), place in grid:
            range_m = float(self.seen(place[None])[1][0])
            time_s = row * self.line_s + (range_m - float(middle_m)) / LIGHT_M_S
            points += (
                f"<geolocationGridPoint><azimuthTime>{when(time_s)}</azimuthTime>"
                f"<slantRangeTime>{2 * range_m / LIGHT_M_S!r}</slantRangeTime><line>{row}</line>"
                f"<pixel>{col}</pixel><latitude>{float(place[1])!r}</latitude>"
                f"<longitude>{float(place[0])!r}</longitude><height>{float(place[2])!r}</height>"
                "</geolocationGridPoint>"
            )
        return (
            f"<product><generalAnnotation><orbitList>{orbit}</orbitList></generalAnnotation><imageAnnotation>"
            f"<imageInformation><productFirstLineUtcTime>{when(0.0)}</productFirstLineUtcTime>"
            f"<azimuthTimeInterval>{self.line_s!r}</azimuthTimeInterval>"
            f"<rangePixelSpacing>{self.spacing_m!r}</rangePixelSpacing>"
            f"<numberOfSamples>{self.shape[1]}</numberOfSamples><numberOfLines>{self.shape[0]}</numberOfLines>"
            "</imageInformation></imageAnnotation><geolocationGrid><geolocationGridPointList>"
            f"{points}</geolocationGridPointList></geolocationGrid><coordinateConversion>"
            f"<coordinateConversionList>{records}</coordinateConversionList></coordinateConversion></product>"
        )

    def image(self, scene: Grid, ground: Callable[[Array], Array]) -> NDArray[np.uint16]:
        """Return the image of a scene, each finely rendered place put where it is seen, with speckle."""
        values = render(scene, noise=0.0)
        centres = [np.arange(size) + 0.5 for size in scene.shape]
        nodes = [np.linspace(at[0], at[-1], len(at) // 4) for at in centres]  # the relief is smooth
        lattice = np.stack(np.meshgrid(nodes[1], nodes[0]), -1).reshape(-1, 2)
        lon_lat = transform_xy(scene.to_xy(lattice), scene.crs, WGS84)
        seen = self.pixels(np.column_stack([lon_lat, ground(lon_lat)])).reshape(len(nodes[0]), -1, 2) - 0.5
        splines = [RectBivariateSpline(*nodes, seen[..., axis])(*centres) for axis in (0, 1)]
        at = np.stack(splines, axis=-1).reshape(-1, 2)
        total, weight = np.zeros(self.shape), np.zeros(self.shape)
        low = np.floor(at).astype(int)
        for right in (0, 1):
            for down in (0, 1):
                col, row = low[:, 0] + right, low[:, 1] + down
                share = np.prod(1.0 - np.abs(at - np.column_stack([col, row])), axis=1)
                inside = (col >= 0) & (col < self.shape[1]) & (row >= 0) & (row < self.shape[0])
                place = (row[inside], col[inside])
                np.add.at(total, place, (share * values.ravel())[inside])
                np.add.at(weight, place, share[inside])
        speckle = np.sqrt(np.random.default_rng(4).gamma(4.0, 0.25, self.shape))
        values = total / np.maximum(weight, 1e-9) * speckle
        return np.where(weight > 0.2, np.rint(values * 20), 0).astype(np.uint16)

    def write(self, folder: Path, scene: Grid, ground: Callable[[Array], Array]) -> Path:
        """Write the SAFE folder of the image of a scene, and return its path."""
        safe = folder / "S1A_IW_GRDH_1SDV_20230809T170000_20230809T170025_049800_05FD00_ABCD.SAFE"
        for name in ("measurement", "annotation"):
            (safe / name).mkdir(parents=True)
        text, grid = self.annotation(ground)
        (safe / "annotation" / f"{STEM}.xml").write_text(text)
        (safe / "manifest.safe").write_text("<manifest/>")
        gcps = [GroundControlPoint(row=row, col=col, x=at[0], y=at[1], z=at[2]) for (col, row), at in grid]
        shape = {"count": 1, "height": self.shape[0], "width": self.shape[1], "dtype": "uint16"}
        image = safe / "measurement" / f"{STEM}.tiff"
        with rasterio.open(image, "w", driver="GTiff", gcps=gcps, crs=WGS84, **shape) as file:
            file.write(self.image(scene, ground), 1)
        return safe
