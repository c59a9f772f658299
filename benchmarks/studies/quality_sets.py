"""Grades of stacks, rigs and blocks, image by image, against a truth that is known everywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from rasterio.transform import Affine
from scipy import ndimage

import pcwlad_geo
from benchmarks.displacing import Field, displace
from benchmarks.pairs import Image, as_uint8, with_noise, write
from benchmarks.quality_scenes import CONDITIONS, HARDER, Ground, Make, clouded, grounds, turned
from benchmarks.rig_scenes import Ground as Land
from benchmarks.rig_scenes import flight, made_rig, write_capture
from benchmarks.runs import Array, Runner
from benchmarks.studies.rig import applied_errors
from benchmarks.studies.rpcblock import VIEWS
from benchmarks.tables import Cell, Check, Table, at_least, at_most
from pcwlad_geo.errors import InputError, RegistrationRejectedError
from pcwlad_geo.multi.stack.result import Stack, StackImage
from pcwlad_geo.raster import Grid, describe, map_px
from pcwlad_geo.rigs.applying_run import rig_apply
from pcwlad_geo.rigs.learning_run import rig_learn
from tests.multi.rpc_views import view_rpc, write_view
from tests.rpc_scene import UNDULATION_M, dem_grid, dem_values, rpc_grid, write_dem

GRID: Final = Affine(10.0, 0.0, 500000.0, 0.0, -10.0, 5000000.0)
CRS: Final = "EPSG:32633"
FINE_PX, OFF_PX, TIMES = 0.5, 1.0, 3.0
FINE_SHARE: Final = 95.0
STEP_PX: Final = 8.0
SEED: Final = 28
SCENES: Final = (
    "shift",
    "noise of 15",
    "moved clouds, 20 %",
    "cold clouds that moved, 30 %",
    "two depths, 15 % by 4 px",
    "ships on their own, 40 % sea",
    "seasonal fields, 60 %",
    "haze up to 80 %",
    "jitter of 1 px, 60 rows",
    "orchard, half of the ground",
    "half flooded",
)
"""Conditions of pairs of which stacks are made."""


@dataclass(frozen=True, slots=True)
class Graded:
    """An image or capture: what is told of it, and the truth."""

    name: str
    grade: str
    """`refused` where there is no result, `none` where no grade is told."""
    expected_ce90_px: float
    true_ce90_px: float
    """NaN where there is no result."""
    open_question: str = ""
    """What the images cannot tell: `fair` is as right as `good` there, as among the pairs."""

    @property
    def wrong(self) -> bool:
        """Whether it is called good and is not."""
        off = self.true_ce90_px
        return self.grade == "good" and bool(off > OFF_PX or off > TIMES * self.expected_ce90_px)


def _table(what: str, found: Sequence[Graded]) -> Table:
    """Return the table of images or captures, and the checks that hold for all kinds of them."""
    rows: list[list[Cell]] = [
        [
            each.name,
            each.grade,
            each.expected_ce90_px,
            each.true_ce90_px,
            "WRONG" if each.wrong else each.open_question,
        ]
        for each in found
    ]
    good = [each for each in found if each.grade == "good"]
    fine = [each for each in found if each.true_ce90_px < FINE_PX and not each.open_question]
    share = 100 * sum(each.grade == "good" for each in fine) / max(len(fine), 1)
    off = sum(each.true_ce90_px > OFF_PX for each in good)
    unexpected = sum(each.true_ce90_px > TIMES * each.expected_ce90_px for each in good)
    checks: list[Check] = [
        at_most(f"good {what} off by more than {OFF_PX:.0f} px", off, 0, digits=0),
        at_most(f"good {what} off by more than {TIMES:.0f} x what is expected", unexpected, 0, digits=0),
        at_least(f"{what} truly better than {FINE_PX} px that are good", share, FINE_SHARE, "%", 1),
    ]
    header = ("", "grade", "CE90 expected", "true", "")
    return Table(f"Grades of {len(found)} {what} ({len(fine)} truly fine)", header, rows, checks)


def _graded(name: str, told: object, errors: Array, question: str = "") -> Graded:
    """Return what a result tells of itself, where it does, beside its (n, 2) errors."""
    off = errors[np.isfinite(errors).all(axis=1)]
    true = float(np.percentile(np.linalg.norm(off, axis=1), 90)) if len(off) else float("nan")
    quality = getattr(told, "quality", None)
    grade = getattr(quality, "grade", quality) or "none"
    expected = getattr(quality, "expected_ce90_px", getattr(told, "expected_ce90_px", None))
    return Graded(name, grade, float("nan") if expected is None else expected, true, question)


# --- stacks


def stacks(data: Path, scratch: Path, _runner: Runner) -> Iterator[Table]:
    """Yield the grades of stacks of four: two plain images, and two in which a condition holds."""
    ground = next(each for each in grounds(data) if each.exact)
    made = CONDITIONS | HARDER
    found: list[Graded] = []
    for number, name in enumerate(SCENES):
        found += _stack_of(name, made[name].make, ground, scratch / f"stack_{number}", SEED + 10 * number)
    yield _table("images of stacks", found)


def _stack_of(name: str, make: Make, ground: Ground, folder: Path, seed: int) -> list[Graded]:
    folder.mkdir(parents=True)
    seen: dict[str, tuple[Image, Field]] = {
        "first": (ground.reference, np.zeros_like),
        "turned": (as_uint8(displace(ground.target, turned)), turned),
    }
    for which in range(2):
        images = make(ground, seed + which)
        seen[f"image{which + 1}"] = images.target, images.field
        if which == 0:
            seen["first"] = images.reference, np.zeros_like
    paths = [
        write(folder / f"{key}.tif", with_noise(as_uint8(image), 1.0, seed + place), GRID, CRS)
        for place, (key, (image, _)) in enumerate(seen.items())
    ]
    fields = dict(zip((path.stem for path in paths), (field for _, field in seen.values()), strict=True))
    try:
        result = pcwlad_geo.stack(paths, out_dir=folder / "out", jobs=1)
    except (InputError, RegistrationRejectedError):
        return [Graded(f"{name}: all", "refused", float("nan"), float("nan"))]
    rows, cols = ground.reference.shape
    at_px = np.stack(np.meshgrid(*(np.arange(4, side, STEP_PX) for side in (cols, rows))), -1).reshape(-1, 2)
    errors = {
        each.name: each.correction.forward(at_px) - at_px - fields[each.name](at_px) for each in result.images
    }
    datum = errors["first"]
    return [
        _graded(f"{name}: {each.name}", each, errors[each.name] - datum)
        for each in result.images
        if each.name != "first"
    ]


# --- rigs


LEARNED, APPLIED = 20, 8
LANDS: Final[dict[str, tuple[float, tuple[float, float]]]] = {
    "as learned": (3.0, (30.0, 120.0)),
    "near the ground": (0.3, (8.0, 12.0)),
    "several depths": (3.0, (10.0, 20.0)),
    "cliffs": (8.0, (30.0, 50.0)),
}
"""Relief (standard deviation) and heights above the ground, m, of captures to which the rig is applied."""


def rigs(_data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield the grades of captures of a rig over ever nearer ground."""
    lenses, land = made_rig(SEED), Land.made(SEED)
    for number, flown in enumerate(flight(SEED, LEARNED, land)):
        write_capture(scratch / "learn", f"L_{number:03}", lenses, flown, land, seed=number, height=True)
    known = rig_learn([scratch / "learn"], jobs=runner.processes)
    found: list[Graded] = []
    for number, (name, (relief_m, heights_m)) in enumerate(LANDS.items()):
        below = Land.made(SEED + 1, relief_m=relief_m)
        captures = flight(SEED + number + 2, APPLIED, below, heights_m=heights_m)
        folder = scratch / f"apply_{number}"
        for index, flown in enumerate(captures):
            write_capture(folder, f"A_{index:03}", lenses, flown, below, seed=100 + index, height=True)
        result = rig_apply(known, [folder], out_dir=scratch / f"out_{number}", jobs=runner.processes)
        for each in result.captures:
            title = f"{name}: {each.name}"
            if each.status != "corrected":
                found.append(Graded(title, "refused", float("nan"), float("nan")))
                continue
            flown = captures[int(each.name.removeprefix("A_"))]
            errors = applied_errors(known, lenses, flown, below, result.out_dir / f"{each.name}.tif")
            found.append(_graded(title, each, max(errors, key=_ce90)))
    yield _table("captures of rigs", found)


