"""The results of a batch: whether they are whole, and their bytes without the times that they tell."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Final

_SECONDS: Final = re.compile(r"(seconds, [a-z ]+</dt><dd>)[^<]*")
_LOST: Final = "a worker process was lost"
_TOLD_LOST: Final = re.compile(rf"<li[^>]*>(?:(?!</li>).)*{_LOST}(?:(?!</li>).)*</li>\s*", re.DOTALL)


def complaints(folder: Path) -> list[str]:
    """Return what is wrong with the folders of pairs: each is complete, or not there."""
    found = []
    for pair in sorted(path for path in folder.glob("*") if path.is_dir() and not path.name.startswith(".")):
        try:
            report = json.loads((pair / "report.json").read_text(encoding="utf-8"))
            missing = [name for name in report["outputs"] if not (pair / name).is_file()]
        except (OSError, ValueError, KeyError) as error:
            found.append(f"{pair.name}: {type(error).__name__}: {error}")
            continue
        found += [f"{pair.name}: {name} is missing" for name in missing]
    return found


def content_of(folder: Path) -> dict[str, bytes]:
    """Return the files of a batch by name, without times, and without what tells of lost workers."""
    return {
        path.relative_to(folder).as_posix(): _timeless(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _timeless(path: Path) -> bytes:
    data = path.read_bytes()
    if path.name == "report.json":
        report = json.loads(data)
        report["seconds"] = None
        report["warnings"] = [each for each in report["warnings"] if _LOST not in each]
        return json.dumps(report).encode()
    if path.name == "rig_apply.json":
        captures = json.loads(data)["captures"]
        return json.dumps([{**each, "seconds": None} for each in captures]).encode()
    if path.name == "report.html":
        text = _TOLD_LOST.sub("", _SECONDS.sub(r"\1", data.decode("utf-8")))
        return re.sub(r"\s+", " ", text).encode()
    if path.name == "summary.csv":
        rows = list(csv.DictReader(io.StringIO(data.decode("utf-8"))))
        aside = ("seconds", "done_before", "warnings")
        return json.dumps([{k: v for k, v in row.items() if k not in aside} for row in rows]).encode()
    return data
