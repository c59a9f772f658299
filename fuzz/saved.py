"""Inputs that have failed, kept as folders: `case.json` and the files, in a folder to run the command in."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from fuzz.cases import Case
from fuzz.fork_server import put_files
from fuzz.judge import Failure
from fuzz.orders import Outcome

FILES: Final = "files"


def save(folder: Path, case: Case, outcome: Outcome, failures: Sequence[Failure]) -> Path:
    """Keep an input; return its folder."""
    kind = re.sub(r"\W+", "_", failures[0].label)[:50].strip("_")
    number = re.sub(r"\W+", "_", case.name)[:40].strip("_")
    place = folder / f"{kind}_{hashlib.sha256(failures[0].label.encode()).hexdigest()[:4]}" / number
    place.mkdir(parents=True, exist_ok=True)
    put_files(case, place / FILES)
    said: dict[str, Any] = outcome.to_json()
    values = {
        "case": case.name,
        "argv": case.argv,
        "command": shlex.join(["pcwlad-geo", *case.argv]),
        "edits": case.edits,
        "places": case.places,
        "out_dir": case.out_dir,
        "failures": [failure.label for failure in failures],
        **{
            name: said[name]
            for name in ("status", "signal", "ended", "seconds", "peak_mb", "stderr", "where")
        },
    }
    (place / "case.json").write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    return place


def read_saved(folder: Path) -> Case:
    """Return a kept input, with the figures of its report drawn."""
    values = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    inside = folder / FILES
    plain = sorted(path for path in inside.rglob("*") if path.is_file() and not path.is_symlink())
    files = {path.relative_to(inside).as_posix(): path.read_bytes() for path in plain}
    files = {name: data for name, data in files.items() if name not in values["places"]}
    return Case(
        values["case"],
        tuple(values["argv"]),
        files,
        values["places"],
        tuple(values["edits"]),
        values["out_dir"],
    )
