"""Grades of pairs with structure that belongs to the frame: it stands still while the ground moves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from rasterio.transform import Affine

from benchmarks.pairs import Image, write
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.studies.quality_sets import CRS, GRID, OFF_PX, TIMES
from benchmarks.tables import Cell, Check, Table, at_least, at_most
from pcwlad_geo.options import Settings
from tests.scenes import make_grid, render

SHAPE: Final = (320, 320)
MOVED_PX: Final = (7.3, -5.6)
"""Displacement of the ground (col, row) that the search reaches."""
NEAR_PX: Final = (2.3, -1.6)
"""Displacement at which what stands still draws the points, all or part of the way."""
HALF_PX: Final = (-0.6, -0.4)
"""Displacement that is told from none only where what stands still is left out."""
NOISE: Final = 1.5
SEED: Final = 54
Overlay = Callable[[Array], Array]
"""(rows, cols) grey values to those that a frame with the structure has."""


def _rng() -> np.random.Generator:
    return np.random.default_rng(SEED)  # what belongs to the frame is the same in all


def _radius() -> Array:
    row, col = np.indices(SHAPE) - np.array(SHAPE)[:, None, None] / 2
    return np.asarray(np.hypot(row, col))


def _added(pattern: Array) -> Overlay:
    return lambda image: image + pattern


def _drawn(draw: Callable[[Image], object], value: float = 255.0, share: float = 1.0) -> Overlay:
    """Return an overlay of what is drawn in white, blended with the image."""
    canvas = np.zeros(SHAPE, np.uint8)
    draw(canvas)
    alpha = share * canvas / 255.0
    return lambda image: (1 - alpha) * image + alpha * value


def _text(canvas: Image) -> None:
    for row in range(4):
        place = (6, 20 + 88 * row)
        cv2.putText(canvas, "FLIR 23.4 C  12:04:31", place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 1)


def _watermark(canvas: Image) -> None:
    for row in range(30, SHAPE[0], 60):
        for col in range(-40 + row % 50, SHAPE[1], 110):
            cv2.putText(canvas, "(c) AIR", (col, row), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255, 2)


def _scale_bar(canvas: Image) -> None:
    for part in range(6):
        cv2.rectangle(canvas, (150 + 25 * part, 296), (175 + 25 * part, 306), 255 * (part % 2), -1)
    cv2.putText(canvas, "0      50     100 m", (150, 290), cv2.FONT_HERSHEY_SIMPLEX, 0.45, 255, 1)


def _logo(canvas: Image) -> None:
    cv2.circle(canvas, (270, 45), 34, 255, 3)
    cv2.putText(canvas, "GEO", (248, 53), cv2.FONT_HERSHEY_SIMPLEX, 0.7, 255, 2)


def _crosses(canvas: Image) -> None:
    for row in range(32, SHAPE[0], 64):
        for col in range(32, SHAPE[1], 64):
            cv2.drawMarker(canvas, (col, row), 255, cv2.MARKER_CROSS, 15, 1)


def _lines(canvas: Image) -> None:
    canvas[40::80] = canvas[:, 40::80] = 255


def _dust(canvas: Image) -> None:
    rng = _rng()
    for _ in range(25):
        place = (int(rng.integers(SHAPE[1])), int(rng.integers(SHAPE[0])))
        cv2.circle(canvas, place, int(rng.integers(3, 9)), int(rng.integers(60, 255)), -1)


def _dead(share: float) -> Overlay:
    dead = _rng().random(SHAPE) < share
    return lambda image: np.where(dead, 0.0, image)


def _dead_columns(image: Array) -> Array:
    image = image.copy()
    image[:, _rng().choice(SHAPE[1], 12, replace=False)] = 20.0
    return image


def _jpeg(image: Array) -> Array:
    _, packed = cv2.imencode(".jpg", np.clip(np.rint(image), 0, 255).astype(np.uint8), [1, 25])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.float64)


def _blocks() -> Array:
    levels = _rng().normal(0, 12, (4, 4))
    return np.kron(levels, np.ones((SHAPE[0] // 4, SHAPE[1] // 4)))


def _masked(value: float) -> Overlay:
    row, col = np.indices(SHAPE) - np.array(SHAPE)[:, None, None] / 2
    angle = np.arctan2(row, col)
    hole = _radius() < 90 * (1 + 0.25 * np.sin(5 * angle) + 0.1 * np.sin(13 * angle))
    return lambda image: np.where(hole, value, np.maximum(image, 1))


@dataclass(frozen=True, slots=True)
class Kind:
    """Structure that belongs to the frame."""

    overlay: Overlay
    dtype: str = "uint8"
    georeferenced: bool = False


KINDS: Final[dict[str, Kind]] = {
    "fixed pattern": Kind(_added(_rng().normal(0, 6, SHAPE))),
    "weak fixed pattern": Kind(_added(_rng().normal(0, 2, SHAPE))),
    "column stripes": Kind(_added(_rng().normal(0, 5, (1, SHAPE[1])))),
    "row stripes": Kind(_added(_rng().normal(0, 5, (SHAPE[0], 1)))),
    "rows and columns": Kind(_added(_rng().normal(0, 5, (SHAPE[0], 1)) + _rng().normal(0, 5, (1, SHAPE[1])))),
    "vignetting": Kind(lambda image: image * (1 - 0.6 * (_radius() / 226) ** 2)),
    "hot spot of the lens": Kind(_added(60 * np.exp(-((_radius() / 60) ** 2)))),
    "dust": Kind(_drawn(_dust, 30, 0.7)),
    "dead pixels": Kind(_dead(0.01)),
    "dead columns": Kind(_dead_columns),
    "burnt text": Kind(_drawn(_text)),
    "watermark": Kind(_drawn(_watermark, 255, 0.4)),
    "scale bar": Kind(_drawn(_scale_bar)),
    "logo": Kind(_drawn(_logo)),
    "reseau crosses": Kind(_drawn(_crosses, 0)),
    "grid lines": Kind(_drawn(_lines, 0)),
    "JPEG": Kind(_jpeg),
    "calibration stripes": Kind(_added(6 * np.sign(np.sin(np.arange(SHAPE[1]) * 2 * np.pi / 23))[None])),
    "interference": Kind(_added(5 * np.sin(np.indices(SHAPE).sum(axis=0) * 2 * np.pi / 11))),
    "borders of a mosaic": Kind(_added(_blocks()), georeferenced=True),
    "mask burnt in": Kind(_masked(0), georeferenced=True),
    "mask in frames": Kind(_masked(255)),
    "fill -9999": Kind(_masked(-9999), "int16", georeferenced=True),
    "fill 1e20": Kind(_masked(1e20), "float32", georeferenced=True),
}
"""What stands still."""

GROUNDS: Final[dict[str, tuple[float, int, tuple[float, float] | None]]] = {
    "clear ground, moved": (1.0, 0, MOVED_PX),
    "faint ground, moved": (0.12, 0, MOVED_PX),
    "faint ground, moved by 2 px": (0.12, 0, NEAR_PX),
    "faint ground, elsewhere": (0.12, 1, None),
    "clear ground, moved by half a pixel": (0.5, 0, HALF_PX),
    "clear ground, in place": (1.0, 0, (0.0, 0.0)),
}
"""Contrast, how much the seed of the ground in the target differs, and how far it has moved; None: it is not
in the reference."""


def frame(_data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield the grades of pairs with structure of the frame, the ground moved, gone, or in place."""
    cases = [(kind, ground) for kind in KINDS for ground in GROUNDS]
    jobs = [_job(scratch, number, *case) for number, case in enumerate(cases)]
    outcomes = runner(jobs)
    rows: list[list[Cell]] = []
    wrong, in_place = 0, []
    for (kind, ground), outcome in zip(cases, outcomes, strict=True):
        found = outcome.registration
        quality = found.quality if found and outcome.accepted else None
        grade, error_px = (quality.grade if quality else "refused"), _error_px(outcome, GROUNDS[ground][2])
        expected_px = quality.expected_ce90_px if quality else float("nan")
        is_wrong = grade == "good" and error_px > min(OFF_PX, TIMES * expected_px)
        wrong += is_wrong
        if GROUNDS[ground][2] == (0.0, 0.0):
            in_place.append(grade == "good")
        rows.append([f"{kind}: {ground}", grade, expected_px, error_px, "WRONG" if is_wrong else ""])
    checks: list[Check] = [
        at_most(
            f"good pairs off by more than {OFF_PX:.0f} px or {TIMES:.0f} x their CE90", wrong, 0, digits=0
        ),
        at_least("pairs in place that are good", 100 * float(np.mean(in_place)), 90, "%", 0),
    ]
    header = ("pair", "grade", "CE90 expected", "true", "")
    yield Table(f"Grades of {len(cases)} pairs with structure of the frame", header, rows, checks)


