"""Three sensors over the same ground: the registrations must close, and agree in both directions.

They close at one pixel size. Two images that differ in date, sun and sensor do not show quite the same
structure, and what is left of it at 30 m lies elsewhere than what their pixels of 10 m show: the same two
files, averaged, are then displaced otherwise, by any measure. A triangle of legs of several pixel sizes shows
that difference.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine

from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.tables import Cell, Check, Table, at_most
from pcwlad_geo.options import Settings

CLOSES_M = 1.0
ONE_SIZE = "all averaged to 30 m"
AGREES_PX = 0.02


@dataclass(frozen=True, slots=True)
class Scene:
    """An image of the ground; its red band is registered."""

    name: str
    path: Path
    band: int
    pixel_m: float

    def averaged(self, pixel_m: float, folder: Path) -> Scene:
        """Write the red band averaged to larger pixels, a whole number of these across, into the folder."""
        factor = round(pixel_m / self.pixel_m)
        with rasterio.open(self.path) as file:
            rows, cols = (length // factor for length in file.shape)
            values = file.read(self.band)[: rows * factor, : cols * factor].astype(np.float32)
            profile = {
                "driver": "GTiff",
                "count": 1,
                "dtype": "float32",
                "crs": file.crs,
                "nodata": file.nodata,
            }
            transform = file.transform * Affine.scale(factor)
        path = folder / f"{self.path.stem}_{pixel_m:.0f}m.tif"
        with rasterio.open(path, "w", width=cols, height=rows, transform=transform, **profile) as file:
            file.write(values.reshape(rows, factor, cols, factor).mean(axis=(1, 3)), 1)
        return replace(self, path=path, band=1, pixel_m=pixel_m)


def closure(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield two tables of registrations with their closure, and one of the two directions."""
    folder = data / "cross_sensor"
    aerial = Scene("aerial", folder / "ngi_rgb_byte_1.tif", 1, 5.0)
    sentinel = Scene("Sentinel-2", folder / "sentinel2_b432_byte.tif", 1, 10.0)
    landsat = Scene("Landsat 8", folder / "landsat8_byte.tif", 4, 30.0)
    legs = [(aerial, sentinel), (sentinel, landsat), (aerial, landsat)]
    ways = legs + [(second, first) for first, second in legs]
    found = dict(zip(ways, runner([_job(*way) for way in ways]), strict=True))
    yield _triangle("own pixel sizes", legs, [found[leg] for leg in legs])
    aerial_30m, sentinel_30m = (scene.averaged(landsat.pixel_m, scratch) for scene in (aerial, sentinel))
    alike = [(aerial_30m, sentinel_30m), (sentinel_30m, landsat), (aerial_30m, landsat)]
    outcomes = runner([_job(*leg) for leg in alike])
    yield _triangle(ONE_SIZE, alike, outcomes)
    yield _directions([(a, b, found[a, b], found[b, a]) for a, b in legs])


def _job(reference: Scene, target: Scene) -> Job:
    settings = Settings(ref_band=reference.band, tgt_band=target.band)
    return Job(reference.path, target.path, settings, match_only=False)


def _triangle(pixels: str, legs: list[tuple[Scene, Scene]], outcomes: list[Outcome]) -> Table:
    """Medians over the ground that all three registrations have points on."""
    low = np.max([outcome.points.xy.min(axis=0) for outcome in outcomes], axis=0)
    high = np.min([outcome.points.xy.max(axis=0) for outcome in outcomes], axis=0)
    rows: list[list[Cell]] = []
    medians = []
    for (first, second), outcome in zip(legs, outcomes, strict=True):
        points, name = outcome.points, f"{first.name} - {second.name}"
        common = ((points.xy >= low) & (points.xy <= high)).all(axis=1)
        moved = points.displacement_m[common]
        medians.append(np.median(moved, axis=0))
        rows.append(
            [name, len(points), int(common.sum()), *(f"{v:+.2f}" for v in (*medians[-1], *moved.std(axis=0)))]
        )
    misclosure = medians[0] + medians[1] - medians[2]
    rows.append(["misclosure", "", "", *(f"{value:+.2f}" for value in misclosure), "", ""])
    checks = [
        at_most(f"triangle, {pixels}, {axis}: misclosure", float(abs(value)), CLOSES_M, "m", 2)
        for axis, value in zip("xy", misclosure, strict=True)
        if pixels == ONE_SIZE
    ]
    header = ("registration", "points", "common ground", "median x, m", "y", "std x, m", "y")
    return Table(f"Closure of the triangle, {pixels}, metres", header, rows, checks)


def _directions(legs: list[tuple[Scene, Scene, Outcome, Outcome]]) -> Table:
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for first, second, forward, backward in legs:
        pixel_m = max(first.pixel_m, second.pixel_m)
        back = _there_and_back_m(forward, backward) / pixel_m
        median, rms = np.median(back, axis=0), np.sqrt((back**2).mean(axis=0))
        name = f"{first.name} - {second.name}"
        rows.append([name, f"{pixel_m:.0f} m", *(f"{value:+.4f}" for value in (*median, *rms))])
        checks.append(
            at_most(f"{name}, there and back: larger axis", float(np.abs(median).max()), AGREES_PX, "px", 4)
        )
    header = ("registration", "pixel", "median x, px", "y", "RMS x, px", "y")
    return Table("Registration there and back: the coarser image's pixels", header, rows, checks)


def _there_and_back_m(forward: Outcome, backward: Outcome) -> Array:
    """Map the forward tie points through both fitted models; (n, 2) metres away from where they began."""
    start = forward.points.xy
    return np.asarray(_through(backward, _through(forward, start)) - start)


def _through(outcome: Outcome, xy: Array) -> Array:
    """Return where ground at (x, y) of the reference is seen in the target, by its georeferencing."""
    correction = outcome.result.model
    if correction is None:
        raise RuntimeError(f"refused: {outcome.reason}")
    grid = outcome.result.target.grid
    return grid.to_xy(correction.forward(grid.to_px(xy)))
