"""Radiometry and noise: what the matching loses when the images are inverted, bent or noisy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.pairs import Image, Pair, landsat, read, rgbnir, with_gamma, with_noise, write
from benchmarks.runs import Job, Outcome, Runner, common_points
from benchmarks.scores import Score, score, translation_errors
from benchmarks.tables import Cell, Check, Table, at_least, at_most

SAME_PX = 1e-3
SEED = 20


@dataclass(frozen=True, slots=True)
class Change:
    """A change of the images, and the largest share of NCM that it may cost (None: only reported)."""

    name: str
    job: Job
    may_lose: float | None = None
    same_points: bool = False


def robustness(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield one table a pair."""
    for pair, losses in ((landsat(data), {25: 0.08}), (rgbnir(data), {10: 0.15, 25: None})):
        changes = _changes(pair, losses, scratch)
        plain, *outcomes = runner([Job(pair.reference, pair.target), *(change.job for change in changes)])
        base = _scored(pair, plain)
        rows: list[list[Cell]] = [["as it is", *_figures(base, base), "", ""]]
        checks: list[Check] = []
        for change, outcome in zip(changes, outcomes, strict=True):
            scored = _scored(pair, outcome)
            share, largest = _sameness(plain, outcome)
            rows.append([change.name, *_figures(scored, base), f"{100 * share:.1f}", f"{largest:.1e}"])
            what = f"{pair.name}, {change.name}"
            if change.may_lose is not None:
                changed = 100 * (scored.correct / base.correct - 1)
                checks.append(at_least(f"{what}: NCM", changed, -100 * change.may_lose, "%", 1))
            if change.same_points:
                checks.append(at_least(f"{what}: same points", 100 * share, 100.0, "%", 2))
                checks.append(at_most(f"{what}: largest difference", largest, SAME_PX, "px", 6))
        header = (
            "images",
            "NCM",
            "change %",
            "CMR %",
            "RMSE",
            "scatter",
            "same points %",
            "largest difference",
        )
        yield Table(f"{pair.name}: radiometry and noise", header, rows, checks)


def _changes(pair: Pair, noise: dict[int, float | None], scratch: Path) -> list[Change]:
    reference, target = read(pair.reference), read(pair.target)

    def made(name: str, image: Image) -> Path:
        return write(scratch / f"{pair.name}_{name}.tif", image)

    changes = [
        Change("target inverted", Job(pair.reference, made("inverted", 255 - target)), 0.0, same_points=True),
        Change("target gamma 0.5", Job(pair.reference, made("gamma", with_gamma(target, 0.5))), 0.02),
    ]
    for sigma, may_lose in noise.items():
        noisy = [
            made(f"{which}_noise{sigma}", with_noise(image, sigma, SEED + index))
            for index, (which, image) in enumerate((("reference", reference), ("target", target)))
        ]
        changes.append(Change(f"noise of sigma {sigma} on both", Job(*noisy), may_lose))
    return changes


def _scored(pair: Pair, outcome: Outcome) -> Score:
    return score(translation_errors(outcome.positions, pair.truth))


def _figures(scored: Score, base: Score) -> list[Cell]:
    change = f"{100 * (scored.correct / base.correct - 1):+.1f}"
    return [scored.correct, change, f"{100 * scored.share_correct:.1f}", scored.rmse_px, scored.scatter_px]


def _sameness(first: Outcome, second: Outcome) -> tuple[float, float]:
    """Return the share of points that both runs have, and their largest difference in px."""
    rows = common_points(first.points, second.points)
    moved = first.points.target_px[rows[0]] - second.points.target_px[rows[1]]
    total = max(len(first.points), len(second.points))
    return len(moved) / total, float(np.abs(moved).max(initial=0.0))
