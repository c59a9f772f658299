"""Workers on this machine: threads for the tiles of a job, processes for whole jobs; the choice of a runner.

What a tile computes holds the interpreter's lock for a thirtieth of its time, so threads keep all cores busy,
and share the maps of the tiles. A small job, of one tile, holds it for a third of its time or more (planning,
fit, report): many of them run in processes.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any, BinaryIO, Final, NoReturn, TypeVar

from pcwlad_geo.child import child_environment, how_it_was_lost, python_command
from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.execution.cluster import connected
from pcwlad_geo.execution.runner import (
    Calls,
    InThisProcess,
    OnExecutor,
    Runner,
    gdal_settings,
    in_environment,
    run_calls,
)
from pcwlad_geo.raster.trust.permissions import current_trust

T = TypeVar("T")

_SERVE: Final = "from pcwlad_geo.execution.workers import serve; serve()"


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    if sys.platform != "win32" and hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class LocalWorkers(InThisProcess):
    """Executes calls in threads of this process, and whole jobs in processes of its own.

    Parameters
    ----------
    jobs : int
        Largest number of calls that are executed at a time.
    """

    def __init__(self, jobs: int) -> None:
        self.threads = jobs
        # no Python can be started where it is embedded in another program
        is_python = Path(sys.executable or "").stem.lower().startswith(("python", "pypy"))
        self.shares_jobs = is_python and jobs > 1
        self._processes: ChildProcesses | None = None

    def run(
        self, function: Callable[..., T], calls: Calls, stage: str, on_event: EventCallback = ignore
    ) -> list[T]:
        """Call the function with each tuple of arguments, in threads; see `Runner`."""
        if self.threads == 1 or len(calls) < 2:
            return super().run(function, calls, stage, on_event)
        with ThreadPoolExecutor(self.threads, thread_name_prefix="pcwlad-geo") as pool:
            return OnExecutor(pool, self.threads, place="the pool of threads").run(
                function, calls, stage, on_event
            )

    def run_jobs(
        self, function: Callable[..., T], calls: Calls, stage: str, on_event: EventCallback = ignore
    ) -> list[T | ExecutionError]:
        """Call a function that does a whole job, in processes; see `Runner`."""
        if not self.shares_jobs or len(calls) < 2:
            return super().run_jobs(function, calls, stage, on_event)
        processes = self._processes = self._processes or ChildProcesses(self.threads)
        settings, trust = gdal_settings(), current_trust()

        def submit(index: int) -> Future[T | ExecutionError]:
            return processes.submit(in_environment, settings, trust, function, calls[index])

        return run_calls(submit, len(calls), self.threads, stage, on_event)

    def close(self) -> None:
        """End the processes, also during a call."""
        if self._processes is not None:
            self._processes.stop()
            self._processes = None


class ChildProcesses:
    """Executes calls of importable functions in processes, which start when they are needed.

    A call whose process dies has an `ExecutionError` as its result, and its process is replaced.
    """

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="pcwlad-geo-child")
        self._all: set[_Child] = set()
        self._idle: list[_Child] = []
        self._lock = threading.Lock()
        self._closed = False

    def submit(self, function: Callable[..., T], *arguments: Any) -> Future[T | ExecutionError]:  # noqa: ANN401
        """Queue a call."""
        return self._threads.submit(self._call, pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL))

    def stop(self) -> None:
        """End the processes, also during a call."""
        with self._lock:
            self._closed = True
            for child in self._all:
                child.process.kill()
        self._threads.shutdown(wait=True, cancel_futures=True)
        for child in self._all:
            child.reap()

    def _call(self, message: bytes) -> Any:  # noqa: ANN401  # whatever the function returns
        with self._lock:
            if self._closed:
                raise ExecutionError("the worker processes of this job have been stopped")
            child = self._idle.pop() if self._idle else _Child()
            self._all.add(child)
        answer = child.ask(message)
        with self._lock:
            if answer is not None:
                self._idle.append(child)
            else:
                self._all.discard(child)
        if answer is None:
            return ExecutionError(f"a worker process was lost: {how_it_was_lost(child.reap())}")
        is_result, value, text = pickle.loads(answer)
        if is_result:
            return value
        raise value from RemoteTraceback(f"\n{text}")


class RemoteTraceback(Exception):  # noqa: N818  # a text that comes with an error, no error by itself
    """The traceback of an error in a process, given as the cause of the error in its parent."""


class _Child:
    """A process that answers one call at a time."""

    def __init__(self) -> None:
        try:
            self.process = subprocess.Popen(
                python_command(_SERVE),
                env=child_environment(),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                # an interrupt of the terminal reaches the parent only, which ends its children
                start_new_session=True,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as error:
            raise ExecutionError(
                f"cannot start a worker process ({error.strerror}): give fewer --jobs"
            ) from error

    def ask(self, message: bytes) -> bytes | None:
        """Send a call and wait for its answer; None if the process is lost."""
        calls, answers = self.process.stdin, self.process.stdout
        with suppress(OSError, EOFError, pickle.UnpicklingError):
            if calls is not None and answers is not None:
                pickle.dump(message, calls)
                calls.flush()
                answer: bytes = pickle.load(answers)
                return answer
        return None

    def reap(self) -> int:
        """Close the pipes to the process, wait for its end, and return its exit status."""
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(OSError):  # unsent data are lost
                if pipe is not None:
                    pipe.close()
        return self.process.wait()


def serve() -> NoReturn:
    """Be a child: answer the calls that come by standard input on standard output, until the parent ends."""
    calls, answers = _take_standard_streams()
    waiting: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(calls, waiting), daemon=True).start()
    while True:
        message = _answer(waiting.get())
        with suppress(OSError):  # the parent has ended, and this process is about to
            pickle.dump(message, answers)
            answers.flush()


def _take_standard_streams() -> tuple[BinaryIO, BinaryIO]:
    """Reserve the pipes for the calls: other reads find no input, other prints go to standard error."""
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    return calls, answers


def _listen(calls: BinaryIO, waiting: SimpleQueue[bytes]) -> None:
    """Queue incoming calls; the end of the pipe ends the process, also during a call."""
    try:
        while True:
            waiting.put(pickle.load(calls))
    finally:  # whatever ended it
        os._exit(0)


def _answer(call: bytes) -> bytes:
    """Execute a pickled call; return (True, result, "") or (False, error, its traceback), pickled."""
    try:
        function, arguments = pickle.loads(call)
        return pickle.dumps((True, function(*arguments), ""), pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        text = "".join(traceback.format_exception(error))
        try:
            message = pickle.dumps((False, error, text))
            pickle.loads(message)
        except Exception:  # an error that cannot be pickled: send its message
            message = pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}"), text))
        return message


@contextmanager
def open_runner(
    executor: Executor | Runner | None,
    on_event: EventCallback,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Iterator[Runner]:
    """Provide the runner for the calls of one or more jobs for the duration of the context.

    It runs on the `executor`, or is that if it is a runner, which is not closed; else on the cluster of a
    dask `scheduler` at that address; else on `jobs` workers here, one per core by default. Warnings about the
    workers go to `on_event`. Raises `ExecutionError` if the scheduler cannot be used.
    """
    if isinstance(executor, Executor):
        yield OnExecutor(executor, shares_memory=isinstance(executor, ThreadPoolExecutor))
    elif executor is not None:
        yield executor
    elif scheduler is not None:
        with connected(scheduler, on_event) as runner:
            yield runner
    else:
        workers = LocalWorkers(jobs or available_cores())
        try:
            yield workers
        finally:
            workers.close()
