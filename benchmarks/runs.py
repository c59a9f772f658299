"""Run the public job on pairs of files, several at a time, and remember the results."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import Registration, register_pair
from pcwlad_geo.tiepoints.table import TiePointTable

Array = NDArray[np.float64]

PAPER: Final = Settings(keypoints="strongest", features=1000, search_radius=10, window=81)
"""The paper's candidates: the 1000 strongest corners, a search radius of 10 px, windows of 81 px."""
PER_POINT: Final = replace(PAPER, consensus="off")
"""Each point on its own, no consensus pass."""


@dataclass(frozen=True, slots=True)
class Job:
    """One run of the job."""

    reference: Path
    target: Path
    settings: Settings = PAPER
    match_only: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What a run gave: a registration, or why the input could not be used."""

    registration: Registration | None
    reason: str | None
    cpu_s: float

    @property
    def accepted(self) -> bool:
        """Whether the pair was matched or registered, not refused."""
        return self.registration is not None and self.registration.status != "rejected"

    @property
    def result(self) -> Registration:
        """The registration, where there is one."""
        if self.registration is None:
            raise RuntimeError(f"the run ended with an error: {self.reason}")
        return self.registration

    @property
    def points(self) -> TiePointTable:
        """The tie points that were not rejected."""
        return self.result.tie_points.select("matched", "fit", "check", "unused")

    @property
    def positions(self) -> Array:
        """(n, 4) reference x, y and target x, y of these points, file px."""
        return np.hstack([self.points.reference_px, self.points.target_px])


@dataclass(slots=True)
class Runner:
    """Runs jobs in processes; a job that ran before is not run again."""

    processes: int = 2
    known: dict[Job, Outcome] = field(default_factory=dict)

    def __call__(self, jobs: Sequence[Job]) -> list[Outcome]:
        """Return the outcomes in the order of the jobs."""
        new = [job for job in dict.fromkeys(jobs) if job not in self.known]
        if new:
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(min(self.processes, len(new)), mp_context=context) as pool:
                self.known.update(zip(new, pool.map(_run, new), strict=True))
        return [self.known[job] for job in jobs]


def _run(job: Job) -> Outcome:
    cv2.setNumThreads(1)
    begun = time.process_time()
    try:
        registration = register_pair(job.reference, job.target, job.settings, match_only=job.match_only)
    except InputError as error:
        return Outcome(None, str(error), time.process_time() - begun)
    return Outcome(registration, registration.reason, time.process_time() - begun)


def common_points(first: TiePointTable, second: TiePointTable) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows of two tables that have the same reference point, in the same order."""
    keys = [
        {
            (round(col, 3), round(row, 3)): index
            for index, (col, row) in enumerate(table.reference_px.tolist())
        }
        for table in (first, second)
    ]
    shared = [key for key in keys[0] if key in keys[1]]
    rows = [np.array([table[key] for key in shared], dtype=np.intp) for table in keys]
    return rows[0], rows[1]
