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
from typing import Any, BinaryIO, Final, TypeVar, cast

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.registration.worker import ONE_THREAD, RemoteTraceback, receive, send

ATTEMPTS: Final = 3
"""How many processes may die on one call."""

_START: Final = (
    "import sys; sys.path[:] = sys.argv[2:]; "
    "from pcwlad_geo.registration.worker import main; main(sys.argv[1])"
)

T = TypeVar("T")


def available_cores() -> int:
    """Return how many cores this process may use."""
    if sys.platform != "win32" and hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def can_start_workers() -> bool:
    """Tell whether this is a Python that can be started again, and not one inside another program."""
    return Path(sys.executable or "").stem.lower().startswith(("python", "pypy"))


class Worker:
    """A process that does one call at a time, and the thread that talks to it.

    It starts at once and imports its libraries while the parent does something else. It is a fresh
    interpreter that does not import the parent's main module, so scripts need no guard against that.

    Parameters
    ----------
    preload : str
        A module to import at the start; may be empty.
    on_loss : callable
        Is told, from another thread, when a process has died and was replaced.
    """

    def __init__(self, preload: str, on_loss: Callable[[str], None]) -> None:
        self._preload = preload
        self._on_loss = on_loss
        self._closed = False
        self._starting = threading.Lock()
        self._process = _start(preload)
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
                self._process = _start(self._preload)
            if attempt + 1 < ATTEMPTS:
                self._on_loss(f"a worker process was lost ({how}): its task is done again")
        raise ExecutionError(
            f"{ATTEMPTS} worker processes were lost on the same task (the last one {how}): "
            "if memory ran out, give fewer --jobs"
        )

    def _ask(self, message: bytes) -> bytes | None:
        """Send a call and wait for its answer; None where the process is lost."""
        calls, answers = _pipes(self._process)
        try:
            send(calls, message)
        except OSError:
            return None
        return receive(answers)


def _start(preload: str) -> subprocess.Popen[bytes]:
    # A session of its own: an interrupt of the terminal reaches the parent only, which ends its workers.
    try:
        return subprocess.Popen(
            [sys.executable, "-c", _START, preload, *map(str, sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD},
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError as error:
        raise ExecutionError(
            f"cannot start a worker process ({error.strerror}): give fewer --jobs"
        ) from error


def _pipes(process: subprocess.Popen[bytes]) -> tuple[BinaryIO, BinaryIO]:
    return cast(BinaryIO, process.stdin), cast(BinaryIO, process.stdout)


def _reap(process: subprocess.Popen[bytes]) -> int:
    """Wait for the end of a process that is dead or dying and close its pipes; return its status."""
    for pipe in _pipes(process):
        with suppress(OSError):  # what could not be sent is lost
            pipe.close()
    return process.wait()


def _how_it_ended(status: int) -> str:
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
