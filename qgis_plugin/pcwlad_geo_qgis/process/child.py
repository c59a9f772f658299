"""A child process: its environment, its lines as they come, its end."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Callable

POLL_S = 0.1
GRACE_S = 5.0
DRAIN_S = 2.0
DROPPED_PREFIXES = ("PYTHON", "GDAL_", "PROJ_", "QT_", "QGIS_", "CONDA_", "DYLD_")
DROPPED = ("LD_LIBRARY_PATH", "LD_PRELOAD", "VIRTUAL_ENV")
OnLine = Callable[[str], None]
OnWait = Callable[[], None]
Lines = queue.Queue[tuple[OnLine, str]]
Readers = Sequence[threading.Thread]
Child = subprocess.Popen


Feedback = Any
"""What is told how the work goes and asked `isCanceled()`: QgsProcessingFeedback, or what has its methods."""


def child_environment(user_site: bool = False, more: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment of QGIS without what would make the engine load QGIS's libraries.

    Parameters
    ----------
    user_site : bool
        The child may load packages of the user's own site folder (`pip install --user`).
    more : mapping, optional
        Variables to add, such as those of a proxy.
    """
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.upper().startswith(DROPPED_PREFIXES) and name not in DROPPED
    }
    kept.update(PYTHONUNBUFFERED="1", PYTHONIOENCODING="utf-8")
    return {**kept, **({} if user_site else {"PYTHONNOUSERSITE": "1"}), **(more or {})}


def follow(
    command: Sequence[str],
    feedback: Feedback,
    on_out: OnLine,
    on_err: OnLine,
    folder: Path,
    grace_s: float = GRACE_S,
    environment: Mapping[str, str] | None = None,
    on_wait: OnWait = lambda: None,
) -> int:
    """Run a command to its end, or until the user cancels, and hand over its lines.

    Cancelling closes the standard input of the child, which ends the engine; after `grace_s` it is killed.

    Parameters
    ----------
    command : sequence of str
    feedback
        Asked whether the user has cancelled.
    on_out, on_err : callable
        Receive the lines of standard output and standard error, in this thread.
    folder : pathlib.Path
        Working folder of the child.
    grace_s : float
        Seconds from cancelling to killing.
    environment : mapping, optional
        That of the child; by default `child_environment()`.
    on_wait : callable
        Called every `POLL_S` without a line; does nothing by default.

    Returns
    -------
    int
        The exit status.
    """
    child = Child(
        list(command),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=dict(environment or child_environment()),
        cwd=folder,
        start_new_session=os.name != "nt",  # so that it can be killed with all its children
        # no console window on Windows
        creationflags=subprocess.CREATE_NO_WINDOW if os.name == "nt" else 0,
    )
    lines: Lines = queue.Queue()
    readers = [
        threading.Thread(target=_read, args=(stream, on_line, lines), daemon=True)
        for stream, on_line in ((child.stdout, on_out), (child.stderr, on_err))
    ]
    try:
        for reader in readers:
            reader.start()
        _hand_over(child, readers, lines, feedback, grace_s, on_wait)
        return child.wait()
    finally:
        if child.poll() is None or any(reader.is_alive() for reader in readers):
            _kill(child)  # with what it has left behind, which keeps the pipes open
        child.wait()
        for stream, reader in zip((child.stdout, child.stderr), readers):
            reader.join(DRAIN_S)
            if not reader.is_alive():  # to close what is being read would wait for its end
                stream.close()
        with suppress(OSError):
            child.stdin.close()


def _read(stream: IO[bytes], on_line: OnLine, lines: Lines) -> None:
    with suppress(ValueError):  # closed meanwhile
        for line in stream:
            lines.put((on_line, line.decode("utf-8", "replace").rstrip("\r\n")))


def _hand_over(
    child: Child, readers: Readers, lines: Lines, feedback: Feedback, grace_s: float, on_wait: OnWait
) -> None:
    """Hand over the lines until there are no more and the child has ended."""
    cancelled_at: float | None = None
    ended_at: float | None = None
    while True:
        now = time.monotonic()
        if cancelled_at is None and feedback.isCanceled():
            cancelled_at = now
            with suppress(OSError):
                child.stdin.close()
        if cancelled_at is not None and now - cancelled_at >= grace_s and child.poll() is None:
            _kill(child)
        if ended_at is None and child.poll() is not None:
            ended_at = now
        reading = any(reader.is_alive() for reader in readers)  # asked first: the last line may still come
        try:
            on_line, line = lines.get(timeout=POLL_S)
        except queue.Empty:
            on_wait()
            # a grandchild that keeps the pipes open must not hold the user up
            if ended_at is not None and (not reading or now - ended_at > DRAIN_S):
                return
        else:
            on_line(line)


def _kill(child: Child) -> None:
    if os.name == "nt":
        child.kill()
    else:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
