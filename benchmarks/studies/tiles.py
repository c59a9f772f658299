"""Tiles: the same tie points whatever the tile size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from benchmarks.pairs import rgbnir
from benchmarks.runs import Job, Runner, common_points
from benchmarks.tables import Cell, Check, Table, at_least, at_most
from pcwlad_geo.options import Settings

SIZES_PX = (256, 384, 1024)
COMMON = 0.98
EQUAL_PX = 0.02


def tiles(data: Path, _scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield one table: every two tile sizes on one pair."""
    pair = rgbnir(data)
    # one search radius and cells, as for a large scene; the tiles differ and nothing else
    settings = Settings(search_radius=10)
    jobs = [Job(pair.reference, pair.target, replace(settings, tile_size=size)) for size in SIZES_PX]
    points = {size: outcome.points for size, outcome in zip(SIZES_PX, runner(jobs), strict=True)}
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for first, second in combinations(SIZES_PX, 2):
        index = common_points(points[first], points[second])
        moved = np.abs(points[first].target_px[index[0]] - points[second].target_px[index[1]]).max(axis=1)
        share = 100 * len(moved) / max(len(points[first]), len(points[second]))
        percentiles = (f"{value:.5f}" for value in np.percentile(moved, (50, 99, 100)))
        counts = (len(points[first]), len(points[second]))
        rows.append([f"{first} and {second}", *counts, f"{share:.1f}", *percentiles])
        what = f"tiles of {first} and {second}"
        checks.append(at_least(f"{what}: common", share, 100 * COMMON, "%", 1))
        checks.append(at_most(f"{what}: largest difference", float(moved.max()), EQUAL_PX, "px", 4))
    header = ("tile sizes", "points", "points", "common %", "difference 50 %", "99 %", "largest")
    yield Table(f"{pair.name}: tile sizes, px", header, rows, checks)
