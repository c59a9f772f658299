"""The same results in the same order, wherever the calls run."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any, TypeVar

import pytest

from pcwlad_geo.registration.progress import Event, Progress, ignore
from pcwlad_geo.registration.tasks import IN_FLIGHT, run_tasks

T = TypeVar("T")


def slow_square(value: int) -> int:
    time.sleep(0.002 * (value % 5))  # they end in another order than they began
    return value * value


def process_of(value: int) -> int:
    return os.getpid()


def fail_at_three(value: int) -> int:
    if value == 3:
        raise ValueError("three")
    return value


CALLS = [(value,) for value in range(40)]
SQUARES = [value * value for value in range(40)]


class Counting(Executor):
    """Threads, and how many calls they had at most at a time."""

    def __init__(self) -> None:
        self.pool = ThreadPoolExecutor(4)
        self.lock = threading.Lock()
        self.open = self.most = 0

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        with self.lock:
            self.open += 1
            self.most = max(self.most, self.open)
        future = self.pool.submit(fn, *args, **kwargs)
        future.add_done_callback(self._done)
        return future

    def _done(self, future: Future[Any]) -> None:
        with self.lock:
            self.open -= 1


def test_here() -> None:
    assert run_tasks(slow_square, CALLS, "squares", None, 1, ignore) == SQUARES


def test_an_executor_gets_a_bounded_number_of_calls_and_order_is_kept() -> None:
    executor = Counting()
    with executor.pool:
        assert run_tasks(slow_square, CALLS, "squares", executor, 1, ignore) == SQUARES
    assert 2 <= executor.most <= IN_FLIGHT


def test_jobs_are_other_processes() -> None:
    processes = set(run_tasks(process_of, CALLS[:6], "processes", None, 2, ignore))
    assert 1 <= len(processes) <= 2
    assert os.getpid() not in processes


def test_one_call_needs_no_other_process() -> None:
    assert run_tasks(process_of, CALLS[:1], "processes", None, 4, ignore) == [os.getpid()]


def test_nothing_to_do() -> None:
    events: list[Event] = []
    assert run_tasks(slow_square, [], "squares", None, 3, events.append) == []
    assert events == [Progress("squares", 0, 0)]


@pytest.mark.parametrize("threads", [False, True])
def test_progress_counts_every_call_once(threads: bool) -> None:
    events: list[Event] = []
    with ThreadPoolExecutor(3) as pool:
        run_tasks(slow_square, CALLS, "squares", pool if threads else None, 1, events.append)
    assert events == [Progress("squares", done, 40) for done in range(41)]


@pytest.mark.parametrize("threads", [False, True])
def test_errors_of_a_call_reach_the_caller(threads: bool) -> None:
    with ThreadPoolExecutor(3) as pool, pytest.raises(ValueError, match="three"):
        run_tasks(fail_at_three, CALLS, "calls", pool if threads else None, 1, ignore)


def test_an_error_ends_the_submitted_calls_too() -> None:
    """The executor is the caller's and lives on: calls of a job that has ended must not keep it busy."""
    begun: list[int] = []
    release = threading.Event()

    def call(value: int) -> int:
        begun.append(value)
        if value == 0:
            raise ValueError("first")
        release.wait(10)
        return value

    with ThreadPoolExecutor(1) as pool:
        with pytest.raises(ValueError, match="first"):
            run_tasks(call, CALLS, "calls", pool, 1, ignore)
        release.set()
    assert len(begun) <= 2
