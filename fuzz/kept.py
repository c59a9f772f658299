"""The kept corpus: small seeds, and inputs that have made the command fail before."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Final

from fuzz.recipes import OUT

FOLDER: Final = Path(__file__).resolve().parent / "corpus"
SEEDS: Final = FOLDER / "seeds"
HOSTILE: Final = FOLDER / "hostile"


@dataclass(frozen=True, slots=True)
class Reproducer:
    """A kept input, as it is run: in a folder that holds its files, the seeds in `../seed`."""

    name: str
    argv: tuple[str, ...]
    files: dict[str, bytes] = field(repr=False)
    """Content by path from the folder it is run in."""
    places: Mapping[str, str] = field(default_factory=dict)
    """What is in the place of a file, by path: one of `fuzz.cases.PLACES`."""
    out_dir: str = OUT


@cache
def seed(name: str) -> bytes:
    """Return the content of a seed."""
    return (SEEDS / name).read_bytes()


@cache
def reproducers(folder: Path = HOSTILE) -> tuple[Reproducer, ...]:
    """Return the kept inputs of a folder with a `cases.json`; none where there is no such folder.

    Files of the seeds are put beside those of the case: `../seed/ref.tif` becomes `ref.tif`.
    """
    listed = folder / "cases.json"
    if not listed.is_file():
        return ()
    found = []
    for case in json.loads(listed.read_text(encoding="utf-8")):
        own = folder / case["case"]
        files = {file.relative_to(own).as_posix(): file.read_bytes() for file in _files(own)}
        argv = []
        for argument in case["argv"]:
            path = PurePosixPath(argument)
            if argument.startswith("../seed/") and (folder / "seed" / path.name).is_file():
                files[path.name] = (folder / "seed" / path.name).read_bytes()
                argument = path.name
            argv.append(argument)
        found.append(
            Reproducer(case["case"], tuple(argv), files, case.get("places", {}), case.get("out_dir", OUT))
        )
    return tuple(found)


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())
