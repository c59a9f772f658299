"""Processes forked from one that has the libraries loaded: a start costs milliseconds, memory is shared.

That one, the stem, has one thread: threads do not survive a fork, the locks that they hold do. It is itself a
fork of the parent where nothing in there can hold a lock, as in the command line; elsewhere it is a fresh
interpreter, which loads the libraries anew. Linux only: on other systems libraries do not survive a fork.
"""

from __future__ import annotations

import gc
import os
import signal
import socket
import stat
import struct
import subprocess
import sys
import threading
import traceback
import warnings
from contextlib import ExitStack, suppress
from importlib import import_module
from pathlib import Path
from typing import BinaryIO, Final, NoReturn, cast

from pcwlad_geo.registration.interpreters import start_interpreter
from pcwlad_geo.registration.worker import ONE_THREAD, answer, answer_calls

CAN_FORK: Final = sys.platform == "linux" and hasattr(socket, "send_fds")
IDLE: Final = "pcwlad-geo-idle"
"""Name of threads that wait for the system and hold no lock meanwhile: a process that has them may fork."""

_FORK, _PREPARE, _WAIT = b"F", b"P", b"W"
_NUMBER: Final = struct.Struct("<q")
_BE_STEM: Final = "from pcwlad_geo.registration.forks import be_stem; be_stem(sys.argv[1], int(sys.argv[2]))"


class Stem:
    """The process that forks workers, as its parent sees it.

    Parameters
    ----------
    preload : str
        A module that it imports at its start, or its parent where that forks itself; may be empty.

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


class _Child:
    """A fork of this process."""

    def __init__(self, process_id: int) -> None:
        self.pid = process_id

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> None:
        with suppress(ChildProcessError):  # somebody else waits for all children
            os.waitpid(self.pid, 0)


def _start(preload: str, control: socket.socket) -> _Child | subprocess.Popen[bytes]:
    """Start a stem: a fork of this process where that is safe, else a fresh interpreter."""
    if _may_fork():
        _import(preload)  # which this process needs itself
        if _may_fork():  # still: libraries may have started threads
            with suppress(OSError):  # too little memory for a second one of this size
                return _fork_self(control)
    number = control.fileno()
    return start_interpreter(_BE_STEM, [preload, str(number)], stdin=subprocess.DEVNULL, pass_fds=[number])


def _may_fork() -> bool:
    """Tell whether no other thread of this process, of Python's or of a library's, can hold a lock."""
    others = [thread for thread in threading.enumerate() if thread is not threading.current_thread()]
    if any(thread.name != IDLE for thread in others):
        return False
    with suppress(OSError):
        for standard in range(3):
            os.fstat(standard)  # a closed one: its number may be that of anything
        return len(list(Path("/proc/self/task").iterdir())) == len(others) + 1
    return False


def _fork_self(control: socket.socket) -> _Child:
    """Fork this process; the fork is a stem.

    Raises
    ------
    OSError
        If it cannot be forked.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # closed, or none at all
            stream.flush()  # or the fork writes it again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    child: _Child | None = None
    try:
        # the fork must not run the parent's handlers, nor wake those that wait for its signals
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads: see `_may_fork`
            process_id = os.fork()
        if process_id == 0:
            _live_on(control.fileno(), before)
        child = _Child(process_id)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    except BaseException:  # an interrupt: handlers run where the mask changes
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if child is not None:
            child.kill()
            child.wait()
        raise
    return child


def _live_on(control_fd: int, signals: set[int]) -> NoReturn:
    """Be a stem in a fork, which must not return to what its parent was doing."""
    try:
        _leave_parent(control_fd)
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        be_stem("", control_fd)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(1)


def _leave_parent(control_fd: int) -> None:
    """Let go of what a fork shares with its parent: terminal, signals, pipes, sockets, files written to."""
    import fcntl  # inside: not on every system

    gc.freeze()  # what is collected here must not run the parent's finalizers
    os.setsid()
    os.environ.update(ONE_THREAD)
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    # Who waits for the end of a pipe, or for a lock, must not wait for the fork. The numbers stay taken, as
    # libraries may hold them; files that are only read stay open, as libraries read from them.
    for descriptor in [int(each.name) for each in Path("/proc/self/fd").iterdir()]:
        with suppress(OSError):
            mode, flags = os.fstat(descriptor).st_mode, fcntl.fcntl(descriptor, fcntl.F_GETFL)
            shared = stat.S_ISSOCK(mode) or stat.S_ISFIFO(mode) or flags & os.O_ACCMODE != os.O_RDONLY
            if descriptor > 2 and descriptor not in (control_fd, nothing) and shared:
                os.dup2(nothing, descriptor)
    # the parent's may be other files by now, and hold what it has not written yet
    sys.stdin, sys.stdout = os.fdopen(0, closefd=False), os.fdopen(2, "w", buffering=1, closefd=False)
    sys.stderr = sys.stdout


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
    _import(preload)
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


def _import(name: str) -> None:
    with suppress(Exception):  # the first call that needs it says what is wrong
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
