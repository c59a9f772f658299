"""Entry point of ``pcwlad-geo`` and ``python -m pcwlad_geo``."""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress


def main() -> None:
    """Run the command line and exit with its status."""
    # before numpy loads: what a job solves is small, and threads that wait for it hinder its processes
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # a search for cycles among all that the libraries leave takes a fifth of a second: once in many jobs
    gc.set_threshold(50_000, 10, 10)
    try:
        from pcwlad_geo.cli.app import run  # inside: an interrupt during the import ends quietly too

        status = run(sys.argv[1:])
    except KeyboardInterrupt:
        status = 130
    if status == 130:  # somebody waits for the end, and the libraries take up to a second to be taken down
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(status)
    gc.freeze()  # a last search for cycles among all that the libraries leave takes half a second
    sys.exit(status)


if __name__ == "__main__":
    main()
