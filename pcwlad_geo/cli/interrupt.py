"""Ctrl-C, SIGTERM and the end of standard input stop a run, also one that is deep in native code."""

from __future__ import annotations

import _thread
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from pcwlad_geo.registration.forks import IDLE

GRACE_S = 1.0
"""How long the main thread may take to clean up by itself before the run is ended from outside."""
CLEANING_S = 0.5
"""How long the cleaning up from outside may take."""
STATUS = 130
SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def cancellable(forced_end: Callable[[], None], *, watch_stdin: bool = False) -> Iterator[None]:
    """Turn the first interrupt into KeyboardInterrupt in the main thread; a stuck run is ended by force.

    Python runs signal handlers between two byte codes of the main thread, which a long call into a C library
    puts off. The wakeup descriptor is written at once, so a thread that reads it can wait `GRACE_S` and
    then clean up and end the process itself.

    Parameters
    ----------
    forced_end : callable
        Cleans up where the main thread did not come to it; the process exits with status 130 after it.
    watch_stdin : bool
        Interrupt at the end of standard input too.
    """
    finished = threading.Event()
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    previous = {number: signal.signal(number, _interrupt) for number in SIGNALS}
    wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    watched = (reader, finished, forced_end)
    watcher = threading.Thread(target=_watch_signals, args=watched, name=IDLE, daemon=True)
    watcher.start()
    if watch_stdin:
        threading.Thread(target=_watch_stdin, args=(finished,), name=IDLE, daemon=True).start()
    try:
        yield
    finally:
        finished.set()
        signal.set_wakeup_fd(wakeup)
        for number, handler in previous.items():
            signal.signal(number, handler)
        writer.close()  # ends the watcher
        watcher.join()


def _interrupt(number: int, frame: FrameType | None) -> None:
    for each in SIGNALS:  # once: a second one must not break off the cleaning up
        signal.signal(each, signal.SIG_IGN)
    raise KeyboardInterrupt


def _watch_signals(reader: socket.socket, finished: threading.Event, forced_end: Callable[[], None]) -> None:
    with reader:
        while received := reader.recv(1):
            if received[0] in SIGNALS:
                if not finished.wait(GRACE_S):
                    _end_process(forced_end)
                return


def _end_process(forced_end: Callable[[], None]) -> None:
    # In a thread of its own: the stuck main thread may hold a lock that cleaning up needs.
    cleaning = threading.Thread(target=forced_end, daemon=True)
    cleaning.start()
    cleaning.join(CLEANING_S)
    os._exit(STATUS)  # worker processes end with this one


def _watch_stdin(finished: threading.Event) -> None:
    # os.read: a thread that sits in sys.stdin would block the interpreter's own end.
    while os.read(0, 4096):
        pass
    if finished.is_set():
        return
    if hasattr(signal, "pthread_kill"):  # wakes a main thread that waits for a lock
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()
