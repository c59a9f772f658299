"""Fault injection: some calls of each kind (``python fuzz/faults.py`` tries all), what counts as wrong."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz import faults
from fuzz.faults import Ended, damage_of, files_of, judge, numbers_to_try, state_of
from tests.conftest import REPOSITORY
from tests.patience import PATIENCE_S

compiled = pytest.mark.skipif(faults.find_compiler() is None, reason="no C compiler, or not Linux")
SOME = "10000"
"""Every so many-th call besides the first and the last ones."""


@compiled
@pytest.mark.slow
def test_whatever_fails_the_folder_is_old_or_new_and_the_cause_is_named() -> None:
    """Calls of each kind, and of each some."""
    rows = tried("register", SOME, *faults.KINDS, once=True)
    assert [row[1] for row in rows] == list(faults.KINDS)
    assert [row[1] for row in rows if not int(row[4]) >= min(6, int(row[3])) > 0] == []


def folder(top: Path, files: dict[str, str], *, listed: list[str] | None = None) -> Path:
    out = top / "out"
    out.mkdir(parents=True)
    for name, text in files.items():
        (out / name).write_text(text)
    names = sorted([*files, "report.json"]) if listed is None else listed
    (out / "report.json").write_text(json.dumps({"outputs": names, "made of": files}))
    return top


def test_a_folder_between_old_and_new_is_recognised(tmp_path: Path) -> None:
    old = folder(tmp_path / "old", {"a": "old", "b": "old"})
    assert state_of(folder(tmp_path / "same", {"a": "old", "b": "old"}), old) == "old"
    assert state_of(folder(tmp_path / "new", {"a": "new", "b": "new"}), old) == "new"
    missing = folder(tmp_path / "missing", {"a": "new"}, listed=["a", "b", "report.json"])
    assert "report.json and its files differ: ['b']" in state_of(missing, old)
    staged = folder(tmp_path / "staged", {"a": "old", "b": "old"})
    (staged / ".out.stage-host-1").mkdir()
    assert state_of(staged, old) == "left behind: .out.stage-host-1"


def test_a_new_file_that_is_not_whole_is_recognised(tmp_path: Path) -> None:
    new = folder(tmp_path / "new", {"a": "new", "b": "new"})
    undisturbed = files_of(new)
    assert damage_of(new, undisturbed) is None
    (new / "out" / "b").write_text("ne")
    assert damage_of(new, undisturbed) == "damaged: out/b"


@pytest.mark.parametrize(
    ("status", "said", "state", "wrong"),
    [
        (0, "", "new", None),
        (0, "warning: a band is empty\n", "new", None),
        (2, "error: cannot write out: Input/output error\n", "old", None),
        (2, "error: cannot write out\n", "old", "the cause is not named"),
        (2, "error: Input/output error\nerror: again\n", "old", "2 lines"),
        (2, "Input/output error\n", "old", "1 lines"),
        (1, "error: unexpected OSError\n", "old", "exit status 1"),
        (-11, "", "old", "exit status -11"),
        (0, "ERROR 1: something\n", "new", "says ERROR 1"),
        (0, "", "old", "exit status 0 with the old results"),
        (2, "error: Input/output error\n", "left behind: .x", "left behind"),
    ],
)
def test_a_wrong_end_is_recognised(status: int, said: str, state: str, wrong: str | None) -> None:
    found = judge(Ended(status, 1, said), state, "open")
    assert [each.startswith(wrong) for each in found] == [True] if wrong else not found


@pytest.mark.parametrize(
    ("said", "wrong"),
    [
        ("warning: b10.tif (line 2): unusable: cannot write out: Input/output error\n", None),
        ("error: cannot write summary.csv: Input/output error\n", None),
        ("warning: b10.tif (line 2): unusable: cannot write out\n", "the cause is not named"),
        ("warning: narrow overlap\n", "0 lines"),
    ],
)
def test_what_batch_says_of_its_pair_counts(said: str, wrong: str | None) -> None:
    found = judge(Ended(2, 1, said), "old", "open", "batch")
    assert [each.startswith(wrong) for each in found] == [True] if wrong else not found


@compiled
@pytest.mark.slow
@pytest.mark.parametrize("command", ["match", "warp", "batch"])
def test_other_commands_leave_the_old_results_or_the_new(command: str) -> None:
    rows = tried(command, SOME, "rename", "fsync")
    assert [row[1] for row in rows] == ["rename", "rename", "fsync", "fsync"]


@compiled
@pytest.mark.slow
def test_a_raster_lacks_no_block_for_which_there_was_no_memory() -> None:
    (once, _) = tried("warp", "5", "allocation")
    assert int(once[4]) > 10


def tried(command: str, every: str, *kinds: str, once: bool = False) -> list[list[str]]:
    """Let calls of a command fail; return the rows of the table, all of which must be without violation."""
    order = [sys.executable, REPOSITORY / "fuzz" / "faults.py", "--every", every, "--command", command]
    order += ["--once"] if once else []
    ended = subprocess.run(
        [*order, *(word for kind in kinds for word in ("--kind", kind))],
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        timeout=10 * PATIENCE_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return [line.split() for line in ended.stdout.splitlines() if line.startswith(command)]


def test_gdal_may_end_the_process_where_memory_lacks_if_the_old_results_stay() -> None:
    assert not judge(Ended(-6, 1, ""), "old", "allocation")
    assert not judge(Ended(-11, 1, ""), "old", "allocation")
    assert judge(Ended(-6, 1, ""), "new", "allocation")
    assert judge(Ended(-6, 1, ""), "old", "open")


def test_the_first_and_the_last_calls_are_always_tried() -> None:
    assert list(numbers_to_try(20, 8)) == [1, 2, 3, 9, 17, 18, 19, 20]
    assert list(numbers_to_try(2, 1)) == [1, 2]
    assert list(numbers_to_try(0, 1)) == []
