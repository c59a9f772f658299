"""Worker processes of our own, and what runs the calls of a job: them, an executor, a cluster."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, BinaryIO, Final, Protocol, TypeVar, cast

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.events import Event, EventCallback, Warned, ignore
from pcwlad_geo.execution.runner import (
    Affinity,
    CallResults,
    InThisProcess,
    OnExecutor,
    Runner,
    gdal_settings,
    in_environment,
    run_calls,
)
from pcwlad_geo.execution.worker import (
    CAN_FORK,
    ForkServer,
    RemoteTraceback,
    receive,
    send,
    start_interpreter,
)
from pcwlad_geo.raster.trust import current_trust

ATTEMPTS: Final = 3
"""Number of processes that may die during one call before it fails."""

_START: Final = "from pcwlad_geo.execution.worker import main; main(sys.argv[1])"

T = TypeVar("T")


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    if sys.platform != "win32" and hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def can_start_workers() -> bool:
    """Return whether this Python can be started again, and is not embedded in another program."""
    return Path(sys.executable or "").stem.lower().startswith(("python", "pypy"))


class Process(Protocol):
    """Handle of a worker process."""

    pid: int
    calls: BinaryIO
    answers: BinaryIO

    def kill(self) -> None:
        """End the process, also during a call."""

    def wait(self) -> int | None:
        """Wait for its end; return its exit status, minus the signal that ended it, None if unknown."""


class Worker:
    """A process that executes one call at a time, and the thread that communicates with it.

    Parameters
    ----------
    start : callable
        Starts its process.
    on_loss : callable
        Receives a message, in another thread, when a process has died and was replaced.
    """

    def __init__(self, start: Callable[[], Process], on_loss: Callable[[str], None]) -> None:
        self._start = start
        self._on_loss = on_loss
        self._closed = False
        self._starting = threading.Lock()
        self._process = start()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="pcwlad-geo-worker")

    @property
    def process_id(self) -> int:
        """Identifier of the current process."""
        return self._process.pid

    def submit(self, function: Callable[..., T], arguments: tuple[Any, ...]) -> Future[T]:
        """Queue a call of the importable `function` with `arguments`.

        The future raises the error of the function, or `ExecutionError` if processes die during the call.
        """
        return self._thread.submit(self._call, pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL))

    def stop(self) -> None:
        """End the process, also during a call."""
        with self._starting:
            self._closed = True
            self._process.kill()

    def join(self) -> None:
        """Wait for the end of a stopped process."""
        self._thread.shutdown(wait=True, cancel_futures=True)
        _reap(self._process)

    def _call(self, message: bytes) -> Any:  # noqa: ANN401  # whatever the function returns
        for attempt in range(ATTEMPTS):
            answer = self._ask(message)
            if answer is not None:
                return _opened(answer)
            how = _how_it_ended(_reap(self._process))
            with self._starting:
                if self._closed:
                    raise ExecutionError("the workers of this job have been stopped")
                self._process = self._start()
            if attempt + 1 < ATTEMPTS:
                self._on_loss(f"a worker process was lost ({how}): its task is done again")
        raise ExecutionError(
            f"{ATTEMPTS} worker processes were lost on the same task (the last one {how}): "
            "if memory ran out, give fewer --jobs"
        )

    def _ask(self, message: bytes) -> bytes | None:
        """Send a call and wait for its answer; None if the process is lost."""
        try:
            send(self._process.calls, message)
        except OSError:
            return None
        return receive(self._process.answers)


class Workers:
    """Starts worker processes: forks of one that has its libraries loaded, or fresh interpreters.

    None of them imports the parent's main module, so scripts need no ``__main__`` guard.

    Parameters
    ----------
    preload : str
        Name of a module that workers import before their first call; may be empty.
    on_loss : callable
        See `Worker`.
    """

    def __init__(self, preload: str, on_loss: Callable[[str], None]) -> None:
        self._preload, self._on_loss = preload, on_loss
        self._fork_server: ForkServer | None = None
        self._all: list[Worker] = []

    def expect(self, count: int) -> None:
        """Prepare for `count` workers: the libraries are loaded, here or in another process."""
        if not CAN_FORK:
            self.at_least(count)
        elif self._fork_server is None:
            self._fork_server = ForkServer(self._preload)

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Call a function in every worker, or before they are forked, without waiting for it."""
        if self._fork_server is not None and not self._all:
            self._fork_server.prepare(pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL))
        for worker in self._all:
            worker.submit(function, arguments)

    def at_least(self, count: int) -> list[Worker]:
        """Return all workers, after starting those missing to `count`."""
        for _ in range(count - len(self._all)):
            self._all.append(Worker(self._process, self._on_loss))
        return self._all

    def stop(self) -> None:
        """End all processes, also during a call."""
        for worker in self._all:  # all at once, then wait
            worker.stop()
        if self._fork_server is not None:
            self._fork_server.close()
            self._fork_server = None
        for worker in self._all:
            worker.join()
        self._all.clear()

    def _process(self) -> Process:
        if self._fork_server is not None:
            with suppress(OSError):  # the fork server is gone
                return self._fork_server.fork()
        return _Fresh(self._preload)


