"""Camera rigs: a real capture by an independent measure, a synthetic rig and a thermal lens by truth."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from benchmarks.rig_scenes import (
    Array,
    Flown,
    Ground,
    TrueLens,
    flight,
    ground_points,
    lens_rays,
    made_rig,
    made_thermal,
    seen_by,
    write_capture,
)
from benchmarks.runs import Runner
from benchmarks.tables import Cell, Table, at_least, at_most, within
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.rigs.applying_run import RigApplied, rig_apply
from pcwlad_geo.rigs.learning_run import rig_learn
from pcwlad_geo.rigs.lens import lattice
from pcwlad_geo.rigs.rig import Rig

WINDOW: Final = 128
"""Side of the windows of the independent measure, px; they do not overlap."""
LOW_PASS: Final = 0.2
"""Standard deviation of the Gaussian weight on its frequencies, cycles per px."""
LEARNED, APPLIED, BAD = 20, 100, 10
THERMAL: Final = 100
SEED: Final = 19


def rig(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield how well lenses lie on each other: a real capture, a synthetic rig, thermal beside visible."""
    yield from _rededge(data / "rig" / "rededge", scratch, runner)
    yield from _synthetic(scratch / "synthetic", runner)
    for told in (True, False):
        yield _thermal(scratch / f"thermal{told}", told, runner)


