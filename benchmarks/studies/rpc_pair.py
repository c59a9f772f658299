"""Two parts cut from products with RPCs, 1000 m above their height offset: found, written, carried over."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from rasterio.rpc import RPC

import pcwlad_geo
from benchmarks.runs import Array
from benchmarks.tables import Cell, Check, Table, at_least, at_most
from pcwlad_geo.raster import RpcModel, open_raster, read_rpc
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.raster.rpc.bias import BIAS_TOLERANCE_PX
from pcwlad_geo.raster.rpc.files import to_gdal
from pcwlad_geo.raster.rpc.ortho import orthorectify
from pcwlad_geo.registration import Registration

WINDOW_PX: Final = 128
DECIMATION: Final = 4
LEFT_PX: Final = 0.05
"""Of the pan's pixels, between two orthoimages."""
WAYS_PX: Final = 0.05
SHARED: Final = 0.99
"""Share of the ground of DEM, image and reference that is written."""


def rpc_pair(data: Path, scratch: Path) -> Iterator[Table]:
    """Yield a table for each question."""
    folder = data / "rpc_pair"
    heights = {"dem": folder / "dem.tif", "dem_vertical": 0.0, "jobs": 1}
    target = folder / "img_02.tif"
    ways = {"ortho_01.tif": scratch / "by_ortho", "img_01.tif": scratch / "by_rpc"}
    found = {
        name: pcwlad_geo.register(folder / name, target, out_dir=out_dir, **heights)  # type: ignore[arg-type]
        for name, out_dir in ways.items()
    }
    yield _found(found, ways)
    after = ways["ortho_01.tif"] / "img_02_registered.tif"
    before = _as_it_was(found["ortho_01.tif"], after, target, scratch / "before.tif")
    yield _orthoimages(folder / "ortho_01.tif", {"with the RPC as it is": before, "corrected": after})
    yield _sibling(target, ways["ortho_01.tif"], after, scratch)


def _found(found: dict[str, Registration], ways: dict[str, Path]) -> Table:
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    shifts = []
    for name, registration in found.items():
        points = registration.tie_points.select("fit", "check", "unused")
        shift = points.displacement_px.mean(axis=0)
        with rasterio.open(ways[name] / "img_02_registered.tif") as file:
            size = f"{file.width} x {file.height}"
            area_m2 = float((file.dataset_mask() != 0).sum() * abs(file.transform.a * file.transform.e))
        with rasterio.open(registration.settings.dem) as dem:
            dem_m2 = dem.width * dem.height * abs(dem.transform.a * dem.transform.e)
        lost = int(np.isnan(points.displacement_m).any(axis=1).sum())
        fold_px = registration.rpc.bias_error_px if registration.rpc else None
        rows.append([name, len(points), *(f"{value:+.3f}" for value in shift), size, lost, f"{fold_px:.1e}"])
        checks.append(at_least(f"{name}: written of the ground shared", area_m2 / dem_m2, SHARED, "", 3))
        checks.append(at_most(f"{name}: points without metres", lost, 0, "", 0))
        checks.append(at_most(f"{name}: fold error", fold_px or 0.0, BIAS_TOLERANCE_PX, "px", 7))
        shifts.append(shift)
    apart = float(np.hypot(*(shifts[0] - shifts[1])))
    checks.append(at_most("an orthoimage and a reference with RPC: apart", apart, WAYS_PX, "px"))
    header = ("reference", "points", "mean column", "row", "output, px", "no metres", "fold error, px")
    return Table("Pleiades pair: what is found", header, rows, checks)


def _as_it_was(registration: Registration, after: Path, target: Path, path: Path) -> Path:
    """Orthorectify the target by its own RPC onto the grid of the registered one."""
    if registration.rpc is None:
        raise RuntimeError("no RPC was used")
    with rasterio.open(after) as file:
        grid = replace(registration.matching_grid, shape=file.shape, transform=file.transform)
    orthorectify(target, path, registration.rpc.original, grid)
    return path


def _orthoimages(reference: Path, images: dict[str, Path]) -> Table:
    """Compare orthoimages by phase correlation, which is no part of the matching."""
    with rasterio.open(reference) as file:
        ours, bounds = file.read(1).astype(np.float64), file.bounds
    valid = ours > 0
    rows: list[list[Cell]] = []
    distance = float("nan")
    for name, path in images.items():
        with rasterio.open(path) as file:
            window = file.window(*bounds).round_offsets().round_lengths()
            theirs = file.read(1, window=window, boundless=True, fill_value=0).astype(np.float64)
        shifts = phase_shifts(ours, theirs, valid & (theirs > 0), WINDOW_PX)
        rows.append([name, len(shifts), *summary(shifts)])
        distance = float(np.hypot(*np.median(shifts, axis=0)))
    checks = [at_most("orthoimages after the correction: apart", distance, LEFT_PX, "px")]
    header = ("img_02", "windows", "median column", "row", "its standard error", "row")
    return Table(f"Against ortho_01, phase correlation of {WINDOW_PX} px windows, px", header, rows, checks)


