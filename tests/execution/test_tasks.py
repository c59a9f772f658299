"""The same results in the same order, wherever the calls run."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context

import pytest

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.events import Event, Progress
from pcwlad_geo.execution.runner import IN_FLIGHT, InThisProcess, OnExecutor, Runner
from pcwlad_geo.execution.workers import LocalWorkers
from pcwlad_geo.job import open_job_runner
from pcwlad_geo.options import Settings
from tests.execution.calls import Counting, Shuffled, die, fail_at_three, slow_square
from tests.patience import PATIENCE_S

CALLS = [(value,) for value in range(40)]
SQUARES = [value * value for value in range(40)]


@pytest.fixture(params=["here", "threads", "shuffled", "own threads"])
def runner(request: pytest.FixtureRequest) -> Iterator[Runner]:
    """Each kind of runner."""
    if request.param == "here":
        yield InThisProcess()
    elif request.param == "own threads":
        yield LocalWorkers(2)
    else:
        with ThreadPoolExecutor(3) if request.param == "threads" else Shuffled(1) as executor:
            yield OnExecutor(executor)


def test_results_come_in_the_order_of_the_calls(runner: Runner) -> None:
    assert runner.run(slow_square, CALLS, "squares") == SQUARES
    assert runner.run_jobs(slow_square, CALLS[:1], "squares") == SQUARES[:1]


def test_one_runner_serves_many_stages(runner: Runner) -> None:
    assert [runner.run(slow_square, CALLS[:5], "squares") for _ in range(3)] == [SQUARES[:5]] * 3


def test_nothing_to_do(runner: Runner) -> None:
    events: list[Event] = []
    assert runner.run(slow_square, [], "squares", events.append) == []
    assert events == [Progress("squares", 0, 0)]


def test_progress_counts_every_call_once(runner: Runner) -> None:
    events: list[Event] = []
    runner.run(slow_square, CALLS, "squares", events.append)
    assert events == [Progress("squares", done, 40) for done in range(41)]


def test_errors_of_a_call_reach_the_caller(runner: Runner) -> None:
    with pytest.raises(ValueError, match="three"):
        runner.run(fail_at_three, CALLS, "calls")
    assert runner.run(slow_square, CALLS[:2], "squares") == [0, 1]  # and the runner lives on


def test_an_exception_of_the_callback_ends_the_stage(runner: Runner) -> None:
    def stop(event: Event) -> None:
        if isinstance(event, Progress) and event.done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        runner.run(slow_square, CALLS, "squares", stop)


def test_an_executor_gets_a_bounded_number_of_calls() -> None:
    executor = Counting()
    with executor.pool:
        calls = [(0,)] * (3 * IN_FLIGHT)
        assert OnExecutor(executor).run(slow_square, calls, "squares") == [0] * len(calls)
    assert 2 <= executor.most <= IN_FLIGHT


def test_the_shuffling_executor_shuffles() -> None:
    with Shuffled(2, holds=len(CALLS)) as executor:
        for call in CALLS:
            executor.submit(slow_square, *call)
    assert sorted(executor.order) == list(range(40))
    assert executor.order != sorted(executor.order)


def test_an_error_ends_the_submitted_calls_too() -> None:
    """The executor is the caller's and lives on: calls of a job that has ended must not keep it busy."""
    begun: list[int] = []
    release = threading.Event()

    def call(value: int) -> int:
        begun.append(value)
        if value == 0:
            raise ValueError("first")
        release.wait(PATIENCE_S)
        return value

    with ThreadPoolExecutor(1) as pool:
        with pytest.raises(ValueError, match="first"):
            OnExecutor(pool).run(call, CALLS, "calls")
        release.set()
    assert len(begun) <= 2


def test_a_broken_executor_is_one_clear_error() -> None:
    lost = pytest.raises(
        ExecutionError, match=r"the executor is lost, or its workers are \(BrokenProcessPool"
    )
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool, lost:
        OnExecutor(pool).run(die, CALLS[:2], "calls")


def test_the_settings_choose_the_runner() -> None:
    def kind(settings: Settings, executor: Executor | Runner | None) -> type:
        with open_job_runner(settings, executor, lambda event: None) as runner:
            return type(runner)

    assert kind(Settings(), None) is LocalWorkers
    with ThreadPoolExecutor(1) as pool:
        assert kind(Settings(jobs=2), pool) is OnExecutor
    here = InThisProcess()
    with nullcontext(here), open_job_runner(Settings(jobs=2), here, lambda event: None) as runner:
        assert runner is here
