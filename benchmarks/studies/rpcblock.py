"""Blocks of images with RPCs: do their orthoimages agree, are biases recovered, are wrong DEMs told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from affine import Affine

import pcwlad_geo
from benchmarks.runs import Array, Runner
from benchmarks.studies.rpc_pair import WINDOW_PX, phase_shifts, summary
from benchmarks.tables import Cell, Check, Table, at_most
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.raster import at_mean_height, describe, jacobian, read_rpc
from pcwlad_geo.raster.rpc.files import to_gdal
from pcwlad_geo.raster.rpc.ortho import orthorectify
from pcwlad_geo.raster.vrt import write_rpc_vrt
from tests.multi.rpc_views import view_rpc, write_view
from tests.rpc_scene import UNDULATION_M, write_dem

IMAGES: Final = ("img_01", "img_02")
REFERENCE: Final = "ortho_01"
BIAS_PX: Final = np.array([3.0, -2.0])
DEM_OFF_M: Final = 20.0
APART_PX: Final = 0.3
RECOVERED_PX: Final = 0.1
TRUTH_PX: Final = 0.05
VIEWS: Final = ((1.0, 1.0), (-1.0, 0.4), (0.2, -1.2), (2.5, 0.8))
"""Of the images of a synthetic block: displacement by height, in that of the scene's RPC."""