def _sibling(target: Path, registration: Path, pan: Path, scratch: Path) -> Table:
    """Correct a coarser sibling, whose RPC is its own, and compare it with the registered pan."""
    path = scratch / "ms.tif"
    pan_rpc, ms_rpc = _write_decimated(target, path)
    pcwlad_geo.warp(registration, [path], out_dir=scratch)
    corrected = [read_rpc(str(file)) for file in (registration / "img_02_rpc.vrt", scratch / "ms_rpc.vrt")]
    if corrected[0] is None or corrected[1] is None:
        raise RuntimeError("no corrected RPC was written")
    moved = [
        np.array([after.rpc.samp_off - before.samp_off, after.rpc.line_off - before.line_off])
        for before, after in zip((pan_rpc, ms_rpc), corrected, strict=True)
    ]
    with rasterio.open(pan) as file, rasterio.open(scratch / "ms_registered.tif") as ms:
        theirs, size = ms.read(1).astype(np.float64), abs(ms.transform.a / file.transform.a)
        whole = file.window(*ms.bounds).round_offsets().round_lengths()
        fine = file.read(1, window=whole, boundless=True, fill_value=0).astype(np.float64)
    mean, covered = _block_mean(fine, round(size)), _block_mean((fine > 0).astype(float), round(size))
    shifts = phase_shifts(mean, theirs, (covered == 1.0) & (theirs > 0), WINDOW_PX // 2)
    apart = np.median(shifts, axis=0) * size
    rows: list[list[Cell]] = [
        ["correction of the pan, its px", "", *(f"{value:+.4f}" for value in moved[0]), "", ""],
        ["carried over, px of the sibling", "", *(f"{value:+.4f}" for value in moved[1]), "", ""],
        ["orthoimages apart, px of the sibling", len(shifts), *summary(shifts)],
    ]
    ratio_px = float(np.hypot(*(moved[1] * DECIMATION - moved[0])))
    checks = [
        at_most("sibling: shift times pixel size, less the pan's", ratio_px, 1e-3, "px", 5),
        at_most("sibling and pan: apart, px of the pan", float(np.hypot(*apart)), LEFT_PX, "px"),
    ]
    header = ("", "windows", "column", "row", "its standard error", "row")
    return Table(f"A sibling of {DECIMATION} times the pixel size with its own RPC", header, rows, checks)


def _write_decimated(target: Path, path: Path) -> tuple[RpcModel, RpcModel]:
    """Write the target with larger pixels and the RPC that these have; return its RPC and the new one."""
    source = read_rpc(str(target))
    if source is None:
        raise RuntimeError(f"{target} has no RPC")
    rpc = source.rpc
    coarse = replace(
        rpc,
        samp_off=(rpc.samp_off + 0.5) / DECIMATION - 0.5,
        line_off=(rpc.line_off + 0.5) / DECIMATION - 0.5,
        samp_scale=rpc.samp_scale / DECIMATION,
        line_scale=rpc.line_scale / DECIMATION,
    )
    with open_raster(str(target)) as file:
        mean = _block_mean(file.read(1).astype(np.float64), DECIMATION)
    values = np.rint(mean).astype(np.uint16)
    rows, cols = values.shape
    with (
        ignoring(NotGeoreferencedWarning),
        rasterio.open(path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype="uint16") as file,
    ):
        file.write(values, 1)
        file.rpcs = RPC.from_gdal(to_gdal(coarse))
    return rpc, coarse


def phase_shifts(first: Array, second: Array, valid: Array, side: int) -> Array:
    """Return (n, 2) shifts (col, row) of the second image against the first, in windows all valid."""
    taper = cv2.createHanningWindow((side, side), cv2.CV_64F)
    found = []
    for row in range(0, first.shape[0] - side + 1, side // 2):
        for col in range(0, first.shape[1] - side + 1, side // 2):
            part = slice(row, row + side), slice(col, col + side)
            if valid[part].all():
                # copies: OpenCV 5 multiplies the taper into what it is given
                found.append(cv2.phaseCorrelate(first[part].copy(), second[part].copy(), taper)[0])
    return np.array(found).reshape(-1, 2)


def summary(shifts: Array) -> list[str]:
    """Return the median and its standard error; windows overlap by half, so that a quarter of them counts."""
    middle = np.median(shifts, axis=0)
    scatter = 1.4826 * np.median(np.abs(shifts - middle), axis=0)
    error = 1.2533 * scatter / np.sqrt(max(1.0, len(shifts) / 4))
    return [f"{value:+.3f}" for value in middle] + [f"{value:.3f}" for value in error]


def _block_mean(values: Array, factor: int) -> Array:
    rows, cols = (side // factor for side in values.shape)
    blocks = values[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor)
    return np.asarray(blocks.mean(axis=(1, 3)))
