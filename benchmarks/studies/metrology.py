"""Pixel locking: Sentinel-2 crops of known quarter-pixel shifts, and bands moved exactly by a Fourier shift.

The crops were sampled anew at each shift, so that each aliases in its own way: beside the matcher stands what
a least-absolute-deviation fit of their grey values leaves. In the second table both targets are one band, so
that what the bands differ by drops out, as does the sharpness that other resampling would take.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.pairs import Image, landsat, read, rgbnir, write
from benchmarks.runs import Array, Job, Outcome, Runner, common_points
from benchmarks.studies.difference import difference
from benchmarks.tables import Cell, Check, Table, at_most
from pcwlad_geo.matching import Method
from pcwlad_geo.options import Settings

METHODS: Final[tuple[Method, ...]] = ("oriented", "gradient")
WINDOWS_PX: Final = (31, 61)
LIMIT_PX, DIFFERENCE_LIMIT_PX = 0.003, 0.005
SHIFTS_XY_PX: Final = ((0.4, 0.4), (-0.25, 0.5))
TAPER_PX: Final = 64
PLAIN: Final = Settings(prealign="none", jobs=1)


@dataclass(frozen=True, slots=True)
class Crop:
    """Two crops of one band, and the displacement between them."""

    name: str
    reference: Path
    target: Path
    truth_xy_px: tuple[float, float]


def metrology(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield tables: the crops, bands displaced exactly, and the difference test."""
    yield _crops(data, runner)
    yield _displaced(data, scratch, runner)
    yield from difference(data, scratch, runner, limit_px=DIFFERENCE_LIMIT_PX)


def crops(data: Path) -> Iterator[Crop]:
    """Yield the crops; their names tell the shift of rows and columns."""
    for reference in sorted((data / "metrology").glob("*-left.tif")):
        found = re.search(r"_r([+-][\d.]+)c([+-][\d.]+)-left", reference.name)
        if found is None:
            raise ValueError(f"{reference.name} tells no shift")
        target = reference.with_name(reference.name.replace("-left", "-right"))
        yield Crop(found[0][1:-5], reference, target, (float(found[2]), float(found[1])))


def _crops(data: Path, runner: Runner) -> Table:
    known = list(crops(data))
    runs = [(crop, method, window) for crop in known for method in METHODS for window in WINDOWS_PX]
    outcomes = runner(
        [
            Job(crop.reference, crop.target, replace(PLAIN, method=method, window=window))
            for crop, method, window in runs
        ]
    )
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for (crop, method, window), outcome in zip(runs, outcomes, strict=True):
        what = f"{crop.name}, {method}, {window}"
        error = _moved(outcome) - crop.truth_xy_px
        rows.append([what, len(error), *_signed(error.mean(axis=0)), *_plain(error.std(axis=0))])
        checks.append(at_most(f"{what}: bias", float(abs(error.mean(axis=0)).max()), LIMIT_PX, "px", 4))
        checks.append(at_most(f"{what}: scatter", float(error.std(axis=0).max()), LIMIT_PX, "px", 4))
    for crop in known:
        images = read(crop.reference), read(crop.target)
        for window in WINDOWS_PX:
            error = grey_value_errors(*images, crop.truth_xy_px, window)
            what = f"{crop.name}, grey values, {window}"
            rows.append([what, len(error), *_signed(error.mean(axis=0)), *_plain(error.std(axis=0))])
    header = ("crop, method, window", "points", "bias x", "y", "scatter x", "y")
    return Table("Sentinel-2 crops of one band, shifted by quarter pixels, px", header, rows, checks)