def _job(scratch: Path, number: int, kind: str, ground: str) -> Job:
    made, (contrast, other, moved_px) = KINDS[kind], GROUNDS[ground]
    grid, band = make_grid(SHAPE), "thermal" if moved_px == (0.0, 0.0) else "red"
    shift_px = moved_px or (0.0, 0.0)
    images = [
        render(grid, seed=SEED, noise=0),
        render(grid, band, seed=SEED + other, displacement_px=shift_px, noise=0),
    ]
    place: dict[str, Affine | str] = {"transform": GRID, "crs": CRS} if made.georeferenced else {}
    paths = []
    for which, image in enumerate(images):
        noise = np.random.default_rng(number * 2 + which).normal(0, NOISE, SHAPE)
        seen = made.overlay(127 + contrast * (image - 127) + noise)
        if made.dtype == "uint8":
            seen = np.clip(np.rint(seen), 0, 255)
        path = scratch / f"frame_{number}_{which}.tif"
        paths.append(write(path, seen.astype(made.dtype), **place))  # type: ignore[arg-type]
    return Job(paths[0], paths[1], Settings(jobs=1), match_only=False)


def _error_px(outcome: Outcome, moved_px: tuple[float, float] | None) -> float:
    """Return the 90th percentile of the correction's error; infinite where no displacement is right."""
    correction = outcome.result.model if outcome.accepted else None
    if correction is None:
        return float("nan")
    if moved_px is None:
        return float("inf")
    at_px = np.stack(np.meshgrid(*(np.arange(4, n, 8.0) for n in SHAPE[::-1])), axis=-1).reshape(-1, 2)
    errors = correction.forward(at_px) - at_px - np.array(moved_px)
    return float(np.percentile(np.linalg.norm(errors, axis=1), 90))
