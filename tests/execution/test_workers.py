"""Workers on this machine: threads for tiles; processes for whole jobs, without orphans."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
import rasterio

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.events import Event, Progress
from pcwlad_geo.execution.runner import InThisProcess, OnExecutor, gdal_settings
from pcwlad_geo.execution.workers import LocalWorkers, available_cores, open_runner
from tests.execution.calls import (
    Shuffled,
    children_of,
    die_at_three,
    fail_oddly,
    is_running,
    print_something,
    process_of,
    sleep,
    thread_of,
    threads_of,
    unpicklable,
    wait_for_end,
)

REPOSITORY = Path(__file__).resolve().parents[2]
CALLS = [(value,) for value in range(8)]


@pytest.fixture
def workers() -> Iterator[LocalWorkers]:
    with open_runner(None, lambda event: None, jobs=2) as runner:
        assert isinstance(runner, LocalWorkers)
        yield runner


def test_tiles_run_in_as_many_threads_as_there_are_jobs() -> None:
    runner = LocalWorkers(3)
    barrier = threading.Barrier(3)  # breaks where fewer are at work
    names = runner.run(thread_of, [(barrier,)] * 3, "threads")
    assert len(set(names)) == 3
    assert threading.current_thread().name not in names
    assert not set(names) & {thread.name for thread in threading.enumerate()}, "they have ended"


@pytest.mark.parametrize(("jobs", "calls"), [(4, 1), (1, 4)])
def test_where_one_worker_is_enough_there_is_no_other(jobs: int, calls: int) -> None:
    runner = LocalWorkers(jobs)
    one = threading.current_thread().name
    assert runner.run(thread_of, [()] * calls, "threads") == [one] * calls
    assert runner.run_jobs(process_of, CALLS[:calls], "processes") == [os.getpid()] * calls


def test_the_default_is_a_worker_a_core() -> None:
    assert 1 <= available_cores() <= (os.cpu_count() or 1)


def test_an_interrupt_ends_after_the_calls_that_have_begun() -> None:
    begun: list[int] = []

    def stop(event: Event) -> None:
        if isinstance(event, Progress) and event.done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        LocalWorkers(2).run(begun.append, CALLS * 20, "calls", stop)
    count = len(begun)
    assert count <= 4
    assert len(begun) == count, "no thread is left"


def test_whole_jobs_run_in_other_processes_that_stay_warm(workers: LocalWorkers) -> None:
    first = workers.run_jobs(process_of, CALLS, "jobs")
    second = workers.run_jobs(process_of, CALLS, "jobs")
    assert os.getpid() not in first
    assert len({*first, *second}) <= 2


def test_a_job_whose_process_dies_is_an_error_and_the_others_are_done(workers: LocalWorkers) -> None:
    for _ in range(2):
        results = workers.run_jobs(die_at_three, CALLS, "jobs")
        lost = results.pop(3)
        assert isinstance(lost, ExecutionError)
        assert "a worker process was lost" in str(lost)
        if sys.platform != "win32":
            assert "crashed (SIGSEGV)" in str(lost)
        assert results == [0, 1, 2, 4, 5, 6, 7]


def test_no_process_outlives_its_runner() -> None:
    def stop(event: Event) -> None:
        if isinstance(event, Progress) and event.done == 1:
            raise KeyboardInterrupt

    before = set(children_of(os.getpid()))
    with pytest.raises(KeyboardInterrupt), open_runner(None, lambda event: None, jobs=2) as runner:
        runner.run_jobs(sleep, [(0.0,), (3600.0,)], "sleep", stop)
    assert not [each for each in set(children_of(os.getpid())) - before if is_running(each)]


ORPHANS = """
from pcwlad_geo.execution.workers import LocalWorkers
from tests.execution.calls import sleep
calls = [(0.0,)] * 2 + [(3600.0,)] * 2
LocalWorkers(2).run_jobs(sleep, calls, "sleep", lambda event: print(event.done, flush=True))
"""


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="asks /proc")
def test_no_process_outlives_a_parent_that_is_killed() -> None:
    """A script without a guard for its main module, too: the processes do not import it."""
    script = [sys.executable, "-c", ORPHANS]
    with subprocess.Popen(script, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        for done in parent.stdout:
            if done == "2\n":
                break
        process_ids = children_of(parent.pid)
        parent.kill()
    assert process_ids
    wait_for_end(process_ids)


def test_stray_prints_and_reads_do_no_harm(workers: LocalWorkers) -> None:
    assert workers.run_jobs(print_something, CALLS, "calls") == list(range(8))


def test_what_cannot_travel_is_an_error_with_its_words(workers: LocalWorkers) -> None:
    with pytest.raises(RuntimeError, match="OddError: 0: odd") as caught:
        workers.run_jobs(fail_oddly, [(0,), (0,)], "calls")
    assert "fail_oddly" in str(caught.value.__cause__)  # where it arose, for --debug
    with pytest.raises((AttributeError, TypeError), match=r"lambda|pickle"):
        workers.run_jobs(unpicklable, CALLS, "calls")


def test_workers_have_one_thread_a_library_and_the_parents_settings_of_gdal(
    workers: LocalWorkers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    with rasterio.Env(CPL_VSIL_CURL_CACHE_SIZE=123456):
        assert gdal_settings()["CPL_VSIL_CURL_CACHE_SIZE"] == 123456
        in_threads = workers.run(threads_of, CALLS[:2], "calls")
        in_processes = workers.run_jobs(threads_of, CALLS[:2], "calls")
    for found, blas in ((in_threads, "7"), (in_processes, "1")):
        for each in found:
            assert (each["cv2"], each["blas"]) == (1, blas)
            assert (each["GDAL_NUM_THREADS"], each["CPL_VSIL_CURL_CACHE_SIZE"]) == (1, 123456)


def test_executors_get_the_settings_of_gdal_from_the_environment_but_no_secret(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("GDAL_HTTP_TIMEOUT", "17")
    monkeypatch.setenv("AWS_REGION", "eu-central-1")
    secrets = (
        "AWS_SECRET_ACCESS_KEY",
        "AWS_SESSION_TOKEN",
        "AWS_ACCESS_KEY_ID",
        "GDAL_HTTP_BEARER",
        "GDAL_HTTP_USERPWD",
        "GDAL_HTTP_HEADERS",
        "GDAL_DATA",
        "HOME",
    )
    for name in secrets:
        monkeypatch.setenv(name, "hidden")
    settings = gdal_settings()
    assert settings["AWS_REGION"] == "eu-central-1"
    assert not set(settings) & set(secrets)
    assert "hidden" not in settings.values()
    for name in secrets:
        monkeypatch.delenv(name)
    with Shuffled(1) as executor:
        (found,) = OnExecutor(executor).run(threads_of, CALLS[:1], "calls")
    assert (found["GDAL_NUM_THREADS"], found["GDAL_HTTP_TIMEOUT"], found["cv2"]) == (1, 17, 1)


@pytest.mark.parametrize("threads", [False, True])
def test_the_callers_own_opencv_keeps_its_threads(threads: bool) -> None:
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(3)
        with Shuffled(1) as executor:
            runner = OnExecutor(executor) if threads else InThisProcess()
            (found,) = runner.run(threads_of, CALLS[:1], "calls")
        assert found["cv2"] == 1
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)
