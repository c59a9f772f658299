"""The first pass of a scene: every candidate matched on its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.correction.selection_parameters import SELECTION
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import JobLog
from pcwlad_geo.matching import Candidates, TiePoints
from pcwlad_geo.matching.keypoints import OUTCOMES
from pcwlad_geo.registration.planning import Plan
from pcwlad_geo.registration.scene.parameters import SceneContext
from pcwlad_geo.registration.tiles import KEPT_BYTES, TileJob, TileResult, match_tile
from pcwlad_geo.types import Index


@dataclass(frozen=True, slots=True, eq=False)
class FirstPass:
    """Every candidate that found a partner, each on its own."""

    jobs: list[TileJob]
    results: list[TileResult]
    """In the order of the jobs."""
    grey_error_px: float
    """Error per axis that matches of grey values share, view px."""

    @property
    def matches(self) -> TiePoints:
        """Every match, tile after tile."""
        return TiePoints.concatenate([result.points for result in self.results])

    @property
    def tile_of(self) -> Index:
        """(n,) tile of each match."""
        return np.repeat(np.arange(len(self.results)), [len(result.points) for result in self.results])

    @property
    def lost(self) -> Candidates:
        """Every candidate that found none, tile after tile."""
        return Candidates.concatenate([result.lost for result in self.results])

    @property
    def lost_tile_of(self) -> Index:
        """(m,) tile of each of these."""
        return np.repeat(np.arange(len(self.results)), [len(result.lost) for result in self.results])

    @property
    def tones_variance_px2(self) -> float:
        """Variance, per axis, that matches have because they are of grey values; 0 if they are not.

        A correction takes `SELECTION.common_sigma` of their sigma for the error that all of them share.
        """
        by_tones = self.jobs[0].reference_scene.tones is not None
        return (self.grey_error_px / SELECTION.common_sigma) ** 2 if by_tones else 0.0

    def without(self, recovered: Index) -> FirstPass:
        """Return the pass without the (k,) lost candidates that were `recovered` later."""
        is_recovered = np.zeros(len(self.lost), bool)
        is_recovered[recovered] = True
        results = []
        for tile, result in enumerate(self.results):
            matched = is_recovered[self.lost_tile_of == tile]
            fewer = np.bincount(result.lost.outcome[matched], minlength=len(OUTCOMES)).tolist()
            counts = {
                name: count - (fewer[OUTCOMES.index(name)] if name in OUTCOMES else 0)
                for name, count in result.counts.items()
            }
            results.append(replace(result, lost=result.lost.part(~matched), counts=counts))
        return replace(self, results=results)


def run_first_pass(planned: Plan, context: SceneContext) -> FirstPass:
    """Match the tiles planned, and small windows of second choice where the first gave too little."""
    first, runner, log = FirstPass([], [], 0.0), context.runner, context.log
    upcoming, kept_bytes = planned.first, KEPT_BYTES * runner.threads if runner.shares_memory else 0
    for _ in range(3):  # the first choices, and two that follow
        threads = runner.threads if len(upcoming) == 1 else 1
        upcoming = [replace(job, kept_bytes=kept_bytes, threads=threads) for job in upcoming]
        results = runner.run(match_tile, [(job,) for job in upcoming], "matching", log.on_event)
        first = FirstPass(first.jobs + upcoming, first.results + results, context.parameters.grey_error_px)
        upcoming = planned.following(first.results)
        if not upcoming:
            break
    warn_of_failures(first.results, log)
    return first


def sum_counts(results: Sequence[TileResult]) -> dict[str, int]:
    """Return the number of tiles, and of candidates by what became of them."""
    total: dict[str, int] = {"tiles": len(results), "candidates": 0}
    for result in results:
        for name, count in result.counts.items():
            total[name] = total.get(name, 0) + count
    return total


def warn_of_failures(results: Sequence[TileResult], log: JobLog) -> None:
    """Warn of tiles that could not be read; raises `InputError` where none could be."""
    failed = [result for result in results if result.status == "failed"]
    if failed and len(failed) == len(results):
        raise InputError(failed[0].reason or "no tile could be read")
    for result in failed:
        log.warn(f"tile {result.id} left out: {result.reason}")
