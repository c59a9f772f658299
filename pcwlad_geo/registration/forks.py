"""Processes forked from one that has the libraries loaded: a start costs milliseconds, memory is shared.

The parent cannot fork itself, as it may have threads. So it starts a fresh interpreter, the stem, which loads
what workers need and has one thread; that one forks them. Linux only: elsewhere libraries do not survive it.
"""

from __future__ import annotations

import gc
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
from contextlib import ExitStack, suppress
from importlib import import_module
from typing import BinaryIO, Final, cast

from pcwlad_geo.registration.interpreters import start_interpreter
from pcwlad_geo.registration.worker import answer, answer_calls

CAN_FORK: Final = sys.platform == "linux" and hasattr(socket, "send_fds")

_FORK, _PREPARE, _WAIT = b"F", b"P", b"W"
_NUMBER: Final = struct.Struct("<q")
_START: Final = "from pcwlad_geo.registration.forks import be_stem; be_stem(sys.argv[1], int(sys.argv[2]))"


class Stem:
    """The process that forks workers, as its parent sees it.

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
            number = theirs.fileno()
            self._process = start_interpreter(
                _START, [preload, str(number)], stdin=subprocess.DEVNULL, pass_fds=[number]
            )
            on_error.pop_all()
        self._control, self._lock = ours, threading.Lock()

    def prepare(self, call: bytes) -> None:
        """Let a pickled call be done before anything is forked, without waiting for it."""
        with self._lock, suppress(OSError):  # a stem that is gone is noticed when it should fork
            self._control.sendall(_PREPARE + _NUMBER.pack(len(call)) + call)

    def fork(self) -> ForkedProcess:
        """Return a new worker.

        Raises
        ------
        OSError
            If the stem is gone.
        """
        ours, theirs = socket.socketpair()
        with ours, theirs, self._lock:
            try:
                socket.send_fds(self._control, [_FORK], [theirs.fileno()])
                return ForkedProcess(_receive_number(self._control), ours, self)
            except BaseException:
                self._control.close()  # an answer left unread would be taken for that to the next question
                raise

    def wait(self, process_id: int) -> int | None:
        """Wait for the end of a worker and return its status; None where nobody knows."""
        try:
            with self._lock:
                self._control.sendall(_WAIT + _NUMBER.pack(process_id))
                return _receive_number(self._control)
        except OSError:
            return None

    def close(self) -> None:
        """End the stem."""
        self._process.kill()  # first: it may be busy, and somebody may be waiting for its answer
        self._control.close()
        self._process.wait()


class ForkedProcess:
    """A forked worker, as the parent sees it."""

    def __init__(self, process_id: int, stream: socket.socket, stem: Stem) -> None:
        self.pid = process_id
        self.calls = cast(BinaryIO, stream.makefile("wb"))
        self.answers = cast(BinaryIO, stream.makefile("rb"))  # these keep the socket open
        self._stem, self._ended, self._status = stem, False, cast("int | None", None)

    def kill(self) -> None:
        """End it, also in the middle of a call."""
        with suppress(ProcessLookupError):
            if not self._ended:
                os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> int | None:
        """Wait for its end; returns its status, minus the signal that ended it, None if nobody knows."""
        if not self._ended:
            self._status, self._ended = self._stem.wait(self.pid), True
        return self._status


def be_stem(preload: str, control_fd: int) -> None:
    """Load what workers need, then do what the parent asks for, until it is gone; in forked workers, work.

    Parameters
    ----------
    preload : str
        A module to import first; may be empty.
    control_fd : int
        File descriptor of a socket to the parent.
    """
    os.dup2(2, 1)  # stray prints go to standard error
    control = socket.socket(fileno=control_fd)
    with suppress(Exception):  # the first call that needs it says what is wrong
        if preload:
            import_module(preload)
    with suppress(OSError):  # the parent is gone
        while True:
            kind, fds, *_ = socket.recv_fds(control, 1, 1)
            if kind == _PREPARE:
                answer(_receive(control, _receive_number(control)))
            elif kind == _WAIT:
                _, status = os.waitpid(_receive_number(control), 0)
                control.sendall(_NUMBER.pack(os.waitstatus_to_exitcode(status)))
            elif kind == _FORK:
                gc.freeze()  # a collection in a worker would copy the pages of all that is shared
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
