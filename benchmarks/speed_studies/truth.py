"""Tie points against the known displacement of a scene."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.speed_studies.scene_files import ORIGIN_XY_M, PIXEL_M, displacement_px

Float64 = NDArray[np.float64]

CORRECT_BELOW_PX: Final = 1.5
LATTICE: Final = 8
"""The scene is divided into this many cells an axis, to see how the points are spread."""


@dataclass(frozen=True, slots=True)
class PointScore:
    """How many points there are, where, and how good they are."""

    points: int
    correct: int
    """Points with a radial error below CORRECT_BELOW_PX."""
    cells: int
    """Cells of the lattice that hold a correct point."""
    rmse_px: float
    """Root mean square of the radial error of the correct points."""


def score(reference_px: Float64, displacement: Float64, side_px: int) -> PointScore:
    """Judge displacements (n, 2) found at positions (n, 2) of a scene, px."""
    error = np.linalg.norm(displacement - displacement_px(reference_px), axis=-1)
    correct = error < CORRECT_BELOW_PX
    cells = np.floor(reference_px[correct] / side_px * LATTICE).clip(0, LATTICE - 1)
    rmse = float(np.sqrt(np.mean(error[correct] ** 2))) if correct.any() else float("nan")
    return PointScore(len(error), int(correct.sum()), len(np.unique(cells, axis=0)), rmse)


def read_tie_points(path: Path) -> tuple[Float64, Float64]:
    """Return reference positions and displacements, (n, 2) each, px, of the points that were not rejected."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["status"] != "rejected"]
    values = np.array(
        [[float(row[name]) for name in ("ref_col", "ref_row", "tgt_col", "tgt_row")] for row in rows]
    ).reshape(-1, 4)
    return values[:, :2], values[:, 2:] - values[:, :2]


def read_arosics(path: Path) -> tuple[Float64, Float64]:
    """Return the same of a table of `arosics_call.py`, which holds map positions and correcting shifts."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    values = np.array(
        [[float(row[name]) for name in ("X_MAP", "Y_MAP", "X_SHIFT_M", "Y_SHIFT_M")] for row in rows]
    ).reshape(-1, 4)
    to_px = np.array([1.0, -1.0]) / PIXEL_M
    return (values[:, :2] - ORIGIN_XY_M) * to_px, -values[:, 2:] * to_px
