"""The kept corpus of damaged inputs: every run ends by itself, with one line of error and nothing left."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import pytest

from fuzz.fork_server import put_in_place
from tests.patience import PATIENCE_S

CORPUS: Final = Path(__file__).resolve().parents[2] / "fuzz" / "corpus" / "hostile"
MAX_BYTES: Final = 3 * 2**30
"""Of memory that a run may have in use."""
CASES: Final[list[dict[str, Any]]] = json.loads((CORPUS / "cases.json").read_text(encoding="utf-8"))
MEASURED: Final = """
import resource, subprocess, sys
ended = subprocess.run([sys.executable, "-m", "pcwlad_geo", *sys.argv[2:]])
kib = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
open(sys.argv[1], "w").write(str(kib))
sys.exit(ended.returncode)
"""
"""Runs the command line and writes down its peak of memory, KiB."""


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: str(case["case"]))
def test_hostile_files_are_refused(case: dict[str, Any], tmp_path: Path) -> None:
    for name in (case["case"], "seed"):
        shutil.copytree(CORPUS / name, tmp_path / name)
    for name, kind in case.get("places", {}).items():
        place = tmp_path / case["case"] / name
        place.parent.mkdir(exist_ok=True)
        put_in_place(place, kind)
    scratch, peak = tmp_path / "scratch", tmp_path / "peak"
    scratch.mkdir()
    before = _content(tmp_path / case["case"])
    ended = subprocess.run(
        [sys.executable, "-c", MEASURED, str(peak), *case["argv"]],
        cwd=tmp_path / case["case"],
        env={**os.environ, "TMPDIR": str(scratch)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert ended.returncode in (0, 2, 3), ended.stderr
    said = [line for line in ended.stderr.splitlines() if not line.startswith("warning: ")]
    told_in_table = case["argv"][0] == "batch" and bool(ended.stdout.strip()) and not said
    assert told_in_table or len(said) == (0 if ended.returncode == 0 else 1), ended.stderr
    assert all(line.startswith("error: ") for line in said)
    assert int(peak.read_text()) * 1024 <= MAX_BYTES
    after = _content(tmp_path / case["case"])
    after = {name: data for name, data in after.items() if not name.startswith("o/")}
    assert after == before  # nothing beside the input, and the input as it was
    assert not list(scratch.iterdir())


def _content(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