def _ce90(errors: Array) -> float:
    return float(np.nanpercentile(np.linalg.norm(errors, axis=1), 90))


# --- blocks


MOVING_CLOUDS: Final = "clouds that move"


def blocks(_data: Path, scratch: Path, _runner: Runner) -> Iterator[Table]:
    """Yield the grades of images with RPCs over one ground, with elevation models and images ever worse."""
    true = write_dem(scratch / "true.tif")
    heights = dem_values(dem_grid())
    middle = float(np.nanmedian(heights))
    models: dict[str, Array] = {
        "right DEM": heights,
        "DEM 40 m too high": heights + 40.0,
        "DEM moved by 3 cells": np.asarray(np.roll(heights, 3, axis=1)),
        "DEM without relief": np.where(np.isfinite(heights), middle, np.nan),
        "DEM upside down": 2 * middle - heights,
    }
    spoils: dict[str, Callable[[Image, int], Image]] = {
        MOVING_CLOUDS: lambda image, seed: clouded(image, 0.3, SEED, (3.0 * seed, -2.0 * seed))[0],
        "half flooded": _flooded,
    }
    found: list[Graded] = []
    for number, (name, values) in enumerate(models.items()):
        dem = write_dem(scratch / f"dem_{number}.tif", values)
        found += _block_of(name, true, dem, scratch / f"block_{number}", None)
    for number, (name, spoil) in enumerate(spoils.items()):
        # whether the clouds stand and the ground moves, two displacements alone cannot tell
        question = "clouds or ground" if name == MOVING_CLOUDS else ""
        found += _block_of(name, true, true, scratch / f"spoilt_{number}", spoil, question)
    yield _table("images of blocks", found)


