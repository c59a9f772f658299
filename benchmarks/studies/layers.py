"""What follows a registration: vectors, and any layer by the grid for PROJ, beside the registered raster."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pyogrio.raw
import pyproj
import rasterio
import shapely
from affine import Affine
from rasterio.enums import Resampling
from rasterio.warp import reproject

import pcwlad_geo
from benchmarks.runs import Runner
from benchmarks.tables import Table, at_most
from pcwlad_geo.outputs.proj_grid import proj_pipeline

SAMPLE: Final = Path(__file__).resolve().parents[2] / "sample_data"
VERTICES, VERTICES_OF_ONE = 1_000_000, 1000
BLOBS_PX: Final = np.array([[x, y] for x in (150.0, 350.0, 550.0) for y in (150.0, 350.0, 550.0)])
WIDTH_PX: Final = 5.0
EDGE_PX: Final = 20
STRIP_PX: Final = 8
"""Width of what GDAL warps at a time: along a row it goes straight where that is right to 0.125 px."""
CPU_S, MEMORY_GB, VECTOR_PX, GRID_PX = 20.0, 1.0, 0.05, 0.02


def layers(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield how well layers lie on the registered raster of the sample pair, and what many vertices cost."""
    job = scratch / "job"
    pair = [str(SAMPLE / f"landsat_{band}.tif") for band in ("b4", "b10")]
    _command("register", *pair, "-o", str(job), "--write-proj-grid", "--no-report")
    correction = pcwlad_geo.load(job)
    checks = []
    for suffix in ("gpkg", "geojson"):
        source = _circles(scratch / f"circles.{suffix}", pair[1])
        seconds, memory_gb = _command("warp", str(job), source, "-o", f"{scratch / suffix}", "--write-sigma")
        checks += [
            at_most(f"{VERTICES:,} vertices of .{suffix}, with sigma, CPU", seconds, CPU_S, "s", 1),
            at_most(f"{VERTICES:,} vertices of .{suffix}, with sigma, memory", memory_gb, MEMORY_GB, "GB", 2),
        ]
    points_px = _points_by_proj(job, correction, pair[1])
    checks += [
        at_most(
            "outlines and what they surround, warped", _vectors_px(scratch, job, pair[1]), VECTOR_PX, "px"
        ),
        at_most("points by PROJ and the grid, and by the correction", points_px, GRID_PX, "px"),
        at_most("raster by GDAL and the grid, and ours", _rasters_px(scratch, job, pair[1]), GRID_PX, "px"),
    ]
    yield Table("Layers that follow the sample pair", ("model",), [(correction.name,)], checks)


