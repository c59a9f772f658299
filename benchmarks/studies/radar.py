"""Radar over optical images: Sentinel-1 over Sentinel-2 with imposed shifts, and simulated speckle.

The tiles lie on one grid to about a pixel, no better: told is how far the band combinations of a tile agree.
The simulation has a truth: backscatter by land cover and the slope towards the sensor, layover and shadow
where that is steep, and speckle of independent pixels. Steep slopes are bright or dark in their place, as in
an orthoimage: none is heaped on its foot, and ridges cast no shadow. It does not show corner reflectors, wind
on water, the direction of furrows, the moisture of a day, or speckle that hangs together.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from affine import Affine

from benchmarks.pairs import write
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.scenes import SAMPLES, SIDE_PX, displacement_px
from benchmarks.tables import Cell, Check, Table, at_least, at_most, within
from benchmarks.unrelated import REPOSITORY
from pcwlad_geo.options import Settings

sys.path.insert(0, str(REPOSITORY / "sample_data"))
from landscape import Cover, Ground, ground

SETTINGS: Final = Settings()
"""The default call."""
RADAR_BANDS: Final = {"VV": 1, "VH": 2}
OPTICAL_BANDS: Final = {"red": 4, "infrared": 8}
LARGEST_SHIFT_PX: Final = 30.0
AGREE_PX: Final = 0.5
LOOKS: Final = {1: 0.8, 2: 0.6, 4: 0.4}
"""Looks of the simulated image, and the RMSE that must be reached, px."""
SEEDS: Final = (3, 5)
MIN_POINTS: Final = 300
PIXEL_M: Final = 10.0
INCIDENCE_DEG: Final = 39.0
"""Of the middle of Sentinel-1's swath; the sensor looks east."""
LAYOVER_DEG: Final = 4.0
"""Ground whose local angle of incidence is smaller is a bright heap."""
FLOOR_DB: Final = -25.0
BACKSCATTER_DB: Final = {
    Cover.CROP: -12.0,
    Cover.MEADOW: -14.0,
    Cover.FOREST: -8.5,
    Cover.ROCK: -10.0,
    Cover.TOWN: -3.0,
    Cover.ROAD: -19.0,
    Cover.WATER: -23.0,
}
DB_PER_K: Final = -0.35
"""Wet ground is cool, and returns more."""


