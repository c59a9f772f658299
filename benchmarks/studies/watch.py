"""Series over time: simulated displacements with steps, clouds and seasons, and ground that moves."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.runs import Array, Runner
from benchmarks.speed_studies.processes import measure
from benchmarks.tables import Table, at_least, at_most
from pcwlad_geo.estimation.time_series import SeriesModel, analyse
from pcwlad_geo.multi.stack.pair_choice import Candidate, choose_pairs
from pcwlad_geo.multi.watch.ground_motion import GroundMotion
from pcwlad_geo.multi.watch.run import watch
from tests.multi.watched import REGION, SIDE, Dated, make_stack

SEED: Final = 32
SENSORS, DATES, YEARS = 3, 120, 4.0
"""Sensors, dates of all of them together, and the time that they span."""
SERIES: Final = 300
"""Series in which nothing happens, and as many with a step."""
CLOUDY: Final = 0.05
"""Share of dates that are off because of clouds."""
CLOUD_PX, STEP_PX, SEASON_PX = 0.4, (0.1, 0.2), 0.08
SIGMA_PX: Final = (0.02, 0.05)
"""Standard deviations of the displacements of images, as stacks have them."""
EDGE: Final = 5
"""Images on either side of a step, at least."""
VELOCITY_PX: Final = (0.4, 0.3)
"""A year, of 2 % of the scene: 0.5 px."""
MOVING_IMAGES: Final = 40
MANY: Final = (250, 500, 1000)
"""Dates of stacks whose time and memory are measured."""
NETWORKS: Final = 150
"""Series whose errors come from pairs, of either kind."""
FIRST_IMAGES: Final = 8
"""Of a stack to which images are added one by one."""


@dataclass
class Steps:
    """What was found of the steps."""

    found: int = 0
    others: int = 0
    """Steps told where there is none."""
    off: list[int] = field(default_factory=list)
    """By how many images the date is off."""
    size_px: list[float] = field(default_factory=list)
    """Length of the error of the size."""
    in_sigmas: list[float] = field(default_factory=list)
    """The same along an axis, in the sigma told."""


def watch_study(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield false alarms, what is found of steps, and of a part of the ground that moves."""
    del data, runner
    random = np.random.default_rng(SEED)
    yield _still(random)
    yield _hanging_together(random)
    yield _stepped(random)
    yield _moving(scratch, random)
    yield _growth(scratch, random)


