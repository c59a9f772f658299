"""Worker processes of our own: few threads, no orphans, and a death that costs one call."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import cv2
import pytest
import rasterio

from pcwlad_geo.errors import ExecutionError, OutputError
from pcwlad_geo.events import Event, Progress, Warned
from pcwlad_geo.execution import processes
from pcwlad_geo.execution.processes import ATTEMPTS, OwnProcesses, available_cores
from pcwlad_geo.execution.runner import InThisProcess, OnExecutor, gdal_settings
from pcwlad_geo.outputs.folder import OutputFolder
from tests.execution.calls import (
    Shuffled,
    children_of,
    die,
    die_once,
    fail_oddly,
    is_running,
    parent_of,
    print_something,
    process_of,
    sleep,
    threads_of,
    unpicklable,
    wait_for_end,
)
from tests.patience import PATIENCE_S

REPOSITORY = Path(__file__).resolve().parents[2]
CALLS = [(value,) for value in range(8)]


NO_FORKS = pytest.mark.skipif(not processes.CAN_FORK, reason="no forks here")


@pytest.fixture(
    autouse=True,
    params=[pytest.param("forks", marks=NO_FORKS), "fresh"],
)
def source(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Where the processes come from: a fork server forks them, or each is a fresh interpreter."""
    if request.param == "fresh":
        monkeypatch.setattr(processes, "CAN_FORK", False)
    return str(request.param)


def test_jobs_are_other_processes_and_the_same_in_every_stage() -> None:
    with OwnProcesses(2, preload="") as runner:
        runner.expect(5)
        assert len(runner.process_ids) == 2
        for _ in range(2):
            assert set(runner.run(process_of, CALLS, "processes").results) <= set(runner.process_ids)
        assert os.getpid() not in runner.process_ids


def test_a_call_goes_to_the_worker_that_it_asks_for() -> None:
    with OwnProcesses(3, preload="") as runner:
        first = runner.run(process_of, CALLS, "first")
        second = runner.run(process_of, CALLS[::-1], "second", affinity=first.workers[::-1])
        assert second.results == first.results[::-1]
        assert second.workers == first.workers[::-1]
        lone = runner.run(process_of, CALLS[:1], "third", affinity=[2])
        assert (lone.results, lone.workers) == ([runner.process_ids[2]], [2])


@pytest.mark.parametrize(("jobs", "calls"), [(4, 1), (1, 4)])
def test_where_one_process_is_enough_there_is_no_other(jobs: int, calls: int) -> None:
    with OwnProcesses(jobs, preload="") as runner:
        runner.expect(calls)
        assert runner.run(process_of, CALLS[:calls], "processes").results == [os.getpid()] * calls
        assert runner.process_ids == []


def test_the_default_is_a_process_a_core() -> None:
    assert 1 <= available_cores() <= (os.cpu_count() or 1)


def test_no_worker_outlives_its_runner() -> None:
    with OwnProcesses(2, preload="") as runner:
        runner.expect(2)
        process_ids = runner.process_ids

        def stop(event: Event) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            runner.run(sleep, [(0.0,), (3600.0,)], "sleep", stop)
    wait_for_end(process_ids)