def _command(*arguments: str) -> tuple[float, float]:
    """Run the program; return its CPU seconds and peak of memory in GB."""
    process = subprocess.Popen(
        [sys.executable, "-m", "pcwlad_geo", *arguments],
        stdout=subprocess.DEVNULL,
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"pcwlad-geo {arguments[0]} ended with {process.returncode}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20


def _circles(path: Path, target: str) -> str:
    """Write circles over a raster, a million vertices together."""
    around = np.linspace(0, 2 * np.pi, VERTICES_OF_ONE, endpoint=False)
    circle_px = 7 * np.column_stack([np.cos(around), np.sin(around)])
    with rasterio.open(target) as file:
        grid, crs = pcwlad_geo.open(target).grid, file.crs.to_wkt()
    random = np.random.default_rng(0)
    corners = np.full(2, 10.0), np.array(grid.shape[::-1]) - 10.0
    count = VERTICES // VERTICES_OF_ONE
    shapes = [shapely.Polygon(grid.to_xy(random.uniform(*corners) + circle_px)) for _ in range(count)]
    _write(path, shapes, crs)
    return str(path)


def _write(path: Path, shapes: list[shapely.Geometry], crs: str) -> None:
    numbers = [np.arange(len(shapes))]
    pyogrio.raw.write(
        path, shapely.to_wkb(np.array(shapes)), numbers, ["number"], geometry_type="Polygon", crs=crs
    )


def _vectors_px(scratch: Path, job: Path, target: str) -> float:
    """Return how far the middles of outlines lie from those of the blobs that they were drawn around."""
    with rasterio.open(target) as file:
        profile = file.profile | {"dtype": "float32", "nodata": None, "predictor": 1}
        crs = file.crs.to_wkt()
    grid = pcwlad_geo.open(target).grid
    row, col = np.mgrid[: grid.shape[0], : grid.shape[1]] + 0.5
    blobs = sum(np.exp(-((col - x) ** 2 + (row - y) ** 2) / (2 * WIDTH_PX**2)) for x, y in BLOBS_PX)
    with rasterio.open(scratch / "blobs.tif", "w", **profile) as file:
        file.write(blobs.astype(np.float32), 1)
    size = WIDTH_PX * np.hypot(grid.transform.a, grid.transform.d)
    outlines = [shapely.Point(place).buffer(size, 64) for place in grid.to_xy(BLOBS_PX)]
    _write(scratch / "outlines.gpkg", outlines, crs)
    raster, vector = pcwlad_geo.warp(
        job, [scratch / "blobs.tif", scratch / "outlines.gpkg"], out_dir=scratch / "moved"
    )
    warped = pcwlad_geo.open(raster)
    values, place = warped.array.filled(0), warped.grid
    row, col = np.mgrid[: place.shape[0], : place.shape[1]] + 0.5
    worst = 0.0
    for outline in shapely.from_wkb(pyogrio.raw.read(vector)[2]):
        middle = place.to_px(np.array(outline.centroid.coords))[0]
        near = values * (np.hypot(col - middle[0], row - middle[1]) < 4 * WIDTH_PX)
        blob = np.array([(near * col).sum(), (near * row).sum()]) / near.sum()
        worst = max(worst, float(np.abs(blob - middle).max()))
    return worst


def _points_by_proj(job: Path, correction: pcwlad_geo.Correction, target: str) -> float:
    """Return how far apart PROJ and the correction put points that were drawn on the target."""
    path, grid = next(job.glob("*_proj.tif")), pcwlad_geo.open(target).grid
    drawn_px = np.random.default_rng(1).uniform((0, 0), grid.shape[::-1], (10_000, 2))
    transformer = pyproj.Transformer.from_pipeline(proj_pipeline(str(path), grid.crs))
    moved_xy = np.column_stack(transformer.transform(*grid.to_xy(drawn_px).T))
    return float(np.abs(grid.to_px(moved_xy) - correction.inverse(drawn_px)).max())


def _rasters_px(scratch: Path, job: Path, target: str) -> float:
    """Return how far apart the pixels of the target are that our raster and GDAL's show at one place."""
    grid = pcwlad_geo.open(target).grid
    positions = [part.astype(np.float32) + 0.5 for part in np.mgrid[: grid.shape[0], : grid.shape[1]]]
    path = next(job.glob("*_proj_inverse.tif"))
    operation = proj_pipeline(str(path), grid.crs, is_inverse=True, is_for_gdal=True)
    worst = 0.0
    for name, values in zip(("rows", "cols"), positions, strict=True):
        pcwlad_geo.Raster(values, grid).save(scratch / f"{name}.tif")
        (ours,) = pcwlad_geo.warp(
            job, [scratch / f"{name}.tif"], out_dir=scratch / name, resampling="bilinear"
        )
        warped = pcwlad_geo.open(ours)
        theirs = np.full(warped.grid.shape, np.nan, np.float32)
        for start in range(0, theirs.shape[1], STRIP_PX):
            strip, _ = reproject(
                values,
                theirs[:, start : start + STRIP_PX].copy(),
                src_transform=grid.transform,
                dst_transform=warped.grid.transform @ Affine.translation(start, 0),
                src_crs=grid.crs,
                dst_crs=warped.grid.crs,
                dst_nodata=np.nan,
                resampling=Resampling.bilinear,
                COORDINATE_OPERATION=operation,
                XSCALE="1",
                YSCALE="1",
            )
            theirs[:, start : start + STRIP_PX] = strip
        inner = slice(EDGE_PX, -EDGE_PX)
        apart = np.abs(warped.array.astype(float).filled(np.nan) - theirs)[inner, inner]
        worst = max(worst, float(np.nanmax(apart)))
    return worst