def _flooded(image: Image, seed: int) -> Image:
    """Put water over half of the last view."""
    wet = ndimage.gaussian_filter((np.arange(image.shape[1]) > image.shape[1] / 2).astype(float), 2.0)
    waves = np.random.default_rng(seed).normal(45.0, 3.0, image.shape)
    return image if seed + 1 < len(VIEWS) else np.asarray(image * (1 - wet) + waves * wet)


def _block_of(
    name: str,
    true: Path,
    dem: Path,
    folder: Path,
    spoil: Callable[[Image, int], Image] | None,
    question: str = "",
) -> list[Graded]:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(SEED)
    paths, biases = [], []
    for number, view in enumerate(VIEWS):
        biases.append(rng.uniform(-3.0, 3.0, 2))
        paths.append(write_view(folder / f"view{number}.tif", true, view_rpc(view), biases[-1], rng))
        if spoil is not None:
            _spoil(paths[-1], spoil, number)
    try:
        result = pcwlad_geo.stack(paths, out_dir=folder / "out", dem=dem, dem_vertical=UNDULATION_M, jobs=1)
    except (InputError, RegistrationRejectedError):
        return [Graded(f"{name}: all", "refused", float("nan"), float("nan"))]
    errors = np.stack(_block_errors(result, true, dem, biases))
    errors = errors - np.nanmean(errors, axis=0)  # where the block lies as a whole is the datum's
    return [
        _graded(f"{name}: {each.name}", each, own, question)
        for each, own in zip(result.images, errors, strict=True)
    ]


def _spoil(path: Path, change: Callable[[Image, int], Image], number: int) -> None:
    with rasterio.open(path, "r+") as file:
        values = file.read(1).astype(np.float64)
        scale = 255.0 / float(values.max())
        file.write(np.clip(change(values * scale, number) / scale, 1, 65535).astype(np.uint16), 1)


def _block_errors(result: Stack, true: Path, dem: Path, biases: Sequence[Array]) -> list[Array]:
    """Return for each image the (n, 2) distances, px of the frame, at places of its orthoimage."""
    frame = _frame(result.images[0])
    at_px = frame.lattice_px(25)
    errors = []
    for image, view, bias in zip(result.images, VIEWS, biases, strict=True):
        rpc = view_rpc(view)
        read = image.correction.forward(map_px(at_px, frame, rpc_grid(dem, rpc)))
        ground = map_px(read - bias, rpc_grid(true, rpc), frame)
        errors.append(np.asarray(ground - at_px))
    return errors


def _frame(image: StackImage) -> Grid:
    return describe(image.registered).grid
