"""A cube of one ground on many dates, displaced by up to 8 px, under clouds: its alignment by `.pcwlad`."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy import ndimage

from benchmarks.runs import Array, Runner
from benchmarks.tables import Cell, Table, at_least, at_most
from tests.scenes import make_grid, render

DATES: Final = 24
SIDE_PX: Final = 1024
SMALLER: Final = ((6, 512),)
"""Dates and side of a cube that is aligned before."""
SEED: Final = 57
SEASONS: Final = 4
LARGEST_PX: Final = 8.0
NOISE_DN: Final = 2.0
CLOUD_SHARES: Final = (0.05, 0.45)
"""Least and largest share of a date under clouds."""
RMS_PX, MEMORY_GB, READ_RATIO, GRADED_SHARE = 0.03, 2.0, 1.3, 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """What the alignment of a cube gave."""

    displacement_px: Array
    """(dates, 2) displacement (col, row); NaN of refused dates."""
    sigma_px: Array
    grades: list[str]
    read: tuple[float, float]
    """Bytes read of a date by the alignment, and by that and the warped cube, in those of the date."""
    memory_gb: float
    """Peak of the process and its workers together, what they share counted once."""
    seconds: tuple[float, float]


def cube(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield how well each date is placed, what was read of it, and the memory."""
    for dates, side in (*SMALLER, (DATES, SIDE_PX)):
        folder = scratch / f"{dates}x{side}"
        folder.mkdir()
        truth, clouds = _write(folder, dates, side)
        # in a process of its own, whose memory is that of the alignment
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            aligned = pool.submit(_align, folder, dates, side, runner.processes).result()
        yield _table(dates, side, truth, clouds, aligned)


def _write(folder: Path, dates: int, side: int) -> tuple[Array, Array]:
    """Write the pixels and the classes of each date; return (dates, 2) displacements and (dates,) clouds."""
    rng = np.random.default_rng([SEED, dates])
    grid = make_grid((side, side))
    truth, clouds = rng.uniform(-LARGEST_PX, LARGEST_PX, (dates, 2)), rng.uniform(*CLOUD_SHARES, dates)
    for number in range(dates):
        shift = truth[number]
        values = 0.85 * render(grid, displacement_px=shift, noise=0.0)
        values += 0.15 * render(grid, seed=10 + number % SEASONS, displacement_px=shift, noise=0.0)
        values += rng.normal(0.0, NOISE_DN, grid.shape)
        smooth = ndimage.gaussian_filter(rng.normal(size=grid.shape), 24.0)
        cloud = smooth > np.quantile(smooth, 1 - clouds[number])
        values[cloud] = 320.0 + 25.0 * smooth[cloud] / smooth.std()
        np.save(folder / f"red{number}.npy", values.astype(np.float32))
        np.save(folder / f"scl{number}.npy", np.where(cloud, 9, 4).astype(np.uint8))
    return truth, clouds


def _align(folder: Path, dates: int, side: int, workers: int) -> Aligned:
    """Align the cube of a folder, count what is read of it, and compute it date by date."""
    import dask
    import dask.array as da
    import xarray as xr

    import pcwlad_geo.xarray  # noqa: F401  # registers the accessor

    grid, reads = make_grid((side, side)), Counter[int]()

    def read(band: str, number: int) -> Any:  # noqa: ANN401
        values = np.load(folder / f"{band}{number}.npy")
        reads[number] += values.nbytes
        return values

    def lazy(band: str, dtype: str) -> xr.DataArray:
        parts = [
            da.from_delayed(dask.delayed(read, pure=False)(band, number), (side, side), dtype)
            for number in range(dates)
        ]
        days = np.datetime64("2020-01-05") + 16 * np.arange(dates)
        transform = grid.transform
        coords = {
            "time": days.astype("datetime64[ns]"),
            "y": transform.f + transform.e * (np.arange(side) + 0.5),
            "x": transform.c + transform.a * (np.arange(side) + 0.5),
            "spatial_ref": ((), 0, {"crs_wkt": grid.crs.to_wkt()}),
        }
        return xr.DataArray(da.stack(parts), dims=("time", "y", "x"), coords=coords, name=band)

    begun, peak_kb, ended = time.perf_counter(), [0], threading.Event()
    threading.Thread(target=_watch_memory, args=(peak_kb, ended)).start()
    aligned = lazy("red", "float32").pcwlad.align(mask=lazy("scl", "uint8"), jobs=workers)
    done = time.perf_counter()
    size = side * side * 5  # pixels and classes
    alone = max(reads.values()) / size
    for number in range(dates):
        aligned[number].compute()
    shift_px = np.column_stack([aligned.dx_m / grid.transform.a, aligned.dy_m / grid.transform.e])
    ended.set()
    return Aligned(
        shift_px,
        aligned.sigma_m.values / grid.transform.a,
        aligned.grade.values.tolist(),
        (alone, max(reads.values()) / size),
        peak_kb[0] / 2**20,
        (done - begun, time.perf_counter() - done),
    )


def _watch_memory(peak_kb: list[int], ended: threading.Event) -> None:
    """Keep the largest memory of this process and those below it, as /proc tells it, until the end."""
    while not ended.wait(0.2):
        total, ids = 0, [os.getpid()]
        for process in ids:
            with suppress(OSError):  # it has ended
                for children in Path(f"/proc/{process}/task").glob("*/children"):
                    ids += map(int, children.read_text().split())
                lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
                total += next(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
        peak_kb[0] = max(peak_kb[0], total)


def _table(dates: int, side: int, truth: Array, clouds: Array, aligned: Aligned) -> Table:
    off_px = aligned.displacement_px - truth
    off_px -= np.nanmean(off_px, axis=0)  # where all lie together is for the reference to say
    rows: list[list[Cell]] = []
    for number, grade in enumerate(aligned.grades):
        moved, off = truth[number], off_px[number]
        row: list[Cell] = [
            f"{number + 1}",
            *(f"{value:+.3f}" for value in moved),
            f"{100 * clouds[number]:.0f} %",
        ]
        rows.append([*row, *(f"{value:+.3f}" for value in off), float(aligned.sigma_px[number]), grade])
    rms = float(np.sqrt(np.nanmean((off_px**2).sum(axis=1))))
    placed = 1 - aligned.grades.count("refused") / dates
    checks = [
        at_most("graded dates, RMS against the truth", rms, RMS_PX, "px", 4),
        at_least("share of the dates that are graded", placed, GRADED_SHARE, "", 2),
        at_most("memory of all processes", aligned.memory_gb, MEMORY_GB, "GB", 2),
        at_most("read of a date, at most, by the alignment", aligned.read[0], READ_RATIO, "x", 2),
        at_most("read of a date, at most, with the warped cube", aligned.read[1], READ_RATIO, "x", 2),
    ]
    title = (
        f"A cube of {dates} dates, {side} x {side} px, aligned in {aligned.seconds[0]:.0f} s, warped in "
        f"{aligned.seconds[1]:.0f} s"
    )
    header = ("date", "moved col, px", "row", "clouds", "error col, px", "row", "sigma", "grade")
    return Table(title, header, rows, checks)