def _displaced(data: Path, scratch: Path, runner: Runner) -> Table:
    """Compare the displacements of a pair before and after its target was moved by a Fourier shift."""
    red, blue = (read(data / "cross_sensor/sentinel2_b432_byte.tif", band) for band in (1, 3))
    files = write(scratch / "red.tif", red), write(scratch / "blue.tif", blue)
    pairs = [("Sentinel-2 red - blue", *files)]
    pairs += [(pair.name, pair.reference, pair.undisplaced) for pair in (landsat(data), rgbnir(data))]
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for name, reference, target in pairs:
        image = read(target)
        places = [target]
        for number, shift in enumerate(SHIFTS_XY_PX):
            places.append(write(scratch / f"{target.stem}_{number}.tif", fourier_shift(image, shift)))
        for method in METHODS:
            chosen = replace(PLAIN, method=method)
            before, *after = runner([Job(reference, place, chosen) for place in places])
            for shift, outcome in zip(SHIFTS_XY_PX, after, strict=True):
                first, second = common_points(before.points, outcome.points)
                error = _moved(outcome)[second] - _moved(before)[first] - shift
                what, bias = f"{name}, {method}, {shift}", np.median(error, axis=0)
                rows.append([what, len(error), *_signed(bias), *_plain(error.std(axis=0))])
                checks.append(at_most(what, float(abs(bias).max()), DIFFERENCE_LIMIT_PX, "px", 4))
    header = ("pair, method, shift", "points", "error x", "y", "scatter x", "y")
    return Table(
        "Displacements after an exact shift less those before it (medians), px", header, rows, checks
    )


def fourier_shift(image: Image, shift_xy_px: tuple[float, float]) -> Array:
    """Return the image moved by a phase factor, its surroundings continued and faded out beyond its edges."""
    mean = image.mean()
    wide = np.pad(image - mean, TAPER_PX, mode="reflect", reflect_type="odd")
    fade = 0.5 - 0.5 * np.cos(np.pi * np.arange(TAPER_PX) / TAPER_PX)
    for axis, n in enumerate(image.shape):
        weight = np.concatenate([fade, np.ones(n), fade[::-1]])
        wide *= weight[:, None] if axis == 0 else weight
    rows, cols = np.fft.fftfreq(wide.shape[0])[:, None], np.fft.fftfreq(wide.shape[1])
    turn = np.exp(-2j * np.pi * (cols * shift_xy_px[0] + rows * shift_xy_px[1]))
    moved = np.fft.ifft2(np.fft.fft2(wide) * turn).real
    return np.asarray(moved[TAPER_PX:-TAPER_PX, TAPER_PX:-TAPER_PX] + mean, np.float32)


def grey_value_errors(
    reference: Image, target: Image, truth_xy_px: tuple[float, float], window_px: int, low_pass: float = 0.35
) -> Array:
    """Return what a fit of the grey values errs by, (n, 2), in windows of the target moved back by the truth.

    Both images are limited to `low_pass` cycles a pixel, below most of what their sampling aliased.
    """
    back = fourier_shift(target, (-truth_xy_px[0], -truth_xy_px[1]))
    first, second = _limited(reference, low_pass), _limited(back, low_pass)
    mean = (first + second) / 2
    slope_y, slope_x = np.gradient(mean)
    design = np.stack([slope_x, slope_y, mean, np.ones_like(mean)], axis=-1)
    half, edge = window_px // 2, max(window_px // 2, 14)
    errors = []
    for row in range(edge, mean.shape[0] - edge, 6):
        for col in range(edge, mean.shape[1] - edge, 6):
            here = np.s_[row - half : row + half + 1, col - half : col + half + 1]
            fit = _least_deviations(design[here].reshape(-1, 4), (first - second)[here].ravel())
            errors.append(fit[:2])
    return np.array(errors)


def _limited(image: Image, low_pass: float) -> Array:
    """Return the image without frequencies above `low_pass`, by a windowed sinc."""
    k = np.arange(-16, 17)
    kernel = np.sinc(2 * low_pass * k) * np.kaiser(33, 5)
    kernel /= kernel.sum()
    wide = np.pad(np.asarray(image, float), 16, mode="reflect")
    along = np.apply_along_axis(np.convolve, 1, wide, kernel, "valid")
    return np.asarray(np.apply_along_axis(np.convolve, 0, along, kernel, "valid"))


def _least_deviations(design: Array, values: Array) -> Array:
    weight = np.ones(len(values))
    for _ in range(8):
        weighted = design * weight[:, None]
        fit = np.linalg.solve(weighted.T @ design, weighted.T @ values)
        residual = abs(values - design @ fit)
        weight = 1 / (1 + residual / (1.4826 * np.median(residual)))
    return np.asarray(fit)


def _moved(outcome: Outcome) -> Array:
    return outcome.points.target_px - outcome.points.reference_px


def _signed(values: Array) -> list[Cell]:
    return [f"{value:+.4f}" for value in values]


def _plain(values: Array) -> list[Cell]:
    return [f"{value:.4f}" for value in values]
