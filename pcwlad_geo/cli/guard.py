"""A process that watches over the work of a command, which ends with a line where a library crashes."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType
from typing import Final

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
"""Signals that interrupt a run."""
ENTRY_POINT: Final = "pcwlad_geo.__main__"
"""Module that the program begins with."""
_PR_SET_PDEATHSIG: Final = 1
"""Of Linux' prctl: the signal that a process gets when its parent ends."""


def watched() -> int | None:
    """Fork, and return None in the new process, which does the work; the other waits for its end.

    There the result is the exit status, or minus the signal that has ended the work. Signals that interrupt
    are passed on, and the work is killed with the process that waits. Where there can be no such process
    (other systems than Linux, other programs that call the command line, callers that have threads or have
    loaded the large libraries, which a fork does not keep intact) the work is done here.
    """
    is_single = threading.active_count() == 1 and "numpy" not in sys.modules
    if sys.platform != "linux" or not is_single or not _is_the_program():
        return None
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with suppress(OSError, ValueError):  # closed, or full: the work will say so
            stream.flush()
    this = os.getpid()
    try:
        child = os.fork()
    except OSError:  # no memory, or too many processes
        return None
    if child:
        return _waited_for(child)
    import ctypes  # inside: only the process that does the work needs it

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != this:  # it has ended meanwhile
        os._exit(1)
    return None


def _is_the_program() -> bool:
    """Return whether this process runs the command line alone: a fork of another would go on with that."""
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    return ENTRY_POINT in sys.modules or (spec is not None and spec.name == ENTRY_POINT)


def _waited_for(child: int) -> int:
    def pass_on(number: int, frame: FrameType | None) -> None:
        with suppress(ProcessLookupError):
            os.kill(child, number)

    for number in SIGNALS:
        signal.signal(number, pass_on)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)