def rpcblock(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield a table for each question."""
    folder = data / "rpc_pair"
    pair = {name: folder / f"{name}.tif" for name in IMAGES}
    dem = folder / "dem.tif"
    alone = _stack(scratch / "alone", pair, dem)
    based = _stack(scratch / "based", pair, dem, folder / f"{REFERENCE}.tif")
    yield _orthoimages(alone, based, scratch)
    yield _biases(folder, scratch, {False: alone, True: based})
    yield _dems(folder, scratch, {False: alone, True: based})
    yield _synthetic(scratch)


def _stack(
    out_dir: Path,
    images: Mapping[str, Path],
    dem: Path,
    reference: Path | None = None,
    *,
    vertical_m: float = 0.0,
    trust_vrt: bool = False,
) -> Stack:
    given = [*images.values(), *([] if reference is None else [reference])]
    return pcwlad_geo.stack(
        given, out_dir=out_dir, dem=dem, dem_vertical=vertical_m, jobs=1, trust_vrt=trust_vrt
    )


def _orthoimages(alone: Stack, based: Stack, scratch: Path) -> Table:
    """Compare the two orthoimages by phase correlation, which is no part of the matching."""
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    ways = {"with the RPCs as they are": _as_they_were(alone, scratch)}
    ways |= {
        name: [found.out_dir / f"{image}_registered.tif" for image in IMAGES]
        for name, found in (("adjusted, without a reference", alone), ("adjusted, with ortho_01", based))
    }
    for name, paths in ways.items():
        first, second = (_read(path) for path in paths)
        shifts = phase_shifts(first, second, (first > 0) & (second > 0), WINDOW_PX)
        rows.append([name, len(shifts), *summary(shifts)])
        if name.startswith("adjusted"):
            apart = float(np.median(np.hypot(*shifts.T)))
            checks.append(at_most(f"{name}: median distance of the orthoimages", apart, APART_PX, "px"))
    header = ("", "windows", "median column", "row", "its standard error", "row")
    return Table(
        f"Two Pleiades orthoimages, phase correlation of {WINDOW_PX} px windows", header, rows, checks
    )


def _as_they_were(found: Stack, scratch: Path) -> list[Path]:
    paths = []
    for image in found.images:
        if image.rpc is None:
            raise RuntimeError(f"{image.name} has no RPC")
        original = image.rpc.registration.original
        paths.append(scratch / f"{image.name}_before.tif")
        orthorectify(image.path, paths[-1], original, describe(image.registered).grid)
    return paths


def _read(path: Path) -> Array:
    with rasterio.open(path) as file:
        return np.asarray(file.read(1).astype(np.float64))


def _biases(folder: Path, scratch: Path, right: Mapping[bool, Stack]) -> Table:
    """Put a bias into the RPC of each image in turn, and see what the adjustment makes of it."""
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for biased in IMAGES:
        moved = _biased(folder, scratch / f"{biased}.vrt", biased)
        images = {name: moved if name == biased else folder / f"{name}.tif" for name in IMAGES}
        for with_reference, before in right.items():
            reference = folder / f"{REFERENCE}.tif" if with_reference else None
            after = _stack(
                scratch / f"{biased}_{with_reference}", images, folder / "dem.tif", reference, trust_vrt=True
            )
            seen = _recovered(before, after, biased, with_reference)
            error = float(np.hypot(*(seen - BIAS_PX)))
            name = f"{biased}, {'with' if with_reference else 'without'} a reference"
            rows.append([name, *(f"{value:+.3f}" for value in seen), error, _told(after)])
            checks.append(at_most(f"bias of {name}: error", error, RECOVERED_PX, "px"))
            checks.append(at_most(f"bias of {name}: DEM called wrong", _told(after), 0, "", 0))
    title = f"A bias of ({BIAS_PX[0]:+.0f}, {BIAS_PX[1]:+.0f}) px put into one RPC, as recovered, px"
    return Table(title, ("", "column", "row", "error", "messages on the DEM"), rows, checks)


def _biased(folder: Path, path: Path, name: str) -> Path:
    source = read_rpc(str(folder / f"{name}.tif"))
    if source is None:
        raise RuntimeError(f"{name} has no RPC")
    rpc = source.rpc
    rpc = replace(rpc, samp_off=rpc.samp_off + BIAS_PX[0], line_off=rpc.line_off + BIAS_PX[1])
    write_rpc_vrt(path, folder / f"{name}.tif", to_gdal(rpc), final_path=path)
    return path


def _recovered(before: Stack, after: Stack, biased: str, with_reference: bool) -> Array:
    """Return the bias as found, px of the biased image; without a reference, relative to the other image."""
    changes = {
        one.name: np.subtract(one.shift_px, other.shift_px)
        for one, other in zip(before.images, after.images, strict=True)
    }
    change = changes[biased]
    if not with_reference:
        other = next(name for name in IMAGES if name != biased)
        grids = {image.name: image.rpc.registration.original for image in before.images if image.rpc}
        level = {name: at_mean_height(grid) for name, grid in grids.items()}
        rate = jacobian(level[other].middle_px, level[other], level[biased])[0]
        change = change - rate @ changes[other]
    return np.asarray(change)


def _told(found: Stack) -> int:
    check = found.block.dem if found.block else None
    return len(check.faults) if check else 0


def _dems(folder: Path, scratch: Path, right: Mapping[bool, Stack]) -> Table:
    """Shift the DEM, and see whether and how that is told."""
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    shifts = {"up": (0, 0, 1), "down": (0, 0, -1), "to the east": (1, 0, 0), "to the north": (0, 1, 0)}
    images = {name: folder / f"{name}.tif" for name in IMAGES}
    for with_reference, before in right.items():
        reference = folder / f"{REFERENCE}.tif" if with_reference else None
        how = f"{'with' if with_reference else 'without'} a reference"
        found = {"as it is": before}
        for name, direction in shifts.items():
            off_m = np.array(direction) * DEM_OFF_M
            dem = _moved_dem(folder / "dem.tif", scratch / f"dem_{name.replace(' ', '_')}.tif", off_m)
            found[name] = _stack(scratch / f"{dem.stem}_{with_reference}", images, dem, reference)
        for name, each in found.items():
            check = each.block.dem if each.block else None
            if check is None:
                raise RuntimeError("no DEM was looked at")
            beside = check.offset_m or (np.nan, np.nan)
            rows.append(
                [
                    f"{name}, {how}",
                    len(check.faults),
                    f"{check.too_high_m or 0.0:+.2f}",
                    check.by_chance or 1.0,
                ]
                + [f"{value:+.2f}" for value in beside]
            )
            missed = int((len(check.faults) > 0) != (name != "as it is"))
            checks.append(at_most(f"DEM {name}, {how}: told wrongly", missed, 0, "", 0))
    header = ("DEM moved by 20 m", "messages", "too high, m", "by chance", "beside x, m", "y, m")
    return Table("A DEM that is moved", header, rows, checks)


def _moved_dem(dem: Path, path: Path, off_m: Array) -> Path:
    with rasterio.open(dem) as file:
        values, profile = file.read(1), file.profile
    profile["transform"] = Affine.translation(off_m[0], off_m[1]) * profile["transform"]
    profile["driver"] = "GTiff"
    with rasterio.open(path, "w", **profile) as file:
        file.write(values + np.float32(off_m[2]), 1)
    return path


def _synthetic(scratch: Path) -> Table:
    """Adjust a block of exact truth: one scene from several sides, each RPC with an error of its own."""
    rng = np.random.default_rng(19)
    dem = write_dem(scratch / "hills.tif")
    images, truth = {}, []
    for number, view in enumerate(VIEWS):
        rpc = view_rpc(view)
        truth.append(rng.uniform(-3.0, 3.0, 2))
        path = scratch / f"view{number}.tif"
        images[path.stem] = write_view(path, dem, rpc, truth[-1], rng)
    found = _stack(scratch / "views", images, dem, vertical_m=UNDULATION_M)
    frame = describe(found.images[0].registered).grid
    grids = [at_mean_height(image.rpc.registration.original) for image in found.images if image.rpc]
    rates = [jacobian(grid.middle_px, grid, frame)[0] for grid in grids]
    shifts = [np.array(image.shift_px) for image in found.images]
    off = np.array([rate @ (shift - bias) for rate, shift, bias in zip(rates, shifts, truth, strict=True)])
    off = off - off.mean(axis=0)  # the mean of all stays
    rows: list[list[Cell]] = [
        [image.name, *(f"{value:+.3f}" for value in error), *(f"{value:.3f}" for value in image.sigma_px)]
        for image, error in zip(found.images, off, strict=True)
    ]
    worst = float(np.hypot(*off.T).max())
    checks = [
        at_most("synthetic block: worst image against the truth", worst, TRUTH_PX, "px", 3),
        at_most("synthetic block: DEM called wrong", _told(found), 0, "", 0),
    ]
    header = ("", "error in column", "row", "sigma column", "row")
    title = f"{len(VIEWS)} synthetic views of hills, errors of up to 3 px put in, mean datum, px"
    return Table(title, header, rows, checks)
