"""Worker processes of our own: one call at a time; one that dies is replaced and its call redone."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol, TypeVar, cast

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.registration.forks import CAN_FORK, Stem
from pcwlad_geo.registration.interpreters import start_interpreter
from pcwlad_geo.registration.worker import RemoteTraceback, receive, send

ATTEMPTS: Final = 3
"""How many processes may die on one call."""

_START: Final = "from pcwlad_geo.registration.worker import main; main(sys.argv[1])"

T = TypeVar("T")


def available_cores() -> int:
    """Return how many cores this process may use."""
    if sys.platform != "win32" and hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def can_start_workers() -> bool:
    """Tell whether this is a Python that can be started again, and not one inside another program."""
    return Path(sys.executable or "").stem.lower().startswith(("python", "pypy"))


class Process(Protocol):
    """A worker process, as the parent sees it."""

    pid: int
    calls: BinaryIO
    answers: BinaryIO

    def kill(self) -> None:
        """End it, also in the middle of a call."""

    def wait(self) -> int | None:
        """Wait for its end; returns its status, minus the signal that ended it, None if nobody knows."""


class Worker:
    """A process that does one call at a time, and the thread that talks to it.

    Parameters
    ----------
    start : callable
        Starts its process.
    on_loss : callable
        Is told, from another thread, when a process has died and was replaced.
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
        """Of the present process."""
        return self._process.pid

    def submit(self, function: Callable[..., T], arguments: tuple[Any, ...]) -> Future[T]:
        """Queue a call of an importable function.

        The future raises what the function raises, or `ExecutionError` where processes die on the call.
        """
        return self._thread.submit(self._call, pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL))

    def stop(self) -> None:
        """End the process, also in the middle of a call."""
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
        """Send a call and wait for its answer; None where the process is lost."""
        try:
            send(self._process.calls, message)
        except OSError:
            return None
        return receive(self._process.answers)


class Workers:
    """Where worker processes come from: forks of one that has its libraries loaded, or fresh interpreters.

    None of them imports the parent's main module, so scripts need no guard against that.

    Parameters
    ----------
    preload : str
        A module that workers import before their first call; may be empty.
    on_loss : callable
        See `Worker`.
    """

    def __init__(self, preload: str, on_loss: Callable[[str], None]) -> None:
        self._preload, self._on_loss = preload, on_loss
        self._stem: Stem | None = None
        self._all: list[Worker] = []

    def expect(self, count: int) -> None:
        """Make ready for so many workers: what they need is loaded, here or in another process."""
        if not CAN_FORK:
            self.at_least(count)
        elif self._stem is None:
            self._stem = Stem(self._preload)

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Call a function in every worker, or before they are forked, without waiting for it."""
        if self._stem is not None and not self._all:
            self._stem.prepare(pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL))
        for worker in self._all:
            worker.submit(function, arguments)

    def at_least(self, count: int) -> list[Worker]:
        """Return all workers, started where there were fewer."""
        for _ in range(count - len(self._all)):
            self._all.append(Worker(self._process, self._on_loss))
        return self._all

    def stop(self) -> None:
        """End all processes, also in the middle of a call."""
        for worker in self._all:  # all at once, then wait
            worker.stop()
        if self._stem is not None:
            self._stem.close()
            self._stem = None
        for worker in self._all:
            worker.join()
        self._all.clear()

    def _process(self) -> Process:
        if self._stem is not None:
            with suppress(OSError):  # the stem is gone
                return self._stem.fork()
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
        with suppress(OSError):  # what could not be sent is lost
            pipe.close()
    return process.wait()


def _how_it_ended(status: int | None) -> str:
    if status is None:
        return "nobody knows how"
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