def _rededge(frames: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    known = rig_learn([frames], out=scratch / "RIG.json", jobs=runner.processes)
    found = rig_apply(known, [frames], out_dir=scratch / "applied", jobs=runner.processes)
    with ignoring(NotGeoreferencedWarning), rasterio.open(found.out_dir / "IMG_0001.tif") as dataset:
        names, bands = dataset.descriptions, dataset.read().astype(np.float64)
    shapes = [_structure(np.where(band == 0, np.nan, band)) for band in bands]
    places = {pair: _windows(shapes[pair[0]], shapes[pair[1]]) for pair in combinations(range(len(names)), 2)}
    rows: list[list[Cell]] = []
    for (one, other), moved in places.items():
        length = np.hypot(moved[..., 0], moved[..., 1])
        rows.append(
            [
                f"{names[one]} - {names[other]}",
                int(np.isfinite(length).sum()),
                float(np.nanmedian(length)),
                float(np.nanpercentile(length, 90)),
                _noise(moved),
            ]
        )
    closures = [
        float(np.hypot(*np.nanmedian((places[a, b] + places[b, c] - places[a, c]).reshape(-1, 2), axis=0)))
        for a, b, c in combinations(range(len(names)), 3)
    ]
    worst = [max(float(row[k]) for row in rows) for k in (2, 3)]
    yield Table(
        "rig/rededge: phase correlation of windows after correction, px",
        ("pair", "windows", "median", "90 %", "noise of the measure, an axis"),
        rows,
        [
            at_most("rig/rededge, worst pair, median", worst[0], 0.1, "px"),
            at_most("rig/rededge, worst pair, 90 %", worst[1], 0.25, "px"),
            at_most("rig/rededge, worst closure", max(closures), 0.05, "px"),
        ],
    )
    offs = [each.off_by_px() or (np.nan, np.nan) for each in known.lenses]
    yield Table(
        "rig/rededge: the camera's own calibration against the learned one, px",
        ("lens", "RMS", "largest", "sigma of the learned"),
        [[each.name, *off, each.distortion_sigma_px] for each, off in zip(known.lenses, offs, strict=True)],
    )


def _structure(values: Array) -> Array:
    """Return the direction of the gradient, doubled: a change of sign of the contrast does not change it."""
    missing = ~np.isfinite(values)
    filled = np.where(missing, np.nanmean(values), values).astype(np.float32)
    smooth = cv2.GaussianBlur(filled, (0, 0), 1.0)
    slope = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) + 1j * cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    size = np.abs(slope)
    local = cv2.GaussianBlur(size, (0, 0), 8.0)
    result = slope**2 / (size**2 + (0.3 * local) ** 2 + 1e-12)
    near = cv2.dilate(missing.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    return np.where(near, np.nan, result)


def _windows(one: Array, other: Array) -> Array:
    """Return the (rows, cols, 2) displacements (col, row) of windows; NaN where one is not seen whole."""
    count = [size // WINDOW for size in one.shape]
    found = np.full((*count, 2), np.nan)
    taper = np.outer(np.hanning(WINDOW), np.hanning(WINDOW))
    for row, col in np.ndindex(*count):
        part = np.s_[row * WINDOW : (row + 1) * WINDOW, col * WINDOW : (col + 1) * WINDOW]
        a, b = one[part], other[part]
        if np.isfinite(a).all() and np.isfinite(b).all():
            found[row, col] = phase_shift((a - a.mean()) * taper, (b - b.mean()) * taper)
    return found


def phase_shift(one: Array, other: Array) -> tuple[float, float]:
    """Return the shift (col, row) of a window by phase correlation, its peak found by Newton's method."""
    row_f, col_f = np.fft.fftfreq(one.shape[0])[:, None], np.fft.fftfreq(one.shape[1])[None]
    cross = np.fft.fft2(other) * np.conj(np.fft.fft2(one))
    cross = cross / (np.abs(cross) + 1e-12 * np.abs(cross).max())
    cross *= np.exp(-(row_f**2 + col_f**2) / (2 * LOW_PASS**2))
    peak = np.unravel_index(np.fft.ifft2(cross).real.argmax(), one.shape)
    at = np.array([k if k < n // 2 else k - n for k, n in zip(peak, one.shape, strict=True)], np.float64)
    waves = [2 * np.pi * row_f + 0 * col_f, 2 * np.pi * col_f + 0 * row_f]
    for _ in range(12):
        turned = cross * np.exp(1j * (waves[0] * at[0] + waves[1] * at[1]))
        slope = np.array([-(wave * turned.imag).sum() for wave in waves])
        bend = -np.array([[(a * b * turned.real).sum() for a in waves] for b in waves])
        at -= np.clip(np.linalg.solve(bend, slope), -0.5, 0.5)
    return float(at[1]), float(at[0])


def _noise(moved: Array) -> float:
    """Return the standard deviation of the measure by an axis, from windows against their four neighbours."""
    around = (moved[:-2, 1:-1] + moved[2:, 1:-1] + moved[1:-1, :-2] + moved[1:-1, 2:]) / 4
    return float(1.4826 * np.nanmedian(np.abs(moved[1:-1, 1:-1] - around)) / np.sqrt(1.25))


def _synthetic(scratch: Path, runner: Runner) -> Iterator[Table]:
    land, lenses = Ground.made(SEED), made_rig(SEED)
    for number, flown in enumerate(flight(SEED, LEARNED, land)):
        write_capture(scratch / "learn", f"L_{number:03}", lenses, flown, land, seed=number, height=True)
    good = flight(SEED + 1, APPLIED, land)
    bad = _spoilt(flight(SEED + 2, BAD, land), lenses)
    for name, captures in (("G", good), ("B", bad)):
        for number, flown in enumerate(captures):
            write_capture(
                scratch / "apply", f"{name}_{number:03}", lenses, flown, land, seed=500 + number, height=True
            )
    begun = time.perf_counter()
    known = rig_learn([scratch / "learn"], jobs=runner.processes)
    learned_s = time.perf_counter() - begun
    begun = time.perf_counter()
    found = rig_apply(known, [scratch / "apply"], out_dir=scratch / "out", jobs=runner.processes)
    applied_s = (time.perf_counter() - begun) / (APPLIED + BAD)
    yield _learned_table(known, lenses, learned_s)
    yield _applied_table(known, lenses, land, good, found, applied_s)


def _spoilt(captures: Sequence[Flown], lenses: Sequence[TrueLens]) -> list[Flown]:
    """Return bad captures of four kinds: a panel, too near, blurred, a lens covered."""
    kinds = (
        {"panel": True, "place": 1.0},
        {"place": 3.0},
        {"motion_px": 7.0},
        {"covered": lenses[3].name},
        {"covered": lenses[0].name},
    )
    spoilt = []
    for number, flown in enumerate(captures):
        change = dict(kinds[number % len(kinds)])
        height = change.pop("place", None)
        place = flown.place_m if height is None else np.array([*flown.place_m[:2], height])
        spoilt.append(replace(flown, place_m=place, **change))  # type: ignore[arg-type]
    return spoilt


def _learned_table(known: Rig, lenses: Sequence[TrueLens], seconds: float) -> Table:
    rows: list[list[Cell]] = []
    ratios = []
    for each, true in zip(known.lenses, lenses, strict=True):
        wrong = np.hypot(*true.lens.distortion_px(each.lens).T)
        off = true.lens.distortion_px(true.calibrated) if true.calibrated else np.full((1, 2), np.nan)
        rows.append(
            [
                each.name,
                float(np.hypot(*off.T).max()),
                float(wrong.max()),
                float(np.median(wrong)),
                each.distortion_sigma_px,
            ]
        )
        ratios.append(float(wrong.max()) / each.distortion_sigma_px)
    return Table(
        f"rig/synthetic: distortion learned from {LEARNED} captures ({seconds:.0f} s), px",
        ("lens", "told, largest error", "learned, largest", "learned, median", "sigma, largest"),
        rows,
        [
            at_most(
                "rig/synthetic, distortion, largest error", max(float(row[2]) for row in rows), 0.1, "px"
            ),
            at_most("rig/synthetic, distortion, largest error over sigma", max(ratios), 3.0),
        ],
    )


def _applied_table(
    known: Rig,
    lenses: Sequence[TrueLens],
    land: Ground,
    good: Sequence[Flown],
    found: RigApplied,
    seconds: float,
) -> Table:
    status = {each.name: each for each in found.captures}
    corrected = [k for k in range(len(good)) if status[f"G_{k:03}"].status == "corrected"]
    named = sum(each.status == "rejected" for name, each in status.items() if name.startswith("B"))
    errors, ratios = [], []
    for k in corrected:
        wrong = applied_errors(known, lenses, good[k], land, found.out_dir / f"G_{k:03}.tif")
        errors.append([float(np.nanmedian(np.hypot(*each.T))) for each in wrong])
        middle = [float(np.hypot(*np.nanmedian(each, axis=0))) for each in wrong]
        ratios.append(max(middle) / max(float(status[f"G_{k:03}"].sigma_px or 0), 1e-9))
    worst = np.array(errors).max(axis=1)
    rows: list[list[Cell]] = [
        [each.name, float(np.median(own)), float(np.percentile(own, 90)), float(own.max())]
        for each, own in zip(lenses[1:], np.array(errors).T, strict=True)
    ]
    return Table(
        f"rig/synthetic: {len(good)} captures and {BAD} bad ones, {seconds:.2f} s each; median error, px",
        ("lens", "median", "90 % of the captures", "worst"),
        rows,
        [
            at_most(
                "rig/synthetic, applied, worst lens, 90 % of captures",
                float(np.percentile(worst, 90)),
                0.15,
                "px",
            ),
            within(
                "rig/synthetic, worst lens within 2.45 sigma",
                100 * float(np.mean(np.array(ratios) < 2.45)),
                80,
                100,
                "%",
            ),
            at_least("rig/synthetic, bad captures named", named, BAD, digits=0),
            at_most("rig/synthetic, good captures named", len(good) - len(corrected), 0, digits=0),
            at_most("rig/synthetic, time of a capture", seconds, 1.0, "s", 2),
        ],
    )


def applied_errors(
    known: Rig, lenses: Sequence[TrueLens], flown: Flown, land: Ground, raster: Path
) -> list[Array]:
    """Return for each lens but the first the (n, 2) distances, px, from where it should have been read."""
    with ignoring(NotGeoreferencedWarning), rasterio.open(raster) as dataset:
        tags = dataset.tags()
    plane = np.array([float(each) for each in tags["RIG_INVERSE_DEPTH"].split()])
    turns = [np.array([float(v) for v in each.split()]) for each in tags["RIG_ROTATIONS_RAD"].split(";")]
    left, top, cols, rows = known.crop()
    rays = known.common_rays(lattice((rows, cols), 16) + np.array([left, top]))
    near = plane[0] + rays @ plane[1:]
    raw = known.reference.project(rays, near)
    good = np.isfinite(raw).all(axis=1)
    down, place = lens_rays(lenses[0], flown, raw[good])
    points = ground_points(land, flown, down, place)
    return [
        replace(each, rotation=turn).project(rays[good], near[good]) - seen_by(true, flown, points)
        for each, turn, true in zip(known.lenses[1:], turns[1:], lenses[1:], strict=True)
    ]


def _thermal(scratch: Path, told: bool, runner: Runner) -> Table:
    land, lenses = Ground.made(SEED + 5), made_thermal(SEED, told=told)
    captures = flight(SEED + 6, THERMAL, land, heights_m=(40.0, 90.0))
    for number, flown in enumerate(captures):
        write_capture(scratch / "frames", f"T_{number:03}", lenses, flown, land, seed=number, height=told)
    some = [file for k in range(0, THERMAL, 10) for file in (scratch / "frames").glob(f"T_{k:03}_*")]
    known = rig_learn(some, jobs=runner.processes)
    found = rig_apply(known, [scratch / "frames"], out_dir=scratch / "out", jobs=runner.processes)
    status = {each.name: each for each in found.captures}
    wrong = []
    for number, flown in enumerate(captures):
        if status[f"T_{number:03}"].status == "corrected":
            (off,) = applied_errors(known, lenses, flown, land, found.out_dir / f"T_{number:03}.tif")
            wrong.append(float(np.nanmedian(np.hypot(*off.T))))
    which = "told" if told else "not told"
    title = f"rig/thermal: 160 x 120 beside 1280 x 960, {THERMAL} captures, calibration {which}; thermal px"
    share = 100 * len(wrong) / THERMAL
    return Table(
        title,
        ("", "found", "median", "90 %", "worst"),
        [["thermal", f"{share:.0f} %", *(float(np.percentile(wrong, q)) for q in (50, 90, 100))]],
        [
            at_least(f"rig/thermal, {which}, found", share, 95, "%", 0),
            at_most(f"rig/thermal, {which}, error, 90 %", float(np.percentile(wrong, 90)), 0.3, "px"),
        ],
    )
