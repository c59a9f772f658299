"""Processes of this Python that this one starts: how, and how they have ended."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from typing import Final

_POOLS: Final = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "VECLIB_MAXIMUM", "GDAL_NUM")
ONE_THREAD: Final = dict.fromkeys((f"{pool}_THREADS" for pool in _POOLS), "1")
"""Environment of a child: there is one a core at most, so its libraries must not start threads."""


def python_command(statement: str, *arguments: str) -> list[str]:
    """Return the command that executes a statement in a new interpreter with the import path of this one.

    It does not import the main module of this process, so scripts need no guard for that. The `arguments`
    are in ``sys.argv[1:]`` there.
    """
    code = f"import sys; n = {len(arguments) + 1}; sys.path[:] = sys.argv[n:]; del sys.argv[n:]; {statement}"
    return [sys.executable, "-c", code, *arguments, *map(str, sys.path)]


def child_environment() -> dict[str, str]:
    """Return the environment of a child: that of this process, with one thread a library."""
    return {**os.environ, **ONE_THREAD}


def how_it_was_lost(status: int) -> str:
    """Return why a process has ended that should not, and what to do, by its exit status.

    That is minus the signal, if one has ended it.
    """
    if status >= 0:
        return f"its process has ended with exit status {status}; run it again, and report it if that recurs"
    name = f"signal {-status}"
    with suppress(ValueError):
        name = signal.Signals(-status).name
    if name == "SIGKILL":
        return "it was killed (SIGKILL), as systems do where memory runs out: give fewer --jobs"
    return (
        f"a library has crashed ({name}), most likely on a damaged file: read each input as a whole "
        "(gdalinfo -checksum FILE), and get the one again that cannot be read"
    )
