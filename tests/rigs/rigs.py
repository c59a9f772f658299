"""Small synthetic rigs for the tests, and what they truly see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from benchmarks.rig_scenes import (
    Flown,
    Ground,
    TrueLens,
    ground_points,
    lens_rays,
    made_rig,
    seen_by,
    write_capture,
)
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.rigs.inspection import measure_sharpness
from pcwlad_geo.rigs.lens import lattice
from pcwlad_geo.rigs.rig import Rig, RigLens
from pcwlad_geo.types import Float64

SHAPE = (240, 320)
DISTANCE_M = 40.0


@lru_cache(maxsize=1)
def ground() -> Ground:
    """Return a ground with some relief."""
    return Ground.made(5, side=1536, relief_m=1.0)


def lenses(count: int = 3) -> tuple[TrueLens, ...]:
    """Return the first lenses of a rig of small frames."""
    return made_rig(11, SHAPE)[:count]


def flown(height_m: float, east_m: float = 38.0, **values: object) -> Flown:
    """Return a capture that looks down, a little askew."""
    turn = np.asarray(cv2.Rodrigues(np.array([0.02, -0.015, 0.7]))[0])
    return replace(Flown(np.array([east_m, 38.0, height_m]), turn), **values)


def with_longer_base(rig: Sequence[TrueLens], times: float) -> tuple[TrueLens, ...]:
    """Return the rig with its lenses farther apart: its parallax is that of ground so many times nearer."""
    return tuple(replace(each, place_m=each.place_m * times) for each in rig)


def write(folder: Path, name: str, rig: Sequence[TrueLens], capture: Flown, seed: int = 1) -> None:
    """Write the frames of a capture."""
    write_capture(folder, name, rig, capture, ground(), seed=seed, height=True)


def true_rig(rig: Sequence[TrueLens], frames: Path, name: str) -> Rig:
    """Return the rig as it is; its frames of one good capture tell what it sees."""
    found = []
    for number, each in enumerate(rig, 1):
        with ignoring(NotGeoreferencedWarning), rasterio.open(frames / f"{name}_{number}.tif") as dataset:
            values = dataset.read(1).astype(np.float32)
        found.append(
            RigLens(
                name=each.name,
                lens=each.lens,
                rotation=np.asarray(cv2.Rodrigues(each.rotation)[0], np.float64).ravel(),
                baseline=-each.rotation @ each.place_m / DISTANCE_M,
                sigma=np.zeros(14),
                mapping_sigma_px=(0.0, 0.0),
                distortion_sigma_px=0.0,
                calibrated=each.calibrated,
                sharpness=measure_sharpness(values),
                wavelength_nm=(float(each.wavelength_nm or 0), 20.0),
            )
        )
    return Rig(tuple(found), "", DISTANCE_M, (0.6, 1.6), 0.1, 0.05, 1, 100, 0.05)


def applied_errors(
    known: Rig, rig: Sequence[TrueLens], capture: Flown, land: Ground, raster: Path, percent: float = 50.0
) -> list[float]:
    """Return for each lens but the first a percentile of the distances, px, from where it should be read."""
    with ignoring(NotGeoreferencedWarning), rasterio.open(raster) as dataset:
        tags = dataset.tags()
    plane = np.array([float(each) for each in tags["RIG_INVERSE_DEPTH"].split()])
    turns = [np.array([float(v) for v in each.split()]) for each in tags["RIG_ROTATIONS_RAD"].split(";")]
    left, top, cols, rows = known.crop()
    rays = known.common_rays(lattice((rows, cols), 16) + np.array([left, top]))
    near = plane[0] + rays @ plane[1:]
    raw = known.reference.project(rays, near)
    good = np.isfinite(raw).all(axis=1)
    down, place = lens_rays(rig[0], capture, raw[good])
    points = ground_points(land, capture, down, place)
    found: list[float] = []
    for number, (each, true) in enumerate(zip(known.lenses, rig, strict=True)):
        read: Float64 = replace(each, rotation=turns[number]).project(rays[good], near[good])
        wrong = np.hypot(*(read - seen_by(true, capture, points)).T)
        found.append(float(np.nanpercentile(wrong, percent)))
    return found[1:]
