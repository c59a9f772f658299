"""The paper's window studies: coarse and fine windows of 21 to 121 px."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

from benchmarks.pairs import Pair, landsat, rgbnir
from benchmarks.runs import PAPER, PER_POINT, Job, Outcome, Runner
from benchmarks.scores import score, translation_errors
from benchmarks.tables import Cell, Table
from pcwlad_geo.options import Settings

SIDES_PX: Final = range(21, 122, 20)
LOST_BEFORE: Final = ("not_comparable", "not_similar", "at_search_border", "not_converged")
"""Stages that a candidate passes up to a converged match."""


def windows(data: Path, _scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield one table a pair and kind of window."""
    for pair in (landsat(data), rgbnir(data)):
        coarse = {
            f"{method}, {side}": replace(PAPER, method=method, template=side)
            for method in ("coarse", "pcwlad")
            for side in SIDES_PX
        }
        yield _table(f"{pair.name}: coarse window (fine window 81)", pair, coarse, runner)
        fine = {
            f"{settings.method}, {side}": replace(settings, window=side)
            for settings in (PER_POINT, replace(PAPER, method="pcwlad"))
            for side in SIDES_PX
        }
        yield _table(f"{pair.name}: fine window (coarse window 101)", pair, fine, runner)


def _table(title: str, pair: Pair, runs: dict[str, Settings], runner: Runner) -> Table:
    outcomes = runner([Job(pair.reference, pair.target, settings) for settings in runs.values()])
    rows: list[list[Cell]] = []
    for (name, settings), outcome in zip(runs.items(), outcomes, strict=True):
        scored = score(translation_errors(outcome.positions, pair.truth))
        converged = 100 * _converged(outcome) / settings.features
        share = f"{100 * scored.share_correct:.1f}"
        rows.append([name, scored.correct, share, f"{converged:.1f}", scored.rmse_px, scored.scatter_px])
    return Table(title, ("method, window", "NCM", "CMR %", "SR (converged) %", "RMSE", "scatter"), rows)


def _converged(outcome: Outcome) -> int:
    counts = outcome.result.counts
    return counts["candidates"] - sum(counts.get(stage, 0) for stage in LOST_BEFORE)
