"""Small images: the default number of candidates beside a thousand, by accuracy and CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray

from benchmarks import scenes
from benchmarks.runs import Runner
from benchmarks.speed_studies import scene_files
from benchmarks.tables import Cell, Table, at_most
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import fit_pair, match_pair, prepare_pair

Array = NDArray[np.float64]

ALL = 1000
CROPS_A_SCENE = 10
SIDES_PX = (256, 512)
SCENE_FILE_PX = 1024
NOISE = (0.02, 0.03)
"""Standard deviation of the noise of reference and target, in units of the spread of an image."""
CHECKED_ALONG = 8
"""Places along each side of a crop at which the correction is compared with the truth."""


@dataclass(frozen=True, slots=True)
class _Scene:
    name: str
    reference: Array
    target: Array
    displacement_px: Callable[[Array], Array]


@dataclass(frozen=True, slots=True)
class _Measured:
    """A crop that was registered once."""

    points: int
    error_px: float
    """RMS over the places of the distance of the correction from the truth."""
    ce90_px: float
    cpu_s: float
    """Of the matching, in this process and its threads."""
    model: str


def candidates(_data: Path, scratch: Path, _runner: Runner) -> Iterator[Table]:
    """Yield, for each side, crops of four scenes by default and with all candidates, in turn."""
    cv2.setNumThreads(1)
    all_scenes = list(_scenes(scratch))
    for side in SIDES_PX:
        yield _table(all_scenes, side, scratch)


def _table(all_scenes: list[_Scene], side: int, scratch: Path) -> Table:
    rows: list[list[Cell]] = []
    ratios: list[float] = []
    costs: list[tuple[float, float]] = []
    refused = 0
    for number, scene in enumerate(all_scenes):
        rng = np.random.default_rng(100 + number)
        for _ in range(CROPS_A_SCENE):
            row, col = (int(rng.integers(0, length - side + 1)) for length in scene.reference.shape)
            files = _written(scene, (row, col), side, scratch)
            truth = partial(_moved, scene, np.array([col, row], np.float64))
            auto, full = (_registered(files, truth, side, Settings(features=n)) for n in (None, ALL))
            name = f"{scene.name}, {side}² at ({col}, {row})"
            if auto is None or full is None:
                refused += (auto is None) != (full is None)
                rows.append([name, *("refused" if one is None else one.points for one in (full, auto))])
                continue
            ratios.append(auto.error_px / full.error_px)
            costs.append((auto.cpu_s, full.cpu_s))
            rows.append(
                [
                    name,
                    full.points,
                    auto.points,
                    f"{full.error_px:.3f} ({full.ce90_px:.3f})",
                    f"{auto.error_px:.3f} ({auto.ce90_px:.3f})",
                    f"{full.cpu_s:.2f}",
                    f"{auto.cpu_s:.2f}",
                    f"{full.model}, {auto.model}",
                ]
            )
    cpu = np.sum(costs, axis=0)
    checks = [
        at_most(f"{side}²: error of the correction / with {ALL}, geometric mean", _mean(ratios), 1.05),
        at_most(f"{side}²: error of the correction / with {ALL}, median", float(np.median(ratios)), 1.05),
        at_most(f"{side}²: CPU time of the matching / with {ALL}", float(cpu[0] / cpu[1]), 0.35),
        at_most(f"{side}²: crops accepted by one and refused by the other", refused, 0, digits=0),
    ]
    header = (
        "crop",
        "points of all",
        "default",
        "off, all",
        "off, default",
        "CPU s, all",
        "default",
        "models",
    )
    return Table(f"Crops of {side}²: {ALL} candidates, and the default", header, rows, checks)


def _mean(ratios: list[float]) -> float:
    return float(np.exp(np.mean(np.log(ratios))))


def _scenes(scratch: Path) -> Iterator[_Scene]:
    pair = scene_files.make_pair(scratch, SCENE_FILE_PX)
    images = []
    for path in (pair.reference, pair.target):
        with rasterio.open(path) as dataset:
            images.append(np.asarray(dataset.read(1), np.float64))
    yield _Scene("fields", images[0], images[1], scene_files.displacement_px)
    for name, texture, seed in (
        ("countryside, seed 5", scenes.countryside, 5),
        ("folds, seed 7", scenes.folds, 7),
        ("countryside, seed 11", scenes.countryside, 11),
    ):
        rng = np.random.default_rng(seed)
        clean = scenes.image_pair(texture, (0, 1), seed)
        noisy = [one + s * rng.standard_normal(one.shape) for one, s in zip(clean, NOISE, strict=True)]
        yield _Scene(name, noisy[0], noisy[1], scenes.displacement_px)


def _written(scene: _Scene, row_col: tuple[int, int], side: int, scratch: Path) -> tuple[Path, Path]:
    row, col = row_col
    paths = []
    for name, image in (("reference", scene.reference), ("target", scene.target)):
        part = image[row : row + side, col : col + side].astype(np.float32)
        path = scratch / f"{name}.tif"
        path.unlink(missing_ok=True)
        profile = {"width": side, "height": side, "count": 1, "dtype": "float32", "crs": "EPSG:32633"}
        transform = Affine(10, 0, 4e5, 0, -10, 5e6)
        with rasterio.open(path, "w", driver="GTiff", transform=transform, **profile) as dataset:
            dataset.write(part, 1)
        paths.append(path)
    return paths[0], paths[1]


def _moved(scene: _Scene, origin_xy: Array, xy_px: Array) -> Array:
    return xy_px + scene.displacement_px(xy_px + origin_xy)


def _registered(
    files: tuple[Path, Path], truth: Callable[[Array], Array], side: int, settings: Settings
) -> _Measured | None:
    begun = time.process_time()
    matches = match_pair(prepare_pair(*files, settings), InThisProcess())
    cpu_s = time.process_time() - begun
    if not matches.accepted:
        return None
    correction = fit_pair(matches).model
    if correction is None:
        return None
    along = (np.arange(CHECKED_ALONG) + 0.5) / CHECKED_ALONG * side
    xy_px = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    off_px = np.linalg.norm(correction.forward(xy_px) - truth(xy_px), axis=1)
    return _Measured(
        points=int((matches.tie_points.status == "matched").sum()),
        error_px=float(np.sqrt((off_px**2).mean())),
        ce90_px=float(np.percentile(off_px, 90)),
        cpu_s=cpu_s,
        model=correction.name,
    )
