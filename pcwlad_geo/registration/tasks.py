"""Run the same function on many arguments: here, in processes, or on any executor; bounded, in order."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from typing import Any, Final, TypeVar

import cv2

from pcwlad_geo.registration.progress import EventCallback, Progress

IN_FLIGHT: Final = 16

T = TypeVar("T")


def run_tasks(
    function: Callable[..., T],
    calls: Sequence[tuple[Any, ...]],
    stage: str,
    executor: Executor | None,
    jobs: int,
    on_event: EventCallback,
) -> list[T]:
    """Call the function with each tuple of arguments and return the results in the order of the calls.

    Parameters
    ----------
    function : callable
        Importable, as it may run in another process.
    calls : sequence of tuples
    stage : str
        Name of the stage in progress events.
    executor : concurrent.futures.Executor, optional
        Where to run; None: `jobs` processes, or this one where one is enough.
    jobs : int
    on_event : callable
    """
    on_event(Progress(stage, 0, len(calls)))
    if executor is not None:
        return _submit(function, calls, stage, executor, on_event)
    if min(jobs, len(calls)) > 1:
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(min(jobs, len(calls)), mp_context=context, initializer=_start_worker)
        try:
            return _submit(function, calls, stage, pool, on_event)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    results = []
    for done, arguments in enumerate(calls, 1):
        results.append(function(*arguments))
        on_event(Progress(stage, done, len(calls)))
    return results


def _submit(
    function: Callable[..., T],
    calls: Sequence[tuple[Any, ...]],
    stage: str,
    executor: Executor,
    on_event: EventCallback,
) -> list[T]:
    results: dict[int, T] = {}
    waiting: dict[Future[T], int] = {}
    upcoming = iter(enumerate(calls))
    try:
        while len(results) < len(calls):
            while len(waiting) < IN_FLIGHT and (following := next(upcoming, None)) is not None:
                index, arguments = following
                waiting[executor.submit(function, *arguments)] = index
            finished, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in finished:
                results[waiting.pop(future)] = future.result()
                on_event(Progress(stage, len(results), len(calls)))
    finally:  # after an error: the executor is the caller's and lives on
        for future in waiting:
            future.cancel()
    return [results[index] for index in range(len(calls))]


def _start_worker() -> None:
    # the parent ends its workers; an interrupt of the terminal would only make them print tracebacks
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