ORPHANS = """
import sys
from pcwlad_geo.execution import processes
processes.CAN_FORK &= sys.argv[1] != "fresh"
from pcwlad_geo.execution.processes import OwnProcesses
from tests.execution.calls import sleep
with OwnProcesses(2, preload="") as runner:
    runner.expect(2)
    print(*runner.process_ids, flush=True)
    runner.run(sleep, [(3600.0,)] * 2, "sleep")
"""


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="asks /proc")
def test_no_worker_outlives_a_parent_that_is_killed(source: str) -> None:
    """A script without a guard for its main module, too: workers do not import it."""
    script = [sys.executable, "-c", ORPHANS, source]
    with subprocess.Popen(script, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        process_ids = [int(process) for process in parent.stdout.readline().split()]
        process_ids += [parent_of(process) for process in process_ids if parent_of(process) != parent.pid]
        parent.kill()
    assert len(process_ids) >= 2
    wait_for_end(process_ids)


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_a_worker_that_dies_is_replaced_and_its_call_done_again(tmp_path: Path) -> None:
    events: list[Event] = []
    with OwnProcesses(2, preload="") as runner:
        calls = [(tmp_path / "killed", value) for value in range(8)]
        assert runner.run(die_once, calls, "calls", events.append).results == list(range(8))
        (warning,) = [event.message for event in events if isinstance(event, Warned)]
        assert "killed by SIGKILL" in warning
        assert [event.done for event in events if isinstance(event, Progress)] == list(range(9))
        assert set(runner.run(process_of, CALLS, "processes").results) <= set(runner.process_ids)


def test_a_call_on_which_every_worker_dies_is_an_error() -> None:
    lost = pytest.raises(ExecutionError, match=rf"{ATTEMPTS} worker processes were lost .*exit status 7")
    with OwnProcesses(2, preload="") as runner, lost:
        runner.run(die, CALLS[:2], "calls")


def test_stray_prints_and_reads_do_no_harm() -> None:
    with OwnProcesses(2, preload="") as runner:
        assert runner.run(print_something, CALLS, "calls").results == list(range(8))


def test_what_cannot_travel_is_an_error_with_its_words() -> None:
    with OwnProcesses(2, preload="") as runner:
        with pytest.raises(RuntimeError, match="OddError: 0: odd") as caught:
            runner.run(fail_oddly, [(0,), (0,)], "calls")
        assert "fail_oddly" in str(caught.value.__cause__)  # where it arose, for --debug
        with pytest.raises((AttributeError, TypeError), match=r"lambda|pickle"):
            runner.run(unpicklable, CALLS, "calls")
        assert runner.run(process_of, CALLS[:1], "calls").results == [os.getpid()]


def test_a_worker_starts_without_the_module_it_should_preload() -> None:
    with OwnProcesses(2, preload="no.such.module") as runner:
        assert os.getpid() not in runner.run(process_of, CALLS, "calls").results


def test_workers_have_one_thread_a_library_and_the_parents_settings_of_gdal(
    source: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    with rasterio.Env(CPL_VSIL_CURL_CACHE_SIZE=123456), OwnProcesses(2, preload="") as runner:
        here = gdal_settings()
        found = runner.run(threads_of, CALLS[:2], "calls").results
    assert here["CPL_VSIL_CURL_CACHE_SIZE"] == 123456
    for each in found:
        assert (each["cv2"], each["blas"]) == (1, "1")
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
        (found,) = OnExecutor(executor).run(threads_of, CALLS[:1], "calls").results
    assert (found["GDAL_NUM_THREADS"], found["GDAL_HTTP_TIMEOUT"], found["cv2"]) == (1, 17, 1)


@pytest.mark.parametrize("threads", [False, True])
def test_the_callers_own_opencv_keeps_its_threads(threads: bool) -> None:
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(3)
        with Shuffled(1) as executor:
            runner = OnExecutor(executor) if threads else InThisProcess()
            (found,) = runner.run(threads_of, CALLS[:1], "calls").results
        assert found["cv2"] == 1
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


@NO_FORKS
def test_workers_go_on_and_are_replaced_without_the_process_that_forked_them(
    source: str, tmp_path: Path
) -> None:
    if source == "fresh":
        pytest.skip("nothing is forked")
    with OwnProcesses(2, preload="") as runner:
        runner.expect(2)
        (stem,) = {parent_of(process) for process in runner.process_ids}
        os.kill(stem, signal.SIGKILL)
        calls = [(tmp_path / "killed", value) for value in range(8)]
        assert runner.run(die_once, calls, "calls").results == list(range(8))
        everyone = runner.process_ids
    wait_for_end(everyone)


@NO_FORKS
def test_a_fork_keeps_no_pipe_of_its_parent_open() -> None:
    end, beginning = os.pipe()
    with OwnProcesses(2, preload="") as runner:
        runner.expect(2)
        runner.run(process_of, CALLS, "calls")
        os.close(beginning)
        readable, _, _ = select.select([end], [], [], PATIENCE_S)
        assert readable
        assert os.read(end, 1) == b"", "the end, although workers are there"
    os.close(end)


LOCKED = """
import sys
from pcwlad_geo.execution.processes import OwnProcesses
from pcwlad_geo.outputs.folder import OutputFolder
from pathlib import Path
busy = "tests.execution.busy"
with OutputFolder(Path(sys.argv[1]), overwrite=True), OwnProcesses(2, preload=busy) as runner:
    runner.expect(2)
    print("busy", flush=True)
    input()
"""


@NO_FORKS
def test_a_busy_fork_does_not_hold_the_output_folder_of_a_killed_parent(tmp_path: Path) -> None:
    script = [sys.executable, "-c", LOCKED, str(tmp_path / "out")]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(script, cwd=REPOSITORY, **pipes) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == b"busy\n"
        with pytest.raises(OutputError), OutputFolder(tmp_path / "out", overwrite=True):
            pass
        forks_of_it = children_of(parent.pid)
        parent.kill()
        parent.wait()
    try:
        assert wait_for_folder(tmp_path / "out")
        assert forks_of_it
        assert all(is_running(process) for process in forks_of_it)
    finally:
        for process in forks_of_it:
            os.kill(process, signal.SIGKILL)


def wait_for_folder(out_dir: Path) -> bool:
    """Wait until an output folder is free: a fork that has not run yet has not let go of anything."""
    for _ in range(10 * PATIENCE_S):
        with suppress(OutputError), OutputFolder(out_dir, overwrite=True):
            return True
        time.sleep(0.1)
    return False
