"""Fresh interpreters for workers: libraries on one thread, out of reach of the terminal's interrupts."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.registration.worker import ONE_THREAD


def start_interpreter(statement: str, arguments: Sequence[str], **options: Any) -> subprocess.Popen[bytes]:  # noqa: ANN401
    """Start this Python anew, with the same places to import from.

    Parameters
    ----------
    statement : str
        What it does; it finds `arguments` in ``sys.argv[1:]``.
    arguments : sequence of str
    **options
        Of `subprocess.Popen`.

    Raises
    ------
    ExecutionError
        If it cannot be started.
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
