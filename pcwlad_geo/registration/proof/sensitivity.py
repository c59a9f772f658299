"""A part of a pair degraded step by step, until its registration is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
import scipy.fft
import scipy.ndimage

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.proof_result import (
    Difficulty,
    LevelUnit,
    LimitEntry,
    Move,
    Reversal,
    Sensitivity,
    TrialEntry,
)
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.events import JobLog, Progress
from pcwlad_geo.matching import AUTO_FEATURES
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Patch, Window
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.registration.proof.parameters import ProofParameters
from pcwlad_geo.registration.proof.resampling import Resampler
from pcwlad_geo.registration.result import Matches, Registration
from pcwlad_geo.registration.tiles import TileJob
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64

Register = Callable[[str, str, Settings], Registration]
"""Registers a reference and a target like any pair, without writing."""
DIFFICULTIES: Final[dict[Difficulty, tuple[LevelUnit, Float64]]] = {
    "displacement": ("px", 2.0 * 2 ** (np.arange(15) / 2)),
    "rotation": ("deg", 0.5 * 2 ** (np.arange(15) / 2)),
    "noise": ("share of the standard deviation", 0.0625 * 2 ** (np.arange(15) / 2)),
    "clouds": ("share of the pixels", np.arange(1.0, 16.0) * 0.06),
}
"""Unit and levels of each difficulty."""
BEFORE_TRIALS: Final = 3
"""Number of registrations of the part as it lies, one of them in reverse."""
TRIALS_EACH: Final = 5
"""Largest number of registrations that find the first level that is not tolerated."""
MOST_TRIALS: Final = BEFORE_TRIALS + TRIALS_EACH * len(DIFFICULTIES)
"""Largest number of registrations of the part."""
INHERITED_SETTINGS: Final = (
    *("method", "points", "keypoints", "template", "window", "search_radius", "ssim_min"),
    *("iterations", "consensus", "prealign", "start_matcher", "geometry", "tile_size"),
)
"""Settings of the pair that also hold for a part of it."""


@dataclass(frozen=True, slots=True, eq=False)
class _TestPart:
    """A part of the pair whose target can be read beyond it, and the function that registers it."""

    job: TileJob
    window: Window
    reference: Float64
    """(rows, cols), NaN where not valid."""
    settings: Settings
    register: Register
    scratch: Scratch
    false_match_px: float
    """Median error of a registration from which it is wrong."""

    def target(self, window: Window) -> Float64:
        """Return the target's pixels in a window of the reference view; NaN where not valid."""
        col, row = self.job.target_offset_px
        return _with_nan(self.job.target.read(window.moved(row, col)))

    def registered(self, reference: Float64, target: Float64) -> Registration | None:
        """Register (rows, cols) images as files of one grid; None where they are refused."""
        grid = self.job.reference.grid.part((self.window.col, self.window.row), self.window.shape)
        transform = grid.transform if grid.located else None
        files = [
            self.scratch.file_of(Raster(image.astype(np.float32), transform, grid.crs, float("nan")), name)
            for name, image in (("reference", reference), ("target", target))
        ]
        try:
            registration = self.register(files[0], files[1], self.settings)
        except InputError:  # too few pixels of an image are valid
            return None
        return None if registration.status == "rejected" else registration


def _with_nan(patch: Patch) -> Float64:
    return np.where(patch.valid, np.asarray(patch.values, np.float64), np.nan)


def _part(matches: Matches, register: Register, parameters: ProofParameters) -> _TestPart:
    """Return the part of the pair that holds most tie points."""
    job, settings, table, side = matches.job, matches.pair.settings, matches.tie_points, parameters.part_px
    if job is None:
        raise InputError("nothing can be proved: no tie point was matched here")
    region, places = job.region, job.reference.from_file_px(table.reference_px[table.status == "matched"])
    cells, counts = np.unique(
        np.floor((places - (region.col, region.row)) / side).astype(np.intp), axis=0, return_counts=True
    )
    col, row = (cells[counts.argmax()] * side).tolist()
    window = Window(region.row + row, region.col + col, side, side).intersection(region)
    model = "auto" if settings.model == "rpc" else settings.model
    features = min(settings.features or AUTO_FEATURES, 256)  # as dense as in a tile
    inherited = {name: getattr(settings, name) for name in INHERITED_SETTINGS}
    settings = Settings(**inherited, model=model, features=features)
    reference, false_px = _with_nan(job.reference.read(window)), parameters.false_match_px
    return _TestPart(job, window, reference, settings, register, Scratch(), false_px)


