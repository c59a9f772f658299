"""Worker processes of our own, fresh or forked from a server that has the libraries loaded.

The first half runs in a worker, the second in the process that sends it calls; `open_runner` chooses between
these processes, an executor and a cluster.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import Any, BinaryIO, Final, NoReturn, Protocol, TypeVar, cast

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
from pcwlad_geo.raster.trust import current_trust

_POOLS: Final = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "VECLIB_MAXIMUM", "GDAL_NUM")
ONE_THREAD: Final = dict.fromkeys((f"{pool}_THREADS" for pool in _POOLS), "1")
"""Environment of a worker: there is one process per core, so libraries must not start threads."""

_LENGTH: Final = struct.Struct("<Q")


class RemoteTraceback(Exception):  # noqa: N818  # a text that comes with an error, no error by itself
    """The traceback of an error in a worker, given as the cause of the error in the parent."""


def send(stream: BinaryIO, message: bytes) -> None:
    """Write `message` to the pipe `stream`.

    Raises `OSError` if the other end of the pipe is closed.
    """
    stream.write(_LENGTH.pack(len(message)) + message)
    stream.flush()


def receive(stream: BinaryIO) -> bytes | None:
    """Read a message from a pipe; None at its end, or where it ends or breaks within a message."""
    try:
        header = stream.read(_LENGTH.size)
        if len(header) < _LENGTH.size:
            return None
        length: int = _LENGTH.unpack(header)[0]
        message = stream.read(length)
    except OSError:  # a socket whose other end was killed
        return None
    return message if len(message) == length else None


def main(preload: str) -> None:
    """Run a worker that receives calls over standard input and sends answers to standard output.

    Parameters
    ----------
    preload : str
        Name of a module to import before the first call; may be empty.
    """
    answer_calls(*_take_standard_streams(), preload)


def answer_calls(calls: BinaryIO, answers: BinaryIO, preload: str = "") -> NoReturn:
    """Answer the calls from `calls` on `answers` until the parent ends; `preload` is that of `main`."""
    waiting: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(calls, waiting), daemon=True).start()
    _import(preload)
    while True:
        message = answer(waiting.get())
        with suppress(OSError):  # the parent has ended, and this process is about to
            send(answers, message)


def answer(call: bytes) -> bytes:
    """Execute a pickled call; return (True, result) or (False, error, its traceback), pickled."""
    try:
        function, arguments = pickle.loads(call)
        return pickle.dumps((True, function(*arguments)), pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        return _failure(error, "".join(traceback.format_exception(error)))


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
        while (call := receive(calls)) is not None:
            waiting.put(call)
    finally:  # whatever ended it
        os._exit(0)


def _failure(error: Exception, text: str) -> bytes:
    try:
        message = pickle.dumps((False, error, text))
        pickle.loads(message)
    except Exception:  # an error that cannot be pickled: send its message
        message = pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}"), text))
    return message


def start_interpreter(statement: str, arguments: Sequence[str], **options: Any) -> subprocess.Popen[bytes]:  # noqa: ANN401
    """Start a new process of this Python interpreter with the same import path.

    Raises `ExecutionError` if it cannot be started. It executes `statement`, with `arguments` in
    ``sys.argv[1:]``; the other options are those of `subprocess.Popen`.
    """
    code = f"import sys; n = {len(arguments) + 1}; sys.path[:] = sys.argv[n:]; del sys.argv[n:]; {statement}"
    try:
        return subprocess.Popen(
            [sys.executable, "-c", code, *arguments, *map(str, sys.path)],
            env={**os.environ, **ONE_THREAD},
            # an interrupt of the terminal reaches the parent only, which ends its workers
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            **options,
        )
    except OSError as error:
        raise ExecutionError(
            f"cannot start a worker process ({error.strerror}): give fewer --jobs"
        ) from error


CAN_FORK: Final = sys.platform == "linux" and hasattr(socket, "send_fds")
"""Whether this system has a fork server."""

_FORK, _WAIT = b"F", b"W"
_NUMBER: Final = struct.Struct("<q")


class ForkServer:
    """Handle of the process that forks workers.

    Parameters
    ----------
    preload : str
        A module that it imports at its start; may be empty.

    Raises
    ------
    ExecutionError
        If it cannot be started.
    """

    def __init__(self, preload: str) -> None:
        ours, theirs = socket.socketpair()
        with theirs, ExitStack() as on_error:
            on_error.push(ours)
            self._process = _start(preload, theirs)
            on_error.pop_all()
        self._control, self._lock = ours, threading.Lock()

    def fork(self) -> ForkedProcess:
        """Return a new worker.

        Raises `OSError` if the server is gone.
        """
        ours, theirs = socket.socketpair()
        with ours, theirs, self._lock:
            try:
                socket.send_fds(self._control, [_FORK], [theirs.fileno()])
                return ForkedProcess(_receive_number(self._control), ours, self)
            except BaseException:
                self._control.close()  # an unread answer would be taken for that to the next request
                raise

    def wait(self, process_id: int) -> int | None:
        """Wait for the end of a worker and return its exit status; None if it is unknown."""
        try:
            with self._lock:
                self._control.sendall(_WAIT + _NUMBER.pack(process_id))
                return _receive_number(self._control)
        except OSError:
            return None

    def close(self) -> None:
        """End the server."""
        self._process.kill()  # first: it may be busy, and somebody may be waiting for its answer
        self._control.close()
        self._process.wait()


class ForkedProcess:
    """Handle of a forked worker process."""

    def __init__(self, process_id: int, stream: socket.socket, server: ForkServer) -> None:
        self.pid = process_id
        self.calls = cast(BinaryIO, stream.makefile("wb"))
        self.answers = cast(BinaryIO, stream.makefile("rb"))  # these keep the socket open
        self._server, self._ended, self._status = server, False, cast("int | None", None)

    def kill(self) -> None:
        """End the process, also during a call."""
        with suppress(ProcessLookupError):
            if not self._ended:
                os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> int | None:
        """Wait for its end; return its exit status, minus the signal that ended it, None if unknown."""
        if not self._ended:
            self._status, self._ended = self._server.wait(self.pid), True
        return self._status


def _start(preload: str, control: socket.socket) -> subprocess.Popen[bytes]:
    """Start the process that forks: a fresh interpreter, as a fork of this one could inherit held locks."""
    number = control.fileno()
    serve = (
        "from pcwlad_geo.execution.processes import serve_forks; serve_forks(sys.argv[1], int(sys.argv[2]))"
    )
    return start_interpreter(serve, [preload, str(number)], stdin=subprocess.DEVNULL, pass_fds=[number])


def serve_forks(preload: str, control_fd: int) -> None:
    """Load the libraries, then serve the requests of the parent until it ends; forked workers answer calls.

    A module named by `preload`, which may be empty, is imported first. Requests come by the socket
    `control_fd`.
    """
    os.dup2(2, 1)  # stray prints go to standard error
    control = socket.socket(fileno=control_fd)
    _import(preload)
    with suppress(OSError):  # the parent has ended
        while True:
            kind, fds, *_ = socket.recv_fds(control, 1, 1)
            if kind == _WAIT:
                _, status = os.waitpid(_receive_number(control), 0)
                control.sendall(_NUMBER.pack(os.waitstatus_to_exitcode(status)))
            elif kind == _FORK:
                gc.freeze()  # garbage collection in a worker would copy all shared memory pages
                process_id = os.fork()
                if process_id == 0:
                    control.close()
                    stream = socket.socket(fileno=fds[0])
                    answer_calls(cast(BinaryIO, stream.makefile("rb")), cast(BinaryIO, stream.makefile("wb")))
                os.close(fds[0])
                control.sendall(_NUMBER.pack(process_id))
            else:
                break
    os._exit(0)


def _import(name: str) -> None:
    with suppress(Exception):  # the first call that needs it reports what is wrong
        if name:
            import_module(name)


def _receive(stream: socket.socket, count: int) -> bytes:
    parts = b""
    while len(parts) < count:
        part = stream.recv(count - len(parts))
        if not part:
            raise ConnectionResetError
        parts += part
    return parts


def _receive_number(stream: socket.socket) -> int:
    number: int = _NUMBER.unpack(_receive(stream, _NUMBER.size))[0]
    return number


ATTEMPTS: Final = 3
"""Number of processes that may die during one call before it fails."""

T = TypeVar("T")


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    if sys.platform != "win32" and hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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


class _Fresh:
    """A fresh interpreter."""

    def __init__(self, preload: str) -> None:
        start = "from pcwlad_geo.execution.processes import main; main(sys.argv[1])"
        self._process = start_interpreter(start, [preload], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
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

    A single call is executed in this process, as are all calls if there is only one worker. Workers are forks
    of a process that has its libraries loaded, or fresh interpreters. None of them imports the parent's main
    module, so scripts need no ``__main__`` guard.

    Parameters
    ----------
    jobs : int
        Largest number of worker processes; they start when calls are expected.
    preload : str
        Name of a module that a worker, or its fork server, imports before the first call; none if empty.
    """

    is_local = True
    honours_affinity = True

    def __init__(self, jobs: int, preload: str = "") -> None:
        # one where this Python cannot be started again, as it is embedded in another program
        self._jobs = jobs if Path(sys.executable or "").stem.lower().startswith(("python", "pypy")) else 1
        self._preload, self._wanted = preload, 0
        self._losses: SimpleQueue[str] = SimpleQueue()
        self._fork_server: ForkServer | None = None
        self._workers: list[Worker] = []

    def __enter__(self) -> OwnProcesses:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for worker in self._workers:  # all at once, then wait
            worker.stop()
        if self._fork_server is not None:
            self._fork_server.close()
            self._fork_server = None
        for worker in self._workers:
            worker.join()
        self._workers.clear()

    @property
    def threads(self) -> int:
        """Number of threads that a call may use which runs alone."""
        return self._jobs

    @property
    def process_ids(self) -> list[int]:
        """Identifiers of the worker processes, which are started if they are expected."""
        return [worker.process_id for worker in self._started()]

    def expect(self, calls: int) -> None:
        """Prepare the workers that `calls` calls can use: the libraries are loaded, without waiting."""
        wanted = min(self._jobs, calls)
        if wanted <= max(1, self._wanted):
            return
        self._wanted = wanted
        if not CAN_FORK:
            self._started()
        elif self._fork_server is None:
            self._fork_server = ForkServer(self._preload)

    def _started(self) -> list[Worker]:
        """Return all workers, after starting those that are wanted and missing."""
        for _ in range(self._wanted - len(self._workers)):
            self._workers.append(Worker(self._process, self._losses.put))
        return self._workers

    def _process(self) -> Process:
        if self._fork_server is not None:
            with suppress(OSError):  # the fork server is gone
                return self._fork_server.fork()
        return _Fresh(self._preload)

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
        workers_ready = self._started()

        def submit(index: int, worker: int) -> Future[T]:
            return workers_ready[worker].submit(in_environment, (settings, trust, function, calls[index]))

        def tell(event: Event) -> None:
            while not self._losses.empty():
                on_event(Warned(self._losses.get()))
            on_event(event)

        results, workers = run_calls(submit, wanted, len(workers_ready), stage, tell)
        return CallResults(results, list(workers))


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

    It runs on the `executor`, or is that if it is a runner, which is not closed; else on the cluster of a
    dask `scheduler` at that address; else on `jobs` processes, one per core by default, which import the
    module `preload` before their first call. Warnings about the workers go to `on_event`. Raises
    `ExecutionError` if the scheduler cannot be used.
    """
    if isinstance(executor, Executor):
        yield OnExecutor(executor)
    elif executor is not None:
        yield executor
    elif scheduler is not None:
        from pcwlad_geo.execution.runner import connected  # an optional dependency

        with connected(scheduler, on_event) as runner:
            yield runner
    else:
        with OwnProcesses(jobs or available_cores(), preload) as processes:
            yield processes
