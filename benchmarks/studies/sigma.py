"""Do the points' sigmas hold? Shares of errors within one and 1.96 sigmas, on scenes with an exact truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy import ndimage

from benchmarks.pairs import write
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.scenes import Texture, countryside, displacement_px, folds, image_pair
from benchmarks.tables import Cell, Check, Table, within
from pcwlad_geo.options import Settings

SEEDS: Final = (201, 202, 203, 204)
"""Windows overlap, so a scene has few independent points: several scenes a condition."""
SETTINGS: Final = Settings(features=300, search_radius=10, prealign="none")
SHARES: Final = ((1.0, "68 %", 60.0, 76.0), (1.96, "95 %", 92.0, 98.0))


@dataclass(frozen=True, slots=True)
class Condition:
    """What the images and the matching are like."""

    name: str
    texture: Texture
    bands: tuple[int, int] = (0, 1)
    noise: float = 0.05
    """Of the images' spread."""
    blur_px: float = 0.0
    """Sigma, the target only."""
    settings: Settings = SETTINGS


CONDITIONS: Final = (
    Condition("countryside, red - thermal", countryside),
    Condition("  default candidates", countryside, settings=replace(SETTINGS, features=None)),
    Condition("  noise 0.3", countryside, noise=0.3),
    Condition("  target blurred by 2 px", countryside, blur_px=2.0),
    Condition("  window 41", countryside, settings=replace(SETTINGS, window=41)),
    Condition("  window 129", countryside, settings=replace(SETTINGS, window=129)),
    Condition("  no consensus pass", countryside, settings=replace(SETTINGS, consensus="off")),
    Condition("countryside, red - red, noise 0.5", countryside, bands=(0, 0), noise=0.5),
    Condition("folds, two contrasts", folds),
    Condition("  noise 0.5, window 61", folds, noise=0.5, settings=replace(SETTINGS, window=61)),
    Condition("  no consensus pass", folds, settings=replace(SETTINGS, consensus="off")),
)


def sigma(_data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield one table: a row a condition, its scenes together."""
    jobs = [job for condition in CONDITIONS for job in _jobs(condition, scratch)]
    outcomes = iter(runner(jobs))
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    family = ""
    for condition in CONDITIONS:
        family = family if condition.name.startswith(" ") else condition.name
        scenes = [next(outcomes) for _ in SEEDS]
        error = np.concatenate([_error(outcome) for outcome in scenes])
        sigmas = np.concatenate([outcome.points.sigma_px for outcome in scenes])
        shares = [float(100 * (np.abs(error) < factor * sigmas).mean()) for factor, *_ in SHARES]
        rmse = float(np.sqrt((error**2).sum(axis=1).mean()))
        shown = [f"{share:.1f}" for share in shares]
        rows.append([condition.name, len(error), rmse, float(np.median(sigmas)), *shown])
        what = condition.name if condition.name == family else f"{family},{condition.name[1:]}"
        checks += [
            within(f"{what}: {name} interval", share, low, high, "%")
            for share, (_, name, low, high) in zip(shares, SHARES, strict=True)
        ]
    yield Table(
        "Calibration of sigma", ("condition", "points", "RMSE", "sigma", "68 %", "95 %"), rows, checks
    )


def _jobs(condition: Condition, scratch: Path) -> Iterator[Job]:
    for seed in SEEDS:
        images = _pair(condition.texture, condition.bands, seed, scratch)
        rng = np.random.default_rng(seed)
        blurred = (images[0], ndimage.gaussian_filter(images[1], condition.blur_px, mode="nearest"))
        index = CONDITIONS.index(condition)
        paths = []
        for which, image in enumerate(blurred):
            noisy = image + condition.noise * rng.standard_normal(image.shape)
            numbers = np.clip(np.rint(20000 + 2000 * noisy), 0, 65535).astype(np.uint16)
            paths.append(write(scratch / f"sigma_{index}_{seed}_{which}.tif", numbers))
        yield Job(*paths, condition.settings)


def _pair(texture: Texture, bands: tuple[int, int], seed: int, scratch: Path) -> tuple[Array, Array]:
    """Make a pair of a scene, once."""
    path = scratch / f"scene_{texture.__name__}_{bands[0]}{bands[1]}_{seed}.npz"
    if not path.exists():
        reference, target = image_pair(texture, bands, seed)
        np.savez(path, reference=reference, target=target)
    with np.load(path) as made:
        return made["reference"], made["target"]


def _error(outcome: Outcome) -> Array:
    points = outcome.points
    return np.asarray(points.displacement_px - displacement_px(points.predicted_px))