def sensitivity(
    matches: Matches,
    register: Register,
    log: JobLog,
    progress_offset: int = 0,
    parameters: ProofParameters = ProofParameters(),
) -> Sensitivity | None:
    """Register a part of a pair like any pair, degraded step by step until it is refused.

    None where the part is refused as it lies. Progress is told to `log` from `progress_offset` on.
    """
    part = _part(matches, register, parameters)
    target = part.target(part.window)
    baseline = part.registered(part.reference, target)
    if baseline is None:
        return None
    settings = replace(part.settings, features=matches.pair.settings.features)
    reversal = _reversal(replace(part, settings=settings), target)
    limits, total = [], progress_offset + MOST_TRIALS
    for number, name in enumerate(DIFFICULTIES):
        log.on_event(Progress("proving", progress_offset + BEFORE_TRIALS + TRIALS_EACH * number, total))
        unit, levels = DIFFICULTIES[name]
        if name == "displacement":
            levels = levels[levels <= min(part.window.shape) / 2]
        limits.append(_limit(name, unit, levels, partial(_trial, part, baseline, name)))
    log.on_event(Progress("proving", total, total))
    return Sensitivity(part.window.shape, len(_accepted(baseline)), tuple(limits), reversal)


def _limit(
    name: Difficulty, unit: LevelUnit, levels: Float64, attempt: Callable[[float], TrialEntry]
) -> LimitEntry:
    """Find the largest level that is tolerated, by halving the levels between it and the least that is not.

    The largest of all is tried first, which is often tolerated.
    """
    trials: list[TrialEntry] = []
    low, high, number = -1, len(levels), len(levels) - 1
    while high - low > 1:
        trials.append(attempt(float(levels[number])))
        low, high = (number, high) if trials[-1].outcome == "correct" else (low, number)
        number = (low + high) // 2
    trials.sort(key=lambda trial: trial.level)
    tolerated = None if low < 0 else float(levels[low])
    return LimitEntry(
        name, unit, tolerated, None if high == len(levels) else float(levels[high]), tuple(trials)
    )


def _trial(part: _TestPart, baseline: Registration, name: Difficulty, level: float) -> TrialEntry:
    """Register the part at a level of a difficulty, and compare its points with those of the baseline."""
    reference, target, move, centre = _degraded(part, name, level, np.random.default_rng([0, 77]))
    registration = part.registered(reference, target)
    if registration is None:
        return TrialEntry(level, "refused", 0, None)
    table, before = _accepted(registration), _accepted(baseline)
    transform = AffineTransform.fit(before.reference_px, before.target_px)

    def off_px(reference_px: Float64, target_px: Float64) -> float:
        return float(np.median(np.linalg.norm(target_px - transform(reference_px), axis=1)))

    error = off_px(table.reference_px, move.source(table.target_px, centre))
    correct = error <= part.false_match_px + off_px(before.reference_px, before.target_px)
    return TrialEntry(level, "correct" if correct else "incorrect", len(table), error)


def _degraded(
    part: _TestPart, name: Difficulty, level: float, random: np.random.Generator
) -> tuple[Float64, Float64, Move, Float64]:
    """Return reference and target at a level of a difficulty, and the move of the target and its centre."""
    window, reference, no_move = part.window, part.reference, Move("shift", (0.0, 0.0))
    centre = np.array([window.cols, window.rows]) / 2
    if name == "displacement":
        col, row = (round(level * share) for share in (0.8, 0.6))
        return reference, part.target(window.moved(row, col)), Move("shift", (-col, -row)), centre
    if name == "rotation":
        margin = max(window.shape) // 4  # at 45 degrees the corners come from as far outside
        values = part.target(window.padded(margin))
        turned, move = Resampler(values, np.isfinite(values)), Move("turn", (0.0, 0.0), rotation_deg=level)
        image, valid = turned.moved(move, centre + margin)
        inner = (slice(margin, -margin), slice(margin, -margin))
        return reference, np.where(valid, image, np.nan)[inner], move, centre
    target = part.target(window)
    if name == "noise":
        reference, target = (
            image + level * np.nanstd(image) * random.standard_normal(image.shape)
            for image in (reference, target)
        )
        return reference, target, no_move, centre
    return reference, _clouded(target, level, random), no_move, centre


def _clouded(image: Float64, share: float, random: np.random.Generator) -> Float64:
    """Return an image with clouds over a share of it, with soft edges and brighter than the image."""
    size = max(image.shape) / 12
    height = scipy.ndimage.gaussian_filter(random.standard_normal(image.shape), size / 2, mode="reflect")
    height = (height - np.quantile(height, 1 - share)) / height.std()
    cover = np.clip(0.5 + 5 * height, 0, 1)
    low, high = np.nanpercentile(image, (1, 99))
    cloud = high + (high - low) * np.clip(0.3 + 0.2 * height, 0.3, 1.0)
    return np.asarray((1 - cover) * image + cover * cloud)


def _accepted(registration: Registration) -> TiePointTable:
    return registration.tie_points.select("matched", "fit", "check", "unused")


def _reversal(part: _TestPart, target: Float64) -> Reversal | None:
    """Return the inverse-consistency error of the two corrections."""
    first, second = part.registered(part.reference, target), part.registered(target, part.reference)
    if first is None or second is None or first.model is None or second.model is None:
        return None
    begin = _accepted(first).predicted_px  # both files have the same grid
    off = second.model.forward(first.model.forward(begin)) - begin
    off = off[np.isfinite(off).all(axis=1)]
    rms = float(np.sqrt((off**2).sum(axis=1).mean()))
    return Reversal(first.model.name, second.model.name, float_pair(off.mean(axis=0)), rms)