def radar(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield tables: Sentinel-1 over Sentinel-2, simulated speckle, other forms of it, heights."""
    yield _tiles(data / "real" / "sar", scratch, runner)
    yield _simulated(scratch, runner)
    yield _forms(scratch, runner)
    yield _heights(scratch, runner)


def _tiles(data: Path, scratch: Path, runner: Runner) -> Table:
    jobs, imposed = [], {}
    for number, path in enumerate(sorted(data.glob("S1*.tif"))):
        optical = next(data.glob(f"S2*{path.stem.split('_', 1)[1]}.tif"))
        draw = np.random.default_rng(number)
        for band in RADAR_BANDS:
            shift_px = draw.uniform(-LARGEST_SHIFT_PX, LARGEST_SHIFT_PX, 2)
            moved = _moved(path, RADAR_BANDS[band], shift_px, scratch / f"{path.stem} {band}.tif")
            for other in OPTICAL_BANDS:
                plain = scratch / f"{optical.stem} {other}.tif"
                if not plain.exists():
                    _moved(optical, OPTICAL_BANDS[other], np.zeros(2), plain)
                job = Job(plain, moved, SETTINGS, match_only=False)
                jobs.append(job)
                imposed[job] = path.stem, f"{band} over {other}", shift_px
    rows: list[list[Cell]] = []
    found: dict[str, list[Array]] = {}
    for job, outcome in zip(jobs, runner(jobs), strict=True):
        tile, bands, shift_px = imposed[job]
        if not outcome.accepted:
            rows.append([tile, bands, "refused", "-", "-", "-", "-"])
            continue
        # what the file says to lie `shift_px` farther is seen that much farther than it is predicted
        left = np.median(outcome.points.displacement_px, axis=0) - shift_px
        found.setdefault(tile, []).append(left)
        result = outcome.result
        quality = result.quality.grade if result.quality else "-"
        rows.append([tile, bands, quality, len(outcome.points), *left.tolist(), _offset(left, found[tile])])
    apart = [float(np.ptp(np.array(each), axis=0).max()) for each in found.values()]
    checks: list[Check] = [
        at_least("Sentinel-1 over Sentinel-2: registered", sum(map(len, found.values())), len(jobs), "", 0),
        at_most("band combinations of a tile agree to", max(apart, default=np.nan), AGREE_PX, "px"),
    ]
    header = ("tile", "bands", "", "points", "col px", "row px", "off the first")
    return Table("Sentinel-1 over Sentinel-2, shifts of up to 30 px", header, rows, checks)


def _offset(left: Array, others: list[Array]) -> float:
    return float(np.hypot(*(left - others[0])))


def _moved(path: Path, band: int, shift_px: Array, out: Path) -> Path:
    """Write a band of a file with its georeferencing shifted by (col, row) px."""
    with rasterio.open(path) as file:
        values = file.read(band)
        transform = file.transform @ Affine.translation(*shift_px.tolist())
        return write(out, values, transform, file.crs, file.nodata)


def _simulated(scratch: Path, runner: Runner) -> Table:
    runs = []
    for seed in SEEDS:
        optical, backscatter = _scene(seed)
        reference = _placed(scratch / f"red {seed}.tif", optical)
        for looks in LOOKS:
            radar = in_db(speckled(backscatter, looks, seed))
            target = _placed(scratch / f"radar {seed} {looks}.tif", radar)
            runs.append((looks, Job(reference, target, SETTINGS, match_only=False)))
    outcomes = runner([job for _, job in runs])
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for looks, limit_px in LOOKS.items():
        errors = [_errors(each) for (of, _), each in zip(runs, outcomes, strict=True) if of == looks]
        counts = [len(error) for error, _ in errors]
        error, ratio = (np.concatenate(each) for each in zip(*errors, strict=True))
        rmse_px = float(np.sqrt((error**2).sum(axis=1).mean())) if len(error) else np.nan
        within_1, within_2 = (100 * float(np.mean(np.abs(ratio) < k)) for k in (1.0, 1.96))
        rows.append([looks, " ".join(map(str, counts)), rmse_px, within_1, within_2])
        what = f"{looks} look{'s' * (looks > 1)}"
        checks += [
            at_least(f"{what}: points of the pair with fewest", min(counts), MIN_POINTS, "", 0),
            at_most(f"{what}: RMSE", rmse_px, limit_px, "px"),
            within(f"{what}: within sigma", within_1, 60.0, 76.0, "%"),
            within(f"{what}: within 1.96 sigma", within_2, 92.0, 98.0, "%"),
        ]
    header = ("looks", "points", "RMSE px", "within sigma %", "within 1.96 sigma %")
    return Table("Simulated radar over red light", header, rows, checks)


def _forms(scratch: Path, runner: Runner) -> Table:
    seed = SEEDS[0]
    optical, backscatter = _scene(seed)
    reference = _placed(scratch / f"red {seed}.tif", optical)
    forms = {"decibels": in_db, "amplitude": np.sqrt, "power": np.asarray}
    runs = {}
    for looks in (1, 4):
        power = speckled(backscatter, looks, seed)
        for name, form in forms.items():
            path = _placed(scratch / f"{name} {looks}.tif", form(power))
            runs[f"{name}, looks: {looks}"] = Job(reference, path, SETTINGS)
            if (name, looks) == ("decibels", 1):
                runs[f"{name}, looks: 1, window 181"] = Job(reference, path, replace(SETTINGS, window=181))
    rows: list[list[Cell]] = []
    for name, outcome in zip(runs, runner(list(runs.values())), strict=True):
        error, _ = _errors(outcome)
        rows.append([name, len(error), float(np.sqrt((error**2).sum(axis=1).mean())) if len(error) else "-"])
    return Table(f"Forms of the radar image, landscape {seed}", ("", "points", "RMSE px"), rows)


def _heights(scratch: Path, runner: Runner) -> Table:
    centres = (np.arange(SIDE_PX * SAMPLES) + 0.5) / SAMPLES
    shift_px = np.array([-3.0, -5.0])

    def seen(shift: Array) -> Array:
        x_m, y_m = (centres - shift[0]) * PIXEL_M, -(centres - shift[1]) * PIXEL_M
        return _averaged(ground(x_m[None], y_m[:, None], SEEDS[0]).height.astype(np.float64))

    noise_m = np.random.default_rng(0).normal(0.0, 0.5, (SIDE_PX, SIDE_PX))
    reference = _placed(scratch / "heights.tif", seen(np.zeros(2)))
    target = _placed(scratch / "others.tif", seen(shift_px) + 7.0 + noise_m)
    (outcome,) = runner([Job(reference, target, SETTINGS)])
    moved = outcome.points.displacement_px
    row = [len(moved), *moved.mean(axis=0).tolist(), float(moved.std(axis=0).max())]
    title = "Heights over heights 7 m lower, noise of 0.5 m, moved by (-3, -5) px"
    return Table(title, ("points", "col px", "row px", "scatter px"), [row])


def _placed(path: Path, values: Array) -> Path:
    transform = Affine(PIXEL_M, 0, 500000, 0, -PIXEL_M, 5000000)
    return write(path, np.asarray(values, np.float32), transform, "EPSG:32632")


def _errors(outcome: Outcome) -> tuple[Array, Array]:
    """Return (n, 2) errors of the tie points, px, and their ratios to the sigmas."""
    if not outcome.accepted:
        return np.empty((0, 2)), np.empty((0, 2))
    points = outcome.points
    error = points.displacement_px - displacement_px(points.predicted_px)
    return error, error / points.sigma_px


def _scene(seed: int) -> tuple[Array, Array]:
    """Return red reflectance, and the backscatter displaced by `displacement_px`, (SIDE_PX, SIDE_PX) each."""
    centres = (np.arange(SIDE_PX * SAMPLES) + 0.5) / SAMPLES
    seen = np.stack(np.meshgrid(centres, centres), axis=-1)
    source = seen - displacement_px(seen)
    for _ in range(6):
        source = seen - displacement_px(source)
    red = ground(seen[..., 0] * PIXEL_M, -seen[..., 1] * PIXEL_M, seed).red
    return _averaged(red.astype(np.float64)), _averaged(_backscatter(source, seed))


def _backscatter(at_px: Array, seed: int) -> Array:
    """Return the power that returns from the ground at (rows, cols, 2) px, without speckle."""
    x_m, y_m = at_px[..., 0] * PIXEL_M, -at_px[..., 1] * PIXEL_M
    here, east = ground(x_m, y_m, seed), ground(x_m + PIXEL_M, y_m, seed)
    slope_deg = np.degrees(np.arctan((east.height.astype(np.float64) - here.height) / PIXEL_M))
    local_deg = INCIDENCE_DEG - slope_deg  # the sensor looks east: ground that rises eastwards faces it
    lit = np.sin(np.radians(INCIDENCE_DEG)) / np.sin(np.radians(np.clip(local_deg, LAYOVER_DEG, 90.0)))
    shadow = local_deg >= 90.0
    return np.where(shadow, 0.0, 10 ** (_cover_db(here) / 10) * lit) + 10 ** (FLOOR_DB / 10)


def _cover_db(here: Ground) -> Array:
    table = np.array([BACKSCATTER_DB[Cover(value)] for value in range(len(Cover))])
    warmth = here.thermal.astype(np.float64)
    dry = np.where(here.cover == Cover.WATER, 0.0, warmth - np.median(warmth))
    return np.asarray(table[here.cover] + DB_PER_K * dry)


def _averaged(samples: Array) -> Array:
    return np.asarray(samples.reshape(SIDE_PX, SAMPLES, SIDE_PX, SAMPLES).mean(axis=(1, 3)))


def speckled(power: Array, looks: int, seed: int) -> Array:
    """Return (rows, cols) power with fully developed speckle: gamma distributed, of mean 1."""
    return np.asarray(power * np.random.default_rng([seed, looks]).gamma(looks, 1 / looks, power.shape))


def in_db(power: Array) -> Array:
    """Return power in decibels, float32 as products have it."""
    return np.asarray(10 * np.log10(np.maximum(power, 1e-6)), np.float32)
