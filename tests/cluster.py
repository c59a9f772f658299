"""A dask cluster on loopback: a real scheduler and real workers, each a process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.patience import PATIENCE_S

REPOSITORY = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Cluster:
    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[Cluster]:
    """Start a scheduler and workers of one thread; wait until all have come together."""
    from distributed import Client

    processes = [_start(folder, "dask_scheduler", "--port", "0", "--scheduler-file", "scheduler.json")]
    try:
        address = _address(folder / "scheduler.json")
        more = ("--nthreads", "1", "--no-nanny", "--memory-limit", "0", address)
        processes += [_start(folder, "dask_worker", *more) for _ in range(workers)]
        with Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=PATIENCE_S)
        yield Cluster(address, *processes[:1], processes[1:])
    finally:
        for process in processes[::-1]:
            process.kill()
        for process in processes:
            process.wait()


def _start(folder: Path, program: str, *arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", f"distributed.cli.{program}", "--host", "127.0.0.1", "--no-dashboard"]
    with (folder / f"{program}.log").open("ab") as log:
        return subprocess.Popen(
            [*command, *arguments],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
        )


def _address(scheduler_file: Path) -> str:
    for _ in range(10 * PATIENCE_S):
        try:
            address: str = json.loads(scheduler_file.read_text(encoding="utf-8"))["address"]
            return address
        except (OSError, ValueError):  # not written yet, or half
            time.sleep(0.1)
    raise TimeoutError("the scheduler has not started: see dask_scheduler.log")
