#!/usr/bin/env python3
"""Add the site of this checkout to the branch gh-pages, beside those of other versions.

    scripts/publish_site.py                  as `dev`
    scripts/publish_site.py --tag v1.2.3     as `1.2`, and as `latest` where no later release is there

A pre-release (v1.3.0rc1) becomes `latest` only where there is no other. The root of the site leads to
`latest`, before there is one to `dev`. Nothing is pushed: .github/workflows/docs.yml does that. Needs the
extra `docs` of the package, and git.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from packaging.version import Version

HERE = Path(__file__).resolve().parents[1]
LATEST = "latest"


def main(arguments: Sequence[str] | None = None) -> int:
    """Build the site and commit it to the branch."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tag", help="vX.Y.Z of a release (default: the site of the main branch)")
    parser.add_argument("--folder", type=Path, default=HERE, help="the checkout (default: this one)")
    asked = parser.parse_args(arguments)
    listed = json.loads(_mike(asked.folder, "list", "--json") or "[]")
    titles = {each["version"]: each["title"] for each in listed}
    latest = next((each["version"] for each in listed if LATEST in each["aliases"]), None)
    names = names_of(asked.tag, titles, latest)
    title = ["--title", asked.tag.removeprefix("v")] if asked.tag else []
    _mike(asked.folder, "deploy", "--update-aliases", *title, *names)
    if latest is None:
        _mike(asked.folder, "set-default", names[-1])
    print("published as", *names)
    return 0


def names_of(tag: str | None, titles: Mapping[str, str], latest: str | None) -> list[str]:
    """Return the folder of the site, and the alias that is to lead there.

    Parameters
    ----------
    tag : str or None
        Of the release, ``vX.Y.Z``.
    titles : mapping
        Full version of each folder that is published.
    latest : str or None
        The folder to which `LATEST` leads now.
    """
    if tag is None:
        return ["dev"]
    version = Version(tag)
    name = f"{version.major}.{version.minor}"
    newest = (
        latest is None
        or latest == name
        or (
            version > Version(titles[latest])
            and (not version.is_prerelease or Version(titles[latest]).is_prerelease)
        )
    )
    return [name, *[LATEST] * newest]


def _mike(folder: Path, *words: str) -> str:
    """Run mike; a failure ends the program. A branch that is not there yet has no versions."""
    command = [sys.executable, "-c", "from mike.driver import main; main()", *words]
    # mike runs `mkdocs`, which lies beside this Python
    beside = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PATH": beside}
    return subprocess.run(
        command, cwd=folder, env=environment, check=True, stdout=subprocess.PIPE, text=True
    ).stdout


if __name__ == "__main__":
    sys.exit(main())
