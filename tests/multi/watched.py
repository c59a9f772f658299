"""Finished stacks, made without matching: what `watch` reads of them.

No module of the tests is imported that needs pytest: the tests of the QGIS plugin make stacks with an engine
that has nothing but the package.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.numbers import SCHEMA_VERSION
from tests.scenes import make_grid, write

FIRST = date(2020, 1, 5)
SIDE = 400
NOISE_PX = 0.1
"""Of the tie points."""
STEP_PX = (0.2, -0.1)
SIGMA_PX = 0.03
REGION = (250.0, 120.0, 32.0)
"""Column, row and radius of a part that may move."""


@dataclass(frozen=True)
class Dated:
    """An image of such a stack."""

    days: float
    """Since `FIRST`."""
    shift_px: tuple[float, float]
    sigma_px: float = 0.03
    series: str | None = None

    @property
    def name(self) -> str:
        """Its name, with the day."""
        return f"{self.series or 'image'}_{(FIRST + timedelta(days=self.days)):%Y%m%d}"


def make_images(count: int, series: str | None = None, shift_px: Sequence[float] = (0.0, 0.0)) -> list[Dated]:
    """Images every 25 days, their displacements nothing but noise around a shift."""
    random = np.random.default_rng(count)
    moved = random.normal(size=(count, 2)) * SIGMA_PX + np.array(shift_px)
    return [Dated(25 * k, (float(col), float(row)), SIGMA_PX, series) for k, (col, row) in enumerate(moved)]


def stepped(images: list[Dated], at: int) -> list[Dated]:
    """Images with a step from one on."""
    return [
        replace(each, shift_px=(each.shift_px[0] + STEP_PX[0], each.shift_px[1] + STEP_PX[1]))
        if number >= at
        else each
        for number, each in enumerate(images)
    ]


def make_stack(
    folder: Path, images: Sequence[Dated], velocity_px: tuple[float, float] | None = None, points: int = 400
) -> Path:
    """Write the folder of a stack of images with these displacements; with tie points if the ground moves.

    Pairs are neighbours in time, and images half of them apart; the `velocity_px`, a year, is of `REGION`.
    """
    out = folder / "stack"
    out.mkdir(parents=True)
    grid = make_grid((SIDE, SIDE))
    random = np.random.default_rng(5)
    count = len(images)
    pairs = [(i, j) for i in range(count) for j in (i + 1, i + 3, i + count // 2) if i < j < count]
    entries = []
    for image in images:
        place = write(folder / f"{image.name}.tif", np.zeros((SIDE, SIDE), np.uint8), grid, dtype="uint8")
        day = f"{FIRST + timedelta(days=image.days):%Y-%m-%d}"
        given = StackInput(str(place), 1, image.name, date=day, series=image.series)
        matrix = np.column_stack([np.eye(2), image.shift_px])
        entries.append(
            {
                "name": image.name,
                "given": asdict(given),
                "shift_px": image.shift_px,
                "sigma_px": (image.sigma_px, image.sigma_px),
                "pixel_size_m": (30.0, 30.0),
                "registered": f"{image.name}_registered.tif",
                "model": AffineCorrection("shift", matrix).to_dict(),
            }
        )
    for i, j in pairs if velocity_px is not None else ():
        years = (images[j].days - images[i].days) / 365.25
        _write_points(out, (images[i], images[j]), np.multiply(years, velocity_px), points, random)
    numbers = {
        "schema_version": SCHEMA_VERSION,
        "datum": "mean",
        "reference": images[0].name,
        "shared": 0.0,
        "block": None,
        "images": entries,
        "pairs": [
            {"reference": images[i].name, "target": images[j].name, "status": "used", "reason": None}
            for i, j in (pairs if velocity_px is not None else ())
        ],
    }
    (out / "stack.json").write_text(json.dumps(numbers))
    return out


def _write_points(
    out: Path, ends: tuple[Dated, Dated], moved: NDArray[np.float64], points: int, random: np.random.Generator
) -> None:
    ground = random.uniform(5, SIDE - 5, (points, 2))
    reference, target = (ground + np.array(image.shift_px) for image in ends)
    col, row, radius = REGION
    target[np.hypot(*(ground - (col, row)).T) < radius] += moved
    target += random.normal(size=target.shape) * NOISE_PX
    place = out / "pairs" / f"{ends[0].name}__{ends[1].name}"
    place.mkdir(parents=True)
    lines = ["ref_col,ref_row,tgt_col,tgt_row,sigma_col,sigma_row"]
    lines += [
        ",".join(f"{v:.6f}" for v in (*r, *t, NOISE_PX, NOISE_PX))
        for r, t in zip(reference, target, strict=True)
    ]
    (place / "tiepoints.csv").write_text("\n".join(lines) + "\n")
