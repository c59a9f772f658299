"""Interrupts of a run: the clean-up that they begin, and the end of a run that is stuck."""

from __future__ import annotations

import _thread
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from pcwlad_geo.cli.guard import SIGNALS

GRACE_S = 1.0
"""Time for the main thread to clean up by itself before the run is ended by another thread."""
CLEANING_S = 0.5
"""Time for the clean-up by that thread."""
WATCHER = "pcwlad-geo-interrupt"
"""Name of the threads that wait for an interrupt."""
INTERRUPTED = 130
"""Exit status of an interrupted run."""


@contextmanager
def cancellable(forced_end: Callable[[], None], *, watch_stdin: bool = False) -> Iterator[None]:
    """Convert the first interrupt to KeyboardInterrupt in the main thread; end a stuck run by force.

    Python runs signal handlers between two byte codes of the main thread, which a long call of a C library
    delays. The wakeup descriptor is written at once, so a thread that reads it can wait `GRACE_S` and then
    clean up by `forced_end` and end the process itself, with status 130. With `watch_stdin`, the end of
    standard input interrupts the run too. Handlers can be set in the main thread alone: in any other one the
    caller's own are left as they are.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    finished = threading.Event()
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    previous = {number: signal.signal(number, _interrupt) for number in SIGNALS}
    wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    watched = (reader, finished, forced_end)
    watcher = threading.Thread(target=_watch_signals, args=watched, name=WATCHER, daemon=True)
    watcher.start()
    if watch_stdin:
        threading.Thread(target=_watch_stdin, args=(finished,), name=WATCHER, daemon=True).start()
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
    for other in SIGNALS:  # once: a second signal must not interrupt the clean-up
        signal.signal(other, signal.SIG_IGN)
    raise KeyboardInterrupt


def _watch_signals(reader: socket.socket, finished: threading.Event, forced_end: Callable[[], None]) -> None:
    with reader:
        while received := reader.recv(1):
            if received[0] in SIGNALS:
                if not finished.wait(GRACE_S):
                    _end_process(forced_end)
                return


def _end_process(forced_end: Callable[[], None]) -> None:
    # In a separate thread: the stuck main thread may hold a lock that the clean-up needs.
    cleaning = threading.Thread(target=forced_end, daemon=True)
    cleaning.start()
    cleaning.join(CLEANING_S)
    os._exit(INTERRUPTED)  # worker processes end with this one


def _watch_stdin(finished: threading.Event) -> None:
    # os.read: a thread that waits in sys.stdin would block the end of the interpreter.
    while os.read(0, 4096):
        pass
    if finished.is_set():
        return
    if hasattr(signal, "pthread_kill"):  # wakes a main thread that waits for a lock
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()
