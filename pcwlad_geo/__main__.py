"""Entry point of ``pcwlad-geo`` and ``python -m pcwlad_geo``."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line and exit with its status."""
    try:
        from pcwlad_geo.cli.app import run  # inside: an interrupt during the import ends quietly too

        status = run(sys.argv[1:])
    except KeyboardInterrupt:
        status = 130
    sys.exit(status)


if __name__ == "__main__":
    main()
