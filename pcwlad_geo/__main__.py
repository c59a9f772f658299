"""Entry point of ``pcwlad-geo`` and ``python -m pcwlad_geo``."""

from __future__ import annotations

import os
import sys
from contextlib import suppress


def main() -> None:
    """Run the command line and exit with its status."""
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
    sys.exit(status)


if __name__ == "__main__":
    main()