class _Fresh:
    """A fresh interpreter."""

    def __init__(self, preload: str) -> None:
        self._process = start_interpreter(_START, [preload], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.pid = self._process.pid
        self.calls = cast(BinaryIO, self._process.stdin)
        self.answers = cast(BinaryIO, self._process.stdout)

    def kill(self) -> None:
        self._process.kill()

    def wait(self) -> int:
        return self._process.wait()


def _reap(process: Process) -> int | None:
    """Wait for the end of a process that is dead or dying and close its pipes; return its status."""
    for pipe in (process.calls, process.answers):
        with suppress(OSError):  # unsent data are lost
            pipe.close()
    return process.wait()


def _how_it_ended(status: int | None) -> str:
    if status is None:
        return "exit status unknown"
    if status < 0:
        with suppress(ValueError):
            return f"killed by {signal.Signals(-status).name}"
    return f"exit status {status}"


def _opened(answer: bytes) -> object:
    """Return the result in an answer, or raise the error."""
    done, *content = pickle.loads(answer)
    if done:
        return content[0]
    error, text = content
    raise error from RemoteTraceback(f"\n{text}")


class OwnProcesses:
    """Executes the calls in worker processes of its own, which serve all stages; a context manager.

    A single call is executed in this process, as are all calls if there is only one worker.

    Parameters
    ----------
    jobs : int
        Largest number of worker processes; they start when calls are expected.
    preload : str
        Name of a module that a worker, or its fork server, imports before the first call; none if empty.
    """

    shares_kernels = True
    honours_affinity = True

    def __init__(self, jobs: int, preload: str = "") -> None:
        self._jobs = jobs if can_start_workers() else 1
        self._wanted = 0
        self._losses: SimpleQueue[str] = SimpleQueue()
        self._workers = Workers(preload, self._losses.put)

    def __enter__(self) -> OwnProcesses:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._workers.stop()

    @property
    def threads(self) -> int:
        """Number of threads that a call may use which runs alone."""
        return self._jobs

    @property
    def process_ids(self) -> list[int]:
        """Identifiers of the worker processes, which are started if they are expected."""
        return [worker.process_id for worker in self._workers.at_least(self._wanted)]

    def expect(self, calls: int) -> None:
        """Prepare the workers that `calls` calls can use."""
        wanted = min(self._jobs, calls)
        if wanted > max(1, self._wanted):
            self._wanted = wanted
            self._workers.expect(wanted)

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Call `function` with `arguments` in every worker that is expected, without waiting."""
        self._workers.prepare(in_environment, (gdal_settings(), current_trust(), function, arguments))

    def run(
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
        affinity: Affinity | None = None,
    ) -> CallResults[T]:
        """Call the function with each tuple of arguments; see `Runner`."""
        self.expect(len(calls))
        wanted = list(affinity) if affinity is not None else [None] * len(calls)
        if not self._wanted or (len(calls) == 1 and wanted[0] is None):
            return InThisProcess().run(function, calls, stage, on_event)
        settings, trust = gdal_settings(), current_trust()
        workers_ready = self._workers.at_least(self._wanted)

        def submit(index: int, worker: int) -> Future[T]:
            return workers_ready[worker].submit(in_environment, (settings, trust, function, calls[index]))

        def tell(event: Event) -> None:
            self._tell_losses(on_event)
            on_event(event)

        results, workers = run_calls(submit, wanted, len(workers_ready), stage, tell)
        return CallResults(results, list(workers))

    def _tell_losses(self, on_event: EventCallback) -> None:
        while True:
            try:
                message = self._losses.get_nowait()
            except Empty:
                return
            on_event(Warned(message))


@contextmanager
def open_runner(
    executor: Executor | Runner | None,
    on_event: EventCallback,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    preload: str = "",
) -> Iterator[Runner]:
    """Provide the runner for the calls of one or more jobs for the duration of the context.

    Raises `ExecutionError` if the scheduler cannot be used.

    Parameters
    ----------
    executor : concurrent.futures.Executor or Runner, optional
        A runner is returned as it is, and not closed.
    on_event : callable
        Receives warnings about the workers.
    jobs : int, optional
        Number of worker processes if there is neither executor nor scheduler; None = one per core.
    scheduler : str, optional
        Address of a dask scheduler, used if there is no executor.
    preload : str
        Name of a module that worker processes import before their first call.
    """
    if isinstance(executor, Executor):
        yield OnExecutor(executor)
    elif executor is not None:
        yield executor
    elif scheduler is not None:
        from pcwlad_geo.execution.cluster import connected  # an optional dependency

        with connected(scheduler, on_event) as runner:
            yield runner
    else:
        with OwnProcesses(jobs or available_cores(), preload) as processes:
            yield processes
