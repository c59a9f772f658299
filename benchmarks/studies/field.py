"""Real targets displaced by a known smooth field: a consensus must not hide it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.displacing import displace
from benchmarks.pairs import landsat, read, rgbnir, write
from benchmarks.runs import PAPER, PER_POINT, Array, Job, Outcome, Runner, common_points
from benchmarks.tables import Cell, Check, Table, at_most

AMPLITUDE_PX = 1.5
WAVELENGTH_PX = 800.0
LIMIT_PX = 0.10


def displacement_field(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield one table: per point, displaced minus undisplaced result against the field."""
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for pair in (landsat(data), rgbnir(data)):
        displaced = write(scratch / f"{pair.name}_field.tif", displace(read(pair.undisplaced), field_px))
        targets = (pair.undisplaced, displaced)
        rmse = {}
        for name, settings in (("oriented", PER_POINT), ("oriented + consensus", PAPER)):
            outcomes = runner([Job(pair.reference, target, settings) for target in targets])
            error = _error(*outcomes)
            rmse[name] = float(np.sqrt((error**2).sum(axis=1).mean()))
            counts = [len(outcome.points) for outcome in outcomes]
            bias = (f"{value:+.3f}" for value in error.mean(axis=0))
            worst = float(np.percentile(np.linalg.norm(error, axis=1), 99))
            rows.append([f"{pair.name}, {name}", *counts, len(error), rmse[name], *bias, worst])
        per_point, consensus = rmse.values()
        checks.append(at_most(f"{pair.name}, oriented: RMSE", per_point, LIMIT_PX, "px"))
        checks.append(at_most(f"{pair.name}, with consensus (not worse): RMSE", consensus, per_point, "px"))
    header = ("pair", "points", "displaced", "common", "RMSE", "bias x", "y", "99 %")
    yield Table(f"Field of +-{AMPLITUDE_PX} px, wavelength {WAVELENGTH_PX:.0f} px", header, rows, checks)


def field_px(xy_px: Array) -> Array:
    """Return the displacement at positions (..., 2): what is at p moves to p + field(p)."""
    x, y = np.moveaxis(xy_px, -1, 0)
    turn = 2 * np.pi / WAVELENGTH_PX
    waves = (np.sin(turn * (0.8 * x + 0.6 * y) + 0.4), np.sin(turn * (0.6 * x - 0.8 * y) + 2.1))
    return AMPLITUDE_PX * np.stack(waves, axis=-1)


def _error(plain: Outcome, displaced: Outcome) -> Array:
    rows = common_points(plain.points, displaced.points)
    before = plain.points.target_px[rows[0]]
    return np.asarray(displaced.points.target_px[rows[1]] - before - field_px(before))
