"""What pieces of work cost inside this process: compared figures are measured in turn, in one run."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU and wall time, s."""

    cpu_s: float
    wall_s: float


def cheapest(works: Sequence[Callable[[], object]], repeats: int) -> list[Cost]:
    """Run the works in turn, `repeats` times; return the least cost of each. The first round warms up."""
    best = [Cost(math.inf, math.inf)] * len(works)
    for round_ in range(repeats + 1):
        for index, work in enumerate(works):
            wall, cpu = time.perf_counter(), time.process_time()
            work()
            cpu_s, wall_s = time.process_time() - cpu, time.perf_counter() - wall
            if round_ > 0:
                best[index] = Cost(min(best[index].cpu_s, cpu_s), min(best[index].wall_s, wall_s))
    return best
