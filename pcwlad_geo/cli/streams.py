"""The standard streams of a run: each for the command's own words, whatever libraries write to it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import TextIO


@contextmanager
def protocol_stream() -> Iterator[TextIO]:
    """Keep the real standard output for the protocol and point file descriptor 1 at standard error.

    So a stray print, of Python or of a C library, cannot corrupt the protocol.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    stream = os.fdopen(os.dup(kept), "w", encoding="utf-8", newline="\n")
    os.dup2(2, 1)
    try:
        yield stream
    finally:
        with suppress(BrokenPipeError):  # the reader has gone: that was found before
            stream.close()
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)


def own_standard_error() -> TextIO:
    """Take standard error for the command's own lines, and point file descriptor 2 at nothing.

    Libraries talk there in every way: Python's log lines and warnings (matplotlib on its cache of fonts), C
    libraries (fontconfig), programs that they start (fc-list). What matters of it arrives as an exception.
    Processes started from now on are as silent. It stays so to the end of the process: a thread that loads a
    library may outlive the run.

    Returns
    -------
    TextIO
        The real standard error; or ``sys.stderr`` as it is, with nothing changed, where that is no file
        descriptor 2: it is closed, or a program that runs the command inside itself has put its own there.
    """
    return _take_standard_error() if _is_descriptor_2(sys.stderr) else sys.stderr


@cache
def _take_standard_error() -> TextIO:
    sys.stderr.flush()
    encoding, errors = sys.stderr.encoding, sys.stderr.errors
    taken = open(os.dup(2), "w", buffering=1, encoding=encoding, errors=errors)  # noqa: PTH123, SIM115
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    os.close(nothing)
    return taken


def _is_descriptor_2(stream: TextIO | None) -> bool:
    try:
        return stream is not None and stream.fileno() == 2 and os.fstat(2) is not None
    except (OSError, ValueError):  # closed, or in memory
        return False