def _series(random: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return times, displacements and sigmas of one of the sensors, every second one with a season."""
    count = DATES // SENSORS
    years = np.sort(random.uniform(0.0, YEARS, count))
    sigma_px = random.uniform(*SIGMA_PX, count)
    moved_px = random.normal(size=(count, 2)) * sigma_px[:, None]
    cloudy = random.random(count) < CLOUDY
    moved_px[cloudy] += random.normal(size=(int(cloudy.sum()), 2)) * CLOUD_PX
    return years, moved_px, sigma_px


def _still(random: np.random.Generator) -> Table:
    alarms, outliers, seasons = 0, 0, 0
    for number in range(SERIES):
        years, moved_px, sigma_px = _series(random)
        seasonal = number % 2 == 1
        if seasonal:
            moved_px = moved_px + _season(years, random)
        model = analyse(years, moved_px, sigma_px)
        kinds = [found.term.kind for found in model.terms]
        alarms += bool({"step", "drift"} & set(kinds) or (not seasonal and "season" in kinds))
        seasons += seasonal and "season" in kinds
        outliers += int(model.outliers.sum())
    rows = [(SERIES, alarms, seasons, SERIES // 2, round(outliers / SERIES, 2))]
    header = ("series", "with a false alarm", "seasons found", "seasons", "outliers each")
    check = at_most("series without a step that are given one, or a drift", alarms / SERIES, 0.01)
    return Table("Series in which nothing happens, half of them with a season", header, rows, [check])


def _hanging_together(random: np.random.Generator) -> Table:
    """Series whose errors come from the pairs of a stack alone, as it chooses them."""
    rows, alarms = [], 0
    for added in (False, True):
        own = 0
        for _ in range(NETWORKS):
            years = np.sort(random.uniform(0.0, YEARS, DATES // SENSORS))
            design = _pairs_of(years, added, random)
            places = np.linalg.pinv(design)
            places *= float(np.mean(SIGMA_PX)) / float(np.median(np.sqrt((places**2).sum(axis=1))))
            covariance = places @ places.T
            moved_px = places @ random.normal(size=(len(design), 2))
            own += bool(analyse(years, moved_px, np.sqrt(np.diag(covariance)), covariance).terms)
        rows.append(("added one by one" if added else "chosen together", NETWORKS, own))
        alarms += own
    check = at_most("of these, series that are given a term", alarms / (2 * NETWORKS), 0.01)
    header = ("pairs", "series", "with a false alarm")
    return Table("Series whose errors hang together by the pairs of a stack", header, rows, [check])


def _pairs_of(years: Array, added: bool, random: np.random.Generator) -> Array:
    """Return the (pairs, images) design of the pairs that a stack chooses of images alike by chance."""
    count, found = len(years), []
    for first, second in combinations(range(count), 2):
        apart = abs(years[second] - years[first])
        season = 2 * min(apart % 1, 1 - apart % 1)
        cost = random.uniform(0.0, 0.1) + 0.3 * season + 0.1 * min(1.0, apart / 10)
        found.append(Candidate((first, second), float(cost)))
    found.sort(key=lambda each: (each.cost, each.pair))
    begun = FIRST_IMAGES if added else count
    pairs = choose_pairs([each for each in found if max(each.pair) < begun], begun)
    for last in range(begun, count):
        pairs = choose_pairs([each for each in found if max(each.pair) <= last], last + 1, None, pairs)
    design = np.zeros((len(pairs), count))
    for row, (first, second) in enumerate(pairs):
        design[row, [first, second]] = -1.0, 1.0
    return design


def _season(years: Array, random: np.random.Generator) -> Array:
    phase, size = random.uniform(0, 2 * np.pi), random.uniform(0.5, 1.0) * SEASON_PX
    angle = 2 * np.pi * years + phase
    return size * np.column_stack([np.cos(angle), np.sin(angle)])


def _stepped(random: np.random.Generator) -> Table:
    tally = Steps()
    for number in range(SERIES):
        years, moved_px, sigma_px = _series(random)
        at = int(random.integers(EDGE, len(years) - EDGE + 1))
        direction = random.uniform(0, 2 * np.pi)
        size = random.uniform(*STEP_PX) * np.array([np.cos(direction), np.sin(direction)])
        moved_px[at:] += size
        if number % 2 == 1:
            moved_px = moved_px + _season(years, random)
        _count(tally, analyse(years, moved_px, sigma_px), at, size)
    right = sum(each <= 1 for each in tally.off) / max(1, len(tally.off))
    size_px = float(np.percentile(tally.size_px, 90))
    unit = float(np.sqrt(np.mean(np.square(tally.in_sigmas))))
    rows = [(SERIES, tally.found, tally.others, right, float(np.median(tally.size_px)), size_px, unit)]
    header = ("series", "found", "others", "date right", "size off, median", "90 %, px", "sigmas, RMS")
    checks = [
        at_least("steps of 0.1 to 0.2 px that are found", tally.found / SERIES, 0.95),
        at_least("of these, date right to one image", right, 0.95),
        at_most("error of the size, 90 %", size_px, 0.03, "px"),
    ]
    return Table("Steps", header, rows, checks)


def _count(tally: Steps, model: SeriesModel, at: int, size: Array) -> None:
    steps = [found for found in model.terms if found.term.kind == "step"]
    near = [found for found in steps if abs(found.term.at - at) <= EDGE]
    tally.others += len(steps) - bool(near)
    if near:
        best = min(near, key=lambda found: abs(found.term.at - at))
        error = best.size_px[0] - size
        tally.found += 1
        tally.off.append(abs(best.term.at - at))
        tally.size_px.append(float(np.hypot(*error)))
        tally.in_sigmas += [float(each) / best.sigma_px for each in error]


def _moving(scratch: Path, random: np.random.Generator) -> Table:
    days = np.sort(random.choice(int(365.25 * YEARS), MOVING_IMAGES, replace=False))
    shifts = random.normal(size=(MOVING_IMAGES, 2)) * SIGMA_PX[0]
    images = [
        Dated(int(day), (float(shift[0]), float(shift[1])), SIGMA_PX[0])
        for day, shift in zip(days, shifts, strict=True)
    ]
    rows, checks = [], []
    for name, velocity in (("moving", VELOCITY_PX), ("still", (0.0, 0.0))):
        place = make_stack(scratch / name, images, velocity)
        found = watch(place, out_dir=scratch / f"{name}_watch").motion
        if found is None:
            raise RuntimeError("no motion was sought")
        rows.append((name, found.tested, len(found.regions), *_region(found)))
        if name == "moving":
            checks.append(at_least("the moving part is found", len(found.regions) == 1, 1, digits=0))
            off = np.hypot(*np.subtract(found.regions[0].velocity_px, VELOCITY_PX)) / np.hypot(*VELOCITY_PX)
            checks.append(at_most("its velocity is off by", float(off), 0.1))
        else:
            checks.append(at_most("moving parts where nothing moves", len(found.regions), 0, digits=0))
    share = np.pi * REGION[2] ** 2 / SIDE**2
    title = f"Ground of which {100 * share:.0f} % moves by 0.5 px a year, {MOVING_IMAGES} dates"
    return Table(
        title, ("ground", "cells", "regions", "share", "col, px a year", "row", "sigma"), rows, checks
    )


def _growth(scratch: Path, random: np.random.Generator) -> Table:
    """Watch stacks of many dates, each in a process of its own."""
    rows, checks = [], []
    for count in MANY:
        days = np.sort(random.choice(int(365.25 * YEARS), count, replace=False))
        shifts = (random.normal(size=(count, 2)) * SIGMA_PX[0]).tolist()
        images = [
            Dated(int(day), (col, row), SIGMA_PX[0]) for day, (col, row) in zip(days, shifts, strict=True)
        ]
        place, out = make_stack(scratch / f"{count} dates", images, VELOCITY_PX), scratch / f"{count} watched"
        command = [sys.executable, "-m", "pcwlad_geo", "watch", str(place), "-o", str(out)]
        cost = measure([*command, "--progress", "none"])
        if cost.status:
            raise RuntimeError(f"{count} dates: exit status {cost.status}: {cost.reason}")
        regions = json.loads((out / "watch.json").read_text(encoding="utf-8"))["motion"]["regions"]
        velocity = np.array(regions[0]["velocity_px"] if regions else (np.nan, np.nan))
        off = float(np.hypot(*(velocity - VELOCITY_PX)) / np.hypot(*VELOCITY_PX))
        page_mb = (out / "watch.html").stat().st_size / 1e6
        rows.append((count, cost.cpu_s, round(cost.peak_mb), page_mb, len(regions), off))
        checks.append(at_most(f"{count} dates: the velocity is off by", off, 0.1))
    checks.append(
        at_most(f"memory of {MANY[-1]} dates over that of {MANY[0]}", rows[-1][2] / rows[0][2], 2.0)
    )
    header = ("dates", "CPU s", "MB", "page MB", "regions", "velocity off by")
    return Table("Stacks of many dates", header, rows, checks)


def _region(found: GroundMotion) -> tuple[float, float, float, float]:
    if not found.regions:
        return 0.0, 0.0, 0.0, found.sigma_px
    first = found.regions[0]
    return first.share, *first.velocity_px, first.sigma_px
