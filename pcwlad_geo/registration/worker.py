"""A worker process of our own: calls come over a pipe, answers go over another, until the pipe ends.

Nothing heavy is imported here: the environment that keeps libraries on one thread is set before they load,
and the process lives no longer than its parent, however that ends.
"""

from __future__ import annotations

import os
import pickle
import struct
import threading
import traceback
from contextlib import suppress
from importlib import import_module
from queue import SimpleQueue
from typing import BinaryIO, Final, NoReturn

_POOLS: Final = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "VECLIB_MAXIMUM", "NUMBA_NUM", "GDAL_NUM")
ONE_THREAD: Final = dict.fromkeys((f"{pool}_THREADS" for pool in _POOLS), "1")
"""Environment of a worker: there is one process a core, so libraries must not start threads."""

_LENGTH: Final = struct.Struct("<Q")


class RemoteTraceback(Exception):  # noqa: N818  # a text that comes with an error, no error by itself
    """Where an error arose in a worker; the cause of the error in the parent."""


def send(stream: BinaryIO, message: bytes) -> None:
    """Write a message to a pipe.

    Raises
    ------
    OSError
        If nobody reads.
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
    """Be a worker of its own: calls come over standard input, answers go to standard output.

    Parameters
    ----------
    preload : str
        A module to import before the first call comes; may be empty.
    """
    answer_calls(*_take_standard_streams(), preload)


def answer_calls(calls: BinaryIO, answers: BinaryIO, preload: str = "") -> NoReturn:
    """Answer calls until the parent closes the stream or is gone; `preload` as for `main`."""
    waiting: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(calls, waiting), daemon=True).start()
    with suppress(Exception):  # the first call that needs it says what is wrong
        if preload:
            import_module(preload)
    while True:
        message = answer(waiting.get())
        with suppress(OSError):  # the parent is gone: so will this process be, at once
            send(answers, message)


def answer(call: bytes) -> bytes:
    """Do a pickled call; return (True, result) or (False, error, its traceback), pickled."""
    try:
        function, arguments = pickle.loads(call)
        return pickle.dumps((True, function(*arguments)), pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        return _failure(error, "".join(traceback.format_exception(error)))


def _take_standard_streams() -> tuple[BinaryIO, BinaryIO]:
    """Keep the pipes for the calls; stray reads find nothing, stray prints go to standard error."""
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    return calls, answers


def _listen(calls: BinaryIO, waiting: SimpleQueue[bytes]) -> None:
    """Queue what comes in; the end of the pipe is the end of the process, in the middle of a call too."""
    try:
        while (call := receive(calls)) is not None:
            waiting.put(call)
    finally:  # whatever ended it
        os._exit(0)


def _failure(error: Exception, text: str) -> bytes:
    try:
        message = pickle.dumps((False, error, text))
        pickle.loads(message)
    except Exception:  # an error that cannot travel: its words can
        message = pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}"), text))
    return message
