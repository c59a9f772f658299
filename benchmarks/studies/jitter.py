"""Jitter of the sensor: the wave injected into the rows of a synthetic pair is found again, and no other."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from scipy import ndimage

from benchmarks.displacing import displace
from benchmarks.pairs import write
from benchmarks.runs import Array, Job, Runner
from benchmarks.tables import Cell, Check, Table, at_most
from pcwlad_geo.correction.jitter import peaks, without_trend
from pcwlad_geo.options import Settings

SIDE_PX: Final = 2048
AMPLITUDE_PX, PERIOD_PX, LIMIT_PX = 0.05, 200.0, 0.01
SETTINGS: Final = Settings(prealign="none", points="all", jobs=1)


def jitter(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield a table: a pair with jitter along the rows, and the same without."""
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for name, amplitude in (("jitter of 0.05 px", AMPLITUDE_PX), ("none", 0.0)):
        paths = _pair(scratch, amplitude)
        (outcome,) = runner([Job(*paths, SETTINGS, False)])
        found = outcome.result
        if found.selection is None:
            raise RuntimeError(f"the pair was refused: {outcome.reason}")
        points = found.tie_points.select("fit", "check", "unused")
        rest = without_trend(points.predicted_px, points.displacement_px)
        shown = [
            each
            for each in peaks(points.predicted_px, rest, found.selection.footprint_px)
            if each.significant or (each.along, each.of) == ("row", "column")
        ]
        for each in shown:
            known = "yes" if each.significant else "no"
            rows.append([name, len(points), each.along, each.of, each.period_px, each.amplitude_px, known])
        waves = [each for each in shown if each.significant]
        checks.append(at_most(f"{name}: waves found", len(waves), 1 if amplitude else 0, ""))
        if amplitude:
            errors = [abs(each.amplitude_px - amplitude) for each in waves]
            checks.append(
                at_most(f"{name}: error of the amplitude", min(errors, default=1.0), LIMIT_PX, "px")
            )
    header = ("pair", "points", "along", "of", "period", "amplitude", "significant")
    yield Table(f"Jitter of rows, {SIDE_PX} x {SIDE_PX} px", header, rows, checks)


def _pair(scratch: Path, amplitude_px: float) -> tuple[Path, Path]:
    """Write a texture as two bands, the second moved by a shift and a wave along its rows."""
    random = np.random.default_rng(11)
    white = random.normal(size=(SIDE_PX, SIDE_PX)).astype(np.float32)
    ground = sum(size * ndimage.gaussian_filter(white, size) for size in (1.2, 3.0, 8.0))
    ground = np.asarray(ground / ground.std(), dtype=np.float32)
    moved = displace(ground, partial(_wave, amplitude_px=amplitude_px))
    bands = 1.0 / (1.0 + np.exp(-ground)), np.exp(-0.4 * moved)
    paths = []
    for number, band in enumerate(bands):
        noisy = band + 0.02 * random.normal(size=band.shape)
        scaled = np.rint(np.clip(10_000 * noisy, 0, 65_535)).astype(np.uint16)
        paths.append(write(scratch / f"jitter_{amplitude_px}_{number}.tif", scaled))
    return paths[0], paths[1]


def _wave(xy_px: Array, amplitude_px: float) -> Array:
    wave = amplitude_px * np.sin(2 * np.pi * xy_px[..., 1] / PERIOD_PX + 0.7)
    return np.stack([1.3 + wave, np.full_like(wave, -0.4)], axis=-1)
