"""A worker process: fresh, or forked from a server that has the libraries loaded."""

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
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from importlib import import_module
from queue import SimpleQueue
from typing import Any, BinaryIO, Final, NoReturn, cast

from pcwlad_geo.errors import ExecutionError

_POOLS: Final = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "VECLIB_MAXIMUM", "NUMBA_NUM", "GDAL_NUM")
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

_FORK, _PREPARE, _WAIT = b"F", b"P", b"W"
_NUMBER: Final = struct.Struct("<q")
_SERVE_FORKS: Final = (
    "from pcwlad_geo.execution.worker import serve_forks; serve_forks(sys.argv[1], int(sys.argv[2]))"
)


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

    def prepare(self, call: bytes) -> None:
        """Let a pickled call be done before anything is forked, without waiting for it."""
        with self._lock, suppress(OSError):  # a server that is gone is noticed when it should fork
            self._control.sendall(_PREPARE + _NUMBER.pack(len(call)) + call)

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
    return start_interpreter(
        _SERVE_FORKS, [preload, str(number)], stdin=subprocess.DEVNULL, pass_fds=[number]
    )


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
            if kind == _PREPARE:
                answer(_receive(control, _receive_number(control)))
            elif kind == _WAIT:
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
