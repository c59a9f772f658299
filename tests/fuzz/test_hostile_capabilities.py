"""Kept inputs that made stacks, rigs, edit, warp and start matchers fail: each ends with a sentence."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import pytest

from tests.patience import PATIENCE_S

CORPUS: Final = Path(__file__).resolve().parents[2] / "fuzz" / "corpus"
CASES: Final = sorted((CORPUS / "capabilities").glob("*/case.json"))
MAX_BYTES: Final = 3 * 2**30
"""Of memory that a run may have in use."""
MEASURED: Final = """
import resource, subprocess, sys
ended = subprocess.run([sys.executable, "-m", "pcwlad_geo", *sys.argv[2:]])
open(sys.argv[1], "w").write(str(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss))
sys.exit(ended.returncode)
"""
"""Runs the command line and writes down its peak of memory, KiB."""
OUTPUTS: Final = ("o/", "series/")
"""Folders that a run writes to; the second is a finished stack to which images are added."""


@pytest.mark.slow
@pytest.mark.gate
@pytest.mark.parametrize("file", CASES, ids=lambda file: file.parent.name)
def test_hostile_capabilities_end_with_a_sentence(file: Path, tmp_path: Path) -> None:
    case: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    folder = tmp_path / "run"
    _lay_out(case, file.parent, folder)
    before = _content(folder)
    runs = [case["argv"], *([case["argv2"]] if "argv2" in case else [])]
    started = [_start(argv, case, folder, tmp_path / f"peak{number}") for number, argv in enumerate(runs)]
    for number, run in enumerate(started):
        out, err = run.communicate(timeout=PATIENCE_S)
        assert run.returncode in (0, 2, 3, 4), err
        assert "Traceback" not in out + err
        said = [line for line in err.splitlines() if line.startswith("error: ")]
        assert run.returncode in (0, 4) or said or '"event": "error"' in out
        assert int((tmp_path / f"peak{number}").read_text()) * 1024 <= MAX_BYTES
    after = _content(folder)
    assert {name: after.get(name) for name in before} == before  # nothing that was read has changed
    if "argv2" in case:  # the one that came second was refused, and nothing of the first is lost
        assert sorted(run.returncode for run in started) in ([0, 2], [0, 0])
        added = json.loads((folder / "series" / "stack.json").read_text(encoding="utf-8"))["images"]
        assert len(added) == 2 + sum(run.returncode == 0 for run in started)


def _lay_out(case: dict[str, Any], kept: Path, folder: Path) -> None:
    shutil.copytree(kept, folder, ignore=shutil.ignore_patterns("case.json"))
    for stored, name in case.get("names", {}).items():
        (folder / stored).rename(folder / name)
    for name, seed in case.get("seeds", {}).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(CORPUS / "seeds" / seed, folder / name)
    if "make" in case and subprocess.run(case["make"].split(), cwd=folder, check=False).returncode:
        pytest.skip(f"{case['make']}: not permitted here")


def _start(argv: list[str], case: dict[str, Any], folder: Path, peak: Path) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    with (folder / case["stdin"] if "stdin" in case else Path(os.devnull)).open("rb") as stdin:
        return subprocess.Popen(
            [sys.executable, "-c", MEASURED, str(peak), *argv],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": path} if "env" in case else None,
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        )


def _content(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    named = ((path.relative_to(folder).as_posix(), path) for path in files)
    return {name: path.read_bytes() for name, path in named if not name.startswith(OUTPUTS)}
